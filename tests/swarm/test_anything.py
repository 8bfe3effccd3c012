"""Whatever the layout, locating ends in an answer with a verdict or in one clear error; nothing else."""

import numpy as np
import pytest

from mapweave.core.errors import MapweaveError
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork, Distance


def anything(seed):
    """A small network of any shape: spread, on a line, on a lattice, or half of it in one place; or None."""
    rng = np.random.default_rng(seed)
    n, dim = int(rng.integers(2, 14)), int(rng.integers(2, 4))
    axis = dim == 3 or rng.random() < 0.6
    p = rng.uniform(0, 30, (n, dim))
    layout = rng.integers(0, 4)
    if layout == 1:
        p[:, 1:] = 0.0
    elif layout == 2:
        p = np.round(p / 10) * 10
    elif layout == 3:
        p[n // 2 :] = p[0]
    m = int(rng.integers(1, 3 * n + 2))
    i, j = rng.integers(0, n, (2, m))
    i, j = i[i != j], j[i != j]
    if not len(i):
        return None
    sigma = float(rng.choice([0.0, 0.01, 0.1]))
    d = p[j] - p[i]
    d[~d.any(axis=1)] = np.eye(dim)[0]
    u = d / np.linalg.norm(d, axis=1, keepdims=True) + sigma * rng.normal(size=d.shape)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    z = u if dim == 3 else np.arctan2(u[:, 1], u[:, 0])
    if dim == 2 and rng.random() < 0.3:
        z = np.where(rng.random(len(z)) < 0.2, rng.uniform(-3, 3, len(z)), z)
    if not axis:
        z = (z - rng.uniform(-3, 3, n)[i] + np.pi) % (2 * np.pi) - np.pi
    anchors = {int(k): p[k] for k in rng.choice(n, int(rng.integers(0, min(n, 3) + 1)), replace=False)}
    a, b = rng.choice(n, 2, replace=False)
    far = float(np.linalg.norm(p[a] - p[b]))
    distances = (Distance(int(a), int(b), far),) if far > 0 and rng.random() < 0.3 else ()
    return BearingNetwork(tuple(map(str, range(n))), dim, i, j, z, np.full(len(i), sigma), anchors, distances, axis)


@pytest.mark.parametrize("method", ["batch", pytest.param("robust", marks=pytest.mark.slow), "iekf", "distributed"])
def test_every_small_network_gives_an_answer_or_one_clear_error(method):
    answered = 0
    for seed in range(60):
        net = anything(seed)
        if net is None:
            continue
        try:
            estimate = locate(net, SwarmConfig(method=method, max_rounds=200))
        except MapweaveError:
            continue
        answered += 1
        assert np.isfinite(estimate.position).all()
        assert len(estimate.not_localisable) == 0 or estimate.warnings
        for k, p in net.anchors.items():
            np.testing.assert_allclose(estimate.position[k], p, atol=1e-9)
        if estimate.cov is not None:
            assert np.isfinite(estimate.cov[estimate.localisable]).all()
    assert answered > 5
