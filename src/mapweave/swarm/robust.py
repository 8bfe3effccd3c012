"""Locating in spite of wrong sightings, with a verdict on the result's own reliability.

Two robots that saw each other must have seen opposite directions; least unsquared deviations start the positions,
graduated non-convexity (Geman-McClure) finds which sightings belong together, robots that fell in with wrong ones are
put, and turned, where most of theirs meet, and few robots without a common axis start from parts of their sightings,
too. Those sightings alone are then used as by the batch estimator, so that the covariance means what it says.
"""

from dataclasses import dataclass, replace
from math import comb, erf, sqrt

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.attitude import headings, matrices
from ..core.errors import DataError, EstimateError
from ..core.gaussian import chi2_quantile
from ..solve import GemanMcClure, SingularError
from . import bearing, factors
from .alternatives import doubts as alternatives
from .batch import answers_beside, batch, refine, with_others
from .config import ALTERNATIVES_DOUBT, ALTERNATIVES_MOST, MUTUAL_GATE, SwarmConfig
from .factors import bearing_factor
from .network import BearingNetwork, components, effective_sigma
from .posterior import (
    CLOSE,
    doubtful_warnings,
    elsewhere_warnings,
    fallen_warnings,
    posterior,
    support_warnings,
    trust_warnings,
)
from .result import SwarmEstimate
from .start import SwarmStart, linear_pattern, linear_start, mutual_pairs, prepare, triads

ROBUST_REWEIGHTS = 12  # of the start of least unsquared deviations
ROBUST_COOLING = 1.6  # by which the kernel's width is divided at each stage
STAGE_ITERATIONS = 4  # of Levenberg-Marquardt at each stage
ROBUST_RESELECTIONS = 3  # of the sightings that agree, at most
ROBUST_SUSPECT = 0.3  # share of a robot's sightings that disagree from which on it may stand at a wrong place
ROBUST_RELOCATIONS = 3  # rounds of putting suspects elsewhere, since they may be neighbours
CROSSINGS_OF = 40  # sightings of one robot whose crossings are tried: 780 pairs
TURNED_AT = 60  # places of a robot at which it is turned by its own sightings: those that others contradict least
PARTS = 12  # of the sightings of a small network, from which it is started anew
PARTS_SHARE = 0.7  # of the sightings in each
WORTH_MOVING = 0.5  # of the limit that a robot's sightings must cost less elsewhere
LEAST_SINE = 0.1  # of the angle between two sightings that tell a turn

FALLEN_HOPS = 3  # sightings away from the two, beyond which robots are held while one sighting is left out
FALLEN_FEW = 4000  # sightings up to which all are asked, not only those of hardly known length
FALLEN_PROMISE = 0.4  # of the limit: what the linear model must promise for a sighting to be left out at all
FALLEN_UNCHECKED = 0.8  # share of its direction that a sighting alone tells, from which on nothing checks it
NEAR_MISS = 70.0  # times the limit, squared residual up to which a sighting called wrong is tried again
FALLEN_SWAPS = 2  # sightings let go at most for one that is taken in
FALLEN_UNDECIDED = 0.5  # of the limit: a loss up to which a sighting called wrong may as well be right
FALLEN_AGAINST = 6.0  # standard deviations of their difference beyond which two of a pair are not both right
FALLEN_LIKELY = 0.015  # probability of being wrong from which on a sighting may as well be
AGREEING, BY_CHANCE = 4, 0.01  # wrong sightings of a robot that agree on one place, and how likely that is by chance
ROBUST_INLIER_GATE = 3.5  # standard deviations a sighting may miss by and count as an inlier


