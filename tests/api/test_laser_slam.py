"""Scans that come one by one: the same map as of their log, poses with covariances, bad scans refused."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import ConfigError, DataError
from mapweave.io.robot_graph import read_robot_graph
from mapweave.mapping.config import LaserConfig

CFG = LaserConfig(method="graph")
HYPOTHESES = replace(CFG, graph=replace(CFG.graph, hypotheses=8))


@pytest.fixture(scope="module")
def drive():
    return mapweave.simulate_laser(
        world=mapweave.OfficeConfig(rooms=2, visited=2, drive=mapweave.OfficeConfig().drive), seed=3
    )


def fed(slam, log, *, light=False, ask=None):
    """The slam with all scans of the log; `ask(slam, k)` after each."""
    for k, (t, scan) in enumerate(zip(log.scan_t.tolist(), log.scans, strict=True)):
        slam.add_scan(
            t,
            scan.ranges,
            scan.angles(),
            odometry=scan.odometry,
            intensities=scan.intensities if light else None,
            range_max=scan.range_max,
        )
        if ask is not None:
            ask(slam, k)
    return slam


def tables(log, *, light=False):
    scans = {
        "t": log.scan_t,
        "ranges": np.array([scan.ranges for scan in log.scans]),
        "angles": log.scans[0].angles(),
        "range_max": log.scans[0].range_max,
    }
    if light:
        scans["intensities"] = np.array([scan.intensities for scan in log.scans])
    poses = np.array([scan.odometry for scan in log.scans])
    return scans, {"t": log.scan_t, "x": poses[:, 0], "y": poses[:, 1], "theta": poses[:, 2]}


def test_the_folder_is_that_of_map_to_the_byte(drive, tmp_path):
    """Asking for poses, maps and graphs on the way changes nothing."""

    def ask(slam, k):
        if k % 40 == 7:
            slam.map()
            slam.graph()
        if k == 90:
            slam.result()

    fed(mapweave.LaserSlam(), drive.log, ask=ask).save(tmp_path / "slam")
    scans, odometry = tables(drive.log)
    mapweave.map(scans=scans, odometry=odometry, method="graph", out=tmp_path / "map")
    mapped, slammed = tmp_path / "map", tmp_path / "slam"
    files = [path for path in mapped.rglob("*") if path.is_file()]
    assert len(files) > 10
    differing = [p.name for p in files if p.read_bytes() != (slammed / p.relative_to(mapped)).read_bytes()]
    assert set(differing) <= {
        *("metrics.json", "report.html", "result.npz", "robot_graph.npz", "robot1.npz", "state.json"),
    }, differing
    for name in ("robot1.tum", "robot1.cov.csv"):
        assert name not in differing
    ours, theirs = (read_robot_graph(tmp_path / d / "local" / "robot1" / "robot_graph.npz") for d in ("slam", "map"))
    assert np.array_equal(ours.pose, theirs.pose)
    assert len(ours.closures) == len(theirs.closures)


@pytest.mark.slow
def test_light_is_used_in_the_result_as_map_uses_it_and_at_once_when_its_calibration_is_known(drive):
    scans, odometry = tables(drive.log, light=True)
    path = {"scans": scans, "odometry": odometry, "method": "graph"}
    made = mapweave.map(**path, laser=mapweave.LaserOptions(particles=8)).maps[0]
    assert made.feature == "normalised"
    slam = fed(mapweave.LaserSlam(HYPOTHESES), drive.log, light=True)
    later = slam.result().maps[0]
    assert np.array_equal(later.track.pose, made.track.pose)
    sooner = fed(mapweave.LaserSlam(HYPOTHESES, calibration=made.calibration), drive.log, light=True)
    assert np.array_equal(sooner.result().maps[0].track.pose, made.track.pose)
    assert np.array_equal(sooner.graph().t, made.graph.t)
    assert np.hypot(*(sooner.pose.pose - made.scans.pose[-1])[:2]) < 0.2
    assert np.linalg.eigvalsh(sooner.pose.cov).min() >= -1e-12
    with pytest.raises(DataError, match="expected intensities"):
        sooner.add_scan(1e9, scans["ranges"][0], scans["angles"], odometry=np.zeros(3))


def test_poses_come_with_covariances_that_hold_the_truth(drive):
    log, truth = drive.log, drive.truth
    at = np.searchsorted(truth.t, log.scan_t)
    true = se2.between(truth.pose[at[0]], truth.pose[at])
    nees = []

    def ask(slam, k):
        e = slam.pose.pose - true[k]
        e[2] = se2.wrap_angle(e[2])
        assert np.linalg.eigvalsh(slam.pose.cov).min() > 0
        nees.append(e @ np.linalg.solve(slam.pose.cov, e) / 3)

    slam = fed(mapweave.LaserSlam(), log, ask=ask)
    assert np.median(nees) < 3.0
    assert np.hypot(*(slam.pose.pose - true[-1])[:2]) < 0.3
    assert len(slam) == len(log.scans)
    grid = slam.map()
    whole = slam.result().maps[0].grid
    assert (grid.occupancy() > 0.65).sum() > 0.5 * (whole.occupancy() > 0.65).sum()


@pytest.mark.slow
def test_a_result_can_be_localised_in(drive, tmp_path):
    slam = fed(mapweave.LaserSlam(), drive.log)
    slam.save(tmp_path / "map")
    mapweave.simulate_laser(tmp_path / "again.mcap", drive.config, seed=3)
    found = mapweave.localize(tmp_path / "again.mcap", tmp_path / "map", start=(0.0, 0.0, 0.0))
    assert found.metrics["localisation"]["trusted"]


def test_a_scan_that_cannot_be_is_refused_and_leaves_the_map_as_it_was(drive):
    scan, t0 = drive.log.scans[0], 5.0
    good = {"t": t0 + 1, "ranges": scan.ranges, "angles": scan.angles(), "odometry": np.zeros(3)}
    slam = mapweave.LaserSlam()
    with pytest.raises(DataError, match="no scan came yet"):
        slam.map()
    with pytest.raises(DataError):
        slam.result()
    slam.add_scan(**(good | {"t": t0}))
    bad = {
        "after the last scan's": {"t": t0 - 1},
        "stamp after": {"t": t0},
        "finite": {"t": np.nan},
        "as many ranges as angles": {"ranges": scan.ranges[:-1]},
        "evenly spaced": {"angles": scan.angles() ** 3},
        "one dimension": {"ranges": scan.ranges[None]},
        "expected numbers": {"ranges": ["far"] * len(scan.ranges)},
        "odometry: found none": {"odometry": None},
        "odometry as x, y, theta": {"odometry": np.zeros(2)},
        "poses that are finite": {"odometry": [0, np.inf, 0]},
        "intensities: found some": {"intensities": np.ones(len(scan.ranges))},
        "range_max above 0": {"range_max": 0.0},
        "sensor_pose as x, y, theta": {"sensor_pose": (0.0, 0.0)},
    }
    for said, change in bad.items():
        with pytest.raises(DataError, match=said) as told:
            slam.add_scan(**(good | {"t": np.float64(t0 + 1)} | change))
        assert "np." not in str(told.value)
    assert len(slam) == 1
    other = mapweave.LaserSlam()
    other.add_scan(**(good | {"t": t0}))
    assert np.array_equal(slam.add_scan(**good).pose, other.add_scan(**good).pose)


def test_a_scan_without_a_return_is_carried_by_odometry(drive):
    scan = drive.log.scans[0]
    slam = mapweave.LaserSlam()
    slam.add_scan(0.0, scan.ranges, scan.angles(), odometry=np.zeros(3), range_max=scan.range_max)
    none = np.full(len(scan.ranges), np.nan)
    pose, cov = slam.add_scan(1.0, none, scan.angles(), odometry=[0.5, 0.0, 0.0], range_max=scan.range_max)
    assert pose == pytest.approx([0.5, 0.0, 0.0])
    assert cov[0, 0] > 1e-4


def test_only_the_graph_takes_scans_one_by_one(tmp_path):
    with pytest.raises(ConfigError, match="expected graph"):
        mapweave.LaserSlam(LaserConfig(method="icp"))
    (tmp_path / "own.toml").write_text("[laser]\nresolution = 0.2\n")
    assert mapweave.LaserSlam(tmp_path / "own.toml").cfg.resolution == 0.2
