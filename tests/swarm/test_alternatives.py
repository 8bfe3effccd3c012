"""Other hypotheses about the same sightings are found, weighed as a dense derivation weighs them, and told."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.gaussian import chi2_quantile
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm import alternatives
from mapweave.swarm.alternatives import Dense, _outside, doubts, hypotheses_near
from mapweave.swarm.batch import batch
from mapweave.swarm.config import ALTERNATIVES_DOUBT, SwarmConfig
from mapweave.swarm.locate import locate

from .swarms import PAPER, as_network, complete, simulated, small

ROBUST = SwarmConfig(method="robust")


def none_wrong(net):
    return np.zeros(len(net.observer), dtype=bool)


def test_the_first_hypothesis_is_the_answer_itself_with_its_covariance():
    net = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1))
    found = batch(net, SwarmConfig())
    hypotheses = hypotheses_near(Dense.of(net, found), none_wrong(net))
    assert not hypotheses.wrong[0].any()
    np.testing.assert_allclose(hypotheses.x[0].reshape(5, 2), found.position, atol=1e-4)
    cov = hypotheses.cov[0].reshape(5, 2, 5, 2)
    for k in range(2, 5):
        np.testing.assert_allclose(cov[k, :, k], found.cov[k], rtol=1e-3)


def test_the_evidence_of_leaving_one_out_is_the_density_of_its_direction_given_all_others():
    net = complete(PAPER, 0.2, np.random.default_rng(1), anchors=(0, 1))
    found = batch(net, SwarmConfig())
    problem = Dense.of(net, found)
    row, m = 13, len(net.observer)
    without = none_wrong(net)
    without[row] = True
    every, less = problem.solved(none_wrong(net)[None]).evidence[0], problem.solved(without[None])
    others = batch(net.select(~without), SwarmConfig())
    p, q = others.position[net.observer[row]], others.position[net.target[row]]
    d = q - p
    J = np.array([-d[1], d[0]]) / (d @ d)
    ends = [int(net.observer[row]), int(net.target[row])]
    E = np.concatenate([-J, J])
    free = [k for k in range(2) if ends[k] not in net.anchors]
    P = np.zeros((4, 4))
    if free:
        at = np.concatenate([2 * k + np.arange(2) for k in free])
        P[np.ix_(at, at)] = others.joint([ends[k] for k in free])
    variance = float(E @ P @ E) + net.sigma[row] ** 2
    miss = (net.bearing[row] - np.arctan2(d[1], d[0]) + np.pi) % (2 * np.pi) - np.pi
    expected = np.exp(-0.5 * miss**2 / variance) / np.sqrt(2 * np.pi * variance) * (2 * np.pi)
    prior = (m - 0.5) / 0.5  # Jeffreys: none wrong of m against one
    np.testing.assert_allclose(np.exp(every - less.evidence[0]), expected * prior, rtol=0.02)


def test_a_robot_that_two_sightings_place_is_doubted_and_one_that_many_place_is_not():
    rng = np.random.default_rng(2)
    truth = np.vstack([PAPER, [[3.0, 15.0]]])
    net = complete(truth, 0.5, rng, anchors=(0, 1, 2))
    sees = (net.observer == 5) | (net.target == 5)
    twice = sees & (net.observer == 5) & (net.target < 2)
    lone = net.select(~sees | twice)
    outside = doubts(lone, ~none_wrong(lone), batch(lone, SwarmConfig()))
    assert outside[5] > ALTERNATIVES_DOUBT
    assert outside[:5].max() < ALTERNATIVES_DOUBT
    assert doubts(net, ~none_wrong(net), batch(net, SwarmConfig())).max() < ALTERNATIVES_DOUBT


def test_in_space_without_axes_a_robot_that_may_be_elsewhere_is_doubted_and_one_that_many_place_is_not():
    scene = SwarmScene(robots=5, dim=3, axis=False, sigma=np.radians(0.5), visibility="mutual", outliers=0.1)
    swarm = simulate_swarm(scene, np.random.default_rng([103, 47]))
    net = as_network(swarm.table, swarm.position[0], (0, 1, 2))
    found = locate(net, ROBUST)
    outside = doubts(net, ~found.outlier, found)
    assert outside[4] > ALTERNATIVES_DOUBT
    assert outside[3] < ALTERNATIVES_DOUBT
    assert any("elsewhere (probability): 5 (" in w for w in found.warnings)
    scene = replace(scene, outliers=0.0)
    swarm = simulate_swarm(scene, np.random.default_rng([103, 47]))
    net = as_network(swarm.table, swarm.position[0], (0, 1, 2))
    assert doubts(net, ~none_wrong(net), batch(net, SwarmConfig())).max() < ALTERNATIVES_DOUBT


def test_in_space_without_axes_it_is_asked_of_fewer_sightings(monkeypatch):
    scene = SwarmScene(robots=5, dim=3, axis=False, sigma=np.radians(0.5), visibility="mutual", outliers=0.1)
    swarm = simulate_swarm(scene, np.random.default_rng([103, 47]))
    net = as_network(swarm.table, swarm.position[0], (0, 1, 2))
    found = locate(net, ROBUST)
    monkeypatch.setattr(alternatives, "ALTERNATIVES_MOST_TURNED", len(net.observer) - 1)
    assert doubts(net, ~found.outlier, found).max() == 0.0


def test_a_wrong_sighting_kept_in_place_of_a_right_one_is_found_by_swapping_them():
    net = complete(PAPER, 0.5, np.random.default_rng(3), anchors=(0, 1))
    bad = 12
    z = net.bearing.copy()
    z[bad] += 0.5
    net = replace(net, bearing=z)
    called = none_wrong(net)
    called[7] = True  # a right one
    found = batch(net.select(~called), SwarmConfig())
    hypotheses = hypotheses_near(Dense.of(net, found), called)
    assert np.flatnonzero(hypotheses.wrong[np.argmax(hypotheses.evidence)]).tolist() == [bad]
    assert doubts(net, ~called, found).max() > 0.9


def test_the_probability_outside_a_gate_is_that_of_a_normal_variable_along_its_worst_direction():
    own = np.eye(2)[None]
    limit = np.sqrt(chi2_quantile(1 - 1e-5, 2.0))
    away = np.array([[[limit, 0.0]], [[0.0, 0.0]], [[100.0, 0.0]]])
    cov = np.repeat(np.eye(2)[None, None], 3, axis=0) * 1e-6
    np.testing.assert_allclose(_outside(away, cov, own, 1e-5)[:, 0], [0.5, 0.0, 1.0], atol=1e-12)
    wide = np.diag([4.0 * limit**2, 1.0])[None, None]
    np.testing.assert_allclose(_outside(away[1:2], wide, own, 1e-5), [[2 * 0.3085375]], rtol=1e-6)


@pytest.mark.parametrize("scene", [{"dim": 3}, {"axis": False, "visibility": "mutual"}])
def test_nothing_is_doubted_of_well_seen_robots_in_space_or_without_an_axis(monkeypatch, scene):
    net, _ = simulated(0, robots=8, sigma=0.5, **{"visibility": "mutual", **scene})
    found = batch(net, SwarmConfig())
    monkeypatch.setattr(alternatives, "ALTERNATIVE_ROUNDS", 1)
    assert doubts(net, ~none_wrong(net), found).max() < ALTERNATIVES_DOUBT


def test_without_anchors_the_shape_is_judged():
    net = complete(PAPER, 0.5, np.random.default_rng(5))
    found = batch(net, SwarmConfig())
    assert doubts(net, ~none_wrong(net), found).max() < ALTERNATIVES_DOUBT
    large, _ = simulated(0, robots=64)
    assert not doubts(large, ~none_wrong(large), batch(large, SwarmConfig())).any()


@pytest.mark.slow
def test_of_small_networks_with_a_wrong_sighting_no_answer_called_reliable_is_wrong():
    sure = 0
    for seed in range(16):
        net, truth = small(seed)
        found = locate(net, ROBUST)
        free = found.localisable & ~found.anchor
        if not free.any() or not found.reliable:
            continue
        e = (found.position - truth)[free]
        assert np.einsum("ni,nij,nj->n", e, np.linalg.inv(found.cov[free]), e).max() < chi2_quantile(1 - 1e-5, 2.0)
        sure += 1
    assert sure >= 6