def relocated(net: BearingNetwork, x: Float[np.ndarray, " s"], limit: float) -> Float[np.ndarray, " s"]:
    """The state `x`, robots with many sightings beyond `limit` (squared, whitened) put, and turned, as fewer are.

    Each is moved to the crossing of two of its rays with the least sum of squared residuals cut off at `limit`, if that
    is less than where it stands. Without a common axis its rays are what others see of it and what it sees as it is
    turned; at each place it may be turned as each two of its own sightings (in the plane each one) say. Robots of which
    few sightings disagree stay, as do the places of anchors.
    """
    position, heading = factors.parted(net, x)
    p, R = np.array(position), None if heading is None else matrices(np.array(heading))
    both = np.concatenate([net.observer, net.target])
    order = np.argsort(both, kind="stable")
    ends = np.searchsorted(both[order], np.arange(len(net) + 1))
    factor = bearing_factor(net)
    for _ in range(ROBUST_RELOCATIONS):
        x = factors.state(p, None if R is None else headings(R))
        share = _share(net, factor.squares(x) > limit)
        suspects = np.flatnonzero((share > ROBUST_SUSPECT) & ~(net.is_anchor & net.axis))
        moved = False
        for k in suspects[np.argsort(-share[suspects], kind="stable")].tolist():
            rows = order[ends[k] : ends[k + 1]] % len(net.observer)
            better = _better_pose(net, p, R, k, rows[:CROSSINGS_OF], limit)
            if better is not None:
                p[k], moved = better[0], True
                if R is not None:
                    R[k] = better[1]
        if not moved:
            break
    return factors.state(p, None if R is None else headings(R))


def unsupported(net: BearingNetwork, outlier: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " k"]:
    """Robots with sightings called wrong whose other sightings do not outnumber them, or only just give a position.

    What was called wrong there could as well be right: nothing is left over that tells. And anchors most of whose
    sightings were: they may stand elsewhere than was said.
    """
    both = np.concatenate([net.observer, net.target])
    wrong = np.bincount(both[np.concatenate([outlier, outlier])], minlength=len(net))
    right = np.bincount(both, minlength=len(net)) - wrong
    unknown = factors.width(net)
    few = np.where(net.is_anchor, right < wrong, (right <= wrong) | ((net.dim - 1) * right <= unknown))
    return np.flatnonzero((wrong > 0) & few)


def elsewhere(
    net: BearingNetwork, p: Float[np.ndarray, "n d"], outlier: Bool[np.ndarray, " m"], limit: float
) -> Int[np.ndarray, " k"]:
    """Robots whose sightings called wrong agree on another place of them, more of them than chance lets agree.

    Sightings that are wrong each by itself point anywhere; these are of a robot that stands there, as one of two that
    are taken for each other does. Axes are common. limit: squared whitened residual up to which a sighting agrees.
    """
    rows = np.flatnonzero(outlier)
    both = np.concatenate([net.observer[rows], net.target[rows]])
    order = np.argsort(both, kind="stable")
    ends = np.searchsorted(both[order], np.arange(len(net) + 1))
    out = []
    for k in np.flatnonzero(np.diff(ends) >= AGREEING).tolist():
        mine = rows[order[ends[k] : ends[k + 1]][:CROSSINGS_OF] % len(rows)]
        own = net.observer[mine] == k
        other, seen = p[np.where(own, net.target[mine], net.observer[mine])], net.direction[mine]
        places = _crossings(other, seen)
        away = np.where(own, 1.0, -1.0)[:, None] * (other - places[:, None, :])
        most = int((_squares(away, seen, net.sigma[mine]) <= limit).sum(axis=1).max(initial=0))
        angle = float(np.sqrt(limit) * net.sigma[mine].max())
        chance = min(1.0, angle / np.pi if net.dim == 2 else 0.5 * (1.0 - np.cos(min(angle, np.pi))))
        ways = comb(len(mine), 2) * comb(len(mine) - 2, max(most - 2, 0)) * len(net)
        if most >= AGREEING and ways * chance ** (most - 2) < BY_CHANCE:
            out.append(k)
    return np.array(out, dtype=np.intp)


