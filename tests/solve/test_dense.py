"""Gauss-Newton on a handful of variables equals the sparse minimiser and keeps its promises."""

import numpy as np
import pytest

from mapweave.solve import Factor, Problem, SolveStatus, gauss_newton, minimise, wrapping

HERE = np.array([0.4, -0.3, 3.0])


def turned_points(rng, n=7):
    """Normal equations of the pose that carries n points onto noisy sightings of them, and the same as a factor."""
    p = rng.normal(size=(n, 2))
    W = np.array([[2.0, 0.5], [0.0, 3.0]])

    def residual(x):
        c, s = np.cos(x[2]), np.sin(x[2])
        return p @ np.array([[c, s], [-s, c]]) + x[:2] - z

    def jacobian(x):
        c, s = np.cos(x[2]), np.sin(x[2])
        J = np.zeros((n, 2, 3))
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, :, 2] = p @ np.array([[-s, c], [-c, -s]])
        return J

    z = np.zeros((n, 2))
    z = residual(HERE) + 0.05 * rng.normal(size=(n, 2))

    def normal(x):
        r, J = (residual(x) @ W.T).ravel(), (W @ jacobian(x)).reshape(2 * n, 3)
        return J.T @ J, J.T @ r, float(r @ r)

    columns = np.tile(np.arange(3), (n, 1))
    return normal, Factor(columns, residual, jacobian, 2, sqrt_info=W[None])


def test_a_small_problem_has_the_minimum_and_covariance_of_the_sparse_one():
    normal, factor = turned_points(np.random.default_rng(0))
    wrap = wrapping([2])
    start = HERE + np.array([0.1, 0.1, 0.3])
    small = gauss_newton(normal, start, max_iterations=30, step_tolerance=1e-12, retract=wrap)
    sparse = minimise(Problem(start, [factor], retract=wrap))
    assert small.converged
    assert small.iterations < 10
    np.testing.assert_allclose(small.x, sparse.x, atol=1e-9)
    np.testing.assert_allclose(small.covariance(), sparse.covariance(), rtol=1e-7)
    assert small.cost == pytest.approx(sparse.cost)
    assert -np.pi < small.x[2] <= np.pi


def test_what_is_held_stays_and_has_no_covariance():
    normal, factor = turned_points(np.random.default_rng(1))
    held = np.array([False, True, False])
    start = HERE + np.array([0.1, 0.1, 0.1])
    small = gauss_newton(normal, start, max_iterations=30, cost_tolerance=1e-14, held=held)
    sparse = minimise(Problem(start, [factor], fixed=held))
    assert small.x[1] == start[1]
    np.testing.assert_allclose(small.x, sparse.x, atol=1e-7)
    np.testing.assert_allclose(small.covariance(), sparse.covariance(), atol=1e-8)
    assert not small.covariance()[1].any()


def test_a_number_of_steps_is_taken_as_asked():
    normal, _ = turned_points(np.random.default_rng(2))
    start = HERE + np.array([0.0, 0.0, 0.5])
    H, g, _ = normal(start)
    once = gauss_newton(normal, start, max_iterations=1)
    np.testing.assert_allclose(once.x, start - np.linalg.solve(H, g), atol=1e-12)
    assert once.iterations == 1
    assert once.converged
    short = gauss_newton(normal, start, max_iterations=1, step_tolerance=1e-9)
    assert short.status is SolveStatus.MAX_ITERATIONS


@pytest.mark.parametrize("tolerance", [0.5, 1e-2, 1e-5])
@pytest.mark.parametrize("share", [2.0, 0.55])
def test_steps_end_with_the_first_that_changes_the_cost_by_no_more_than_the_share_asked_for(tolerance, share):
    costs, x = [], 3.0  # each step goes 1 / share of the way: to half of it, or beyond
    while len(costs) < 2 or abs(costs[-1] - costs[-2]) > tolerance * max(costs[-2:]):
        costs.append(x * x + 1.0)
        x -= x / share
    found = gauss_newton(
        lambda x: (share * np.eye(1), x, float(x @ x) + 1.0),
        np.array([3.0]),
        max_iterations=99,
        cost_tolerance=tolerance,
    )
    assert found.converged
    assert found.iterations == len(costs) - 1
    assert found.cost == pytest.approx(costs[-1])


def test_failures_are_a_status():
    blind = gauss_newton(lambda _x: (np.zeros((2, 2)), np.zeros(2), 0.0), np.ones(2), max_iterations=3)
    assert blind.status is SolveStatus.SINGULAR
    np.testing.assert_array_equal(blind.x, [1.0, 1.0])
    far = gauss_newton(lambda x: (np.eye(1), np.ones(1), np.nan if x[0] < 0.5 else 1.0), np.ones(1), max_iterations=3)
    assert far.status is SolveStatus.DIVERGED
    assert far.x[0] == 1.0
