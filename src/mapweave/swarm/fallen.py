"""Sightings that agree only because robots fell in with them: each is left out in turn, and the others are asked.

A wrong sighting between neighbours is escaped by shrinking the distance between them: across a short distance any
direction fits, and its residual is small. Without it the two stand where their other sightings put them. Where these
then fit better by more than a sighting called wrong costs, and the one left out misses, it was wrong; where they fit
better by less, but by so much that it is wrong with a probability worth telling, neither story may be trusted.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..solve import SingularError
from . import bearing, factors
from .batch import refine
from .close_pairs import CLOSE
from .config import FallenConfig, SwarmConfig
from .network import BearingNetwork
from .result import SwarmEstimate
from .start import prepare


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
    least = detection_threshold(net, inlier, cfg.fallen.likely)
    for row in _promising(net, inlier, found, limit, cfg.fallen):
        gain, miss = _left_out(net, inlier, found.position, row, cfg)
        if miss > limit and gain > min(limit, least[row]):
            (wrong if gain > limit else undecided).append(row)
    for row in _near_misses(net, inlier, found, limit * cfg.fallen.near_miss):
        gain, others = _taken_in(net, inlier, found.position, row, limit, cfg)
        if gain > 0.0:
            wrong += others
        elif gain > -cfg.fallen.undecided * limit:
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


def unchecked(
    net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, cfg: FallenConfig
) -> Bool[np.ndarray, " m"]:
    """(m,) of the sightings `inlier`, those of hardly known length that no other checks: wrong or not, they fit."""
    rows = _doubtful(net, inlier, found)
    out = np.zeros(len(inlier), dtype=bool)
    if len(rows):
        out[rows] = _told(net, rows, found)[1] > cfg.unchecked
    return out


def _promising(
    net: BearingNetwork, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, limit: float, cfg: FallenConfig
) -> list[int]:
    """Unconfirmed sightings whose removal the linear model rewards, the best first; in large networks short ones."""
    rows = _doubtful(net, inlier, found, anywhere=len(inlier) <= cfg.few)
    if not len(rows):
        return []
    squares, told = _told(net, rows, found)
    promise = squares / np.maximum(1.0 - told, 1e-6)
    order = np.argsort(-promise, kind="stable")
    return [int(rows[k]) for k in order if promise[k] > cfg.promise * limit]


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
    part = _part(net, kept, position, row, cfg.fallen.hops)
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
    let_go = _against(net, kept, row, cfg.fallen.against)
    kept[row], kept[let_go] = True, False
    for _ in range(cfg.fallen.swaps + 1):
        part = _part(net, kept, position, row, cfg.fallen.hops)
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
