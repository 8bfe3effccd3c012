"""Wrong sightings are found, the rest is used to the full, and what cannot be trusted says so."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.attitude import angles, headings, matrices
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.factors import parted, state
from mapweave.swarm.locate import locate
from mapweave.swarm.robust import mutual_agreement, relocated, unsupported

from .swarms import PAPER, as_network, complete, score, simulated

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
    found = relocated(net, off.ravel(), 3.5**2).reshape(truth.shape)
    assert np.linalg.norm(found - truth, axis=1)[free].max() < 0.5
    np.testing.assert_array_equal(relocated(net, truth.ravel(), 3.5**2).reshape(truth.shape)[free], truth[free])


@pytest.mark.parametrize(("dim", "visibility"), [(2, "mutual"), (3, "mutual"), (3, "directed")])
def test_a_robot_with_axes_of_its_own_is_put_and_turned_where_most_of_its_sightings_meet(dim, visibility):
    net, truth = simulated(5, robots=64, dim=dim, axis=False, visibility=visibility, outliers=0.1)
    swarm = simulate_swarm(
        SwarmScene(robots=64, dim=dim, axis=False, visibility=visibility, outliers=0.1, sigma=np.radians(0.5)),
        np.random.default_rng(5),
    )
    R = matrices(swarm.heading[0])
    free, anchor = np.flatnonzero(~net.is_anchor)[:3], next(iter(net.anchors))
    off, turned = truth.copy(), R.copy()
    off[free] += 7.0
    turned[[*free, anchor]] = turned[[*free, anchor]].swapaxes(1, 2)
    found, heading = parted(net, relocated(net, state(off, headings(turned)), 15.0))
    assert np.linalg.norm(found - truth, axis=1)[free].max() < 1.0
    assert np.degrees(angles(matrices(heading), R)).max() < 10.0
    np.testing.assert_array_equal(found[anchor], truth[anchor])


@pytest.mark.parametrize(("seed", "dim"), [(0, 2), (1, 2), (0, 3), (14, 3)])
def test_wrong_sightings_leave_no_robot_at_a_wrong_place_where_no_axis_is_common(seed, dim):
    scene = SwarmScene(robots=27, dim=dim, axis=False, sigma=np.radians(0.5), visibility="mutual", outliers=0.1)
    swarm = simulate_swarm(scene, np.random.default_rng([12, seed]))
    net, truth = as_network(swarm.table, swarm.position[0], swarm.corners), swarm.position[0]
    found = locate(net, SwarmConfig(method="robust"))
    assert found.localisable.all()
    assert found.reliable
    assert np.linalg.norm(found.position - truth, axis=1).max() < 1.0


def test_few_robots_that_a_wrong_sighting_turns_start_from_parts_of_the_sightings_too():
    scene = SwarmScene(robots=5, dim=3, axis=False, sigma=np.radians(0.5), visibility="mutual", outliers=0.1)
    for seed in (40, 132):
        swarm = simulate_swarm(scene, np.random.default_rng([99, seed]))
        truth = swarm.position[0]
        found = locate(as_network(swarm.table, truth, (0, 1, 2)), SwarmConfig(method="robust"))
        assert np.linalg.norm(found.position - truth, axis=1).max() < 0.5


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


def test_an_anchor_that_is_said_to_stand_elsewhere_makes_no_reliable_answer():
    net, _ = simulated(3, robots=30, sigma=1.0)
    assert locate(net, ROBUST).reliable
    for k in net.anchors:
        moved = locate(replace(net, anchors={**net.anchors, k: net.anchors[k] + 15.0}), ROBUST)
        assert not moved.reliable
        assert "prove nothing" in moved.warnings[0]


@pytest.mark.parametrize("visibility", ["directed", "mutual"])
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_two_robots_that_the_others_take_for_each_other_are_not_called_reliable(visibility, outliers):
    net, _ = simulated(1, robots=36, sigma=1.0, visibility=visibility, outliers=outliers)
    assert locate(net, ROBUST).reliable
    a, b = 14, 28
    target = np.where(net.target == a, b, np.where(net.target == b, a, net.target))
    kept = net.observer != target
    estimate = locate(replace(net.select(np.flatnonzero(kept)), target=target[kept]), ROBUST)
    assert not estimate.reliable
    (told,) = [warning for warning in estimate.warnings if "stand elsewhere" in warning]
    assert {net.ids[a], net.ids[b]} & set(told.rpartition(": ")[2].split(", "))
