"""Closures that can be true together: cycles against sampling, cliques against trying every set."""

from itertools import combinations

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.laser.consistency import (
    _by_degeneracy,
    adjoint,
    cycle_squares,
    largest_clique,
)


def brute_size(adjacent):
    n = len(adjacent)
    for size in range(n, 0, -1):
        for members in combinations(range(n), size):
            if all(adjacent[i, j] for i, j in combinations(members, 2)):
                return size
    return 0


def test_the_largest_clique_is_that_of_trying_every_set():
    for case in range(60):
        rng = np.random.default_rng([case, 5])
        n = int(rng.integers(1, 13))
        upper = np.triu(rng.random((n, n)) < rng.uniform(0.1, 0.95), 1)
        adjacent = upper | upper.T
        found = largest_clique(adjacent)
        assert found.exact
        assert len(found.members) == brute_size(adjacent)
        assert all(adjacent[i, j] for i, j in combinations(found.members, 2))
        assert found.members == tuple(sorted(found.members))


def test_a_clique_among_hundreds_is_found_and_a_search_cut_short_says_so():
    rng = np.random.default_rng(0)
    upper = np.triu(rng.random((200, 200)) < 0.2, 1)
    hidden = np.sort(rng.choice(200, 30, replace=False))
    upper[np.ix_(hidden, hidden)] = np.triu(np.ones((30, 30), dtype=bool), 1)
    found = largest_clique(upper | upper.T)
    assert found.exact
    assert found.members == tuple(hidden.tolist())
    assert not largest_clique(upper | upper.T, most_nodes=3).exact
    assert largest_clique(np.zeros((0, 0), dtype=bool)).members == ()
    assert len(largest_clique(np.zeros((4, 4), dtype=bool)).members) == 1


def test_a_search_takes_nodes_with_most_ties_first_each_the_last_of_the_least_tied_that_are_left():
    rng = np.random.default_rng(4)
    for _ in range(10):
        upper = np.triu(rng.random((12, 12)) < 0.5, 1)
        adjacent = upper | upper.T
        order = _by_degeneracy(adjacent)
        assert sorted(order) == list(range(12))
        for last in range(12):
            rest = order[: last + 1]
            ties = adjacent[np.ix_(rest, rest)].sum(axis=1)
            assert ties[last] == ties.min()
            assert rest[last] == max(rest[ties == ties.min()])


def test_the_adjoint_carries_small_motions():
    rng = np.random.default_rng(1)
    for _ in range(20):
        T, d = rng.normal(0, 2, 3), 1e-6 * rng.normal(size=3)
        moved = se2.compose(se2.compose(T, d), se2.inverse(T))
        assert np.allclose(adjoint(T) @ d, moved, atol=1e-10)


def sampled(rng, n, sd, way_sd):
    """Two maps of n places, closures between them with noise, ways with noise; and their covariances."""
    T = se2.pose(*rng.normal(0, 5, 2), rng.uniform(-3, 3))
    first = np.column_stack([rng.uniform(-10, 10, (n, 2)), rng.uniform(-3, 3, n)])
    places = se2.compose(first, np.column_stack([rng.uniform(-2, 2, (n, 2)), rng.uniform(-3, 3, n)]))
    second = se2.between(T, places)
    measured = se2.compose(se2.between(first, places), rng.normal(0, sd, (n, 3)))
    moved = se2.compose(second, rng.normal(0, way_sd, (n, 3)))
    return first, moved, measured


def test_cycles_of_true_closures_have_the_chi_square_their_covariances_promise():
    sd, way = np.array([0.05, 0.08, 0.01]), np.array([0.03, 0.02, 0.005])
    means = []
    for seed in range(60):
        rng = np.random.default_rng([seed, 9])
        first, second, measured = sampled(rng, 6, sd, way)
        # each end moved on its own: way k to l has the noise of both ends, k's carried to l's frame
        carried = adjoint(se2.inverse(se2.between(second[:, None], second[None, :])))
        W = carried @ np.diag(way**2) @ carried.swapaxes(-1, -2) + np.diag(way**2)
        squares = cycle_squares(first, second, measured, np.repeat(np.diag(sd**2)[None], 6, 0), None, W)
        assert np.array_equal(squares, squares.T)
        means.append(squares[np.triu_indices(6, 1)].mean())
    assert 2.6 < np.mean(means) < 3.4


@pytest.mark.parametrize("false", [3, 12])
def test_false_closures_stand_outside_the_largest_consistent_set(false):
    sd = np.array([0.05, 0.05, 0.01])
    for seed in range(5):
        rng = np.random.default_rng([seed, 2])
        first, second, measured = sampled(rng, 10, sd, np.zeros(3))
        n = 10 + false
        more = np.column_stack([rng.uniform(-10, 10, (false, 2)), rng.uniform(-3, 3, false)])
        first, second = (np.concatenate([a, rng.permutation(a)[np.arange(false) % 10]]) for a in (first, second))
        squares = cycle_squares(first, second, np.concatenate([measured, more]), np.repeat(np.diag(sd**2)[None], n, 0))
        near = (squares <= 20.0) & ~np.eye(n, dtype=bool)
        found = largest_clique(near)
        assert found.members == tuple(range(10))


def random_covariances(rng, *shape):
    A = 0.05 * rng.normal(size=(*shape, 3, 3))
    return A @ A.swapaxes(-1, -2) + 1e-4 * np.eye(3)


@pytest.mark.parametrize("ways", ["none", "first", "second", "both"])
def test_a_cycles_error_is_weighed_with_what_small_errors_of_its_parts_make_of_it(ways):
    rng = np.random.default_rng(11)
    n, h = 4, 1e-6
    first, second, measured = sampled(rng, n, np.array([0.3, 0.2, 0.1]), np.zeros(3))
    own, one, two = random_covariances(rng, n), random_covariances(rng, n, n), random_covariances(rng, n, n)
    one, two = (one if ways in ("first", "both") else None), (two if ways in ("second", "both") else None)
    squares = cycle_squares(first, second, measured, own, one, two)
    assert not np.diag(squares).any()
    for k in range(n):
        for l in range(k + 1, n):

            def error(d, k=k, l=l):
                u = se2.compose(se2.between(first[l], first[k]), d[:3])
                v = se2.compose(se2.between(second[k], second[l]), d[9:])
                ahead = se2.compose(u, se2.compose(se2.compose(measured[k], d[3:6]), v))
                return se2.between(se2.compose(measured[l], d[6:9]), ahead)

            e = error(np.zeros(12))
            J = np.stack([se2.between(e, error(h * d)) / h for d in np.eye(12)], axis=1)
            S = np.zeros((12, 12))
            S[3:6, 3:6], S[6:9, 6:9] = own[k], own[l]
            if one is not None:
                S[:3, :3] = one[l, k]
            if two is not None:
                S[9:, 9:] = two[k, l]
            wanted = e @ np.linalg.solve(J @ S @ J.T, e)
            assert squares[k, l] == pytest.approx(wanted, rel=1e-4)
            assert squares[l, k] == squares[k, l]
