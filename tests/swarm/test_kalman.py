"""The paper's filter does what its equations say, and the batch estimator does better."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.filtered import filter_start, innovation, sighting_matrix, update
from mapweave.swarm.locate import locate

from .swarms import PAPER, complete, score, simulated


@pytest.mark.eq("Hamatani:2", "Hamatani:4", "Hamatani:5", "Hamatani:6", "Hamatani:7", "Hamatani:8")
def test_one_update_equals_the_information_form_worked_out_by_hand():
    rng = np.random.default_rng(3)
    net = complete(PAPER, 0.5, rng, anchors=(0, 1))
    start = filter_start(net, PAPER + rng.normal(size=PAPER.shape), sigma=10.0)
    after = update(start, net)
    H = np.zeros((len(net.observer), 10))
    e = np.zeros(len(net.observer))
    for row, (i, j) in enumerate(zip(net.observer, net.target, strict=True)):
        dx, dy = start.x[j] - start.x[i]
        H[row, [2 * j, 2 * j + 1]] = [-dy / (dx**2 + dy**2), dx / (dx**2 + dy**2)]
        H[row, [2 * i, 2 * i + 1]] = [dy / (dx**2 + dy**2), -dx / (dx**2 + dy**2)]
        e[row] = np.angle(np.exp(1j * (net.bearing[row] - np.arctan2(dy, dx))))
    H = H[:, 4:]  # robots 1 and 2 are known
    A = np.eye(6) / 100.0 + H.T @ H / net.sigma[0] ** 2
    np.testing.assert_allclose(after.P, np.linalg.inv(A), atol=1e-9)
    step = np.linalg.solve(A, H.T @ e / net.sigma[0] ** 2)
    np.testing.assert_allclose(after.x.ravel()[4:], start.x.ravel()[4:] + step, atol=1e-8)
    np.testing.assert_array_equal(after.x[:2], PAPER[:2])


def test_the_iterated_update_ends_at_the_most_likely_positions():
    net, _ = simulated(4, robots=36, sigma=2.0)
    filtered = locate(net, SwarmConfig(method="iekf", prior_sigma=1e4))
    np.testing.assert_allclose(filtered.position, locate(net).position, atol=1e-3)


@pytest.mark.parametrize("form", ["ekf", "iekf", "fej"])
def test_sets_of_sightings_and_turns_are_counted_over_all_updates(form):
    rng = np.random.default_rng(4)
    net = complete(PAPER, 0.5, rng, anchors=(0, 1))
    state = filter_start(net, PAPER + rng.normal(size=PAPER.shape))
    turns = []
    for k in range(3):
        alone = update(replace(state, updates=0, iterations=0), net, form)
        state = update(state, net, form)
        turns.append(alone.iterations)
        assert (alone.updates, state.updates) == (1, k + 1)
        assert state.iterations == sum(turns)
    assert (min(turns) > 1) == (form == "iekf")


def test_exact_sightings_are_taken_in_although_the_matrix_of_the_paper_is_singular():
    rng = np.random.default_rng(0)
    for sigma_p in (0.0, 0.1, 5.0):
        net = complete(PAPER, 0.0, rng, anchors=(0, 1), single=True, exact=True)
        H = sighting_matrix(net, PAPER)
        assert np.linalg.matrix_rank(H @ H.T) < len(H)
        state = filter_start(net, PAPER + sigma_p * rng.normal(size=PAPER.shape))
        for _ in range(200):
            state = update(state, net)
        assert np.abs(state.x - PAPER).max() < 1e-10
        assert np.abs(locate(net).position - PAPER).max() < 1e-10


def drifted(form, sigma_p, variance, linear=False, updates=200):
    """Mean distance error over the robots 10 apart, of five robots with nothing known, over four runs."""
    sides = [(0, 1), (1, 2), (3, 4), (0, 3), (1, 3), (1, 4), (2, 4)]
    errors = []
    for k in range(4):
        rng = np.random.default_rng([9, k])
        draw = lambda anchors=(): complete(PAPER, np.sqrt(variance), rng, anchors, single=True)
        first = PAPER + sigma_p * rng.normal(size=PAPER.shape)
        if linear:
            shape = locate(draw()).position
            spread = np.square(first - first.mean(axis=0)).sum(), np.square(shape).sum()
            first = first.mean(axis=0) + shape * np.sqrt(spread[0] / spread[1])
        state = filter_start(draw(), first)
        for _ in range(updates):
            state = update(state, draw(), form)
        errors += [abs(np.linalg.norm(state.x[i] - state.x[j]) - 10) for i, j in sides]
    return float(np.mean(errors))


@pytest.mark.slow
def test_the_first_estimate_jacobian_removes_the_scale_drift_of_the_paper():
    assert drifted("ekf", 0.0, 0.01) > 1.0
    assert drifted("fej", 0.0, 0.01) < 0.005
    assert drifted("ekf", 0.1, 0.01) > 4 * drifted("fej", 0.1, 0.01)
    assert drifted("fej", 5.0, 0.01) > 5.0  # a bad first estimate is a bad place to linearise at
    assert drifted("fej", 5.0, 0.01, linear=True) < 5.0  # the scale of the guess stays, the drift is gone


def test_from_a_bad_guess_one_update_misses_the_bound_and_the_batch_estimator_does_not():
    sizes = {"ekf": 0.0, "batch": 0.0, "bound": 0.0}
    for k in range(100):
        rng = np.random.default_rng([1, k])
        net = complete(PAPER, 0.1, rng, anchors=(0, 1))
        guess = PAPER + 5.0 * rng.normal(size=PAPER.shape)
        one = locate(net, SwarmConfig(method="ekf"), initial=guess)
        best = locate(net)
        assert best.status == "converged"
        rmse, bound, _ = score(best, PAPER)
        assert rmse < 8 * bound
        sizes["ekf"] += np.square(one.position - PAPER).sum()
        sizes["batch"] += 3 * rmse**2
        sizes["bound"] += 3 * bound**2
    assert np.sqrt(sizes["ekf"] / sizes["bound"]) > 20
    assert np.sqrt(sizes["batch"] / sizes["bound"]) < 1.15


@pytest.mark.slow
def test_five_robots_with_two_known_are_placed_to_a_millimetre_and_a_half():
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(20):
        state = filter_start(complete(PAPER, 0.1, rng, (0, 1), single=True), PAPER + 0.1 * rng.normal(size=(5, 2)))
        for _ in range(200):
            state = update(state, complete(PAPER, 0.1, rng, (0, 1), single=True))
        sides = [(0, 1), (1, 2), (3, 4), (0, 3), (1, 3), (1, 4), (2, 4)]
        errors += [abs(np.linalg.norm(state.x[i] - state.x[j]) - 10) for i, j in sides]
    assert np.mean(errors) == pytest.approx(0.0015, rel=0.4)


def test_innovations_are_zero_at_the_truth():
    net = complete(PAPER, 0.0, np.random.default_rng(0), exact=True)
    np.testing.assert_allclose(innovation(net, PAPER), 0, atol=1e-12)
