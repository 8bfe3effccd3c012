"""From a minimum to an answer: covariances in the named gauge, degrees of freedom, and verdicts."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool

from ..solve import Information, Pattern, Problem, SingularError, Solution
from ..solve import Status as SolveStatus
from . import factors
from .config import SwarmConfig
from .gauge import basis, normalise
from .joint import JointInformation
from .network import Network
from .posterior_covariance import spread_of
from .result import Status, SwarmEstimate, Traffic
from .start import Start
from .verdict import barely_determined, chi2_warnings, layout_warnings

STATUS = {
    SolveStatus.CONVERGED: Status.CONVERGED,
    SolveStatus.MAX_ITERATIONS: Status.ITERATION_LIMIT,
    SolveStatus.SINGULAR: Status.FAILED,
    SolveStatus.DIVERGED: Status.FAILED,
}


def finish(
    net: Network,
    start: Start,
    solution: Solution,
    problem: Problem,
    cfg: SwarmConfig,
    method: str,
    outlier: Bool[np.ndarray, " m"] | None = None,
    traffic: Traffic | None = None,
    notes: tuple[str, ...] = (),
    pattern: Pattern | None = None,
) -> SwarmEstimate:
    """The estimate at `solution`, its covariance in the gauge of `start`.

    `outlier`: (m_all,) of the whole network when `net` holds the inliers only; `notes`: warnings known already.
    """
    n, w, dim = len(net), factors.width(net), net.dim
    gauge, localisable = start.gauge, start.seen.localisable
    anyone = (localisable & ~net.is_anchor).any()  # else there was nothing to refine
    status = STATUS[solution.status] if anyone else Status.CONVERGED
    before = solution.x.reshape(n, w)
    position, heading = normalise(gauge, before[:, :dim], None if net.axis else before[:, dim])
    position = position.copy()
    for k, p in net.anchors.items():  # also those in other pieces, which the gauge of this one may have moved
        position[k] = p
    x, information = solution.x, solution.information
    if gauge.name and information is not None:
        x = (position if heading is None else np.concatenate([position, heading[:, None]], axis=1)).ravel()
        information = _information_at(problem, x, information, pattern)
    G, C = basis(net, gauge, position)
    found = None
    if information is not None and cfg.covariance:
        found = spread_of(net, gauge, information, solution.free, localisable, position, (G, C))
    measured = problem.terms[: 1 + bool(net.distances)]
    chi2 = float(sum(term.squares(solution.x).sum() for term in measured))
    unknown = dim * (n - len(net.anchors)) + (0 if net.axis else len(np.unique(net.observer)))
    dof = len(net.observer) * (dim - 1) + len(net.distances) - unknown + start.seen.nullity
    doubts = chi2_warnings(chi2, dof) if anyone and np.any(net.sigma > 0) else []
    if status is not Status.CONVERGED:
        doubts.append(f"the refinement ended with: {status}")
    if information is None:
        doubts.append("the information matrix is singular: there is no covariance")
    weak = found is not None and found.weak
    remarks = [*notes, *layout_warnings(net, localisable, start.seen.in_line)]
    if found is not None:
        remarks += barely_determined(net, position, found.cov, localisable)
    if found is not None and weak:
        remarks.append(
            f"weak anchors: {100 * (found.mode_share or 0.0):.0f} % of all variance lies in one mode (most often the "
            "scale); place known robots further apart"
        )
    return SwarmEstimate(
        ids=net.ids,
        dim=dim,
        method=method,
        position=position,
        cov=None if found is None else found.cov,
        localisable=localisable,
        anchor=net.is_anchor,
        outlier=np.zeros(len(net.observer), dtype=bool) if outlier is None else outlier,
        gauge=gauge.name,
        null_space=start.seen.nullity,
        iterations=solution.iterations,
        chi2=chi2,
        dof=dof,
        status=status,
        reliable=bool(anyone) and not doubts,
        warnings=(*doubts, *remarks),
        heading=heading,
        heading_var=None if found is None else found.heading_var,
        weak_anchors=weak,
        mode_share=None if found is None else found.mode_share,
        traffic=traffic,
        information=None if information is None else _embedded(information, solution.free, n, w),
        gauge_motions=G if gauge.name else None,
        gauge_conditions=C if gauge.name else None,
    )


def _information_at(problem: Problem, x: np.ndarray, known: Information, pattern: Pattern | None) -> Information | None:
    """The information once more, at the state brought into the gauge."""
    pattern = pattern or Pattern.of(problem)
    normal = [term.normal(x) for term in problem.terms]
    H, _ = pattern.assemble([a for a, _ in normal], [b for _, b in normal])
    try:
        return Information.of(H, pattern.elimination)
    except SingularError:
        return None if known.size else known


def _embedded(A: Information, free: np.ndarray, n: int, width: int) -> JointInformation:
    """The information over the whole state; fixed entries have none."""
    held = np.ones(n * width, dtype=bool)
    held[free] = False
    coo = A.matrix.tocoo()
    whole = sp.csc_matrix((coo.data, (free[coo.row], free[coo.col])), shape=(n * width, n * width))
    return JointInformation(whole, held, width)