def _share(net: BearingNetwork, wrong: Bool[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
    """By robot, the share of its sightings that are `wrong`."""
    both = np.concatenate([net.observer, net.target])
    count = np.bincount(both, minlength=len(net))
    return np.asarray(np.bincount(both[np.concatenate([wrong, wrong])], minlength=len(net)) / np.maximum(count, 1))


def _better_pose(
    net: BearingNetwork,
    p: Float[np.ndarray, "n d"],
    R: Float[np.ndarray, "n d d"] | None,
    k: int,
    rows: Int[np.ndarray, " r"],
    limit: float,
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"]] | None:
    """Place and turn of robot k at which its sightings `rows` cost least; None where none beats those it has."""
    own = net.observer[rows] == k
    other = p[np.where(own, net.target[rows], net.observer[rows])]
    sigma, mine = net.sigma[rows], net.direction[rows[own]]
    seen = net.direction[rows] if R is None else np.einsum("rab,rb->ra", R[net.observer[rows]], net.direction[rows])
    places = p[k][None]
    if k not in net.anchors:
        places = np.concatenate([places, _crossings(other, seen)])
        if R is not None:
            places = np.concatenate([places, _sides(other, seen, own)])
    away = np.where(own, 1.0, -1.0)[:, None] * (other - places[:, None, :])  # (c, r, d) along what is to be seen
    costs = _costs(away, seen, sigma, limit)
    best = int(np.argmin(costs))
    at, least, turn = best, costs[best], np.eye(net.dim) if R is None else R[k]
    if R is not None and own.any():
        by_others = _costs(away[:, ~own], seen[~own], sigma[~own], limit)
        for c in np.argsort(by_others, kind="stable")[:TURNED_AT].tolist():
            turns = _turns(away[c, own], mine)
            if len(turns):
                tried = np.einsum("hab,rb->hra", turns, mine)
                cost = by_others[c] + _costs(np.broadcast_to(away[c, own], tried.shape), tried, sigma[own], limit)
                h = int(np.argmin(cost))
                if cost[h] < least:
                    at, least, turn = c, cost[h], turns[h]
    return None if least > costs[0] - WORTH_MOVING * limit else (places[at], turn)


def _crossings(other: Float[np.ndarray, "r d"], seen: Float[np.ndarray, "r d"]) -> Float[np.ndarray, "c d"]:
    """Where each two rays along `seen` through `other` cross that are not parallel."""
    across = np.eye(other.shape[1]) - seen[:, :, None] * seen[:, None, :]
    pulled = np.einsum("rab,rb->ra", across, other)
    i, j = np.triu_indices(len(other), 1)
    A = across[i] + across[j]
    crossing = np.linalg.det(A) > 1e-4
    i, j, A = i[crossing], j[crossing], A[crossing]
    return np.asarray(np.linalg.solve(A, (pulled[i] + pulled[j])[..., None])[..., 0])


def _sides(
    other: Float[np.ndarray, "r d"], seen: Float[np.ndarray, "r d"], own: Bool[np.ndarray, " r"]
) -> Float[np.ndarray, "c d"]:
    """Where a robot stands on the ray of one that sees it, if it sees that one and a third under the angle it does.

    Of the triangle of these three one side and all angles are known, however the robot is turned.
    """
    ray, a, b = (k.ravel() for k in np.meshgrid(np.flatnonzero(~own), *2 * [np.flatnonzero(own)], indexing="ij"))
    mutual = (other[ray] == other[a]).all(axis=1) & (a != b)
    ray, a, b = ray[mutual], a[mutual], b[mutual]
    side = other[b] - other[ray]
    length = np.linalg.norm(side, axis=1)
    at_ray = np.einsum("cd,cd->c", side, seen[ray]) / np.maximum(length, bearing.TINY)
    there = np.arccos(np.clip(at_ray, -1.0, 1.0))
    here = np.arccos(np.clip(np.einsum("cd,cd->c", seen[a], seen[b]), -1.0, 1.0))
    far = length * np.sin(there + here) / np.maximum(np.sin(here), LEAST_SINE)
    told = (far > 0.0) & (np.sin(here) > LEAST_SINE)
    return np.asarray((other[ray] + far[:, None] * seen[ray])[told])


def _turns(u: Float[np.ndarray, "r d"], b: Float[np.ndarray, "r d"]) -> Float[np.ndarray, "h d d"]:
    """Turns that carry what a robot sees in its own axes (b) onto where it is (along u), by each two rows, or one."""
    u = u / np.maximum(np.linalg.norm(u, axis=1, keepdims=True), bearing.TINY)
    if u.shape[1] == 2:
        aside = np.array([[0.0, 1.0], [-1.0, 0.0]])
        F, E = (np.stack([x, x @ aside], axis=-1) for x in (u, b))
        return np.asarray(F @ E.swapaxes(1, 2))
    i, j = np.triu_indices(len(u), 1)
    (F, near), (E, far) = triads(u[i], u[j]), triads(b[i], b[j])
    return np.asarray((F @ E.swapaxes(1, 2))[np.minimum(near, far) > LEAST_SINE])


def _costs(
    away: Float[np.ndarray, "*h r d"], seen: Float[np.ndarray, "*r d"], sigma: Float[np.ndarray, " r"], limit: float
) -> Float[np.ndarray, " h"]:
    """The squared residuals of sightings along `seen` where the way is `away`, each cut off at `limit`, summed."""
    return np.asarray(np.minimum(_squares(away, seen, sigma), limit).sum(axis=-1))


def _squares(
    away: Float[np.ndarray, "*h r d"], seen: Float[np.ndarray, "*r d"], sigma: Float[np.ndarray, " r"]
) -> Float[np.ndarray, "*h r"]:
    along = np.einsum("...rd,...rd->...r", away, seen)
    across = np.linalg.norm(away - along[..., None] * seen, axis=-1)
    return np.asarray(np.square(np.arctan2(across, along) / sigma))


@dataclass(frozen=True, slots=True)
class Fallen:
    """Indices of sightings that are wrong, and of those that may as well be."""

    wrong: Int[np.ndarray, " w"]
    undecided: Int[np.ndarray, " d"]


def fallen_together(
    net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, limit: float, cfg: SwarmConfig
) -> Fallen:
    """Of the sightings `inlier` that `found` was made of, those that the others contradict once they are free to.

    limit: squared whitened residual from which a sighting is wrong. Only sightings not confirmed by one the other way
    are left out. Common axes are assumed, and covariances.
    """
    wrong: list[int] = []
    undecided: list[int] = []
    least = detection_threshold(net, inlier, FALLEN_LIKELY)
    for row in _promising(net, inlier, found, limit):
        gain, miss = _left_out(net, inlier, found.position, row, cfg)
        if miss > limit and gain > min(limit, least[row]):
            (wrong if gain > limit else undecided).append(row)
    for row in _near_misses(net, inlier, found, limit * NEAR_MISS):
        gain, others = _taken_in(net, inlier, found.position, row, limit, cfg)
        if gain > 0.0:
            wrong += others
        elif gain > -FALLEN_UNDECIDED * limit:
            undecided += others
    return Fallen(np.array(wrong, dtype=np.intp), np.array(undecided, dtype=np.intp))


def detection_threshold(net: BearingNetwork, inlier: Bool[np.ndarray, " m"], likely: float) -> Float[np.ndarray, " m"]:
    """(m,) what the chi-square of all others must lose without a sighting for it to be wrong with probability `likely`.

    Bayes' rule: a wrong sighting points anywhere, a right one is normal about the truth, and sightings are wrong as
    often as they were found to be (half of one more, so that none found is not none).
    """
    wrong, every = float(np.count_nonzero(~inlier)), len(inlier)
    share = (wrong + 0.5) / (every + 1.0)
    sigma = np.maximum(net.sigma, 1e-9)
    density = np.log(np.sqrt(2.0 * np.pi) / sigma) if net.dim == 2 else np.log(2.0 / sigma**2)
    odds = np.log(likely / (1.0 - likely)) - np.log(share / (1.0 - share))
    return np.asarray(2.0 * np.maximum(density + odds, 0.0))


def _near_misses(net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, most: float) -> list[int]:
    """Sightings called wrong that miss by so little that they may be right, their squares below `most`."""
    squares = factors.bearing_factor(net).squares(found.position.ravel())
    both = found.localisable[net.observer] & found.localisable[net.target]
    return [int(k) for k in np.flatnonzero(~inlier & both & (squares < most))]


def unchecked(net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate) -> Bool[np.ndarray, " m"]:
    """(m,) of the sightings `inlier`, those of hardly known length that no other checks: wrong or not, they fit."""
    rows = _doubtful(net, inlier, found)
    out = np.zeros(len(inlier), dtype=bool)
    if len(rows):
        out[rows] = _told(net, rows, found)[1] > FALLEN_UNCHECKED
    return out


def _promising(net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, limit: float) -> list[int]:
    """Unconfirmed sightings whose removal the linear model rewards, the best first; in large networks short ones."""
    rows = _doubtful(net, inlier, found, anywhere=len(inlier) <= FALLEN_FEW)
    if not len(rows):
        return []
    squares, told = _told(net, rows, found)
    promise = squares / np.maximum(1.0 - told, 1e-6)
    order = np.argsort(-promise, kind="stable")
    return [int(rows[k]) for k in order if promise[k] > FALLEN_PROMISE * limit]


def _doubtful(
    net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, *, anywhere: bool = False
) -> Int[np.ndarray, " c"]:
    """Unconfirmed sightings between robots that are localisable: of hardly known length, or `anywhere`."""
    if found.cov is None or found.information is None or not np.any(net.sigma > 0):
        return np.zeros(0, dtype=np.intp)
    p = found.position
    _, r = bearing.predict(p[net.observer], p[net.target])
    deviation = np.sqrt(np.nan_to_num(np.trace(found.cov, axis1=1, axis2=2)))
    both = found.localisable[net.observer] & found.localisable[net.target]
    short = r < CLOSE * (deviation[net.observer] + deviation[net.target])
    return np.flatnonzero(inlier & ~_confirmed(net, inlier) & both & (short | anywhere))


def _told(
    net: BearingNetwork, rows: Int[np.ndarray, " c"], found: SwarmEstimate
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Squared residuals of the sightings `rows`, and how much of its own direction each tells: near 1, it alone."""
    if found.information is None:
        return np.zeros(len(rows)), np.zeros(len(rows))
    x = found.position.ravel()
    factor = factors.bearing_factor(net.select(rows))
    white = np.ones((1, factor.rows)) if factor.sqrt_info is None else factor.sqrt_info
    J = white[..., None] * factor.jacobian(x)
    E = np.zeros((x.size, len(rows) * factor.rows))
    columns = np.arange(E.shape[1]).reshape(len(rows), factor.rows)
    np.add.at(E, (factor.columns[:, None, :], columns[:, :, None]), J)
    try:
        told = found.information.variances(E)[columns].max(axis=1)
    except SingularError:  # something is not determined at all: whatever is sighted there tells everything
        told = np.ones(len(rows))
    return factor.squares(x), told


def _confirmed(net: BearingNetwork, inlier: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """(m,) sightings of pairs that other inliers, either way, are of too."""
    n = len(net)
    low, high = np.minimum(net.observer, net.target), np.maximum(net.observer, net.target)
    _, which, count = np.unique(np.where(inlier, low * n + high, -1), return_inverse=True, return_counts=True)
    return np.asarray(count[which.ravel()] > 1)


@dataclass(frozen=True, slots=True)
class _Part:
    """A part of a network: its sightings that are used, all of its sightings, and which robots (whole numbering)."""

    used: BearingNetwork
    whole: BearingNetwork
    rows: Int[np.ndarray, " r"]
    robots: Int[np.ndarray, " n"]


def _part(
    net: BearingNetwork, kept: Bool[np.ndarray, " m"], position: Float[np.ndarray, "n d"], row: int, hops: int
) -> _Part | None:
    """What lies within `hops` sightings `kept` of the two robots of `row`, the outermost robots held where they are."""
    both = [int(net.observer[row]), int(net.target[row])]
    near, core = np.zeros(len(net), dtype=bool), np.zeros(len(net), dtype=bool)
    near[both] = True
    for _ in range(hops):
        core = near.copy()
        touched = kept & (near[net.observer] | near[net.target])
        near[net.observer[touched]] = near[net.target[touched]] = True
    inside = kept & near[net.observer] & near[net.target]
    robots = np.unique(np.concatenate([net.observer[inside], net.target[inside]]))
    at = np.full(len(net), -1)
    at[robots] = np.arange(len(robots))
    if min(at[both]) < 0:
        return None  # nothing else sights one of them
    known = {int(at[k]): position[k] for k in robots.tolist() if not core[k] or k in net.anchors}

    def piece(rows: np.ndarray) -> BearingNetwork:
        return replace(
            net.select(rows),
            ids=tuple(net.ids[k] for k in robots.tolist()),
            observer=at[net.observer[rows]],
            target=at[net.target[rows]],
            anchors=known,
            distances=(),
        )

    rows = np.flatnonzero((at[net.observer] >= 0) & (at[net.target] >= 0))
    return _Part(piece(np.flatnonzero(inside)), piece(rows), rows, robots)


def _left_out(
    net: BearingNetwork, inlier: Bool[np.ndarray, " m"], position: Float[np.ndarray, "n d"], row: int, cfg: SwarmConfig
) -> tuple[float, float]:
    """What the chi-square of the other inliers near by loses without sighting `row`, and its own squared residual."""
    kept = inlier.copy()
    kept[row] = False
    part = _part(net, kept, position, row, FALLEN_HOPS)
    if part is None:
        return 0.0, 0.0
    before = position[part.robots]
    x = refine(part.used, prepare(part.used, before), cfg, everyone=True)[0].x
    factor = factors.bearing_factor(part.used)
    gain = float(factor.squares(before.ravel()).sum() - factor.squares(x).sum())
    return gain, float(factors.bearing_factor(part.whole).squares(x)[part.rows == row][0])


def _against(net: BearingNetwork, inlier: Bool[np.ndarray, " m"], row: int, least: float) -> list[int]:
    """The inliers of the same pair, the other way, that are so far from opposite to `row` that one of them is wrong.

    least: standard deviations of their difference from which they are.
    """
    back = np.flatnonzero(inlier & (net.observer == net.target[row]) & (net.target == net.observer[row]))
    u, v = -net.direction[row], net.direction[back]
    cosine = v @ u
    miss = np.arctan2(np.linalg.norm(v - cosine[:, None] * u, axis=1), cosine)
    spread = net.sigma[row] ** 2 + net.sigma[back] ** 2
    return [int(k) for k in back[miss**2 > least**2 * spread]]


def _taken_in(
    net: BearingNetwork,
    inlier: Bool[np.ndarray, " m"],
    position: Float[np.ndarray, "n d"],
    row: int,
    limit: float,
    cfg: SwarmConfig,
) -> tuple[float, list[int]]:
    """What the cost of all sightings near by, each cut off at `limit`, loses where `row` is believed; what then is not.

    Those the other way that contradict it are let go first, since one of the two is wrong; then the sighting that
    misses most, until all that are left fit or `row` itself is the one.
    """
    kept = inlier.copy()
    let_go = _against(net, kept, row, FALLEN_AGAINST)
    kept[row], kept[let_go] = True, False
    for _ in range(FALLEN_SWAPS + 1):
        part = _part(net, kept, position, row, FALLEN_HOPS)
        if part is None:
            break
        before = position[part.robots]
        x = refine(part.used, prepare(part.used, before), cfg, everyone=True)[0].x
        whole = factors.bearing_factor(part.whole)
        now = whole.squares(x)
        misses = np.where(kept[part.rows], now, 0.0)
        worst = int(np.argmax(misses))
        if misses[worst] <= limit:
            costs = np.minimum(whole.squares(before.ravel()), limit).sum() - np.minimum(now, limit).sum()
            return (float(costs), let_go) if let_go else (-np.inf, [])
        if part.rows[worst] == row:
            break
        let_go.append(int(part.rows[worst]))
        kept[let_go[-1]] = False
    return -np.inf, []


def robust(net: BearingNetwork, cfg: SwarmConfig, initial: np.ndarray | None = None) -> SwarmEstimate:
    """The most likely positions under the sightings found to agree; the others are marked in `outlier`."""
    if not np.any(net.sigma > 0):
        return replace(batch(net, cfg, initial), method="robust")
    agree = mutual_agreement(net, MUTUAL_GATE)
    if not agree.any():
        agree[:] = True  # nothing agrees: the verdict will say so
    kept = net.select(agree)
    start = prepare(kept, initial)
    used = agree.copy()
    used[agree] = start.used
    kept = net.select(used)
    if initial is None and net.axis:  # directions turned wrongly would draw all robots together
        start = replace(start, position=unsquared_start(kept, start))
    x = _settled(kept, start, cfg)
    if initial is None and not net.axis and len(kept.observer) <= ALTERNATIVES_MOST:
        x = _from_parts(kept, x, cfg)
    inlier = agreeing(net, x, ROBUST_INLIER_GATE) & ~without_heading(net, used)
    if not inlier.any():
        return _nothing_agrees(net, cfg, initial)
    doubts: list[str] = []
    for round_ in range(ROBUST_RESELECTIONS):
        estimate, inlier, start = _selected(net, x, start, used, inlier, cfg)
        if not net.axis or not cfg.covariance:
            break
        fallen = fallen_together(net, inlier, estimate, outlier_limit(net, ROBUST_INLIER_GATE), cfg)
        if not len(fallen.wrong) or round_ == ROBUST_RESELECTIONS - 1:
            doubts = fallen_warnings(net, np.concatenate([fallen.wrong, fallen.undecided]))
            break
        inlier[fallen.wrong] = False
        chosen = net.select(inlier)
        start = prepare_at(chosen, estimate.position.ravel(), start)
        x = refine(chosen, start, cfg, everyone=True)[0].x
        inlier = agreeing(net, x, ROBUST_INLIER_GATE)
    outside = alternatives(net, inlier, estimate)
    doubts += doubtful_warnings(net, outside, ALTERNATIVES_DOUBT)
    doubts += [*trust_warnings(net, ~inlier), *support_warnings(net, unsupported(net, ~inlier))]
    if net.axis:
        limit = outlier_limit(net, ROBUST_INLIER_GATE)
        doubts += elsewhere_warnings(net, elsewhere(net, estimate.position, ~inlier, limit))
    told = replace(estimate, reliable=estimate.reliable and not doubts, warnings=(*doubts, *estimate.warnings))
    return with_others(told, answers_beside(net.select(inlier), told, cfg))


def _settled(net: BearingNetwork, start: SwarmStart, cfg: SwarmConfig) -> Float[np.ndarray, " s"]:
    """The state that most sightings agree with, from `start`, robots that fell in with wrong ones put elsewhere."""
    return relocated(net, graduated(net, start, cfg), outlier_limit(net, ROBUST_INLIER_GATE))


def _from_parts(net: BearingNetwork, x: Float[np.ndarray, " s"], cfg: SwarmConfig) -> Float[np.ndarray, " s"]:
    """The best of `x` and what starts from parts of the sightings, drawn at random, lead to.

    Few robots have a start that one wrong sighting turns; some of the parts are without it.
    """
    limit = outlier_limit(net, ROBUST_INLIER_GATE)
    factor, rng = bearing_factor(net), np.random.default_rng(0)

    def cost(x: Float[np.ndarray, " s"]) -> float:
        return float(np.minimum(factor.squares(x), limit).sum())

    least = cost(x)
    for _ in range(PARTS if (factor.squares(x) > limit).any() else 0):
        rows = rng.random(len(net.observer)) < PARTS_SHARE
        try:
            part = prepare(net.select(rows))
            tried = _settled(net, prepare(net, part.position, part.heading), cfg)
        except (DataError, EstimateError):
            continue
        if cost(tried) < least:
            x, least = tried, cost(tried)
    return x


def _selected(
    net: BearingNetwork, x: np.ndarray, start: SwarmStart, used: np.ndarray, inlier: np.ndarray, cfg: SwarmConfig
) -> tuple[SwarmEstimate, Bool[np.ndarray, " m"], SwarmStart]:
    """The estimate of the sightings that agree with it, found from those that agree at x; and which they are."""
    for _ in range(ROBUST_RESELECTIONS):
        chosen = net.select(inlier)
        start = prepare_at(chosen, x, start)
        solution, problem, pattern = refine(chosen, start, cfg, everyone=True)
        x = solution.x
        again = agreeing(net, x, ROBUST_INLIER_GATE) & ~without_heading(net, used)
        if (again == inlier).all() or not again.any():
            break
        inlier = again
    chosen = net.select(inlier)
    if len(chosen.observer) != problem.terms[0].size // (net.dim - 1):
        start = prepare_at(chosen, x, start)
        solution, problem, pattern = refine(chosen, start, cfg, everyone=True)
    estimate = posterior(chosen, start, solution, problem, cfg, "robust", ~inlier, pattern=pattern)
    if net.axis and not inlier.all():  # where some are wrong, one that nothing checks may be
        alone = unchecked(net, inlier, estimate)[inlier]
        if alone.any():
            estimate = posterior(
                chosen, start, solution, problem, cfg, "robust", ~inlier, pattern=pattern, unchecked=alone
            )
    return estimate, inlier, start


def _nothing_agrees(net: BearingNetwork, cfg: SwarmConfig, initial: np.ndarray | None) -> SwarmEstimate:
    estimate = batch(net, cfg, initial)
    warning = "no sightings agree with each other: the estimate uses all of them"
    return replace(estimate, method="robust", reliable=False, warnings=(warning, *estimate.warnings))


def mutual_agreement(net: BearingNetwork, gate: float) -> Bool[np.ndarray, " m"]:
    """(m,) False for both of two mutual sightings that miss being opposite by `gate` standard deviations.

    Without a common axis mutual sightings tell the headings instead, and nothing can be checked.
    """
    agree = np.ones(len(net.observer), dtype=bool)
    if not net.axis:
        return agree
    a, b = mutual_pairs(net)
    u = net.direction
    cosine = -np.einsum("mk,mk->m", u[a], u[b])
    miss = np.arctan2(np.linalg.norm(u[a] + cosine[:, None] * u[b], axis=1), cosine)
    wrong = miss > gate * np.hypot(net.sigma[a], net.sigma[b])
    agree[a[wrong]] = agree[b[wrong]] = False
    return agree


def unsquared_start(net: BearingNetwork, start: SwarmStart) -> Float[np.ndarray, "n d"]:
    """Positions of least summed (not squared) deviation, by reweighting the linear start."""
    parts = components(net)
    pattern, held = linear_pattern(net, parts)
    direction = net.direction
    position = start.position
    for _ in range(ROBUST_REWEIGHTS):
        d = position[net.target] - position[net.observer]
        usual = float(np.median(np.linalg.norm(d, axis=1))) or 1.0
        along = np.einsum("mk,mk->m", d, direction)
        miss = np.linalg.norm(d - np.maximum(along, 0.0)[:, None] * direction, axis=1) / usual
        weights = 1.0 / np.maximum(miss, effective_sigma(net))
        position = linear_start(net, parts, direction, pattern, held, weights / weights.max())
    return position


def graduated(net: BearingNetwork, start: SwarmStart, cfg: SwarmConfig) -> Float[np.ndarray, " s"]:
    """The state under a Geman-McClure kernel narrowed from covering all residuals to the inlier gate.

    All robots are kept apart, since a wrong sighting is escaped by falling together.
    """
    state = factors.state(start.position, start.heading)
    largest = float(np.sqrt(bearing_factor(net).squares(state).max()))
    width, pattern = max(largest, ROBUST_INLIER_GATE), None
    stage = replace(cfg, max_iterations=STAGE_ITERATIONS)
    while True:
        solution, _, pattern = refine(net, start, stage, GemanMcClure(width), pattern, everyone=True)
        start = _moved(net, start, solution.x)
        if width <= ROBUST_INLIER_GATE:
            return solution.x
        width = max(width / ROBUST_COOLING, ROBUST_INLIER_GATE)


def agreeing(net: BearingNetwork, x: Float[np.ndarray, " s"], gate: float) -> Bool[np.ndarray, " m"]:
    """(m,) sightings that miss the state by less than what `gate` standard deviations mean in one dimension."""
    return np.asarray(bearing_factor(net).squares(x) <= outlier_limit(net, gate))


def outlier_limit(net: BearingNetwork, gate: float) -> float:
    """The squared whitened residual of a sighting that is as unlikely as `gate` standard deviations."""
    return gate**2 if net.dim == 2 else chi2_quantile(_two_sided(gate), 2.0)


def without_heading(net: BearingNetwork, used: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """(m,) sightings by robots none of whose sightings was of use at the start (their heading is unknown)."""
    if net.axis:
        return np.zeros(len(used), dtype=bool)
    heard = np.zeros(len(net), dtype=bool)
    heard[net.observer[used]] = True
    return np.asarray(~heard[net.observer])


def prepare_at(net: BearingNetwork, x: Float[np.ndarray, " s"], start: SwarmStart) -> SwarmStart:
    """A start for other sightings of the same robots, at positions already found."""
    moved = _moved(net, start, x)
    return prepare(net, moved.position, moved.heading)


def _two_sided(gate: float) -> float:
    """The probability that a normal variable misses by less than `gate` standard deviations."""
    return erf(gate / sqrt(2.0))


def _moved(net: BearingNetwork, start: SwarmStart, x: np.ndarray) -> SwarmStart:
    position, heading = factors.parted(net, x)
    return replace(start, position=position, heading=heading)
