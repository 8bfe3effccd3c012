"""A chain of stretches solved in pieces is the whole solved at once."""

import numpy as np
import pytest
import scipy.sparse as sp

from mapweave.solve import SingularError
from mapweave.solve.chain import Gauss, SchurComplement, passed, solve

ENDS, HUBS, OWN = 3, 4, 7


def stretches(rng, n=5):
    """Random information, gradient and point of each stretch: own variables, ends in and out, hubs."""
    out = []
    for k in range(n):
        size = OWN + HUBS + ENDS * ((k > 0) + (k < n - 1))
        A = rng.normal(size=(size + 4, size))
        out.append((A.T @ A, rng.normal(size=size), rng.normal(size=size)))
    return out


def places(k, n):
    """Where stretch k's variables stand in the whole: ends, hubs, then own ones of each."""
    own = ENDS * (n - 1) + HUBS + OWN * k + np.arange(OWN)
    ends = [ENDS * j + np.arange(ENDS) for j in (k - 1, k) if 0 <= j < n - 1]
    return np.concatenate([*ends, ENDS * (n - 1) + np.arange(HUBS), own])


def test_a_chain_in_pieces_is_the_whole_at_once():
    rng = np.random.default_rng(1)
    made = stretches(rng)
    n = len(made)
    whole = np.zeros((ENDS * (n - 1) + HUBS + OWN * n,) * 2)
    eta = np.zeros(len(whole))
    links = []
    for k, (H, g, x) in enumerate(made):
        at = places(k, n)
        whole[np.ix_(at, at)] += H
        eta[at] += H @ x - g
        links.append(SchurComplement.of(sp.csc_matrix(H), g, x, np.arange(len(at) - OWN)))
    expected = np.linalg.solve(whole, eta)
    entry, steps = Gauss(np.zeros((HUBS, HUBS)), np.zeros(HUBS)), []
    for k, link in enumerate(links):
        steps.append(passed(entry, link, ENDS * (k > 0), ENDS * (k < n - 1), np.arange(HUBS)))
        entry = steps[-1].on
    hubs, ends = solve(entry.Lambda, entry.eta), np.zeros(0)
    hub_rows = ENDS * (n - 1) + np.arange(HUBS)
    np.testing.assert_allclose(hubs, expected[hub_rows], atol=1e-10)
    np.testing.assert_allclose(
        solve(entry.Lambda, np.eye(HUBS)), np.linalg.inv(whole)[np.ix_(hub_rows, hub_rows)], atol=1e-10
    )
    for k in reversed(range(n)):
        before = steps[k].w - steps[k].W @ np.concatenate([ends, hubs])
        x = links[k].inside(np.concatenate([before, ends, hubs]))
        np.testing.assert_allclose(x, expected[places(k, n)], atol=1e-9)
        ends = before


def test_what_nothing_tells_is_refused():
    with pytest.raises(SingularError):
        solve(np.diag([1.0, 0.0]), np.ones(2))
    H = sp.csc_matrix(np.diag([1.0, 1.0, 0.0]))
    with pytest.raises(SingularError):
        SchurComplement.of(H, np.zeros(3), np.zeros(3), np.array([0]))
