"""A finished result is opened, or written for the Rerun viewer, or it is said why not."""

import webbrowser
from importlib.util import find_spec

import numpy as np
import pytest

import mapweave
from mapweave.io.finished import read_finished

needs_rerun = pytest.mark.skipif(find_spec("rerun") is None, reason="the extra [viewer] is not installed")


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view")
    mapweave.simulate_landmarks(folder / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.map(folder / "team", folder / "out")
    return folder / "out"


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")


def test_a_finished_result_holds_its_ways_and_landmarks(result):
    (part,) = read_finished(result)
    assert list(part.tracks) == ["robot1", "robot2"]
    assert part.tracks["robot1"].cov is not None
    assert len(part.landmarks) > 5
    assert part.walls is None


def test_without_a_display_the_report_is_named(result, no_display):
    assert mapweave.view(result) == [f"report: {result / 'report.html'}"]


def test_with_a_display_the_report_is_opened(result, monkeypatch):
    opened = []
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", opened.append)
    assert mapweave.view(result) == [f"opened {result / 'report.html'}"]
    assert opened == [(result / "report.html").resolve().as_uri()]
    assert mapweave.view(result, browser=False) == [f"report: {result / 'report.html'}"]


def test_a_viewer_that_cannot_start_is_an_error(result, no_display):
    told = "no display" if find_spec("rerun") else "install mapweave with the extra"
    with pytest.raises(mapweave.MapweaveError, match=told):
        mapweave.view(result, rerun=True)


@needs_rerun
def test_a_recording_is_written(result, tmp_path, no_display):
    assert mapweave.view(result, save=tmp_path / "map.rrd") == [f"wrote {tmp_path / 'map.rrd'}"]
    held = (tmp_path / "map.rrd").read_bytes()
    assert held[:4] == b"RRF2"
    assert len(held) > 20_000


def swarm(folder):
    rows = [
        f"{t},{a},{b},{np.arctan2(y - v, x - u + 0.1 * t * (b == 'c')):.6f}"
        for t in range(4)
        for a, u, v in (("a", 0, 0), ("b", 9, 0))
        for b, x, y in (("a", 0, 0), ("b", 9, 0), ("c", 4, 5))
        if a != b
    ]
    (folder / "s.csv").write_text("\n".join(["t,observer,target,bearing", *rows]) + "\n")
    mapweave.locate(folder / "s.csv", folder / "out", anchors={"a": (0, 0), "b": (9, 0)}, sigma=0.01)


def graph(folder):
    rows = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(4)]
    rows += [f"EDGE_SE2 {a} {b} {b - a} 0 0 9 0 0 9 0 9" for a, b in ((0, 1), (1, 2), (2, 3), (0, 3))]
    (folder / "g.g2o").write_text("\n".join(rows) + "\n")
    mapweave.solve_pose_graph(folder / "g.g2o", folder / "out")


def field(folder):
    mapweave.explore("yuan", folder / "out", until=2)


def fused(folder):
    mapweave.simulate_landmarks(folder / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    mapweave.map(folder / "team", folder / "a", refine=False)
    mapweave.fuse(folder / "a", out=folder / "out")


@needs_rerun
@pytest.mark.filterwarnings("error:(send_columns|log)")  # what Rerun leaves out it warns of
@pytest.mark.parametrize(
    ("made", "held"),
    [
        (swarm, lambda part: (len(part.swarm.positions.ids), len(part.swarm.pairs) > 0, list(part.swarm.ways)[-1])),
        (graph, lambda part: (part.closures.ends.tolist(), part.closures.accepted.tolist())),
        (field, lambda part: (sorted(part.true_tracks), len(part.true_landmarks) > 9)),
        (fused, lambda part: (sorted(part.tracks), [line[:16] for line in part.decisions])),
    ],
)
def test_results_of_every_kind_have_something_to_show(tmp_path, made, held):
    made(tmp_path)
    part = read_finished(tmp_path / "out")[0]
    assert (
        held(part)
        == {
            swarm: (3, True, "c"),
            graph: ([[0.0, 0.0, 3.0, 0.0]], [True]),
            field: (["robot1", "robot2"], True),
            fused: (["a/robot1", "a/robot2"], ["robot a/robot1: ", "robot a/robot2: "]),
        }[made]
    )
    assert mapweave.view(tmp_path / "out", save=tmp_path / "map.rrd") == [f"wrote {tmp_path / 'map.rrd'}"]
    assert (tmp_path / "map.rrd").stat().st_size > 5_000


@needs_rerun
def test_a_recording_that_cannot_be_written_is_one_error(result, tmp_path):
    with pytest.raises(mapweave.MapweaveError):
        mapweave.view(result, save=tmp_path / "nowhere" / "map.rrd")


def test_a_folder_that_is_no_result_is_refused(tmp_path):
    with pytest.raises(mapweave.ReaderError):
        mapweave.view(tmp_path, save=tmp_path / "map.rrd")
