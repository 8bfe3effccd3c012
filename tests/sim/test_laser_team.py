"""Laser robots in one building: they stop short of walls and each other, see each other, and repeat themselves."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import DataError, EstimateError
from mapweave.sim.laser import LaserWorld
from mapweave.sim.laser_team import LaserRobotsConfig, LaserTeamSim, OdometryNoise

ROOM = np.array([[-5, -5, 5, -5], [5, -5, 5, 5], [5, 5, -5, 5], [-5, 5, -5, -5]], dtype=float)
WORLD = LaserWorld(ROOM, np.full(4, 0.6), name="room")
PERFECT = LaserRobotsConfig(odometry=OdometryNoise(factor=0.0))


def team(*starts, cfg=PERFECT, seed=0):
    return LaserTeamSim(WORLD, np.array(starts, dtype=float), cfg, seed)


def test_a_robot_drives_the_arc_it_is_told():
    sim = team((0, 0, 0))
    sim.step(np.array([[0.4, 0.8]]))
    assert np.allclose(sim.true_poses[0], se2.exp(np.array([0.2, 0.0, 0.4])), atol=1e-9)
    assert np.allclose(sim.odometry[0], sim.true_poses[0], atol=1e-6)
    assert sim.collisions[0] == 0


def test_a_robot_driven_at_a_wall_is_stopped_short_and_counted_once():
    sim = team((4.0, 0, 0))
    for _ in range(6):
        sim.step(np.array([[0.6, 0.0]]))
    assert sim.collisions[0] == 1
    assert 4.75 < sim.true_poses[0, 0] <= 4.8
    sim.step(np.array([[-0.5, 0.0]]))
    for _ in range(3):
        sim.step(np.array([[0.6, 0.0]]))
    assert sim.collisions[0] == 2


def test_two_robots_driven_at_each_other_stop_before_they_touch():
    sim = team((-1, 0, 0), (1, 0, np.pi))
    for _ in range(8):
        sim.step(np.array([[0.6, 0.0], [0.6, 0.0]]))
    gap = np.hypot(*(sim.true_poses[0, :2] - sim.true_poses[1, :2]))
    assert 0.4 <= gap < 0.45
    assert sim.collisions.tolist() == [1, 1]


def test_a_stopped_robot_can_still_turn():
    sim = team((4.79, 0, 0))
    sim.step(np.array([[0.3, 1.0]]))
    assert sim.true_poses[0, 2] == pytest.approx(0.5)


def test_another_robot_is_seen_as_a_disc():
    sim = team((0, 0, 0), (2, 0, 0))
    scan = sim.scan(0)
    angles = scan.angles()
    on_it = scan.ranges < 3.0
    assert np.abs(angles[on_it]).max() < np.arcsin(0.1) + 1e-6
    assert on_it.sum() == 12  # beams half a degree off the axis and on, one a degree
    assert scan.ranges[np.argmin(np.abs(angles))] == pytest.approx(1.8, abs=0.1)
    alone = team((0, 0, 0)).scan(0)
    assert alone.ranges.min() > 4.5


def test_the_scan_covers_the_whole_circle_once_and_says_what_it_hit():
    scan = team((0, 0, 0.3)).scan(0)
    assert len(scan.ranges) == 360
    assert scan.angle_min + 360 * scan.angle_increment == pytest.approx(scan.angle_min + 2 * np.pi, abs=1e-5)
    points = se2.act(
        np.array([0, 0, 0.3]), scan.ranges[:, None] * np.column_stack([np.cos(scan.angles()), np.sin(scan.angles())])
    )
    assert np.abs(np.abs(points).max(axis=1) - 5).max() < 0.4
    assert scan.hit.all()


def test_the_same_seed_gives_the_same_run_however_often_scans_are_asked_for():
    one, two = (team((0, 0, 0), (2, 1, 1), cfg=LaserRobotsConfig(), seed=5) for _ in range(2))
    for k in range(10):
        u = np.array([[0.5, 0.3], [0.4, -0.2]])
        one.step(u)
        two.step(u)
        two.scan(k % 2)
    assert np.array_equal(one.odometry, two.odometry)
    assert np.array_equal(one.scan(1).ranges, two.scan(1).ranges)
    other = team((0, 0, 0), (2, 1, 1), cfg=LaserRobotsConfig(), seed=6)
    assert not np.array_equal(
        other.scan(1).ranges, team((0, 0, 0), (2, 1, 1), cfg=LaserRobotsConfig(), seed=5).scan(1).ranges
    )


def test_every_stream_of_randomness_is_its_own():
    noisy, quiet = LaserRobotsConfig(), PERFECT
    with_noise, without = team((0, 0, 0), cfg=noisy), team((0, 0, 0), cfg=quiet)
    alone, beside = team((0, 0, 0), cfg=noisy), team((0, 0, 0), (-4, -4, 0), cfg=noisy)
    for _ in range(5):
        with_noise.step(np.array([[0.5, 0.2]]))
        without.step(np.array([[0.5, 0.2]]))
        alone.step(np.array([[0.5, 0.2]]))
        beside.step(np.array([[0.5, 0.2], [0.0, 0.0]]))
    assert np.array_equal(with_noise.true_poses, without.true_poses)
    assert np.array_equal(with_noise.scan(0).ranges, without.scan(0).ranges)
    assert np.array_equal(alone.odometry[0], beside.odometry[0])


def test_odometry_errs_as_much_as_its_configuration_says():
    errors = []
    for seed in range(60):
        sim = team((0, 0, 0), cfg=replace(PERFECT, odometry=OdometryNoise(scale=0, bias=0, turning=0)), seed=seed)
        for k in range(20):
            sim.step(np.array([[0.5 if k % 2 else -0.5, 0.0]]))
        errors.append(sim.odometry[0, 2])
    expected = np.radians(0.4) * np.sqrt(20 * 0.25)
    assert 0.75 * expected < np.std(errors) < 1.25 * expected


def test_a_start_in_a_wall_or_in_another_robot_and_a_team_of_none_are_refused():
    with pytest.raises(DataError, match=r"robot2 would start in a wall at \(4.9, 0\)"):
        team((0, 0, 0), (4.9, 0, 0))
    with pytest.raises(DataError, match="robot1 and robot2 would start in each other"):
        team((0, 0, 0), (0.3, 0, 0))
    with pytest.raises(DataError, match="no robots"):
        LaserTeamSim(WORLD, np.zeros((0, 3)), PERFECT)


def test_commands_of_the_wrong_shape_or_that_are_no_numbers_are_refused():
    sim = team((0, 0, 0))
    with pytest.raises(EstimateError, match="1 x 2"):
        sim.step(np.zeros((2, 2)))
    with pytest.raises(EstimateError, match="finite"):
        sim.step(np.array([[np.nan, 0.0]]))
