"""Association against an enumeration of every assignment, on random landmarks with correlated predictions."""

import itertools

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.gaussian import chi2_quantile
from mapweave.landmarks import association as pairing
from mapweave.landmarks.association import (
    Assignment,
    certain,
    individual_costs,
    jcbb,
    nearest_neighbour,
    pairing_probabilities,
)

R = np.array([[0.04, 0.001], [0.001, 0.0016]])
GATE, NEW = 9.21, 25.0


def drawn(seed, m=3, n=4):
    """Observations, half of them of a landmark, predictions a gate or less apart, and what correlates these."""
    rng = np.random.default_rng([seed, 40])
    zhat = np.column_stack([rng.uniform(4.0, 5.0, n), np.pi + rng.uniform(-0.2, 0.2, n)])
    shared = rng.normal(size=(2 * n, 3)) * np.tile([0.1, 0.04], n)[:, None]
    S = shared @ shared.T + np.diag(rng.uniform(1e-5, 2e-3, 2 * n))
    chosen = rng.permutation(n)[:m]
    noise = rng.multivariate_normal(np.zeros(2 * n), S)[np.repeat(2 * chosen, 2).reshape(-1, 2) + np.arange(2)]
    z = zhat[chosen] + noise + rng.multivariate_normal(np.zeros(2), R, m)
    z[-1] += rng.uniform(0, 1, 2) * [0.6, 0.1]
    z[:, 1] = se2.wrap_angle(z[:, 1])
    return z, zhat, S


def innovations(z, zhat):
    e = z[:, None] - zhat[None]
    e[..., 1] = np.angle(np.exp(1j * e[..., 1]))
    return e


def joint(pairs, e, S):
    rows = np.array([2 * j + a for _, j in pairs for a in (0, 1)], dtype=int)
    C = S[np.ix_(rows, rows)] + np.kron(np.eye(len(pairs)), R)
    v = np.array([e[k, j] for k, j in pairs]).ravel()
    return float(v @ np.linalg.inv(C) @ v), float(np.linalg.slogdet(C)[1])


def assignments(m, n):
    """Every way in which each observation has one landmark or none, and no landmark two observations."""
    for chosen in itertools.product([None, *range(n)], repeat=m):
        used = [j for j in chosen if j is not None]
        if len(set(used)) == len(used):
            yield chosen, [(k, j) for k, j in enumerate(chosen) if j is not None]


