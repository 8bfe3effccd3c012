"""What is in view among walls, against a dense computation."""

import numpy as np
import pytest

from mapweave.core.records import frozen
from mapweave.kernels.walls.segments import (
    Raster,
    Sector,
    distance_of_moves,
    free_share,
    mark_near,
    sight_on_raster,
)
from mapweave.kernels.walls.sight import mark_in_sight, nearest_views, points_in_sight, unexplored_in_sight

RNG = np.random.default_rng(2)
SEGMENTS = frozen(RNG.uniform(0, 20, (7, 4)))


def hidden(a, b):
    """Whether a segment meets the line a-b, by solving for the line parameters."""
    for s in SEGMENTS:
        u = np.linalg.solve(np.column_stack([b - a, s[:2] - s[2:]]), s[:2] - a)
        if np.all((u >= 0) & (u <= 1)):
            return True
    return False


def dense_view(pose, shape, reach, half_angle, origin, cell):
    out = np.zeros(shape, dtype=bool)
    for iy, ix in np.ndindex(*shape):
        centre = origin + cell * (np.array([ix, iy]) + 0.5)
        d = centre - pose[:2]
        turn = np.abs((np.arctan2(d[1], d[0]) - pose[2] + np.pi) % (2 * np.pi) - np.pi)
        out[iy, ix] = np.hypot(*d) <= reach and turn <= half_angle + 1e-9 and not hidden(pose[:2], centre)
    return out


@pytest.mark.kernel
def test_cells_come_into_view_when_near_ahead_and_not_hidden():
    origin, cell = frozen([-1.0, 0.5]), 0.9
    for pose in np.column_stack([RNG.uniform(2, 18, (6, 2)), RNG.uniform(-3, 3, 6)]):
        seen = np.zeros((21, 23), dtype=bool)
        mark_in_sight(seen, pose, Sector(8.0, np.pi / 2), Raster(origin, cell), SEGMENTS)
        np.testing.assert_array_equal(seen, dense_view(pose, seen.shape, 8.0, np.pi / 2, origin, cell))
        assert seen.sum() > 10


@pytest.mark.kernel
def test_new_cells_among_walls_are_those_a_look_from_there_would_mark():
    explored = RNG.random((20, 20)) < 0.4
    place = np.array([7.0, 9.0])
    poses = np.array([[*place, 0.0], [*place, 1.0], [12.0, 5.0, 1.0], [*place, 1.0]])
    counted = unexplored_in_sight(explored, poses, Sector(7.0, np.pi / 2), Raster(frozen(np.zeros(2)), 1.0), SEGMENTS)
    for pose, n in zip(poses, counted, strict=True):
        after = explored.copy()
        mark_in_sight(after, pose, Sector(7.0, np.pi / 2), Raster(frozen(np.zeros(2)), 1.0), SEGMENTS)
        assert after.sum() - explored.sum() == n > 0


@pytest.mark.kernel
def test_points_in_sight_are_near_and_not_hidden():
    place, points = np.array([9.0, 9.0]), RNG.uniform(0, 20, (60, 2))
    want = [np.hypot(*(p - place)) <= 9.0 and not hidden(place, p) for p in points]
    assert 0 < sum(want) < 60
    np.testing.assert_array_equal(points_in_sight(place, points, 9.0, SEGMENTS), want)


@pytest.mark.kernel
@pytest.mark.parametrize("neighbours", [0, 3])
def test_the_nearest_view_of_a_point_is_the_nearest_place_that_sees_it_with_enough_others_around(neighbours):
    stand = RNG.random((14, 15)) < 0.5
    lower, cell = frozen([-1.2, 0.7]), 1.4
    centres = lower + cell * (np.stack(np.meshgrid(np.arange(15), np.arange(14)), axis=-1) + 0.5)
    points = frozen(RNG.uniform(0, 20, (25, 2)))
    found = nearest_views(points, stand, Raster(lower, cell), 6.0, SEGMENTS, neighbours)
    for point, at in zip(points, found, strict=True):
        sees = np.array([[stand[i] and not hidden(centres[i], point) for i in np.ndindex(14, 15)]]).reshape(14, 15)
        padded = np.pad(sees, 1).astype(int)
        around = sum(padded[1 + i : 15 + i, 1 + j : 16 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)) - sees
        d = np.where(sees & (around >= neighbours), np.hypot(*np.moveaxis(centres - point, -1, 0)), np.inf)
        if d.min() >= 6.0:
            assert at.tolist() == [-1, -1]
        else:
            assert tuple(at) == np.unravel_index(np.argmin(d), d.shape)


