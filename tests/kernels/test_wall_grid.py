"""Walls in buckets: the same answers as asking every wall."""

import numpy as np
import pytest

from mapweave.core.walls import WallIndex
from mapweave.kernels.walls.segments import cast


def clutter(seed, many):
    """Slanted and axis-parallel walls, some on the borders of buckets."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(-6, 6, (many, 2))
    slanted = np.hstack([a, a + rng.uniform(-2, 2, (many, 2))])
    x, y = rng.integers(-6, 6, (2, many)).astype(float)
    return np.vstack([slanted, np.column_stack([x, y, x + 2, y]), np.column_stack([x, y, x, y + 1])])


@pytest.mark.kernel
def test_beams_end_where_asking_every_wall_says():
    walls = clutter(1, 8)
    rng = np.random.default_rng(2)
    sensor = np.vstack([rng.uniform(-9, 9, (12, 3)), [[0.0, 0.0, 0.0], [-3.0, 2.0, np.pi / 2]]])  # some on borders
    discs = np.tile([[[1.0, 1.0, 0.4], [-2.0, 0.5, 0.0]]], (len(sensor), 1, 1))
    angles = np.linspace(-np.pi, np.pi, 41)
    want = cast(sensor, angles, walls, discs, 7.0)
    got = WallIndex.of(walls).cast(sensor, angles, discs, 7.0)
    assert np.isfinite(want[0]).sum() > 100
    assert (want[1] >= len(walls)).any()
    for a, b in zip(got, want, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.kernel
def test_a_world_without_walls_is_seen_as_empty():
    empty = WallIndex.of(np.zeros((0, 4)))
    r, what, _ = empty.cast(np.zeros((1, 3)), np.zeros(3), np.zeros((1, 0, 3)), 5.0)
    assert np.isinf(r).all()
    assert (what == -1).all()
    assert not empty.touches(np.zeros((1, 2)), 1.0).any()


@pytest.mark.kernel
def test_a_disc_touches_exactly_the_walls_nearer_than_its_radius():
    walls = clutter(3, 5)
    points = np.random.default_rng(4).uniform(-8, 8, (150, 2))
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    along = np.clip(((points[:, None] - a) * e).sum(-1) / (e**2).sum(-1), 0, 1)
    nearest = np.hypot(*np.moveaxis(a + along[..., None] * e - points[:, None], -1, 0)).min(axis=1)
    touches = WallIndex.of(walls).touches(points, 0.7)
    assert touches.any()
    assert not touches.all()
    assert np.array_equal(touches, nearest < 0.7)


@pytest.mark.kernel
def test_a_beam_from_outside_the_buckets_meets_what_asking_every_wall_says():
    walls = clutter(5, 6)
    around = np.linspace(-np.pi, np.pi, 12, endpoint=False)
    sensor = np.column_stack([21.0 * np.cos(around) + 3.0, 17.0 * np.sin(around) - 2.0, around + np.pi])
    angles = np.linspace(-0.6, 0.6, 31)
    want = cast(sensor, angles, walls, np.zeros((len(sensor), 0, 3)), 30.0)
    got = WallIndex.of(walls).cast(sensor, angles, np.zeros((len(sensor), 0, 3)), 30.0)
    assert np.isfinite(want[0]).sum(axis=1).min() >= 3
    for a, b in zip(got, want, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.kernel
def test_robots_drive_their_arcs_from_where_they_stand():
    poses = np.array([[4.0, -3.0, 0.5], [-6.0, 2.0, -2.0], [1.0, 7.0, 3.0]])
    commands = np.array([[0.8, 0.4], [0.5, 0.0], [0.0, 1.0]])
    far = WallIndex.of(np.array([[-40.0, -40.0, 40.0, -40.0]]))
    got, stopped = far.drive(poses, commands, 0.5, 0.2)
    turn, angle = commands[:, 1] * 0.5, poses[:, 2]
    want = poses.copy()
    want[0, 0] += 2.0 * (np.sin(angle[0] + turn[0]) - np.sin(angle[0]))  # a circle of v / w = 2 m
    want[0, 1] -= 2.0 * (np.cos(angle[0] + turn[0]) - np.cos(angle[0]))
    want[1, :2] += 0.25 * np.array([np.cos(angle[1]), np.sin(angle[1])])
    want[:, 2] += turn
    assert not stopped.any()
    np.testing.assert_allclose(got, want, atol=1e-9)


@pytest.mark.kernel
@pytest.mark.parametrize("corner", [[0.0, 0.0], [9.0, -5.0]])
def test_robots_that_meet_stop_before_they_touch_wherever_they_are(corner):
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, np.pi], [-0.5, 1.2, 0.0]]) + np.array([*corner, 0.0])
    commands = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    far = WallIndex.of(np.array([[-40.0, -40.0, 40.0, -40.0]]))
    got, stopped = far.drive(poses, commands, 1.0, 0.25)
    gap = np.hypot(*(got[0] - got[1])[:2])
    assert stopped.tolist() == [True, True, False]
    assert 0.5 <= gap < 0.5 + 0.1  # a twentieth of the period brings each 0.05 m nearer
    np.testing.assert_allclose(got[2, :2], np.array([0.5, 1.2]) + corner)


@pytest.mark.kernel
def test_a_robot_stops_before_a_wall_and_turns_on():
    wall = WallIndex.of(np.array([[6.0, -3.0, 6.0, 3.0]]))
    got, stopped = wall.drive(np.array([[5.0, 0.5, 0.0]]), np.array([[1.0, 0.2]]), 2.0, 0.25)
    assert stopped.all()
    assert 0.25 <= 6.0 - got[0, 0] < 0.25 + 0.101
    assert got[0, 2] == pytest.approx(0.4)
