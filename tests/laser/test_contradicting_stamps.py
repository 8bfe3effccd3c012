"""Poses of one moment: their middle where they contradict, untouched where they do not."""

import numpy as np

from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import MOMENT_WITHIN, map_laser, of_one_moment
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor


def driving(t):
    return np.column_stack([0.5 * t, np.zeros(len(t)), np.full(len(t), 0.3)])


def test_poses_of_one_moment_that_agree_stay_to_the_bit():
    t = np.sort(np.concatenate([np.arange(0.0, 5.0, 0.1), np.arange(0.0, 5.0, 0.1) + 0.5 * MOMENT_WITHIN]))
    pose, moved = of_one_moment(t, driving(t), np.arange(len(t)) % 2 == 0)
    assert not moved.any()
    np.testing.assert_array_equal(pose, driving(t))


def test_a_pose_against_two_of_the_same_moment_goes_to_them_and_those_of_other_moments_stay():
    t = np.array([1.0, 2.0, 2.001, 2.0015, 2.005, 3.0])
    given = driving(t)
    given[1, 0] += 0.3
    pose, moved = of_one_moment(t, given, np.zeros(6, dtype=bool))
    np.testing.assert_array_equal(moved, [False, True, True, True, False, False])
    np.testing.assert_allclose(pose[1:4, 0], driving(t)[2:4, 0].mean(), atol=0.002)
    np.testing.assert_array_equal(pose[[0, 4, 5]], given[[0, 4, 5]])


def test_a_scan_outweighs_a_row_of_odometry():
    t = np.array([2.0, 2.001])
    pose, _ = of_one_moment(t, np.array([[0.0, 0, 0], [0.3, 0, 0]]), np.array([True, False]))
    np.testing.assert_allclose(pose, 0.0, atol=1e-12)


def test_headings_meet_across_half_a_turn():
    t = np.array([2.0, 2.001])
    pose, moved = of_one_moment(t, np.array([[0.0, 0, np.pi - 0.1], [0.0, 0, 0.1 - np.pi]]), np.ones(2, dtype=bool))
    assert moved.all()
    np.testing.assert_allclose(np.abs(pose[:, 2]), np.pi, atol=1e-9)


def test_a_log_with_a_stamp_that_cannot_be_says_so_and_the_way_does_not_jump():
    log = simulate_corridor(seed=0, cfg=CorridorConfig(distance=3.0)).log
    rows = log.odometry if log.odometry is not None else Track(log.scan_t, np.array([s.odometry for s in log.scans]))
    k = len(log.scans) // 2
    late = np.searchsorted(rows.t, log.scan_t[k] + 0.001)
    back = log.scans[k - 4].odometry  # what the wheels said four scans ago, written down now
    t = np.insert(rows.t, late, log.scan_t[k] + 0.001)
    wrong = Track(t, np.insert(rows.pose, late, back, axis=0), frame="odom")
    bad = LaserLog(log.robot, log.source, log.scan_t, log.scans, wrong)
    cfg = LaserConfig(method="gated", feature="none")
    made, clean = map_laser(bad, cfg, 0), map_laser(log, cfg, 0)
    assert "stamps-mixed" in {f.code for f in made.findings}
    assert "stamps-mixed" not in {f.code for f in clean.findings}
    at = np.searchsorted(made.track.t, t[late])
    np.testing.assert_allclose(made.track.pose[at, :2], made.scans.pose[k, :2], atol=0.01)
    np.testing.assert_array_equal(made.scans.pose, clean.scans.pose)
