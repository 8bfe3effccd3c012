"""Swarms the tests share: simulated networks with their truth, and how an estimate is scored."""

import numpy as np

from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.network import BearingNetwork

ROOT3 = np.sqrt(3.0)
PAPER = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [5.0, 5 * ROOT3], [15.0, 5 * ROOT3]])


def simulated(seed, anchors="corners", distances=(), **scene):
    """A network and the truth (n, d) it was drawn from; sigma in degrees."""
    scene = {**scene, "sigma": np.radians(scene.get("sigma", 0.5))}
    swarm = simulate_swarm(SwarmScene(**scene), np.random.default_rng(seed))
    known = swarm.corners if anchors == "corners" else anchors
    truth = swarm.position[0]
    return as_network(swarm.table, truth, known, distances), truth


def as_network(table, truth, known, distances=()):
    dim = truth.shape[1]
    d = table.direction
    bearing = np.arctan2(d[:, 1], d[:, 0]) if dim == 2 else d
    anchors = {int(k): truth[k] for k in known}
    return BearingNetwork(
        table.ids, dim, table.observer, table.target, bearing, table.sigma, anchors, distances, table.axis
    )


def complete(truth, sigma, rng, anchors=(), single=False, exact=False):
    """Everyone sees everyone, 2D; sigma in degrees; `single`: only the lower index looks."""
    n = len(truth)
    i, j = np.nonzero(~np.eye(n, dtype=bool)) if not single else np.triu_indices(n, 1)
    d = truth[j] - truth[i]
    sigma = np.radians(sigma)
    z = np.arctan2(d[:, 1], d[:, 0]) + (0 if exact else sigma * rng.normal(size=len(i)))
    z = (z + np.pi) % (2 * np.pi) - np.pi
    s = np.full(len(i), 0.0 if exact else sigma)
    return BearingNetwork(tuple(map(str, range(n))), 2, i, j, z, s, {k: truth[k] for k in anchors})


def score(estimate, truth):
    """RMSE, the bound's RMSE, and NEES per degree of freedom over the free robots that are localisable."""
    free = estimate.localisable & ~estimate.anchor
    error = np.square(estimate.position - truth)[free].sum(axis=1)
    bound = np.trace(estimate.cov[free], axis1=1, axis2=2)
    value, dof = estimate.nees(truth)
    return float(np.sqrt(error.mean())), float(np.sqrt(bound.mean())), value / dof


def small(seed, sigma=1.0):
    """4 to 11 robots, two of them known, who sight others at random, one bearing wrong; and the truth."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 12))
    truth = rng.uniform(0, 10 * np.sqrt(n), (n, 2))
    pairs = np.argwhere(~np.eye(n, dtype=bool))
    m = min(len(pairs), int(n * rng.integers(2, 5)))
    i, j = pairs[np.sort(rng.choice(len(pairs), m, replace=False))].T
    d = truth[j] - truth[i]
    s = np.radians(sigma)
    z = np.arctan2(d[:, 1], d[:, 0]) + rng.normal(0, s, m)
    wrong = rng.integers(m)
    z[wrong] += rng.uniform(-np.pi, np.pi)
    z = (z + np.pi) % (2 * np.pi) - np.pi
    return BearingNetwork(tuple(map(str, range(n))), 2, i, j, z, np.full(m, s), {0: truth[0], 1: truth[1]}), truth
