"""Ways through a grid agree with an independent shortest-path library, and never cut a corner."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from mapweave.kernels.exploration.wavefront import DIAGONAL, NO_LIMIT, STRAIGHT, UNREACHED, descend, spread

pytestmark = pytest.mark.kernel


def random_weights(seed: int, rows: int = 17, cols: int = 23) -> np.ndarray:
    rng = np.random.default_rng(seed)
    weight = rng.integers(1, 5, size=(rows, cols)).astype(np.uint8)
    weight[rng.random((rows, cols)) < 0.35] = 0
    weight[3, 4] = 1
    return weight


def by_scipy(weight: np.ndarray, source: tuple[int, int]) -> np.ndarray:
    rows, cols = weight.shape
    a, b, price = [], [], []
    for y in range(rows):
        for x in range(cols):
            for dy, dx in np.ndindex(3, 3):
                v, u = y + dy - 1, x + dx - 1
                if (v, u) == (y, x) or not (0 <= v < rows and 0 <= u < cols) or not weight[y, x] or not weight[v, u]:
                    continue
                if v != y and u != x and not (weight[y, u] and weight[v, x]):
                    continue
                a.append(y * cols + x)
                b.append(v * cols + u)
                mean = 0.5 * (int(weight[y, x]) + int(weight[v, u]))
                price.append((DIAGONAL if v != y and u != x else STRAIGHT) * mean)
    graph = coo_matrix((price, (a, b)), shape=(rows * cols, rows * cols)).tocsr()
    return dijkstra(graph, indices=source[0] * cols + source[1]).reshape(rows, cols)


@pytest.mark.parametrize("seed", range(6))
def test_costs_equal_those_of_an_independent_dijkstra(seed):
    weight = random_weights(seed)
    got = spread(weight, np.array([[3, 4]]), NO_LIMIT).astype(float)
    got[got == UNREACHED] = np.inf
    want = by_scipy(weight, (3, 4))
    want[weight == 0] = np.inf
    assert np.array_equal(got, want)


@pytest.mark.parametrize("seed", range(3))
def test_the_way_down_ends_at_the_source_and_never_passes_a_blocked_corner(seed):
    weight = random_weights(seed)
    cost = spread(weight, np.array([[3, 4]]), NO_LIMIT)
    for cell in np.argwhere(cost > 0):
        way = descend(cost, weight, cell, 400)
        assert tuple(way[-1]) == (3, 4)
        moves = np.abs(np.diff(way, axis=0)).sum(axis=1)
        on_way = weight[tuple(way.T)].astype(float)
        paid = np.where(moves == 2, DIAGONAL, STRAIGHT) * 0.5 * (on_way[:-1] + on_way[1:])
        assert paid.sum() == cost[tuple(cell)]
        for (y, x), (v, u) in pairwise(way):
            assert all((weight[v, u], weight[y, u], weight[v, x]))


def test_no_way_leads_from_a_cell_that_is_cut_off():
    weight = np.ones((5, 7), dtype=np.uint8)
    weight[:, 3] = 0
    cost = spread(weight, np.array([[2, 1]]), NO_LIMIT)
    assert (cost[:, 4:] == UNREACHED).all()
    assert len(descend(cost, weight, np.array([2, 5]), 50)) == 0


def test_a_blocked_source_reaches_nothing():
    weight = np.ones((4, 4), dtype=np.uint8)
    weight[1, 1] = 0
    assert (spread(weight, np.array([[1, 1]]), NO_LIMIT) == UNREACHED).all()


def test_dear_cells_do_not_overflow_their_byte():
    weight = np.full((1, 4), 200, dtype=np.uint8)
    assert spread(weight, np.array([[0, 0]]), NO_LIMIT).tolist() == [[0, 28_000, 56_000, 84_000]]


def test_costs_up_to_the_limit_are_what_they_are_without_one():
    weight = random_weights(7, 40, 40)
    every, near = spread(weight, np.array([[3, 4]]), NO_LIMIT), spread(weight, np.array([[3, 4]]), 2000)
    assert np.array_equal(near[(every >= 0) & (every <= 2000)], every[(every >= 0) & (every <= 2000)])
    assert (near[every > 2000 + 4 * DIAGONAL] == UNREACHED).all()
