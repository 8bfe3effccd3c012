"""NEES with the frame left free, and NIS."""

import numpy as np
from scipy.optimize import minimize

from mapweave.core import se2
from mapweave.evaluation.consistency import gauge_free_nees, mean_or_none, shape_covariance


def random_map(rng, n=8):
    truth = rng.uniform(-4, 4, (n, 2))
    A = rng.normal(size=(2 * n, 2 * n)) * 0.05
    cov = A @ A.T + 1e-4 * np.eye(2 * n)
    mean = se2.act(np.array([3.0, -1.0, 2.0]), truth) + rng.multivariate_normal(np.zeros(2 * n), cov).reshape(-1, 2)
    return mean, cov, truth


def test_the_frame_found_is_the_one_a_general_optimiser_finds():
    rng = np.random.default_rng(0)
    for _ in range(5):
        mean, cov, truth = random_map(rng)
        information = np.linalg.inv(cov)

        def cost(T, mean=mean, truth=truth, information=information):
            e = (mean - se2.act(T, truth)).ravel()
            return e @ information @ e

        best = minimize(cost, se2.align(truth, mean), method="BFGS", options={"gtol": 1e-9}).fun
        value, dof = gauge_free_nees(mean, cov, truth)
        assert dof == 2 * 8 - 3
        assert abs(value - best) < 1e-5 * best


def test_an_honest_map_has_a_mean_of_one_per_degree_of_freedom():
    rng = np.random.default_rng(1)
    values = [gauge_free_nees(*random_map(rng)) for _ in range(300)]
    mean = np.mean([v / dof for v, dof in values])
    assert abs(mean - 1) < 4 * np.sqrt(2 / (13 * 300))


def test_moving_the_truth_rigidly_changes_nothing():
    mean, cov, truth = random_map(np.random.default_rng(2))
    a, _ = gauge_free_nees(mean, cov, truth)
    b, _ = gauge_free_nees(mean, cov, se2.act(np.array([9.0, 4.0, -1.3]), truth))
    assert abs(a - b) < 1e-6 * a


def test_a_covariance_that_is_none_gives_no_figure():
    mean, cov, truth = random_map(np.random.default_rng(3))
    assert gauge_free_nees(mean, -cov, truth) is None
    assert gauge_free_nees(mean[:1], cov[:2, :2], truth[:1]) is None


def test_the_mean_is_that_of_the_values_there_are():
    assert mean_or_none([1.0, None, 3.0]) == 2.0
    assert mean_or_none([None]) is None


def test_moving_and_turning_a_map_as_a_whole_is_no_error_of_its_shape():
    mean, cov, _ = random_map(np.random.default_rng(2))
    h = 1e-6
    for motion in np.eye(3) * h:
        moved = ((se2.act(motion, mean) - mean) / h).ravel()
        assert np.abs(shape_covariance(mean, np.outer(moved, moved))).max() < 1e-4
    shape = shape_covariance(mean, cov)
    assert np.linalg.matrix_rank(shape, tol=1e-8) == len(cov) - 3
    np.testing.assert_allclose(shape_covariance(mean, shape), shape, atol=1e-12)
