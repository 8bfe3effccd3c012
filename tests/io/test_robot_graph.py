"""A robot's laser graph, written and read again; and files that are none."""

import numpy as np
import pytest

from mapweave.core.errors import ReaderError
from mapweave.io.robot_graph import read_robot_graph, write_robot_graph
from mapweave.laser.beam import IntensityCalibration
from mapweave.laser.closures import Closure
from mapweave.laser.robot_graph import RobotGraph


def graph(*, light=True, n=4):
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 6, n)
    m = int(counts.sum())
    closures = tuple(
        Closure((0, 0), 0, n - 1, ok, reason, rng.normal(size=3), np.eye(3) * 4, rng.normal(size=3), 0.7, nis, 0.8, low)
        for ok, reason, nis, low in ((True, "it fits", 1.5, 0.3), (False, "too few returns", None, None))
    )
    return RobotGraph(
        robot="2",
        t=np.arange(n) + 0.25,
        pose=rng.normal(size=(n, 3)),
        cov=np.tile(np.eye(3), (n, 1, 1)),
        path=np.arange(n, dtype=float),
        step=rng.normal(size=(n - 1, 3)),
        step_information=np.tile(np.eye(3), (n - 1, 1, 1)),
        closures=closures,
        start=np.concatenate([[0], np.cumsum(counts)]),
        points=rng.normal(size=(m, 2)).astype(np.float32),
        normals=rng.normal(size=(m, 2)).astype(np.float32),
        q=rng.random(m).astype(np.float32) if light else None,
        lined=rng.random(m) > 0.5,
        sensor=np.zeros((n, 2)),
        feature="normalised" if light else "none",
        calibration=IntensityCalibration(np.arange(3.0), np.zeros(3), 1.2, 300.0, 0.1, 77, np.ones(3))
        if light
        else None,
        source="a.clf",
        log_hash="abc",
    )


@pytest.mark.parametrize("light", [True, False])
def test_a_written_graph_comes_back_and_the_bytes_are_the_same_each_time(tmp_path, light):
    one = graph(light=light)
    write_robot_graph(tmp_path / "a.npz", one)
    write_robot_graph(tmp_path / "b.npz", read_robot_graph(tmp_path / "a.npz"))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = read_robot_graph(tmp_path / "a.npz")
    for name in ("robot", "feature", "source", "log_hash"):
        assert getattr(back, name) == getattr(one, name)
    for name in ("t", "pose", "cov", "step", "start", "points", "normals", "lined"):
        assert np.array_equal(getattr(back, name), getattr(one, name)), name
    assert (back.q is None) == (not light)
    assert [c.reason for c in back.closures] == ["it fits", "too few returns"]
    assert back.closures[1].nis is None
    assert back.closures[0].runner_up == 0.3
    assert np.array_equal(back.graph().measured, one.graph().measured)
    assert back.graph().edges == len(one)  # n - 1 steps and one closure


def test_what_is_no_graph_is_refused_with_the_reason(tmp_path):
    path = tmp_path / "g.npz"
    with pytest.raises(ReaderError, match="No such file"):
        read_robot_graph(path)
    path.write_bytes(b"hello")
    with pytest.raises(ReaderError, match="expected a laser graph: File is not a zip"):
        read_robot_graph(path)
    write_robot_graph(path, graph())
    whole = dict(np.load(path))
    np.savez(path, **(whole | {"version": np.array(99)}))
    with pytest.raises(ReaderError, match="version 1, found 99"):
        read_robot_graph(path)
    np.savez(path, **(whole | {"pose": whole["pose"][:2]}))
    with pytest.raises(ReaderError, match="pose has shape"):
        read_robot_graph(path)
    np.savez(path, **(whole | {"pose": np.full_like(whole["pose"], np.nan)}))
    with pytest.raises(ReaderError, match="not finite"):
        read_robot_graph(path)
    ends = whole["closure_ends"].copy()
    ends[0, 3] = 40
    np.savez(path, **(whole | {"closure_ends": ends}))
    with pytest.raises(ReaderError, match="closure 0 ties keyframes"):
        read_robot_graph(path)
    np.savez(path, **(whole | {"q": whole["q"].astype(str)}))
    with pytest.raises(ReaderError, match="q has values of the type <U"):
        read_robot_graph(path)
    np.savez(path, **(whole | {"q": whole["q"][:3]}))
    with pytest.raises(ReaderError, match=r"q has shape \(3,\)"):
        read_robot_graph(path)
    np.savez(path, **(whole | {"closure_reason": np.zeros(2)}))
    with pytest.raises(ReaderError, match="closure_reason has values of the type float64"):
        read_robot_graph(path)
