"""Is an estimate as good as it says? NEES against truth with the frame left free, NIS against the data alone."""

from collections.abc import Sequence

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import symmetrise
from ..solve import gauss_newton


def gauge_free_nees(
    mean: Float[np.ndarray, "n 2"], cov: Float[np.ndarray, "m m"], truth: Float[np.ndarray, "n 2"]
) -> tuple[float, int] | None:
    """`min over T of e^T P^-1 e` with `e = mean - T truth`, and its degrees of freedom `2n - 3`.

    mean [m] and cov [m^2] (order x1 y1 x2 y2 ..) in the map's frame, truth [m] in a frame of its own. None where there
    are fewer than two points or the covariance is not positive definite.
    """
    n = len(mean)
    if n < 2:
        return None
    try:
        factor = sla.cholesky(symmetrise(np.asarray(cov)), lower=True)
    except sla.LinAlgError:
        return None

    def normal(T: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        placed = se2.act(T, truth)
        e = sla.solve_triangular(factor, (mean - placed).ravel(), lower=True)
        J = np.zeros((2 * n, 3))
        J[0::2, 0] = J[1::2, 1] = 1.0
        J[0::2, 2], J[1::2, 2] = -(placed[:, 1] - T[1]), placed[:, 0] - T[0]
        A = -sla.solve_triangular(factor, J, lower=True)
        return A.T @ A, A.T @ e, float(e @ e)

    fit = gauss_newton(normal, se2.align(truth, mean), max_iterations=50, cost_tolerance=1e-12)
    return fit.cost, 2 * n - 3


def shape_covariance(mean: Float[np.ndarray, "n 2"], cov: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
    """The covariance (2n, 2n) of what is left of a map's error after an unweighted rigid alignment.

    Where the frame itself lies is no property of the map's shape, yet it makes up most of `cov`. Rank 2n - 3.
    """
    n = len(mean)
    J = np.zeros((2 * n, 3))
    J[0::2, 0] = J[1::2, 1] = 1.0
    centred = mean - mean.mean(0)
    J[0::2, 2], J[1::2, 2] = -centred[:, 1], centred[:, 0]
    A = np.eye(2 * n) - J @ np.linalg.pinv(J)
    return symmetrise(A @ cov @ A.T)


def mean_or_none(values: Sequence[float | None]) -> float | None:
    """The mean of the values that exist."""
    there = [v for v in values if v is not None]
    return float(np.mean(there)) if there else None
