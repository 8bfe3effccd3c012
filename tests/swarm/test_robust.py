"""Wrong sightings are found, the rest is used to the full, and what cannot be trusted says so."""

import numpy as np
import pytest

from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.robust import mutual_agreement, relocated, unsupported

from .swarms import PAPER, complete, score, simulated

ROBUST = SwarmConfig(method="robust")


def ratios(outliers, draws, **scene):
    """RMSE over the bound that the same sightings would have without outliers, by draw."""
    found = []
    for seed in range(draws):
        net, truth = simulated(seed, robots=100, sigma=1.0, outliers=outliers, **scene)
        clean, _ = simulated(seed, robots=100, sigma=1.0, **scene)
        estimate, best = locate(net, ROBUST), locate(clean, initial=truth)
        free = estimate.localisable & ~estimate.anchor
        bound = np.trace(best.cov[free], axis1=1, axis2=2).mean()
        found.append(np.sqrt(np.square(estimate.position - truth)[free].sum(axis=1).mean() / bound))
    return np.array(found)


@pytest.mark.parametrize(
    ("outliers", "limit"),
    [(0.05, 1.25), *(pytest.param(*p, marks=pytest.mark.slow) for p in [(0.1, 1.25), (0.2, 1.6)])],
)
def test_mutual_sightings_carry_outliers_at_little_cost(outliers, limit):
    assert np.median(ratios(outliers, 9, visibility="mutual")) <= limit


def test_without_outliers_robust_costs_nothing_and_calls_almost_nothing_wrong():
    net, truth = simulated(3, robots=100, sigma=1.0, visibility="mutual")
    estimate = locate(net, ROBUST)
    assert estimate.reliable
    assert estimate.outlier.mean() < 0.005
    rmse, bound, _ = score(estimate, truth)
    assert rmse < 1.3 * bound


@pytest.mark.parametrize("seed", range(4))
def test_single_sightings_with_two_anchors_and_many_outliers_are_not_called_reliable(seed):
    net, _ = simulated(seed, robots=100, sigma=1.0, visibility="single", outliers=0.2, anchors=(0, 99))
    estimate = locate(net, ROBUST)
    assert not estimate.reliable
    assert estimate.warnings


def test_the_plain_estimator_says_when_outliers_spoil_it():
    net, _ = simulated(1, robots=100, sigma=1.0, visibility="mutual", outliers=0.05)
    estimate = locate(net)
    assert not estimate.reliable
    assert any("larger than sigma says" in w for w in estimate.warnings)


@pytest.mark.parametrize("dim", [2, 3])
def test_two_mutual_sightings_that_are_not_opposite_are_both_doubted(dim):
    net, truth = simulated(2, robots=64, dim=dim, sigma=1.0, visibility="mutual", outliers=0.1)
    d = truth[net.target] - truth[net.observer]
    u = d / np.linalg.norm(d, axis=1, keepdims=True)
    miss = np.arccos(np.clip(np.einsum("mk,mk->m", u, net.direction), -1, 1))
    wrong = miss > np.radians(15.0)
    agree = mutual_agreement(net, 4.0)
    assert wrong.sum() > 10
    assert agree[wrong].mean() < 0.05
    pairs = {(i, j) for i, j, bad in zip(net.observer, net.target, ~agree, strict=True) if bad}
    assert all((j, i) in pairs for i, j in pairs)


def test_outliers_in_space_are_found():
    net, truth = simulated(5, robots=125, dim=3, sigma=1.0, visibility="mutual", outliers=0.1)
    estimate = locate(net, ROBUST)
    rmse, bound, _ = score(estimate, truth)
    assert estimate.reliable
    assert 0.08 < estimate.outlier.mean() < 0.12
    assert rmse < 1.3 * bound


@pytest.mark.slow
@pytest.mark.parametrize("anchors", [(0, 99), "corners"])
def test_single_sightings_with_few_outliers_are_located_right_or_said_to_be_unsure(anchors):
    sure = 0
    for seed in range(10):
        net, truth = simulated(seed, robots=100, sigma=1.0, visibility="single", outliers=0.05, anchors=anchors)
        clean, _ = simulated(seed, robots=100, sigma=1.0, visibility="single", anchors=anchors)
        estimate, best = locate(net, ROBUST), locate(clean, initial=truth)
        free = estimate.localisable & ~estimate.anchor
        error = np.square(estimate.position - truth)[free].sum(axis=1)
        if estimate.reliable:
            sure += 1
            assert np.sqrt(error.mean() / np.trace(best.cov[free], axis1=1, axis2=2).mean()) < 2.0
            assert np.sqrt((error / np.trace(estimate.cov[free], axis1=1, axis2=2)).max()) < 5.0
        else:
            assert estimate.warnings
    assert sure >= 6


@pytest.mark.parametrize("dim", [2, 3])
def test_a_robot_at_a_wrong_crossing_is_put_where_most_of_its_sightings_meet(dim):
    net, truth = simulated(3, robots=64, dim=dim, sigma=0.5, visibility="single", outliers=0.05)
    free = np.flatnonzero(~net.is_anchor)[:3]
    off = truth.copy()
    off[free] += 7.0
    found = relocated(net, off, 3.5**2)
    assert np.linalg.norm(found - truth, axis=1)[free].max() < 0.5
    np.testing.assert_array_equal(relocated(net, truth, 3.5**2)[free], truth[free])


def test_robots_whose_right_sightings_do_not_outnumber_the_wrong_are_named():
    rng = np.random.default_rng(0)
    net = complete(PAPER, 0.5, rng, anchors=(0, 1), single=True)  # everyone has four sightings
    outlier = np.zeros(len(net.observer), dtype=bool)
    assert not len(unsupported(net, outlier))
    mine = np.flatnonzero((net.observer == 3) | (net.target == 3))
    outlier[mine[:1]] = True
    assert unsupported(net, outlier).tolist() == []
    outlier[mine[:2]] = True
    assert unsupported(net, outlier).tolist() == [3]
