"""Gauss-Newton on a handful of variables: a dense information matrix, no pattern, no damping."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..core.gaussian import solve_psd, symmetrise
from .optimise import Status
from .problem import Retract, add

Vector = Float[np.ndarray, " n"]
Normal = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, float]]


@dataclass(frozen=True, slots=True)
class DenseSolution:
    """Where a small problem's minimum lies.

    x: (n,); cost and information (n, n) are those of the normal equations at x, over all variables, held or not;
    free: (n,) which were estimated.
    """

    x: Vector
    status: Status
    iterations: int
    cost: float
    information: Float[np.ndarray, "n n"]
    free: Bool[np.ndarray, " n"]

    @property
    def converged(self) -> bool:
        return self.status is Status.CONVERGED

    def covariance(self) -> Float[np.ndarray, "n n"]:
        """The covariance of x, zero where held; raises numpy.linalg.LinAlgError when something is not observed."""
        P = np.zeros_like(self.information)
        at = np.ix_(self.free, self.free)
        P[at] = symmetrise(solve_psd(self.information[at], np.eye(int(self.free.sum()))))
        return P


def gauss_newton(
    normal: Normal,
    x0: Vector,
    *,
    max_iterations: int,
    step_tolerance: float = 0.0,
    cost_tolerance: float = 0.0,
    held: Bool[np.ndarray, " n"] | None = None,
    retract: Retract = add,
) -> DenseSolution:
    """The minimum of a sum of squares from `x0`, each step taken as it comes; a failure is a status.

    normal(x) -> H (n, n), g (n,), cost: the information `J^T W J`, `J^T W r` (half the gradient) and `r^T W r` of
    residuals r, prediction less measurement; `wrapping` retracts angles. Ends converged when no variable moves by more
    than `step_tolerance` or the cost changes by no more than that share; with both 0 after `max_iterations` steps,
    which is then no failure: the caller chose their number. For a thousand variables and more, or a start that may be
    far, use `minimise`.
    """
    free = np.ones(len(x0), dtype=bool) if held is None else ~held
    at = np.ix_(free, free)
    x = np.array(x0, dtype=float)
    H, g, cost = normal(x)
    status = Status.MAX_ITERATIONS if step_tolerance > 0 or cost_tolerance > 0 else Status.CONVERGED
    iterations, step = 0, np.zeros(len(x))
    while iterations < max_iterations:
        try:
            step[free] = -solve_psd(H[at], g[free])
        except np.linalg.LinAlgError:
            status = Status.SINGULAR
            break
        tried = retract(x, step)
        after = normal(tried)
        if not np.isfinite(after[2]):
            status = Status.DIVERGED
            break
        before, x, (H, g, cost) = cost, tried, after
        iterations += 1
        small = step_tolerance > 0 and float(np.abs(step).max(initial=0.0)) <= step_tolerance
        if small or (cost_tolerance > 0 and abs(before - cost) <= cost_tolerance * max(before, cost)):
            status = Status.CONVERGED
            break
    return DenseSolution(x, status, iterations, float(cost), H, free)