@pytest.mark.parametrize("seed", range(12))
def test_costs_are_those_of_each_pair_by_itself(seed):
    z, zhat, S = drawn(seed)
    D2, logdet, e = individual_costs(z, zhat, S, R, (1,))
    np.testing.assert_allclose(e, innovations(z, zhat), atol=1e-12)
    for k in range(len(z)):
        for j in range(len(zhat)):
            assert (D2[k, j], logdet[j]) == pytest.approx(joint([(k, j)], e, S), rel=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_nearest_neighbours_are_the_cheapest_of_all_assignments_with_most_pairs(seed):
    z, zhat, S = drawn(seed)
    D2, logdet, _ = individual_costs(z, zhat, S, R, (1,))
    best = min(
        (-len(pairs) * (GATE + logdet.max() + 1.0) + sum(D2[p] + logdet[p[1]] for p in pairs), chosen)
        for chosen, pairs in (a for a in assignments(*D2.shape) if all(D2[p] < GATE for p in a[1]))
    )
    found = nearest_neighbour(z, zhat, S, R, GATE, NEW, (1,))
    assert found.landmark == best[1]
    assert found.new == tuple(j is None and bool((row > NEW).all()) for j, row in zip(found.landmark, D2, strict=True))


@pytest.mark.parametrize("seed", range(12))
def test_the_joint_hypothesis_is_the_longest_then_nearest_whose_every_beginning_is_compatible(seed):
    z, zhat, S = drawn(seed)
    D2, _, e = individual_costs(z, zhat, S, R, (1,))
    probability = 1 - np.exp(-0.5 * GATE)

    def compatible(pairs):
        whole = range(1, len(pairs) + 1)
        return all(joint(pairs[:k], e, S)[0] < chi2_quantile(probability, 2.0 * k) for k in whole)

    allowed = [(c, p) for c, p in assignments(*D2.shape) if all(D2[q] < GATE for q in p) and compatible(p)]
    best = min(allowed, key=lambda a: (-len(a[1]), joint(a[1], e, S)[0] if a[1] else 0.0))
    found = jcbb(z, zhat, S, R, GATE, NEW, (1,))
    assert found.landmark == best[0]


@pytest.mark.parametrize("odd", range(4))
def test_an_observation_at_odds_with_all_the_others_gives_way_to_them_wherever_it_stands_among_them(odd):
    zhat = np.array([[5.0, 0.0], [9.0, 4.0], [2.0, 8.0], [-4.0, -3.0]])
    S = np.kron(np.ones((4, 4)), np.eye(2)) + 1e-6 * np.eye(8)  # they all err together
    z = zhat + np.array([0.8, -0.3])
    z[odd] = zhat[odd] - np.array([0.8, -0.3])
    found = jcbb(z, zhat, S, 0.01 * np.eye(2), GATE, NEW)
    assert found.landmark == tuple(None if k == odd else k for k in range(4))
    assert not any(found.new)


def test_the_joint_gate_of_another_dimension_than_two_holds_99_percent():
    S, noise = np.zeros((1, 1)), np.eye(1)
    inside, outside = (np.sqrt(chi2_quantile(0.99, 1.0)) * s for s in (0.99, 1.01))
    for at, found in ((inside, 0), (outside, None)):
        assert jcbb(np.array([[at]]), np.zeros((1, 1)), S, noise, 1e3, 1e4).landmark == (found,)


def test_a_search_that_takes_too_long_ends_with_the_best_so_far():
    n = 14  # every observation fits every landmark: far too many hypotheses to try
    z = np.tile([5.0, 0.0], (n, 1))
    zhat = z + np.column_stack([np.linspace(0, 0.01, n), np.zeros(n)])
    found = jcbb(z, zhat, 1e-3 * np.eye(2 * n), R, GATE, NEW, (1,))
    assert sorted(j for j in found.landmark if j is not None) == list(range(n))


@pytest.mark.parametrize("seed", range(12))
def test_a_match_is_kept_where_its_probability_over_all_pairs_inside_the_gate_is_sure(seed):
    z, zhat, S = drawn(seed)
    D2, _, e = individual_costs(z, zhat, S, R, (1,))
    density = np.array([0.5, 2.0, 8.0])
    pairs = [(k, j) for k in range(len(z)) for j in range(len(zhat)) if D2[k, j] < GATE]
    C = np.zeros((2 * len(pairs), 2 * len(pairs)))
    for a, (k, i) in enumerate(pairs):
        for b, (q, j) in enumerate(pairs):
            block = S[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] + R * (k == q)
            C[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = block
    labels = np.array([(k, len(z) + j) for k, j in pairs])
    p = pairing_probabilities(labels, np.array([e[q] for q in pairs]), C, density[[k for k, _ in pairs]])
    found = nearest_neighbour(z, zhat, S, R, GATE, NEW, (1,))
    kept = certain(found, z, zhat, S, R, GATE, NEW, (1,), density, 0.6)
    sure = {q for q, value in zip(pairs, p, strict=True) if value > 0.6}
    assert kept.landmark == tuple(j if (k, j) in sure else None for k, j in enumerate(found.landmark))
    free = [j for j in range(len(zhat)) if j not in kept.landmark]
    for k, (was, now) in enumerate(zip(found.landmark, kept.landmark, strict=True)):
        assert kept.new[k] == (was is None and now is None and bool((D2[k, free] > NEW).all()))


def test_without_landmarks_or_observations_there_is_nothing_to_be_sure_of():
    nothing = Assignment((), ())
    density = np.zeros(0)
    z = np.zeros((0, 2))
    assert certain(nothing, z, z, np.zeros((0, 0)), R, GATE, NEW, (1,), density, 0.9) is nothing
    one = np.array([[5.0, 0.0]])
    fresh = Assignment((None,), (True,))
    assert certain(fresh, one, z, np.zeros((0, 0)), R, GATE, NEW, (1,), np.ones(1), 0.9) is fresh
    assert certain(nothing, z, one, 1e-3 * np.eye(2), R, GATE, NEW, (1,), density, 0.9) is nothing


def many(n):
    """Pairs (k, n + k) and (k, n + k + 1), each of which fits or does not by itself."""
    rng = np.random.default_rng(7)
    pairs = np.array([(k, n + k + a) for k in range(n) for a in (0, 1)])
    return pairs, rng.normal(size=(2 * n, 2)), np.eye(4 * n)


def test_letting_hopeless_hypotheses_go_changes_no_probability(monkeypatch):
    monkeypatch.setattr(pairing, "WIDTH", 10**6)
    pairs, e, S = many(5)
    e[4] = 9.0
    kept = pairing_probabilities(pairs, e, S, 0.05)
    monkeypatch.setattr(pairing, "HOPELESS", 1e9)
    exact = pairing_probabilities(pairs, e, S, 0.05)
    np.testing.assert_allclose(kept, exact, atol=1e-9)
    assert 0.05 < np.median(exact) < 0.95


def test_differences_without_any_uncertainty_are_decided_by_whether_they_are_zero():
    pairs, S = np.array([[0, 2], [1, 3]]), np.zeros((4, 4))
    p = pairing_probabilities(pairs, np.array([[0.0, 0.0], [0.1, 0.0]]), S, 1.0)
    np.testing.assert_allclose(p, [1.0, 0.0], atol=1e-9)
