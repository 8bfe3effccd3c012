"""Gaussian algebra shared by all estimators: one solver, one symmetric form, one chi-square."""

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float
from scipy.special import gammaincinv

Matrix = Float[np.ndarray, "n n"]


def symmetrise(P: Matrix) -> Matrix:
    return np.asarray(0.5 * (P + P.T))


def solve_psd(A: Matrix, B: np.ndarray) -> np.ndarray:
    """`A^-1 B` by Cholesky; raises numpy.linalg.LinAlgError when A is not positive definite."""
    return np.asarray(sla.cho_solve(sla.cho_factor(A, lower=True, check_finite=False), B, check_finite=False))


def mahalanobis2(e: Float[np.ndarray, " n"], P: Matrix) -> float:
    """`e^T P^-1 e`: NIS when e is an innovation and P its covariance, NEES when e is an estimation error."""
    return float(e @ solve_psd(P, e))


def joseph(P: Matrix, K: Float[np.ndarray, "n m"], H: Float[np.ndarray, "m n"], R: np.ndarray) -> Matrix:
    """The updated covariance in Joseph form: symmetric and positive semi-definite for any gain K."""
    A = np.eye(len(P)) - K @ H
    return symmetrise(A @ P @ A.T + K @ R @ K.T)


def is_positive_definite(P: Matrix) -> bool:
    try:
        np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        return False
    return True


def chi2_quantile(probability: float, dof: float) -> float:
    """The value a chi-square variable with `dof` degrees of freedom stays under with `probability`."""
    return float(2.0 * gammaincinv(0.5 * dof, probability))


def ellipse(P: Float[np.ndarray, "2 2"], probability: float = 0.95) -> tuple[float, float, float]:
    """Half axes [m], larger first, and the larger one's angle [rad] of the region holding `probability`."""
    values, vectors = np.linalg.eigh(symmetrise(P))
    k = chi2_quantile(probability, 2.0)
    a, b = np.sqrt(k * np.maximum(values[::-1], 0.0))
    return float(a), float(b), float(np.arctan2(vectors[1, 1], vectors[0, 1]))
