"""Gauss-Newton and Levenberg-Marquardt on the sparse information form.

A handful of variables takes a dense information matrix, no pattern and no damping: `gauss_newton`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.gaussian import solve_psd, symmetrise
from .information import Information, Pattern, SingularError
from .problem import Problem, Retract, add

HARDEST = 1e12  # damping beyond which no step is found any more
ROUNDING = 1e-11  # relative change of the cost that is arithmetic, not progress
Vector = Float[np.ndarray, " n"]
Normal = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveConfig:
    """damping: at the start, relative to the diagonal; 0 is Gauss-Newton, which takes every step as it comes."""

    max_iterations: int = 100
    damping: float = 1e-6
    step_tolerance: float = 1e-9  # largest change of any variable [its unit]
    cost_tolerance: float = 1e-10  # relative decrease of the cost


class SolveStatus(StrEnum):
    """How a minimisation ended."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    SINGULAR = "singular"
    DIVERGED = "diverged"


@dataclass(frozen=True, slots=True)
class Solution:
    """Where the minimum lies and how it was reached.

    x: (n,); cost: sum of robust costs; chi2: sum of squared whitened residuals; dof: rows less free variables;
    costs: after each accepted step, the first before any; free: the entries of x estimated; information: factorised
    at x over the free variables, undamped, or None when it is singular there.
    """

    x: Float[np.ndarray, " n"]
    status: SolveStatus
    iterations: int
    cost: float
    chi2: float
    dof: int
    costs: tuple[float, ...]
    free: Int[np.ndarray, " f"]
    information: Information | None

    @property
    def converged(self) -> bool:
        return self.status is SolveStatus.CONVERGED

    def covariance(self, index: Int[np.ndarray, " k"] | None = None) -> Float[np.ndarray, "k k"]:
        """The joint covariance of the entries `index` of x (all when None); zero where an entry is fixed."""
        at = self._position(np.arange(len(self.x)) if index is None else index)
        free = at >= 0
        P = np.zeros((len(at), len(at)))
        P[np.ix_(free, free)] = self._known().covariance(at[free])
        return P

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """For each row of `index`, the covariance of those k entries of x; zero where an entry is fixed."""
        at = self._position(index)
        free = at >= 0
        P = self._known().blocks(np.where(free, at, np.maximum(at.max(axis=1, keepdims=True), 0)))
        return np.asarray(P * free[:, :, None] * free[:, None, :])

    def dissected(
        self, group: Int[np.ndarray, " n"], coordinates: Float[np.ndarray, "n d"] | None = None
    ) -> "Solution":
        """The same solution, its information factorised by nested dissection: for the `blocks` of thousands of groups.

        group, coordinates: of every entry of x, as `Information.dissected` takes them. As it is when it is singular.
        """
        if self.information is None:
            return self
        where = None if coordinates is None else coordinates[self.free]
        return replace(self, information=self.information.dissected(group[self.free], where))

    def _position(self, index: Int[np.ndarray, "..."]) -> Int[np.ndarray, "..."]:
        at = np.full(len(self.x), -1)
        at[self.free] = np.arange(len(self.free))
        return np.asarray(at[index])

    def _known(self) -> Information:
        if self.information is None:
            raise SingularError("the problem is singular at its solution: there is no covariance")
        return self.information


