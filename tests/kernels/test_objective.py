"""What a control is judged by, against dense algebra, and tours and covers, against trying everything."""

import itertools

import numpy as np
import pytest

from mapweave.core.gaussian import joseph
from mapweave.core.records import frozen
from mapweave.core.se2 import wrap_angle
from mapweave.kernels.exploration.objective import (
    MotionAndSight,
    expected_uncertainty,
    map_uncertainty,
    mark_half_disc,
    unexplored_cells,
)
from mapweave.kernels.exploration.tours import TourCosts, _cheapest, balanced_tours, greedy_cover
from mapweave.kernels.walls.segments import Raster, Sector

pytestmark = pytest.mark.kernel

SECTOR, BALANCE = Sector(4.0, 1.2), 0.3


def drawn(rng, n):
    root = rng.normal(size=(n, n))
    return 0.02 * (root @ root.T + np.eye(n))


def uncertainty(P):
    blocks = [P[:3, :3], *(P[k : k + 2, k : k + 2] for k in range(3, len(P), 2))]
    return np.pi * sum(np.sqrt(np.linalg.det(B)) for B in blocks)


@pytest.mark.eq("Yuan09:17")
def test_a_maps_uncertainty_is_the_sum_of_its_blocks_volumes():
    P = drawn(np.random.default_rng(0), 9)
    assert map_uncertainty(P) == pytest.approx(uncertainty(P))
    assert map_uncertainty(np.zeros((5, 5))) == 0.0
    flat = np.diag([1.0, 1.0, -1e-18, 1.0, -1e-18])  # rounding may leave a determinant below zero
    assert map_uncertainty(flat) == 0.0


@pytest.mark.eq("Yuan09:18")
@pytest.mark.parametrize("heading", [0.4, 2.9, -2.0])
def test_expected_uncertainty_is_that_of_a_dense_kalman_filter(heading):
    rng = np.random.default_rng(1)
    pose = np.array([1.0, -2.0, heading])
    ahead = heading + np.array([0.3, -0.9, 1.1, 2.5, 0.1])
    away = np.array([2.0, 3.0, 3.5, 2.0, 6.0])
    landmarks = pose[:2] + away[:, None] * np.stack([np.cos(ahead), np.sin(ahead)], axis=1)
    cov, Q, R = drawn(rng, 13), np.diag([0.01, 0.02, 0.003]), np.array([[0.04, 0.002], [0.002, 0.01]])
    controls = np.array([[0.0, 0.0], [0.8, 0.5], [1.0, -0.6]])
    got = expected_uncertainty(
        frozen(pose), frozen(landmarks), frozen(cov), controls, MotionAndSight(0.9, frozen(Q), frozen(R), SECTOR)
    )
    for (v, w), value in zip(controls, got, strict=True):
        step = 0.9 * v * np.array([np.cos(heading), np.sin(heading)])
        after = pose + np.array([*step, 0.9 * w])
        F = np.eye(13)
        F[0, 2], F[1, 2] = -step[1], step[0]
        P = F @ cov @ F.T
        P[:3, :3] += Q
        seen = 0
        for j, p in enumerate(landmarks):
            d = p - after[:2]
            r = np.hypot(*d)
            if r > SECTOR.reach or abs(wrap_angle(np.arctan2(d[1], d[0]) - after[2])) > SECTOR.half_angle:
                continue
            u, g = d / r, np.array([-d[1], d[0]]) / r**2
            H = np.zeros((2, 13))
            H[0, :2], H[1, :2], H[1, 2] = -u, -g, -1.0
            H[:, 3 + 2 * j : 5 + 2 * j] = u, g
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            P = joseph(P, K, H, R)
            seen += 1
        assert 2 <= seen <= 4
        assert value == pytest.approx(uncertainty(P), rel=1e-9)


def held(pose, shape, raster):
    """Cells whose centres the sector holds, by distance and angle."""
    rows, cols = np.indices(shape)
    x = raster.corner[0] + (cols + 0.5) * raster.cell - pose[0]
    y = raster.corner[1] + (rows + 0.5) * raster.cell - pose[1]
    turn = np.abs(wrap_angle(np.arctan2(y, x) - pose[2]))
    return (np.hypot(x, y) <= SECTOR.reach) & (turn <= SECTOR.half_angle)


@pytest.mark.eq("Yuan09:19")
@pytest.mark.parametrize("corner", [(0.0, 0.0), (5.0, -3.0), (-4.0, 2.0)])
def test_new_ground_is_what_the_sector_holds_and_was_not_explored(corner):
    rng = np.random.default_rng(2)
    raster = Raster(frozen(corner), 0.7)
    places = np.array(corner) + rng.uniform(-1.0, [12.0, 10.0], (12, 2))
    poses = np.column_stack([places, rng.uniform(-3, 3, 12)])
    explored = rng.random((13, 16)) < 0.4
    counted = unexplored_cells(explored, poses, SECTOR, raster)
    assert counted.max() > 15
    for pose, count in zip(poses, counted, strict=True):
        view = held(pose, explored.shape, raster)
        assert count == (view & ~explored).sum()
        after = explored.copy()
        mark_half_disc(after, pose, SECTOR, raster)
        np.testing.assert_array_equal(after, explored | view)


