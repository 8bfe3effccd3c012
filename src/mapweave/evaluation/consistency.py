"""Is an estimate as good as it says? NEES against truth with the frame left free, NIS against the data alone.

And whether a truth is of the recording that a result was made of: names such as `7` coincide between any two. A truth
that belongs fits the result better in its own order than in others. Handed out in another order, the same true places
are what a truth with coincidental names would be; where they fit as well, the names prove nothing, and the score is a
distance between two rooms.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float, Int

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


SHUFFLES = 500  # other orders tried where there are more of them
ALL_ORDERS = 5  # names up to which every order is tried
LUCK = 0.01  # the share of other orders that may fit as well
SMALL = 0.25  # an error below this share of the truth's spread is not asked about: symmetric places fit in many orders
MANY = 100  # names that take part; of more, some evenly spaced
MEASURED = 10.0  # an error in angles of so many deviations of the bearings is none that bearings leave
STANDING = 0.1  # robots that move by more than this share of their spread do not stand
STILL = 0.5  # [m] a trajectory's error that is never asked about

BEYOND = 100.0  # NEES a degree of freedom, that of errors of ten deviations

Order = Int[np.ndarray, " n"]
Points = Float[np.ndarray, "n d"]


def another_order_fits(n: int, error: Callable[[Order], float], spread: float) -> bool:
    """Whether the n true places fit about as well in another order. Below three names nothing is known: False.

    error: of the best fit with the places in that order [m]; spread: of the true places about their centroid [m]. The
    orders drawn are the same every time.
    """
    if n < 3:
        return False
    own = error(np.arange(n))
    if own <= SMALL * spread:
        return False
    if n <= ALL_ORDERS:
        others = [np.array(p) for p in itertools.islice(itertools.permutations(range(n)), 1, None)]
    else:
        rng = np.random.default_rng(n)
        others = [rng.permutation(n) for _ in range(SHUFFLES)]
    as_good = sum(error(order) <= own for order in others)
    return as_good > LUCK * len(others)


def by_chance(what: str, n: int, own: float) -> str:
    """The words for names that prove nothing."""
    return (
        f"the truth's places fit the {n} {what} no better in their own order than in others (RMSE {own:.3g} m): "
        f"the names may coincide by chance, and the truth be of another recording"
    )


def few_known(what: str, known: int, n: int) -> str:
    """The words where the truth names less than half of what there is; empty otherwise."""
    return "" if 2 * known >= n else f"the truth knows only {known} of {n} {what}: it may be of another recording"


def beyond(nees_per_dof: float | None) -> str:
    """The words where errors are far from what the result says of itself; empty otherwise."""
    if nees_per_dof is None or nees_per_dof <= BEYOND:
        return ""
    return (
        f"errors are {np.sqrt(nees_per_dof):,.0f} times what the result says of itself: the truth may be of another "
        f"recording or frame, or the result far too sure"
    )


def some(n: int) -> Order:
    """Which of n take part: all, or `MANY` evenly spaced."""
    return np.arange(n) if n <= MANY else np.linspace(0, n - 1, MANY).astype(np.int64)


def spread_of(places: Points) -> float:
    """RMS distance of the rows from their centroid [m]."""
    return float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1)))) if len(places) else 0.0