def minimise(
    problem: Problem,
    cfg: SolveConfig | None = None,
    pattern: Pattern | None = None,
    on_step: Callable[[], None] | None = None,
) -> Solution:
    """The local minimum of `problem` from its start; a failure is a status, never an exception.

    `pattern` may be handed in when the same structure is solved again; on_step: called before every step.
    """
    cfg = cfg or SolveConfig()
    pattern = pattern or Pattern.of(problem)
    free = problem.free
    x, cost = problem.x0.copy(), problem.cost(problem.x0)
    costs, damping, raised, status = [cost], cfg.damping, 2.0, SolveStatus.MAX_ITERATIONS
    iterations = 0
    data, g = pattern.summed(term.normal(x) for term in problem.terms)
    step = np.zeros(len(x))
    while iterations < cfg.max_iterations:
        iterations += 1
        if on_step is not None:
            on_step()
        added = damping * _scale(data, pattern)
        try:
            dx = np.asarray(pattern.factorised(data, added).solve(-g))
        except SingularError:
            if cfg.damping == 0 or damping > HARDEST:
                status = SolveStatus.SINGULAR
                break
            damping, raised = max(damping, 1e-12) * raised, 2 * raised
            continue
        step[free] = dx
        tried = problem.retract(x, step)
        new = problem.cost(tried) if np.isfinite(dx).all() else np.inf
        predicted = float(added @ np.square(dx) - g @ dx)  # -2 g dx - dx H dx, as (H + added) dx = -g
        small = bool(np.abs(dx).max(initial=0.0) <= cfg.step_tolerance) or predicted <= ROUNDING * ROUNDING * cost
        if cfg.damping == 0 and not np.isfinite(new):
            status = SolveStatus.DIVERGED
            break
        if cfg.damping == 0 or new < cost or (small and new <= cost * (1 + ROUNDING)):
            converged = small or (damping <= 1 and abs(cost - new) <= cfg.cost_tolerance * cost)
            gain = (cost - new) / predicted if predicted > 0 else 1.0
            damping, raised = damping * max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3), 2.0
            x, cost = tried, new
            costs.append(cost)
            data, g = pattern.summed(term.normal(x) for term in problem.terms)
            if converged:
                status = SolveStatus.CONVERGED
                break
        elif small or damping > HARDEST:
            status = SolveStatus.CONVERGED if small or predicted <= ROUNDING * cost else SolveStatus.DIVERGED
            break
        else:
            damping, raised = max(damping, 1e-12) * raised, 2 * raised
    return Solution(
        x=x,
        status=status,
        iterations=iterations,
        cost=cost,
        chi2=problem.chi2(x),
        dof=problem.dof,
        costs=tuple(costs),
        free=free,
        information=_factorised(data, pattern),
    )


def _scale(data: Float[np.ndarray, " nnz"], pattern: Pattern) -> Float[np.ndarray, " f"]:
    """What a damping of 1 adds to each entry of the diagonal."""
    diagonal = data[pattern.diagonal]
    return np.asarray(np.maximum(diagonal, 1e-9 * diagonal.max(initial=1.0)))


def _factorised(data: Float[np.ndarray, " nnz"], pattern: Pattern) -> Information | None:
    try:
        return Information(pattern.matrix(data), pattern.factorised(data))
    except SingularError:
        return None


@dataclass(frozen=True, slots=True)
class DenseSolution:
    """Where a small problem's minimum lies.

    x: (n,); cost and information (n, n) are those of the normal equations at x, over all variables, held or not;
    free: (n,) which were estimated.
    """

    x: Vector
    status: SolveStatus
    iterations: int
    cost: float
    information: Float[np.ndarray, "n n"]
    free: Bool[np.ndarray, " n"]

    @property
    def converged(self) -> bool:
        return self.status is SolveStatus.CONVERGED

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
    status = SolveStatus.MAX_ITERATIONS if step_tolerance > 0 or cost_tolerance > 0 else SolveStatus.CONVERGED
    iterations, step = 0, np.zeros(len(x))
    while iterations < max_iterations:
        try:
            step[free] = -solve_psd(H[at], g[free])
        except np.linalg.LinAlgError:
            status = SolveStatus.SINGULAR
            break
        tried = retract(x, step)
        after = normal(tried)
        if not np.isfinite(after[2]):
            status = SolveStatus.DIVERGED
            break
        before, x, (H, g, cost) = cost, tried, after
        iterations += 1
        small = step_tolerance > 0 and float(np.abs(step).max(initial=0.0)) <= step_tolerance
        if small or (cost_tolerance > 0 and abs(before - cost) <= cost_tolerance * max(before, cost)):
            status = SolveStatus.CONVERGED
            break
    return DenseSolution(x, status, iterations, float(cost), H, free)
