"""Gaussian algebra equals what its definitions give, by sampling, by dense inverses and by tables of chi-square."""

import numpy as np
import pytest
from scipy import stats

from mapweave.core.gaussian import (
    chi2_quantile,
    ellipse,
    is_positive_definite,
    joseph,
    mahalanobis2,
    solve_psd,
    symmetrise,
)


def drawn(rng, n):
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_the_symmetric_part_is_half_of_a_matrix_and_its_transpose():
    A = np.array([[1.0, 2.0], [6.0, 5.0]])
    np.testing.assert_array_equal(symmetrise(A), [[1.0, 4.0], [4.0, 5.0]])


def test_a_squared_distance_weighs_an_error_with_the_inverse_covariance():
    rng = np.random.default_rng(0)
    P, e, B = drawn(rng, 4), rng.normal(size=4), rng.normal(size=(4, 3))
    assert mahalanobis2(e, P) == pytest.approx(e @ np.linalg.inv(P) @ e)
    np.testing.assert_allclose(solve_psd(P, B), np.linalg.inv(P) @ B, rtol=1e-9)


def test_josephs_form_is_the_covariance_of_the_error_that_any_gain_leaves():
    rng = np.random.default_rng(1)
    P, R, H, K = drawn(rng, 3), drawn(rng, 2), rng.normal(size=(2, 3)), 0.3 * rng.normal(size=(3, 2))
    error = rng.multivariate_normal(np.zeros(3), P, 400_000)
    noise = rng.multivariate_normal(np.zeros(2), R, 400_000)
    left = error - (error @ H.T + noise) @ K.T
    stated = joseph(P, K, H, R)
    np.testing.assert_allclose(stated, np.cov(left.T), atol=0.02 * np.abs(stated).max())
    np.testing.assert_array_equal(stated, stated.T)


def test_josephs_form_at_the_optimal_gain_is_the_inverse_of_the_summed_information():
    rng = np.random.default_rng(2)
    P, R, H = drawn(rng, 4), drawn(rng, 2), rng.normal(size=(2, 4))
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    summed = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(joseph(P, K, H, R), np.linalg.inv(summed), rtol=1e-9, atol=1e-12)


def test_chi_square_quantiles_are_those_of_the_distribution():
    for probability in (0.05, 0.5, 0.95, 0.999):
        for dof in (1.0, 2.0, 7.0, 60.0):
            assert chi2_quantile(probability, dof) == pytest.approx(stats.chi2.ppf(probability, dof), rel=1e-9)


def test_an_ellipse_holds_its_share_of_what_is_drawn_and_lies_along_the_larger_axis():
    rng = np.random.default_rng(3)
    angle = 0.6
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    P = R @ np.diag([4.0, 0.25]) @ R.T
    points = rng.multivariate_normal(np.zeros(2), P, 200_000)
    a, b, theta = ellipse(P)
    along = points @ np.stack([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]]).T
    assert a / b == pytest.approx(4.0)
    assert np.tan(theta) == pytest.approx(np.tan(angle))
    assert np.mean((along[:, 0] / a) ** 2 + (along[:, 1] / b) ** 2 < 1) == pytest.approx(0.95, abs=0.003)
    wide, _, _ = ellipse(P, 0.5)
    assert a / wide == pytest.approx(np.sqrt(stats.chi2.ppf(0.95, 2) / stats.chi2.ppf(0.5, 2)))


def test_an_ellipse_of_a_covariance_without_width_is_a_line():
    along = np.array([0.6, 0.8])
    a, b, theta = ellipse(np.outer(along, along) - 1e-18 * np.eye(2))
    assert a == pytest.approx(np.sqrt(stats.chi2.ppf(0.95, 2)))
    assert b == pytest.approx(0.0, abs=1e-7)
    assert np.tan(theta) == pytest.approx(4 / 3)


def test_only_matrices_with_positive_eigenvalues_are_positive_definite():
    assert is_positive_definite(np.diag([1.0, 1e-9]))
    assert not is_positive_definite(np.diag([1.0, -1e-9]))
    assert not is_positive_definite(np.array([[1.0, 2.0], [2.0, 1.0]]))
