"""What sightings, distances and robots kept apart cost: derivatives by differences, and pairs by trying every one."""

import numpy as np
import pytest

from mapweave.core.attitude import matrices
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.factors import (
    apart_factor,
    bearing_factor,
    distance_factor,
    parted,
    prior_factor,
    retract,
    state,
    width,
)
from mapweave.swarm.network import BearingNetwork, Distance
from mapweave.swarm.start import mutual_pairs

from ..differences import assert_derivative
from .swarms import simulated

RNG = np.random.default_rng(6)


def a_network(dim, axis, n=5, sigma=0.02):
    """Robots that stand anywhere and see each other about where they are."""
    places = RNG.uniform(-3, 3, (n, dim))
    headings = np.zeros(n) if axis else RNG.uniform(-3, 3, n)
    i, j = np.nonzero(~np.eye(n, dtype=bool))
    d = places[j] - places[i]
    seen = np.arctan2(d[:, 1], d[:, 0]) - headings[i] if dim == 2 else d / np.linalg.norm(d, axis=1, keepdims=True)
    if dim == 2:
        seen = (seen + np.pi) % (2 * np.pi) - np.pi
    distances = (Distance(0, 3, 2.0, 0.3), Distance(4, 1, 1.5))
    net = BearingNetwork(tuple(map(str, range(n))), dim, i, j, seen, np.full(len(i), sigma), {}, distances, axis)
    return net, np.column_stack([places, headings])[:, : width(net)].ravel()


@pytest.mark.parametrize(("dim", "axis"), [(2, True), (2, False), (3, True)])
def test_every_derivative_of_a_swarm_is_that_of_differences(dim, axis):
    net, truth = a_network(dim, axis)
    x = truth + (0.05 * RNG.normal(size=len(truth)) if dim == 2 else 0.0)  # in space exact at the prediction
    assert_derivative(bearing_factor(net), x, 1e-5)
    assert_derivative(distance_factor(net), x)
    assert_derivative(prior_factor(np.array([1, 4]), x + 0.1, 3.0), x)
    apart = apart_factor(net, np.arange(12), 4.0)
    silent = apart.residual(x)[:, 0] == 0.0
    assert 2 <= silent.sum() <= 10
    assert not apart.jacobian(x)[silent].any()
    assert_derivative(apart, x)


def test_distances_are_off_by_what_robots_stand_too_far_apart_and_loose_entries_by_what_they_moved():
    net, x = a_network(2, False)
    p = x.reshape(-1, 3)[:, :2]
    far = [np.hypot(*(p[0] - p[3])), np.hypot(*(p[4] - p[1]))]
    factor = distance_factor(net)
    np.testing.assert_allclose(factor.residual(x)[:, 0], np.array(far) - [2.0, 1.5])
    np.testing.assert_allclose(1.0 / factor.sqrt_info[:, 0], [0.3, 1.5 * 1e-4 * 0.02])
    loose = prior_factor(np.array([2, 7]), x - np.eye(15)[7], 4.0)
    np.testing.assert_allclose(loose.squares(x), [0.0, 1.0 / 16.0], atol=1e-12)


def test_robots_are_kept_apart_by_how_many_times_too_near_they_are():
    net, x = a_network(2, True)
    rows = np.array([0, 3, 7, 11])
    p = x.reshape(-1, 2)
    r = np.hypot(*(p[net.target[rows]] - p[net.observer[rows]]).T)
    found = apart_factor(net, rows, 3.0).residual(x)[:, 0]
    np.testing.assert_allclose(found, np.maximum(np.log(3.0 / r), 0.0))


@pytest.mark.parametrize("seed", range(8))
def test_mutual_pairs_are_those_of_trying_every_two_sightings(seed):
    rng = np.random.default_rng(seed)
    n, m = 6, 3 + 4 * seed
    i = rng.integers(0, n, m)
    j = (i + rng.integers(1, n, m)) % n
    z = rng.uniform(-3, 3, m)
    net = BearingNetwork(tuple(map(str, range(n))), 2, i, j, z, np.full(m, 0.1), axis=False)
    a, b = mutual_pairs(net)
    wanted = set()
    for one in range(n):
        for two in range(one + 1, n):
            there, back = np.flatnonzero((i == one) & (j == two)), np.flatnonzero((i == two) & (j == one))
            if len(there) and len(back):
                wanted.add((int(there[0]), int(back[0])))
    assert set(zip(a.tolist(), b.tolist(), strict=True)) == wanted
    assert len(a) == len(wanted)


def test_who_is_seen_and_sees_nobody_is_no_mutual_pair():
    net = BearingNetwork(
        ("a", "b", "c"), 2, np.array([0, 1]), np.array([2, 2]), np.zeros(2), np.full(2, 0.1), axis=False
    )
    assert not len(mutual_pairs(net)[0])


def test_a_step_turns_robots_about_the_common_axes_and_sightings_change_as_their_derivative_says():
    net = simulated(3, robots=8, dim=3, axis=False, sigma=0.0)[0]
    swarm = simulate_swarm(SwarmScene(robots=8, dim=3, axis=False, sigma=0.0), np.random.default_rng(3))
    x = state(swarm.position[0], swarm.heading[0])
    factor, step = bearing_factor(net), RNG.normal(size=len(x))
    np.testing.assert_allclose(factor.residual(x), 0.0, atol=1e-9)
    np.testing.assert_array_equal(state(*parted(net, x)), x)
    turn = parted(net, step)[1]
    np.testing.assert_allclose(
        matrices(parted(net, retract(net, x, step))[1]), matrices(turn) @ matrices(swarm.heading[0])
    )
    h = 1e-6
    change = (factor.residual(retract(net, x, h * step)) - factor.residual(retract(net, x, -h * step))) / (2 * h)
    said = np.einsum("mkc,mc->mk", factor.jacobian(x), step[factor.columns])
    np.testing.assert_allclose(change, said, atol=1e-6)
