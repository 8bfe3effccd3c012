"""Shortest ways over a raster: known lengths, never through a corner, unreachable places told."""

import heapq
from itertools import pairwise

import numpy as np
import pytest

from mapweave.exploration.paths import Reach
from mapweave.kernels.walls.segments import sight_on_raster

ZERO = np.zeros(2)


def dense(free, start):
    """Dijkstra by hand, diagonals only where both cells beside them are free."""
    d = np.full(free.shape, np.inf)
    d[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        far, (r, c) = heapq.heappop(queue)
        if far > d[r, c]:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                y, x = r + dr, c + dc
                if (dr, dc) == (0, 0) or not (0 <= y < free.shape[0] and 0 <= x < free.shape[1]) or not free[y, x]:
                    continue
                if dr and dc and not (free[r, x] and free[y, c]):
                    continue
                if far + np.hypot(dr, dc) < d[y, x] - 1e-12:
                    d[y, x] = far + np.hypot(dr, dc)
                    heapq.heappush(queue, (d[y, x], (y, x)))
    return d


def test_distances_are_the_shortest_from_every_source():
    rng = np.random.default_rng(3)
    free = rng.random((17, 23)) > 0.35
    cells = np.argwhere(free)[rng.choice(int(free.sum()), 4, replace=False)]
    reach = Reach(free, np.array([-3.0, 2.0]), 0.5)
    found = reach.distances(reach.centres(cells))
    for k, cell in enumerate(cells):
        np.testing.assert_allclose(found[k], 0.5 * dense(free, tuple(cell)), rtol=1e-4)


def test_a_path_round_a_wall_turns_at_its_ends_and_has_the_known_length():
    free = np.ones((21, 21), dtype=bool)
    free[:18, 10] = False  # a wall from below with a gap above
    reach = Reach(free, ZERO, 1.0)
    start, goal = np.array([5.5, 5.5]), np.array([15.5, 5.5])
    distance = reach.distances(start[None])[0]
    path = reach.path(distance, goal)
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    assert len(path) == 4
    # up to row 18 beside the wall, across its end, down again
    assert distance[5, 15] == pytest.approx(2 * (9 + 4 * np.sqrt(2)) + 2, rel=1e-4)
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    assert length == pytest.approx(2 * np.hypot(4, 13) + 2)


def test_no_path_squeezes_between_two_cells_that_touch_at_a_corner():
    free = np.ones((4, 4), dtype=bool)
    free[1, :2] = free[2, 2:] = False  # they touch only at a corner
    reach = Reach(free, ZERO, 1.0)
    distance = reach.distances(np.array([[0.5, 0.5]]))[0]
    assert np.isinf(distance[3, 0])
    assert reach.path(distance, np.array([0.5, 3.5])) is None
    assert reach.regions()[0, 0] != reach.regions()[3, 0]


@pytest.mark.kernel
def test_every_leg_of_a_path_runs_over_free_cells():
    rng = np.random.default_rng(8)
    free = rng.random((30, 30)) > 0.25
    free[0, 0] = True
    reach = Reach(free, ZERO, 1.0)
    distance = reach.distances(np.array([[0.5, 0.5]]))[0]
    ends = np.argwhere(np.isfinite(distance))[::17]
    assert len(ends) > 20
    for end in ends:
        path = reach.path(distance, end[::-1] + 0.5)
        along = [a + u * (b - a) for a, b in pairwise(path) for u in np.linspace(0, 1, 301)[:-1]]
        at = np.floor(np.array([*along, path[-1]])).astype(int)
        assert free[at[:, 1], at[:, 0]].all()
        assert np.hypot(*np.diff(path, axis=0).T).sum() <= distance[tuple(end)] + 1e-9


@pytest.mark.kernel
def test_sight_along_a_diagonal_needs_both_cells_at_each_corner():
    free = np.ones((3, 3), dtype=bool)
    a, b = np.array([0.5, 0.5]), np.array([2.5, 2.5])
    assert sight_on_raster(free, a, b)
    free[0, 1] = False
    assert not sight_on_raster(free, a, b)
    assert not sight_on_raster(np.ones((3, 3), dtype=bool), a, np.array([3.5, 0.5]))


def test_a_place_that_is_not_free_counts_as_the_nearest_free_one_within_reach():
    free = np.ones((5, 5), dtype=bool)
    free[:, :2] = False
    point = np.array([[1.8, 2.4]])
    assert Reach(free, ZERO, 1.0).cells(point).tolist() == [[-1, -1]]
    assert np.isinf(Reach(free, ZERO, 1.0).distances(point)).all()
    assert Reach(free, ZERO, 1.0, snap=1.0).cells(point).tolist() == [[2, 2]]


def test_without_free_cells_nothing_is_reached():
    reach = Reach(np.zeros((3, 4), dtype=bool), ZERO, 1.0)
    assert np.isinf(reach.distances(np.ones((2, 2)))).all()
    assert (reach.regions() == -1).all()


def test_a_large_building_is_searched_from_eight_places():
    free = np.ones((354, 354), dtype=bool)
    free[::20, :300] = False
    reach = Reach(free, ZERO, 0.2)
    sources = np.column_stack([np.full(8, 65.0), np.linspace(1, 69, 8)])
    distance = reach.distances(sources)
    assert distance.shape == (8, 354, 354)
    assert np.isfinite(distance[:, free]).all()
    assert reach.path(distance[0], np.array([1.0, 65.0])) is not None
