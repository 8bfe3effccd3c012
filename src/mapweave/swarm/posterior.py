"""From a minimum to an estimate: covariances in the named gauge, pairs too close to tell, and verdicts."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from ..core.attitude import Headings
from ..core.gaussian import chi2_quantile
from ..solve import Factor, Information, Pattern, Problem, SingularError, Solution, SolveStatus
from . import bearing, factors
from .config import SwarmConfig
from .network import BearingNetwork
from .observability import Gauge, Observability, gauge_basis, normalise
from .result import JointInformation, OtherAnswer, SwarmEstimate, SwarmStatus, Traffic
from .start import SwarmStart, mutual_pairs

VERDICT_MANY = 0.07  # share called wrong beyond which single sightings prove nothing: some wrong ones are not found

VERDICT_DOUBT = 1e-3  # probability below which a chi-square is called wrong
TOO_MANY = 0.25  # share called wrong beyond which nothing does
WEAK_SHARE = 0.8  # of all variance in one way to move: anchors hold the shape weakly, if a robot errs by
WEAK_DEVIATION = 3.0  # times the error of one sighting at that distance

CLOSE = 3.0  # standard deviations of its own length below which a sighting is close; beyond, r^2 errs by a tenth
ANY_DIRECTION = float(np.pi / np.sqrt(3.0))  # [rad] standard deviation of a direction drawn at random
ROUNDS = 3  # of lengthening: what is told of one pair changes what is known of others


def with_true_lengths(
    net: BearingNetwork,
    x: Float[np.ndarray, " s"],
    problem: Problem,
    information: Information,
    pattern: Pattern | None,
    deviation: Float[np.ndarray, " n"],
    chosen: Bool[np.ndarray, " n"],
    unchecked: Bool[np.ndarray, " m"] | None = None,
) -> tuple[Information, int]:
    """The information at `x` with close sightings counted by the lengths they may have, and of how many pairs they are.

    problem: whose first term are the sightings; deviation: (n,) [m] no less than that of each of the robots `chosen`
    along any direction. Where no sighting between those is close it is the very `information`.
    unchecked: (m,) close sightings that may be wrong: they count as directions drawn at random, next to nothing.
    """
    u, r = bearing.predict(*_ends(net, x))
    apart = r < CLOSE * (deviation[net.observer] + deviation[net.target])
    rows = np.flatnonzero(apart & chosen[net.observer] & chosen[net.target])
    if not len(rows) or not np.any(net.sigma > 0):
        return information, 0
    pattern = pattern or Pattern.of(problem)
    parts = [term.normal(x) for term in problem.terms]
    sightings, current = factors.bearing_factor(net), information
    length = r.copy()
    for _ in range(ROUNDS):
        along = _along(net, current, problem.free, rows, u[rows])
        length[rows] = np.where(r[rows] ** 2 < CLOSE**2 * along, np.sqrt(r[rows] ** 2 + along), r[rows])
        if (length == r).all():
            return information, 0
        share = r / length
        if unchecked is not None:
            anywhere = unchecked & (share < 1.0)
            share[anywhere] *= np.minimum(net.sigma[anywhere] / ANY_DIRECTION, 1.0)
        wider = _weighed(sightings, share)
        H, _ = pattern.assemble([wider.normal(x)[0], *(a for a, _ in parts[1:])], [b for _, b in parts])
        try:
            current = Information.of(H, pattern.elimination)
        except SingularError:
            return information, 0
    close = length > r
    pairs = np.sort(np.stack([net.observer[close], net.target[close]], axis=1), axis=1)
    return current, len(np.unique(pairs, axis=0))


def _ends(net: BearingNetwork, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p = x.reshape(len(net), factors.width(net))[:, : net.dim]
    return p[net.observer], p[net.target]


def _along(
    net: BearingNetwork,
    information: Information,
    free: np.ndarray,
    rows: Int[np.ndarray, " c"],
    u: Float[np.ndarray, "c d"],
) -> Float[np.ndarray, " c"]:
    """The variance [m^2] of the length of each of the sightings `rows`, whose directions are u."""
    w, k = factors.width(net), np.arange(net.dim)
    at = np.full(len(net) * w, -1)
    at[free] = np.arange(len(free))
    out = np.zeros(len(rows))
    step = 256
    for a in range(0, len(rows), step):
        part = slice(a, min(a + step, len(rows)))
        E = np.zeros((information.size + 1, part.stop - part.start))  # the last row takes what is fixed
        columns = np.arange(E.shape[1])[:, None]
        for end, sign in ((net.observer, -1.0), (net.target, 1.0)):
            E[at[w * end[rows[part], None] + k], columns] = sign * u[part]
        E = E[:-1]
        out[part] = np.einsum("ec,ec->c", E, information.solve(E))
    return out


def _weighed(term: Factor, share: Float[np.ndarray, " m"]) -> Factor:
    """The factor with its standard deviations divided by `share`."""
    white = np.ones((1, term.rows)) if term.sqrt_info is None else term.sqrt_info
    return replace(term, sqrt_info=white * share[:, None])


def trust_warnings(net: BearingNetwork, outlier: np.ndarray) -> list[str]:
    """What stands against trusting which sightings were called wrong."""
    beyond = share_warnings(outlier)
    if beyond:
        return beyond
    share = float(outlier.mean())
    share_text = f"{100 * share:.0f} % of the sightings were called wrong"
    single = 2 * len(mutual_pairs(net)[0]) < 0.5 * len(net.observer)
    if share > VERDICT_MANY and single:
        return [f"{share_text}; where robots are not sighted from both ends the rest cannot be told from them"]
    return []


def share_warnings(outlier: np.ndarray) -> list[str]:
    """What stands against telling wrong sightings from right ones where so many are called wrong."""
    share = float(outlier.mean()) if len(outlier) else 0.0
    if share <= TOO_MANY:
        return []
    return [f"{100 * share:.0f} % of the sightings were called wrong: too many to say which ones"]


def fallen_warnings(net: BearingNetwork, rows: np.ndarray) -> list[str]:
    """What stands against sightings `rows` that agree only while two robots stand close together."""
    if not len(rows):
        return []
    pairs = [f"{net.ids[net.observer[k]]}-{net.ids[net.target[k]]}" for k in rows[:10].tolist()]
    named = ", ".join(pairs) + (", .." if len(rows) > 10 else "")
    return [f"{len(rows)} sightings may as well be wrong, and the two robots then stand further apart: {named}"]


def doubtful_warnings(net: BearingNetwork, outside: np.ndarray, doubt: float) -> list[str]:
    """What stands against places outside whose covariance robots are with probability `outside` (n,), over `doubt`."""
    robots = np.flatnonzero(outside > doubt)
    if not len(robots):
        return []
    robots = robots[np.argsort(-outside[robots], kind="stable")]
    named = ", ".join(f"{net.ids[k]} ({100 * outside[k]:.0f} %)" for k in robots[:10].tolist())
    named += ", .." if len(robots) > 10 else ""
    whose = "a robot" if len(robots) == 1 else f"{len(robots)} robots"
    return [f"other sightings may be the wrong ones, and {whose} then elsewhere (probability): {named}"]


def others_warnings(found: SwarmEstimate, others: tuple[OtherAnswer, ...]) -> list[str]:
    """What stands against places where `others` fit the sightings about as well as those `found`."""
    off = np.max([np.linalg.norm(one.position - found.position, axis=1) for one in others], axis=0)
    robots = np.flatnonzero(off > 0.5 * off.max())
    robots = robots[np.argsort(-off[robots], kind="stable")]
    named = ", ".join(f"{found.ids[k]} ({off[k]:.3g})" for k in robots[:10].tolist()) + (", .." * (len(robots) > 10))
    fit = "another answer fits" if len(others) == 1 else f"{len(others)} other answers fit"
    return [f"{fit} the sightings about as well, where robots stand elsewhere (by how far): {named}"]


def support_warnings(net: BearingNetwork, robots: np.ndarray) -> list[str]:
    """What stands against the places of `robots` (indices), whose own sightings contradict each other too much."""
    if not len(robots):
        return []
    names = ", ".join(net.ids[k] for k in robots[:10].tolist()) + (", .." if len(robots) > 10 else "")
    return [f"so many sightings of {len(robots)} robots were called wrong that their others prove nothing: {names}"]


def elsewhere_warnings(net: BearingNetwork, robots: np.ndarray) -> list[str]:
    """What stands against the places of `robots` (indices), whose sightings called wrong agree on others."""
    if not len(robots):
        return []
    names = ", ".join(net.ids[k] for k in robots[:10].tolist()) + (", .." if len(robots) > 10 else "")
    return [f"sightings called wrong agree that robots stand elsewhere, as where names are exchanged: {names}"]


def chi2_warnings(chi2: float, dof: int) -> list[str]:
    """What stands against trusting residuals of `chi2` with `dof` degrees of freedom."""
    if dof <= 0:
        counted = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
        return [f"no sightings are left over to check the positions with ({counted})"]
    if chi2 <= chi2_quantile(1 - VERDICT_DOUBT, float(dof)):
        return []
    counted = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
    return [f"the residuals are larger than sigma says ({counted}): outliers, a bias, or sigma too small"]


def faint_remarks(chi2: float, dof: int) -> list[str]:
    """What is said of residuals far smaller than sigma: the positions may well be right, their covariance is not."""
    if dof <= 0 or chi2 >= chi2_quantile(VERDICT_DOUBT, float(dof)):
        return []
    counted = f"chi-square {chi2:.4g} with {dof} degrees of freedom"
    return [f"the residuals are far smaller than sigma says ({counted}): sigma too large, or rows that are copies"]


def barely_determined(net: BearingNetwork, position: np.ndarray, cov: np.ndarray, localisable: np.ndarray) -> list[str]:
    """Robots that the null space calls localisable, but no better than to within their distance to those they see."""
    span = float(np.median(np.linalg.norm(position[net.target] - position[net.observer], axis=1)))
    worst = np.sqrt(np.linalg.eigvalsh(cov[localisable]).max(axis=1, initial=0.0))
    count = int(np.count_nonzero(worst > span))
    if not count or count > 0.5 * len(worst):  # most robots at once: that is the scale, said elsewhere
        return []
    return [f"robots barely determined, by rays nearly parallel: {count}; the covariance may fall short of their error"]


def close_remarks(pairs: int) -> list[str]:
    """What is said of `pairs` of robots whose distance is hardly known."""
    if not pairs:
        return []
    named = f"{pairs} pairs of robots that see each other stand" if pairs > 1 else "a pair of robots that sight stands"
    return [f"{named} so close that the distance is not known: the covariance counts their sightings accordingly"]


def layout_warnings(net: BearingNetwork, localisable: np.ndarray, in_line: int) -> list[str]:
    """What in the layout itself stands against locating it."""
    warnings = []
    if len(net.anchors) > 1 and len({tuple(p) for p in net.anchors.values()}) == 1:
        warnings.append("all anchors stand at one place: they fix no scale")
    if in_line:
        line = f"{in_line} robots stand on one line, all sightings parallel but for noise"
        warnings.append(f"{line}: nothing tells how far")
    lost = int(np.count_nonzero(~localisable))
    if lost:
        warnings.append(f"{lost} of {len(net)} robots cannot be located from these sightings")
    return warnings


def facing_remarks(net: BearingNetwork, seen: Observability) -> list[str]:
    """What is said of robots whose place is known and whose own axes are not: all they see lies on one line."""
    turned = np.flatnonzero(seen.localisable & ~seen.oriented)
    if not len(turned):
        return []
    names = ", ".join(net.ids[k] for k in turned[:10].tolist()) + (", .." if len(turned) > 10 else "")
    return [f"how {len(turned)} robots are turned about the line to all they see is not known: {names}"]


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
    position, heading = normalise(gauge, *factors.parted(net, solution.x))
    position = position.copy()
    for k, p in net.anchors.items():  # also those in other components, which the gauge of this one may have moved
        position[k] = p
    x, information = solution.x, solution.information
    if gauge.name and information is not None:
        x = factors.state(position, heading)
        information = _information_at(problem, x, information, pattern)
    G, C = gauge_basis(net, gauge, position)
    covariance = None
    close = 0
    if information is not None and cfg.covariance:
        covariance = position_covariance(net, gauge, information, solution.free, start.seen, position, (G, C))
        deviation = np.sqrt(np.nan_to_num(np.trace(covariance.cov, axis1=1, axis2=2)))
        honest, close = with_true_lengths(net, x, problem, information, pattern, deviation, localisable, unchecked)
        if close:
            information = honest
            covariance = position_covariance(net, gauge, information, solution.free, start.seen, position, (G, C))
    measured = problem.terms[: 1 + bool(net.distances)]
    chi2 = float(sum(term.squares(solution.x).sum() for term in measured))
    unknown = dim * (n - len(net.anchors)) + (w - dim) * len(np.unique(net.observer))
    dof = len(net.observer) * (dim - 1) + len(net.distances) - unknown + start.seen.nullity
    doubts = chi2_warnings(chi2, dof) if anyone and np.any(net.sigma > 0) else []
    doubts += ["every robot is an anchor: nobody is left to be found"] * bool(net.is_anchor.all())
    if status is not SwarmStatus.CONVERGED:
        doubts.append(f"the refinement ended with: {status}")
    if information is None:
        doubts.append("the information matrix is singular: there is no covariance")
    weak = covariance is not None and covariance.weak
    remarks = [*notes, *layout_warnings(net, localisable, start.seen.in_line), *facing_remarks(net, start.seen)]
    if anyone and np.any(net.sigma > 0):
        remarks += faint_remarks(chi2, dof)
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
    heading_var: Headings | None
    mode_share: float | None
    weak: bool


def position_covariance(
    net: BearingNetwork,
    gauge: Gauge,
    A: Information,
    free: np.ndarray,
    seen: Observability,
    position: Float[np.ndarray, "n d"],
    basis: tuple[np.ndarray, np.ndarray],
) -> PositionCovariance:
    """Per-robot covariances from the information `A` over the entries `free`; exact sightings leave none."""
    dim, localisable = net.dim, seen.localisable
    blocks = robot_blocks(A, free, len(net), factors.width(net), *basis)
    exact = not np.any(net.sigma > 0)
    cov = blocks[:, :dim, :dim] * (0.0 if exact else 1.0)
    cov[~localisable] = np.nan
    cov[list(net.anchors)] = 0.0
    heading_var = None
    if not net.axis:
        heading_var = np.einsum("nkk->nk", blocks)[:, dim:] * (0.0 if exact else 1.0)
        heading_var[~(localisable & seen.oriented)] = np.nan
        heading_var = heading_var[:, 0] if dim == 2 else heading_var
    share = None if exact or gauge.name else _largest_mode(net, A, free, cov, localisable)
    one_mode = share is not None and share > WEAK_SHARE
    weak = one_mode and _relative_deviation(net, cov, localisable, position) > WEAK_DEVIATION
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
