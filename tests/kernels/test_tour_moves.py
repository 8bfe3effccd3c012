"""Moves on open tours: never dearer, every node once, and as good as trying all of them on small cases."""

from itertools import permutations

import numpy as np
import pytest

from mapweave.kernels.exploration.tours import balanced_tours, improve_tours, open_length, tours_cost

pytestmark = pytest.mark.kernel


def case(seed: int, robots: int, nodes: int):
    rng = np.random.default_rng(seed)
    at, places = rng.uniform(0, 20, (robots, 2)), rng.uniform(0, 20, (nodes, 2))
    first = np.linalg.norm(at[:, None] - places[None], axis=-1)
    return first, np.linalg.norm(places[:, None] - places[None], axis=-1)


def cost(first, between, tours, counts):
    lengths = [open_length(first, between, r, tours[r], counts[r]) for r in range(len(counts))]
    return tours_cost(np.array(lengths))


@pytest.mark.parametrize("seed", range(8))
def test_improved_tours_visit_every_node_once_and_are_never_dearer(seed):
    first, between = case(seed, 3, 12)
    tours, counts = balanced_tours(first, between, np.zeros_like(first), 0.3)
    before = cost(first, between, tours, counts)
    improve_tours(first, between, tours, counts, 3)
    assert sorted(n for r in range(3) for n in tours[r, : counts[r]]) == list(range(12))
    assert cost(first, between, tours, counts) <= before + 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_small_cases_come_within_a_few_percent_of_the_best_of_all_tours(seed):
    first, between = case(100 + seed, 2, 5)
    tours, counts = balanced_tours(first, between, np.zeros_like(first), 0.3)
    improve_tours(first, between, tours, counts, 3)
    best = min(
        cost(first, between, np.array([[*p[:k], *p][:5], [*p[k:], *p][:5]]), (k, 5 - k))
        for p in permutations(range(5))
        for k in range(6)
    )
    assert cost(first, between, tours, counts) <= 1.06 * best
