"""Walls against brute force: distance, touch, inside, the raster of places too near, and walls of a raster."""

from itertools import product

import numpy as np
import pytest

from mapweave.core.records import frozen
from mapweave.core.walls import Walls, walls_of_raster
from mapweave.kernels.walls.segments import distance_of_moves, touches

RNG = np.random.default_rng(5)
SEGMENTS = frozen(RNG.uniform(-6, 6, (14, 4)))


def dense_distance(point, segments):
    """To the nearest of 4,001 points on every segment."""
    u = np.linspace(0, 1, 4001)[:, None]
    return min(np.hypot(*(s[:2] + u * (s[2:] - s[:2]) - point).T).min() for s in segments)


def dense_touch(a, b, segment):
    """By solving for the two line parameters."""
    A = np.column_stack([b - a, segment[:2] - segment[2:]])
    if abs(np.linalg.det(A)) < 1e-12:
        return False
    u = np.linalg.solve(A, segment[:2] - a)
    return bool(np.all((u >= 0) & (u <= 1)))


@pytest.mark.kernel
def test_clearance_is_the_distance_to_the_nearest_wall():
    points = RNG.uniform(-8, 8, (40, 2))
    want = [dense_distance(p, SEGMENTS) for p in points]
    np.testing.assert_allclose(Walls.of(SEGMENTS).clearance(points), want, atol=2e-3)


@pytest.mark.kernel
def test_a_move_touches_a_wall_exactly_when_the_lines_meet():
    a, b = RNG.uniform(-6, 6, (2, 60, 2))
    want = [any(dense_touch(p, q, s) for s in SEGMENTS) for p, q in zip(a, b, strict=True)]
    assert 0 < sum(want) < 60
    np.testing.assert_array_equal(distance_of_moves(a, b, SEGMENTS) == 0, want)


@pytest.mark.kernel
@pytest.mark.parametrize(
    ("a", "b", "touches"),
    [
        ((0, 0), (2, 0), True),  # ends on the wall
        ((0, 0), (1.9, 0), False),
        ((2, -1), (2, -3), True),  # along the wall, starting on its end
        ((2, -2), (2, -3), False),  # on its line, beyond it
        ((0, 3), (4, 3), False),
        ((1, -1), (3, 3), True),  # through its middle
        ((2, 0), (2, 0), True),  # standing on it
    ],
)
def test_ends_and_parallel_moves_count_as_touching(a, b, touches):
    wall = frozen([[2.0, -1.0, 2.0, 2.0]])
    assert (distance_of_moves(np.array([a], float), np.array([b], float), wall) == 0).tolist() == [touches]


@pytest.mark.kernel
@pytest.mark.parametrize("along", [(1, 0), (0, 1), (1, 1), (2, -1)])
def test_a_move_along_the_line_of_a_wall_touches_it_exactly_when_their_spans_overlap(along):
    u, places = np.array(along, float), range(4)
    for c, d in product(places, places):
        wall = np.concatenate([c * u, d * u])[None] + 0.5
        for a, b in product(places, places):
            overlap = max(min(a, b), min(c, d)) <= min(max(a, b), max(c, d))
            start, end = a * u + 0.5, b * u + 0.5
            assert touches(*start, *end, wall, 0) == overlap, (a, b, c, d)
            assert (distance_of_moves(start[None], end[None], wall)[0] == 0) == overlap, (a, b, c, d)


@pytest.mark.kernel
def test_blocked_cells_are_those_whose_centre_is_too_near():
    lower, upper = np.array([-7.0, -5.5]), np.array([7.0, 6.0])
    walls = Walls.of(SEGMENTS)
    blocked = walls.blocked(lower, upper, 0.5, 0.7)
    assert blocked.shape == (23, 28)
    rows, cols = np.indices(blocked.shape)
    centres = lower + 0.5 * (np.stack([cols, rows], axis=-1).reshape(-1, 2) + 0.5)
    np.testing.assert_array_equal(blocked.ravel(), walls.clearance(centres) < 0.7)


@pytest.mark.kernel
def test_the_walls_of_a_raster_enclose_its_occupied_cells_and_nothing_else():
    occupied = RNG.random((9, 13)) < 0.4
    pose, side = np.array([3.0, -2.0, 0.4]), 0.25
    walls = walls_of_raster(occupied, pose, side)
    rows, cols = np.indices(occupied.shape)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    local = side * (np.stack([cols, rows], axis=-1).reshape(-1, 2) + RNG.uniform(0.1, 0.9, (occupied.size, 2)))
    points = local @ np.array([[c, s], [-s, c]]) + pose[:2]
    np.testing.assert_array_equal(walls.inside(points), occupied.ravel())
    assert (walls.clearance(points)[occupied.ravel()] == 0).all()


def test_a_straight_raster_wall_becomes_four_long_segments():
    occupied = np.zeros((50, 80), dtype=bool)
    occupied[20:22, 10:70] = True
    walls = walls_of_raster(occupied, np.zeros(3), 0.1)
    assert len(walls.segments) == 4
    lengths = np.hypot(*(walls.segments[:, 2:] - walls.segments[:, :2]).T)
    np.testing.assert_allclose(sorted(lengths), [0.2, 0.2, 6.0, 6.0])


def test_no_walls_are_infinitely_far_away():
    none = Walls.of(np.zeros((0, 4)))
    assert np.isinf(none.clearance(np.zeros((2, 2)))).all()
    assert not none.blocked(np.zeros(2), np.ones(2), 0.5, 1.0).any()


@pytest.mark.kernel
def test_a_raster_is_enclosed_where_each_of_its_cells_is():
    rng = np.random.default_rng(6)
    corners = rng.uniform(-3, 3, (9, 2))
    star = np.hstack([corners, np.roll(corners, -1, axis=0)])
    box = np.array([[-2.0, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]])
    for segments in (star, box + 0.03, box + 0.05):
        walls = Walls.of(segments, solid=True)
        lower, cell = np.array([-2.45, -2.9]), 0.1
        made = walls.blocked(lower, np.array([2.6, 3.1]), cell, 0.0)
        rows, cols = made.shape
        x, y = np.meshgrid(lower[0] + (np.arange(cols) + 0.5) * cell, lower[1] + (np.arange(rows) + 0.5) * cell)
        inside = walls.inside(np.column_stack([x.ravel(), y.ravel()])).reshape(rows, cols)
        assert inside.any()
        assert np.array_equal(made, inside)