@pytest.mark.kernel
def test_a_disc_moves_until_it_would_touch_a_wall_and_away_from_one_it_touches():
    wall = frozen([[5.0, -10.0, 5.0, 10.0]])
    a = frozen([0.0, 0.0])
    assert free_share(a, frozen([4.0, 1.0]), 0.5, wall) == 1.0
    assert free_share(a, frozen([9.0, 0.0]), 0.5, wall) == pytest.approx(0.5)
    touching = frozen([4.6, 0.0])
    assert free_share(touching, frozen([4.0, 0.0]), 0.5, wall) == 1.0
    assert free_share(touching, frozen([4.6, 3.0]), 0.5, wall) == 1.0
    assert free_share(touching, frozen([4.7, 0.0]), 0.5, wall) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.kernel
def test_the_distance_of_a_move_is_the_least_along_it():
    a, b = RNG.uniform(0, 20, (2, 30, 2))
    found = distance_of_moves(a, b, SEGMENTS)
    u = np.linspace(0, 1, 801)[:, None]
    for p, q, d in zip(a, b, found, strict=True):
        along = p + u * (q - p)
        least = min(
            np.hypot(*(s[:2] + v * (s[2:] - s[:2]) - along).T).min() for s in SEGMENTS for v in np.linspace(0, 1, 201)
        )
        assert d == pytest.approx(least, abs=0.06)
        assert (d == 0.0) == hidden(p, q)


@pytest.mark.kernel
@pytest.mark.parametrize("corner", [(0.0, 0.0), (3.0, 5.0), (-2.0, -3.5)])
def test_cells_are_near_a_wall_where_their_centres_are_wherever_the_raster_lies(corner):
    corner, cell = frozen(corner), 0.8
    near = np.zeros((19, 23), dtype=bool)
    mark_near(near, SEGMENTS, 1.3, Raster(corner, cell))
    centres = corner + cell * (np.stack(np.meshgrid(np.arange(23), np.arange(19)), axis=-1) + 0.5)
    flat = centres.reshape(-1, 2)
    np.testing.assert_array_equal(near.ravel(), distance_of_moves(flat, flat, SEGMENTS) < 1.3)
    assert near.any()
    assert not near.all()


@pytest.mark.kernel
@pytest.mark.parametrize("corner", [(0.0, 0.0), (4.0, 3.0), (-3.0, -6.0)])
def test_a_view_over_the_edge_of_the_raster_counts_what_is_on_it(corner):
    raster, sector = Raster(frozen(corner), 1.1), Sector(6.0, np.pi / 2)
    edges = np.array(corner) + 1.1 * np.array([[0.6, 0.4], [11.3, 0.7], [0.4, 9.2], [11.3, 9.6], [6.1, 5.3]])
    for place in edges:
        for heading in (0.3, 2.0, -2.5):
            pose = np.array([*place, heading])
            seen = np.zeros((10, 12), dtype=bool)
            mark_in_sight(seen, pose, sector, raster, SEGMENTS)
            np.testing.assert_array_equal(seen, dense_view(pose, seen.shape, 6.0, np.pi / 2, raster.corner, 1.1))
            counted = unexplored_in_sight(np.zeros((10, 12), dtype=bool), pose[None], sector, raster, SEGMENTS)
            assert counted[0] == seen.sum()


@pytest.mark.kernel
def test_sight_on_a_raster_is_free_where_every_cell_under_the_line_is():
    free = RNG.random((12, 15)) < 0.8
    seen = 0
    for _ in range(300):
        a, b = RNG.uniform(-0.5, [15.5, 12.5], (2, 2))
        under = np.unique(np.floor(a + np.linspace(0, 1, 4001)[:, None] * (b - a)).astype(int), axis=0)
        inside = ((under >= 0) & (under < [15, 12])).all(axis=1)
        want = inside.all() and free[under[inside, 1], under[inside, 0]].all()
        assert sight_on_raster(free, a, b) == want
        seen += want
    assert 20 < seen < 280


@pytest.mark.kernel
def test_a_line_through_a_corner_needs_both_cells_beside_it():
    a, b = np.array([0.5, 0.5]), np.array([2.5, 2.5])
    for corner, want in (((0, 1), False), ((1, 0), False), ((2, 1), False), ((0, 2), True)):
        free = np.ones((3, 3), dtype=bool)
        free[corner] = False
        assert sight_on_raster(free, a, b) == want
        assert sight_on_raster(free, b, a) == want
        assert sight_on_raster(free[:, ::-1], a * [-1, 1] + [3, 0], b * [-1, 1] + [3, 0]) == want