def test_each_disc_of_a_cover_is_the_one_that_gains_most():
    rng = np.random.default_rng(3)
    xs, ys = np.arange(0.0, 9.0, 1.5), np.arange(-1.0, 7.0, 1.5)
    cells = rng.uniform([-1.5, -2.5], [10.0, 8.0], (60, 2))
    discs = greedy_cover(cells, xs, ys, 1.8)
    grid = np.array([(x, y) for y in ys for x in xs])
    near = np.hypot(*np.moveaxis(grid[:, None] - cells, -1, 0)) <= 1.8
    left = near.any(axis=0)
    assert 40 < left.sum() < 60
    for disc in discs:
        gain = (near & left).sum(axis=1)
        best = int(np.argmax(gain))
        np.testing.assert_array_equal(disc, grid[best])
        left &= ~near[best]
    assert not left.any()


def length(first, between, last, robot, tour):
    if not tour:
        return 0.0
    steps = [between[a, b] for a, b in itertools.pairwise(tour)]
    return first[robot, tour[0]] + sum(steps) + last[robot, tour[-1]]


@pytest.mark.parametrize("open_end", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_tours_visit_everything_once_and_no_reversal_or_relocation_makes_them_better(seed, open_end):
    rng = np.random.default_rng([seed, 6])
    nodes, robots = rng.uniform(0, 10, (9, 2)), rng.uniform(0, 10, (3, 2))
    first = np.hypot(*np.moveaxis(robots[:, None] - nodes, -1, 0))
    between = np.hypot(*np.moveaxis(nodes[:, None] - nodes, -1, 0))
    last = np.zeros_like(first) if open_end else 1.0 * first
    tours, counts = balanced_tours(first, between, last, BALANCE)
    plan = [list(tour[:n]) for tour, n in zip(tours, counts, strict=True)]
    assert sorted(node for tour in plan for node in tour) == list(range(9))
    now = [length(first, between, last, r, tour) for r, tour in enumerate(plan)]
    for r, tour in enumerate(plan):
        for a, b in itertools.combinations(range(len(tour)), 2):
            turned = tour[:a] + tour[a : b + 1][::-1] + tour[b + 1 :]
            assert length(first, between, last, r, turned) >= now[r] - 1e-8
        for a, node in enumerate(tour):
            rest = tour[:a] + tour[a + 1 :]
            without = length(first, between, last, r, rest)
            for s, other in enumerate(plan):
                to = rest if s == r else other
                for p in range(len(to) + 1):
                    then = length(first, between, last, s, [*to[:p], node, *to[p:]])
                    if s == r:
                        assert then >= now[r] - 1e-8
                    else:
                        before = max(now[r], now[s]) + BALANCE * (now[r] + now[s])
                        assert max(without, then) + BALANCE * (without + then) >= before - 1e-8


def test_one_robots_tour_of_few_places_is_nearly_the_shortest():
    rng = np.random.default_rng(8)
    over = []
    for _ in range(10):
        nodes, start = rng.uniform(0, 10, (6, 2)), rng.uniform(0, 10, (1, 2))
        first = np.hypot(*np.moveaxis(start[:, None] - nodes, -1, 0))
        between = np.hypot(*np.moveaxis(nodes[:, None] - nodes, -1, 0))
        last = np.zeros_like(first)
        tours, counts = balanced_tours(first, between, last, BALANCE)
        assert counts.tolist() == [6]
        shortest = min(length(first, between, last, 0, order) for order in itertools.permutations(range(6)))
        over.append(length(first, between, last, 0, list(tours[0])) / shortest)
    assert np.mean(over) < 1.05
    assert min(over) >= 1 - 1e-9


def test_the_next_node_goes_where_the_longest_tour_and_then_the_sum_grow_least():
    rng = np.random.default_rng(9)
    for _ in range(6):
        first, between, last = rng.uniform(1, 9, (2, 6)), rng.uniform(1, 9, (6, 6)), rng.uniform(0, 3, (2, 6))
        between = 0.5 * (between + between.T)
        plan = [[4, 1], [2]]
        tours, counts = np.zeros((2, 7), dtype=np.int64), np.array([2, 1])
        tours[0, :2], tours[1, 0] = plan[0], plan[1][0]
        done = np.isin(np.arange(6), [1, 2, 4])
        lengths = np.array([length(first, between, last, r, plan[r]) for r in (0, 1)])
        costs = {}
        for node in np.flatnonzero(~done).tolist():
            for r in (0, 1):
                for p in range(len(plan[r]) + 1):
                    then = length(first, between, last, r, [*plan[r][:p], node, *plan[r][p:]])
                    costs[node, r, p] = max(lengths.max(), then) + BALANCE * (then - lengths[r])
        assert _cheapest(TourCosts(first, between, last, BALANCE), tours, counts, lengths, done) == min(
            costs, key=costs.get
        )
