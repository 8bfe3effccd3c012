"""The filters where no axis is common: a heading a robot stands in the state beside its place."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.core.gaussian import chi2_quantile
from mapweave.core.se2 import wrap_angle
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.factors import bearing_factor
from mapweave.swarm.filtered import filter_start, sighting_matrix, update
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork, Distance

from .swarms import as_network, score, simulated


def turned(seed, robots=16, sigma=1.0, anchors=None):
    """A network without axes, the true places (n, 2) and headings (n,)."""
    scene = SwarmScene(robots=robots, axis=False, sigma=np.radians(sigma))
    swarm = simulate_swarm(scene, np.random.default_rng(seed))
    known = swarm.corners if anchors is None else anchors
    return as_network(swarm.table, swarm.position[0], known), swarm.position[0], swarm.heading[0]


@pytest.mark.parametrize("form", ["ekf", "iekf", "fej"])
def test_a_filter_is_as_far_off_as_it_says_in_places_and_headings_together(form):
    place, turn = (3.0, 1.0) if form == "iekf" else (0.1, 0.02)  # one linearisation is good near the truth alone
    total = dof = 0.0
    for seed in range(8):
        net, truth, heading = turned(seed)
        rng = np.random.default_rng([seed, 1])
        first = truth + place * rng.normal(size=truth.shape), heading + turn * rng.normal(size=len(heading))
        state = update(filter_start(net, first[0], place, first[1], turn), net, form)
        error = np.column_stack([state.x[:, :2] - truth, wrap_angle(state.x[:, 2] - heading)]).ravel()[state.free]
        total += error @ np.linalg.solve(state.P, error)
        dof += len(error)
    assert chi2_quantile(0.0005, dof) < total < chi2_quantile(0.9995, dof)


@pytest.mark.parametrize("visibility", ["mutual", "directed"])
def test_the_iterated_filter_finds_what_the_batch_estimator_finds(visibility):
    net, truth = simulated(3, robots=36, axis=False, visibility=visibility)
    batch, filtered = locate(net), locate(net, SwarmConfig(method="iekf", prior_sigma=1000.0))
    spread = np.sqrt(np.trace(batch.cov, axis1=1, axis2=2)).max()
    np.testing.assert_allclose(filtered.position, batch.position, atol=1e-3 * spread)
    np.testing.assert_allclose(filtered.cov, batch.cov, atol=1e-3 * spread**2)
    np.testing.assert_allclose(wrap_angle(filtered.heading - batch.heading), 0, atol=1e-5)
    np.testing.assert_allclose(filtered.heading_var, batch.heading_var, rtol=1e-3)
    assert (filtered.dof, filtered.null_space) == (batch.dof, 0)
    assert filtered.reliable
    assert filtered.nees(truth)[0] == pytest.approx(batch.nees(truth)[0], rel=1e-2)


@pytest.mark.parametrize("form", ["ekf", "fej"])
def test_one_update_from_the_linear_start_is_at_the_bound(form):
    for seed in range(3):
        net, truth = simulated(seed, robots=36, axis=False, visibility="mutual")
        rmse, bound, nees = score(locate(net, SwarmConfig(method=form)), truth)
        assert rmse < 1.3 * bound
        assert 0.6 < nees < 1.5


def test_one_update_from_the_linear_start_finds_the_shape_when_one_robot_is_known_or_none():
    for anchors in ((0,), ()):
        net, _ = simulated(5, robots=36, axis=False, visibility="mutual", sigma=1.0, anchors=anchors)
        batch, one = locate(net), locate(net, SwarmConfig(method="ekf"))
        assert one.reliable
        assert one.chi2 == pytest.approx(batch.chi2, rel=1e-3)
        assert one.null_space == batch.null_space


def test_only_first_estimate_jacobians_learn_nothing_of_the_orientation_that_no_sighting_tells():
    net, truth, heading = turned(1, robots=9, anchors=())
    rng = np.random.default_rng(7)
    first, turn = truth + 0.3 * rng.normal(size=truth.shape), heading + 0.05 * rng.normal(size=len(heading))
    known = {}
    for form in ("ekf", "fej"):
        state = filter_start(net, first, 1.0, turn, 0.3)
        x, y = state.first[:, 0], state.first[:, 1]
        turned_about_origin = np.column_stack([-y, x, np.ones(len(x))])
        round_about = turned_about_origin.ravel()[state.free]
        before = round_about @ np.linalg.solve(state.P, round_about)
        for k in range(30):
            state = update(state, turned_again(net, truth, heading, k), form)
        known[form] = (round_about @ np.linalg.solve(state.P, round_about)) / before
    assert known["fej"] == pytest.approx(1.0, rel=1e-6)
    assert known["ekf"] > 2.0


def turned_again(net, truth, heading, seed):
    """The same robots' sightings with other noise."""
    rng = np.random.default_rng([seed, 2])
    d = truth[net.target] - truth[net.observer]
    z = np.arctan2(d[:, 1], d[:, 0]) - heading[net.observer] + net.sigma * rng.normal(size=len(d))
    return BearingNetwork(net.ids, 2, net.observer, net.target, wrap_angle(z), net.sigma, net.anchors, axis=False)


def test_the_matrix_of_sightings_is_the_derivative_by_places_and_headings():
    net, truth, heading = turned(2, robots=9)
    x, step = np.column_stack([truth, heading]), 1e-6
    H = sighting_matrix(net, x)
    factor = bearing_factor(net)
    for k in range(x.size):
        d = step * np.eye(1, x.size, k).ravel()
        slope = (factor.residual(x.ravel() + d) - factor.residual(x.ravel() - d)).ravel() / (2 * step)
        np.testing.assert_allclose(H[:, k], slope, atol=1e-7)


def test_a_robot_that_sees_nobody_is_located_and_has_no_heading():
    net, truth = simulated(4, robots=25, axis=False, visibility="mutual")
    deaf = 12
    heard = net.select(net.observer != deaf)
    estimate = locate(heard, SwarmConfig(method="ekf"))
    assert estimate.localisable.all()
    assert np.linalg.norm(estimate.position[deaf] - truth[deaf]) < 1.0
    assert estimate.heading_var[deaf] == 0.0
    assert len(filter_start(heard, truth).free) == 2 * (25 - len(net.anchors)) + 24


def test_first_places_give_first_headings():
    net, truth = simulated(5, robots=25, axis=False, visibility="single")  # no two see each other
    estimate = locate(net, SwarmConfig(method="iekf", prior_sigma=1.0), truth + 0.3)
    assert estimate.reliable
    assert np.sqrt(np.square(estimate.position - truth).sum(axis=1).mean()) < 0.5


def test_the_filters_refuse_what_they_cannot_do():
    net, _ = simulated(1, robots=36, axis=False, visibility="single")
    with pytest.raises(DataError, match="no heading can be started"):
        locate(net, SwarmConfig(method="ekf"))
    tied = BearingNetwork(
        net.ids, 2, net.observer, net.target, net.bearing, net.sigma, net.anchors, (Distance(0, 1, 10.0),), axis=False
    )
    with pytest.raises(DataError, match="no known distances"):
        locate(tied, SwarmConfig(method="ekf"))
