"""Shortest ways over a raster: known lengths, never through a corner, unreachable places told."""

import heapq
from itertools import pairwise

import numpy as np
import pytest

from mapweave.exploration.ground import Ground
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
    ground = Ground.of(free, np.array([-3.0, 2.0]), 0.5)
    found = ground.distances(ground.centres(cells))
    for k, cell in enumerate(cells):
        np.testing.assert_allclose(found[k], 0.5 * dense(free, tuple(cell)), rtol=1e-4)


def test_a_path_round_a_wall_turns_at_its_ends_and_has_the_known_length():
    free = np.ones((21, 21), dtype=bool)
    free[:18, 10] = False  # a wall from below with a gap above
    ground = Ground.of(free, ZERO, 1.0)
    start, goal = np.array([5.5, 5.5]), np.array([15.5, 5.5])
    ways = ground.cost_to_go(ground.cells(goal[None]))
    path = ways.path(start)
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    assert len(path) == 4
    # up to row 18 beside the wall, across its end, down again
    assert ways.metres[5, 5] == pytest.approx(2 * (9 + 4 * np.sqrt(2)) + 2, rel=1e-4)
    assert ways.metres_from(start[None])[0] == ways.metres[5, 5]
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    assert length == pytest.approx(2 * np.hypot(4, 13) + 2)


def test_no_path_squeezes_between_two_cells_that_touch_at_a_corner():
    free = np.ones((4, 4), dtype=bool)
    free[1, :2] = free[2, 2:] = False  # they touch only at a corner
    ground = Ground.of(free, ZERO, 1.0)
    ways = ground.cost_to_go(np.array([[0, 0]]))
    assert np.isinf(ways.metres[3, 0])
    assert ways.path(np.array([0.5, 3.5])) is None
    assert ground.regions()[0, 0] != ground.regions()[3, 0]


@pytest.mark.kernel
def test_every_leg_of_a_path_runs_over_free_cells():
    rng = np.random.default_rng(8)
    free = rng.random((30, 30)) > 0.25
    free[0, 0] = True
    ways = Ground.of(free, ZERO, 1.0).cost_to_go(np.array([[0, 0]]))
    ends = np.argwhere(ways.cost >= 0)[::17]
    assert len(ends) > 20
    for end in ends:
        path = ways.path(end[::-1] + 0.5)
        along = [a + u * (b - a) for a, b in pairwise(path) for u in np.linspace(0, 1, 301)[:-1]]
        at = np.floor(np.array([*along, path[-1]])).astype(int)
        assert free[at[:, 1], at[:, 0]].all()
        assert np.hypot(*np.diff(path, axis=0).T).sum() <= ways.metres[tuple(end)] + 1e-9


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
    assert Ground.of(free, ZERO, 1.0).cells(point).tolist() == [[-1, -1]]
    assert np.isinf(Ground.of(free, ZERO, 1.0).distances(point)).all()
    assert Ground.of(free, ZERO, 1.0, snap=1.0).cells(point).tolist() == [[2, 2]]


def test_without_free_cells_nothing_is_reached():
    ground = Ground.of(np.zeros((3, 4), dtype=bool), ZERO, 1.0)
    assert np.isinf(ground.distances(np.ones((2, 2)))).all()
    assert (ground.regions() == -1).all()


def test_a_place_far_outside_the_raster_is_unreachable():
    ground = Ground.of(np.ones((3, 4), dtype=bool), ZERO, 1.0, snap=2.0)
    far = np.array([[1e308, 0.5], [-1e12, 2.5], [5.0, 1.5]])
    assert ground.cells(far).tolist() == [[-1, -1], [-1, -1], [1, 3]]


def test_nothing_beyond_the_limit_is_told_to_be_nearer_than_it_is():
    ground = Ground.of(np.ones((1, 50), dtype=bool), ZERO, 0.5)
    ways = ground.cost_to_go(np.array([[0, 0]]), limit=5.0)
    assert ways.metres[0, 10] == 5.0
    assert np.isinf(ways.metres[0, 30])


def test_a_large_building_is_searched_from_eight_places():
    free = np.ones((354, 354), dtype=bool)
    free[::20, :300] = False
    ground = Ground.of(free, ZERO, 0.2)
    sources = np.column_stack([np.full(8, 65.0), np.linspace(1, 69, 8)])
    distance = ground.distances(sources)
    assert distance.shape == (8, 354, 354)
    assert np.isfinite(distance[:, free]).all()
    assert ground.cost_to_go(ground.cells(sources[:1])).path(np.array([1.0, 65.0])) is not None
