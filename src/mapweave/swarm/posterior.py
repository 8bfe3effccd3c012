"""From a minimum to an estimate: covariances in the named gauge, degrees of freedom, and verdicts."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from ..solve import Information, Pattern, Problem, SingularError, Solution, SolveStatus
from . import factors
from .close_pairs import with_true_lengths
from .config import SwarmConfig, VerdictConfig
from .gauge import Gauge, gauge_basis, normalise
from .network import BearingNetwork
from .result import JointInformation, SwarmEstimate, SwarmStatus, Traffic
from .start import SwarmStart
from .verdict import barely_determined, chi2_warnings, close_remarks, faint_remarks, layout_warnings

STATUS = {
    SolveStatus.CONVERGED: SwarmStatus.CONVERGED,
    SolveStatus.MAX_ITERATIONS: SwarmStatus.ITERATION_LIMIT,
    SolveStatus.SINGULAR: SwarmStatus.FAILED,
    SolveStatus.DIVERGED: SwarmStatus.FAILED,
}

POWER_STEPS = 12  # of the power iteration: the largest mode to a percent, which a warning needs


def posterior(
    net: BearingNetwork,
    start: SwarmStart,
    solution: Solution,
    problem: Problem,
    cfg: SwarmConfig,
    method: str,
    outlier: Bool[np.ndarray, " m"] | None = None,
    traffic: Traffic | None = None,
    notes: tuple[str, ...] = (),
    pattern: Pattern | None = None,
    unchecked: Bool[np.ndarray, " used"] | None = None,
) -> SwarmEstimate:
    """The estimate at `solution`, its covariance in the gauge of `start`.

    `outlier`: (m_all,) of the whole network when `net` holds the inliers only; `notes`: warnings known already;
    `unchecked`: of those in `net`, sightings that may be wrong unnoticed; the covariance counts none between close
    robots.
    """
    n, w, dim = len(net), factors.width(net), net.dim
    gauge, localisable = start.gauge, start.seen.localisable
    anyone = (localisable & ~net.is_anchor).any()  # else there was nothing to refine
    status = STATUS[solution.status] if anyone else SwarmStatus.CONVERGED
    before = solution.x.reshape(n, w)
    position, heading = normalise(gauge, before[:, :dim], None if net.axis else before[:, dim])
    position = position.copy()
    for k, p in net.anchors.items():  # also those in other components, which the gauge of this one may have moved
        position[k] = p
    x, information = solution.x, solution.information
    if gauge.name and information is not None:
        x = (position if heading is None else np.concatenate([position, heading[:, None]], axis=1)).ravel()
        information = _information_at(problem, x, information, pattern)
    G, C = gauge_basis(net, gauge, position)
    covariance = None
    close = 0
    if information is not None and cfg.covariance:
        covariance = position_covariance(
            net, gauge, information, solution.free, localisable, position, (G, C), cfg.verdict
        )
        deviation = np.sqrt(np.nan_to_num(np.trace(covariance.cov, axis1=1, axis2=2)))
        honest, close = with_true_lengths(net, x, problem, information, pattern, deviation, localisable, unchecked)
        if close:
            information = honest
            covariance = position_covariance(
                net, gauge, information, solution.free, localisable, position, (G, C), cfg.verdict
            )
    measured = problem.terms[: 1 + bool(net.distances)]
    chi2 = float(sum(term.squares(solution.x).sum() for term in measured))
    unknown = dim * (n - len(net.anchors)) + (0 if net.axis else len(np.unique(net.observer)))
    dof = len(net.observer) * (dim - 1) + len(net.distances) - unknown + start.seen.nullity
    doubts = chi2_warnings(chi2, dof, cfg.verdict) if anyone and np.any(net.sigma > 0) else []
    if status is not SwarmStatus.CONVERGED:
        doubts.append(f"the refinement ended with: {status}")
    if information is None:
        doubts.append("the information matrix is singular: there is no covariance")
    weak = covariance is not None and covariance.weak
    remarks = [*notes, *layout_warnings(net, localisable, start.seen.in_line)]
    if anyone and np.any(net.sigma > 0):
        remarks += faint_remarks(chi2, dof, cfg.verdict)
    if covariance is not None:
        remarks += [*barely_determined(net, position, covariance.cov, localisable), *close_remarks(close)]
    if covariance is not None and weak:
        remarks.append(
            f"weak anchors: {100 * (covariance.mode_share or 0.0):.0f} % of all variance lies in one mode (most often "
            "the scale); place known robots further apart"
        )
    return SwarmEstimate(
        ids=net.ids,
        dim=dim,
        method=method,
        position=position,
        cov=None if covariance is None else covariance.cov,
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
        heading_var=None if covariance is None else covariance.heading_var,
        weak_anchors=weak,
        mode_share=None if covariance is None else covariance.mode_share,
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


@dataclass(frozen=True, slots=True)
class PositionCovariance:
    """cov: (n, d, d), zero for anchors, NaN where not localisable; mode_share: None when a gauge is free."""

    cov: Float[np.ndarray, "n d d"]
    heading_var: Float[np.ndarray, " n"] | None
    mode_share: float | None
    weak: bool


def position_covariance(
    net: BearingNetwork,
    gauge: Gauge,
    A: Information,
    free: np.ndarray,
    localisable: Bool[np.ndarray, " n"],
    position: Float[np.ndarray, "n d"],
    basis: tuple[np.ndarray, np.ndarray],
    cfg: VerdictConfig,
) -> PositionCovariance:
    """Per-robot covariances from the information `A` over the entries `free`; exact sightings leave none."""
    dim = net.dim
    blocks = robot_blocks(A, free, len(net), factors.width(net), *basis)
    exact = not np.any(net.sigma > 0)
    cov = blocks[:, :dim, :dim] * (0.0 if exact else 1.0)
    cov[~localisable] = np.nan
    cov[list(net.anchors)] = 0.0
    heading_var = None
    if not net.axis:
        heading_var = np.where(localisable, blocks[:, dim, dim] * (0.0 if exact else 1.0), np.nan)
    share = None if exact or gauge.name else _largest_mode(net, A, free, cov, localisable)
    one_mode = share is not None and share > cfg.weak_share
    weak = one_mode and _relative_deviation(net, cov, localisable, position) > cfg.weak_deviation
    return PositionCovariance(cov, heading_var, share, weak)


def robot_blocks(
    A: Information, free: np.ndarray, n: int, w: int, G: np.ndarray, C: np.ndarray
) -> Float[np.ndarray, "n w w"]:
    """Covariance blocks by robot with the conditions `C^T dx = 0` (Baarda's S-transformation), zero where fixed."""
    if not len(free):
        return np.zeros((n, w, w))
    at = np.full(n * w, -1)
    at[free] = np.arange(len(free))
    index = at.reshape(n, w)
    known = index >= 0
    blocks = A.blocks(np.where(known, index, np.maximum(index.max(axis=1, keepdims=True), 0)))
    blocks = blocks * known[:, :, None] * known[:, None, :]
    if G.shape[1]:
        B = np.zeros_like(C)
        B[free] = A.solve(C[free])
        M = C.T @ B
        K = np.linalg.solve((C.T @ G).T, G.T).T.reshape(n, w, -1)
        B = B.reshape(n, w, -1)
        blocks = blocks - K @ B.swapaxes(1, 2) - B @ K.swapaxes(1, 2) + K @ M @ K.swapaxes(1, 2)
    return np.asarray(0.5 * (blocks + blocks.swapaxes(1, 2)))


def _largest_mode(
    net: BearingNetwork, A: Information, free: np.ndarray, cov: np.ndarray, localisable: np.ndarray
) -> float | None:
    """The share of all position variance in its largest mode, by power iteration."""
    chosen = localisable & ~net.is_anchor
    if not chosen.any():
        return None
    mask = np.zeros((len(net), factors.width(net)), dtype=bool)
    mask[chosen, : net.dim] = True
    mine = mask.ravel()[free]
    x, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(len(free), 3)) * mine[:, None])
    top = 0.0
    for _ in range(POWER_STEPS):
        y = A.solve(x) * mine[:, None]
        top = float(np.linalg.eigvalsh(x.T @ y)[-1])
        x, _ = np.linalg.qr(y)
    return top / float(np.trace(cov[chosen], axis1=1, axis2=2).sum())


def _relative_deviation(net: BearingNetwork, cov: np.ndarray, localisable: np.ndarray, position: np.ndarray) -> float:
    """Root mean square standard deviation of a robot, in units of one sighting's error at its usual distance."""
    chosen = localisable & ~net.is_anchor
    span = np.linalg.norm(position[net.target] - position[net.observer], axis=1)
    own = float(np.median(span) * np.sqrt(np.mean(net.sigma**2)))
    return float(np.sqrt(np.trace(cov[chosen], axis1=1, axis2=2).mean())) / own
