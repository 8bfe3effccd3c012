"""`mapweave map` on laser logs: the files of the contract, several logs, bad input from one end to the other."""

import json
import sys
import warnings
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from mapweave.api import map as verb
from mapweave.api import map_laser as lasers
from mapweave.api.map import map as map_logs
from mapweave.api.map_options import LaserOptions
from mapweave.cli import _run
from mapweave.core.errors import MapweaveError, UsageError
from mapweave.io.g2o import read_g2o
from mapweave.io.laser_logs import read_laser
from mapweave.io.laser_map import read_grid
from mapweave.io.robot_graph import read_robot_graph
from mapweave.io.table import read_table
from mapweave.io.tum import read_tum

from ..caches import own_cache
from ..io.ros_logs import Recording, wall

OWN = ("map.pgm", "map.yaml", "intensity.png", "scans.csv", "pose_graph.g2o", "grid.npz")
FEW = ["--particles", "8"]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "ring.mcap"
    assert (
        _run(["simulate", "corridor", "--out", str(path), "--distance", "15", "--start", "46", "--end-error", "0,0"])
        == 0
    )
    return path


@pytest.fixture(scope="module")
def mapped(log, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "map"
    assert _run(["map", str(log), "--out", str(out), "--truth", str(log.with_suffix(".truth.tum")), *FEW]) == 0
    return out


def test_every_file_of_the_contract_is_there_and_the_only_robots_own_stand_at_the_top(mapped):
    for name in OWN:
        assert (mapped / "local" / "robot1" / name).read_bytes() == (mapped / name).read_bytes()
    assert (mapped / "report.html").is_file()
    assert sorted(p.name for p in (mapped / "figures").iterdir())


def test_there_is_a_pose_at_every_odometry_and_every_scan_stamp(mapped, log):
    track, stamps = read_tum(mapped / "trajectories" / "robot1.tum"), read_laser(log).stamps()
    assert np.allclose(track.t, stamps, atol=1e-6)
    assert np.allclose(track.pose[0], 0, atol=1e-9)


def test_scans_grid_and_pose_graph_tell_of_the_same_scans(mapped):
    table, graph = read_table(mapped / "scans.csv"), read_g2o(mapped / "pose_graph.g2o")
    assert len(table) == 61
    assert len(graph) == len(read_robot_graph(mapped / "robot_graph.npz")) > 20
    grid, calibration, feature = read_grid(mapped / "grid.npz")
    assert (feature, calibration is not None) == ("normalised", True)
    assert (grid.weight > 0).sum() > 200


def test_metrics_hold_the_keys_of_the_contract_and_the_score(mapped):
    metrics = json.loads((mapped / "metrics.json").read_text())
    assert {"version", "seed", "robots", "components", "fusion", "timing", "evaluation"} <= set(metrics)
    robot = metrics["robots"]["1"]
    assert {"source", "odometry", "sightings", "dropped", "down_weighted", "nis_median", "warnings", "verdict"} <= set(
        robot
    )
    assert (robot["method"], robot["feature"], robot["particles"], robot["sightings"]) == (
        "graph",
        "normalised",
        8,
        61,
    )
    assert metrics["evaluation"]["robots"]["1"]["ate"] < 0.1
    assert metrics["components"] == [["1"]]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_files_and_only_timing_differs(mapped, log, tmp_path):
    out = tmp_path / "again"
    assert _run(["map", str(log), "--out", str(out), "--truth", str(log.with_suffix(".truth.tum")), *FEW]) == 0
    for name in ("trajectories/robot1.tum", *OWN):
        assert (out / name).read_bytes() == (mapped / name).read_bytes(), name
    a, b = (json.loads((d / "metrics.json").read_text()) for d in (out, mapped))
    assert {**a, "timing": 0} == {**b, "timing": 0}


@pytest.mark.slow
def test_the_graph_method_leaves_its_graph_its_closures_and_covariances(log, tmp_path):
    out = tmp_path / "graph"
    assert _run(["map", str(log), "--out", str(out), "--method", "graph", "--no-loops", "--particles", "5"]) == 0
    robot = json.loads((out / "metrics.json").read_text())["robots"]["1"]
    assert (robot["method"], robot["particles"]) == ("graph", 5)
    stamps = [line.split()[0] for line in (out / "trajectories" / "robot1.tum").read_text().splitlines()]
    rows = [line.split(",") for line in (out / "trajectories" / "robot1.cov.csv").read_text().splitlines()]
    assert rows[0] == ["t", "xx", "xy", "yy", "xt", "yt", "tt"]
    assert [row[0] for row in rows[1:]] == stamps
    assert len((out / "closures.csv").read_text().splitlines()) == 1
    graph = read_robot_graph(out / "local" / "robot1" / "robot_graph.npz")
    assert len(read_g2o(out / "pose_graph.g2o")) == len(graph) > 2
    assert graph.log_hash == robot["log_hash"]


@pytest.mark.slow
def test_several_logs_are_mapped_each_on_its_own_whatever_the_number_of_processes(tmp_path):
    logs = [str(rolling(tmp_path / "a.mcap")), str(rolling(tmp_path / "b.bag", 12))]
    outs = [tmp_path / "one", tmp_path / "two"]
    for out, jobs in zip(outs, ("1", "2"), strict=True):
        assert _run(["map", *logs, "--out", str(out), "--method", "gated", "--jobs", jobs]) == 0
        assert all((out / "local" / f"robot{k}" / name).is_file() for k in (1, 2) for name in OWN)
        assert not (out / "map.pgm").exists()
    for name in ("trajectories/robot1.tum", "trajectories/robot2.tum", "local/robot2/grid.npz"):
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes()
    assert json.loads((outs[0] / "metrics.json").read_text())["components"] == [["1"], ["2"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "feature", "near"),
    [
        ("icp", "normalised", 0.3),
        ("icp", "none", 0.6),
        ("particle", "raw", 1.0),
        ("gated", "none", 0.5),
        ("particle", "normalised", 0.15),
        ("particle", "none", 0.5),
    ],
)
def test_methods_and_features_can_be_chosen_and_stay_near_the_truth(log, method, feature, near):
    result = map_logs(
        log,
        method=method,
        laser=LaserOptions(particles=8, feature=feature),
        truth=log.with_suffix(".truth.tum"),
        share={"1": 0.5},
    )
    made = result.maps[0]
    assert (made.method, made.feature) == (method, feature)
    assert made.scans.t[-1] - made.scans.t[0] == pytest.approx(15.0)
    assert result.metrics["evaluation"]["robots"]["1"]["ate"] < near


def rolling(path, n=16, *, odometry=True, light=1.0, spoil=None):
    """A robot creeping towards a curved wall; `spoil(k, ranges)` may damage scan k."""
    out = Recording(path)
    for k in range(n):
        if odometry:
            out.odom(1 + 0.1 * k, -0.01 * k)
        ranges = wall(k, 180)
        ranges = ranges if spoil is None else spoil(k, ranges)
        out.scan(1 + 0.1 * k, ranges, light * (1000 + 100 * np.arange(len(ranges)) % 700))
    return out.write()


SPOILED = {
    "no odometry": ({"odometry": False}, "no odometry"),
    "intensities all zero": ({"light": 0.0}, "all intensities are 0"),
    "scans without returns": ({"spoil": lambda k, r: np.full_like(r, np.inf) if k in {0, 7, 15} else r}, "no return"),
    "NaN and zero ranges": (
        {"spoil": lambda k, r: np.where(np.arange(len(r)) % 9 == k % 9, [np.nan, 0.0][k % 2], r)},
        "not a number",
    ),
    "changing beam counts": ({"spoil": lambda k, r: r[: 180 - 60 * (k % 2)]}, "beam count changes"),
    "only empty scans": ({"spoil": lambda k, r: np.zeros_like(r)}, "no scan of 16 has a return"),
}


@pytest.mark.parametrize("case", sorted(SPOILED))
@pytest.mark.parametrize("method", ["icp", "gated", "particle", "graph"])
def test_a_spoiled_log_is_mapped_all_the_same_and_says_what_was_wrong(tmp_path, case, method):
    how, told = SPOILED[case]
    path = rolling(tmp_path / "a.mcap", **how)
    made = map_logs(path, method=method, laser=LaserOptions(particles=8)).maps[0]
    assert any(told in warning for warning in made.warnings), made.warnings
    assert len(made.scans) == 16
    assert np.isfinite(made.track.pose).all()
    assert np.isfinite(made.scans.pose).all()


def test_options_of_laser_logs_are_refused_for_other_logs(log, monkeypatch):
    other = ModuleType("mapweave.api.map_other")
    other.applies = lambda path: True
    monkeypatch.setitem(sys.modules, other.__name__, other)
    monkeypatch.setattr(verb, "MAPPERS", (other.__name__,))
    with pytest.raises(UsageError, match="--particles, --mirrored: only for laser logs"):
        map_logs(log, laser=LaserOptions(particles=5, mirrored=True))


def test_a_topic_that_is_not_there_and_a_method_nobody_knows_are_told(log, tmp_path, capsys):
    assert _run(["map", str(log), "--out", str(tmp_path / "o"), "--scan-topic", "/front"]) == 1
    assert "no scan topic '/front'; there are" in capsys.readouterr().err
    assert _run(["map", str(log), "--out", str(tmp_path / "o"), "--method", "magic"]) == 2
    assert "expected one of particle, graph, gated, icp, found 'magic'" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_progress_tells_of_reading_and_of_every_scan(log):
    told = []
    map_logs(
        log,
        method="gated",
        share={"1": 0.2},
        on_progress=lambda stage, done, total=None: told.append((stage, done, total)),
    )
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert stages[0] == "robot1: reading"
    assert ("robot1: reading", 1, 1) in told
    assert len(stages) > 1
    assert told[-1][1] == told[-1][2] == 13


def test_one_robot_of_several_logs_can_be_asked_for(log):
    made = map_logs([log, log], robots=["2"], method="gated", share={"2": 0.2})
    assert [m.robot for m in made.maps] == ["2"]
    scans = made.maps[0].scans
    assert np.isnan(scans.n_eff).all()  # one hypothesis has no weights, and nothing to draw anew
    assert not scans.resampled.any()
    assert replace(made.maps[0], timing={}).scans.t[-1] < 1000.0 + 0.21 * 30


def test_robots_that_were_mapped_before_the_run_broke_off_are_not_mapped_again(log, monkeypatch, tmp_path):
    monkeypatch.setattr("mapweave.io.kept.LEAST", 0.0)
    monkeypatch.setenv("MAPWEAVE_CACHE_DIR", str(own_cache(tmp_path)))
    mapped, broken, map_laser, metrics = [], [True], lasers.map_laser, lasers.laser_metrics

    def counted(*words):
        mapped.append(words[0].robot)
        return map_laser(*words)

    def full(*words):
        if broken and broken.pop():
            raise OSError(28, "No space left on device", "disk")
        return metrics(*words)

    monkeypatch.setattr(lasers, "map_laser", counted)
    monkeypatch.setattr(lasers, "laser_metrics", full)
    more = {"method": "gated", "share": {"1": 0.1, "2": 0.2}}
    with pytest.raises(MapweaveError, match="disk: No space left") as told:
        map_logs([log, log], **more)
    assert told.value.__notes__ == ["2 finished parts are kept: the same command goes on from there"]
    assert mapped == ["1", "2"]
    again = map_logs([log, log], **more)
    assert mapped == ["1", "2"]
    assert again.maps[1].track.pose.tobytes() == map_logs([log, log], **more).maps[1].track.pose.tobytes()
    assert mapped == ["1", "2"] * 2


@pytest.fixture
def one_scan(tmp_path):
    log = tmp_path / "one.clf"
    log.write_text(f"FLASER 180 {' '.join(['2.5'] * 180)} 0 0 0 0 0 0 12.5 host 12.5\n")
    return log


def test_a_log_of_one_scan_is_drawn_without_a_warning(one_scan, tmp_path):
    with warnings.catch_warnings(action="error"):
        made = map_logs([one_scan], out=tmp_path / "out")
    assert "few-scans" in {f.code for f in made.findings}


def test_an_option_for_recordings_is_told_to_be_idle_where_the_log_is_text(one_scan):
    made = map_logs([one_scan], laser=LaserOptions(scan_topic="/scan", fixes="none"))
    assert [f.value["option"] for f in made.findings if f.code == "option-idle"] == ["--scan-topic", "--fixes"]
