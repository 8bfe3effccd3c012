"""Sightings that agree only because the two robots fell together: each is left out in turn, and the others are asked.

A wrong sighting between neighbours is escaped by shrinking the distance between them: across a short distance any
direction fits, and its residual is small. Without it the two stand where their other sightings put them. Where these
then fit better by more than a sighting called wrong costs, and the one left out misses, it was wrong; where they fit
better by half of that, both stories are as likely and neither may be trusted.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from . import bearing, factors
from .batch import refine
from .close_pairs import CLOSE
from .config import SwarmConfig
from .network import Network
from .result import SwarmEstimate
from .start import prepare

HOPS = 3  # sightings away from the two, beyond which robots are held while one sighting is left out
PROMISE = 0.4  # of the limit: what the linear model must promise for a sighting to be left out at all
UNDECIDED = 0.5  # of the limit: a gain from which on a sighting may as well be wrong


@dataclass(frozen=True, slots=True)
class Fallen:
    """Indices of sightings that are wrong, and of those that may as well be."""

    wrong: Int[np.ndarray, " w"]
    undecided: Int[np.ndarray, " d"]


def fallen_together(
    net: Network, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, limit: float, cfg: SwarmConfig
) -> Fallen:
    """Of the sightings `inlier` that `found` was made of, those beyond `limit` (squared, whitened) once left out.

    Sightings confirmed by one the other way are not doubted. Common axes are assumed, and covariances.
    """
    wrong: list[int] = []
    undecided: list[int] = []
    for row in _promising(net, inlier, found, limit):
        gain, miss = _left_out(net, inlier, found.position, row, cfg)
        if miss > limit and gain > UNDECIDED * limit:
            (wrong if gain > limit else undecided).append(row)
    return Fallen(np.array(wrong, dtype=np.intp), np.array(undecided, dtype=np.intp))


def _promising(net: Network, inlier: Bool[np.ndarray, " m"], found: SwarmEstimate, limit: float) -> list[int]:
    """Unconfirmed sightings of hardly known length whose removal the linear model rewards, the best first."""
    if found.cov is None or found.information is None or not np.any(net.sigma > 0):
        return []
    p = found.position
    _, r = bearing.predict(p[net.observer], p[net.target])
    deviation = np.sqrt(np.nan_to_num(np.trace(found.cov, axis1=1, axis2=2)))
    rows = np.flatnonzero(
        inlier
        & ~_confirmed(net, inlier)
        & found.localisable[net.observer]
        & found.localisable[net.target]
        & (r < CLOSE * (deviation[net.observer] + deviation[net.target]))
    )
    if not len(rows):
        return []
    factor = factors.bearing_factor(net.select(rows))
    whitened = factor.whitened(p.ravel())
    white = np.ones((1, factor.rows)) if factor.sqrt_info is None else factor.sqrt_info
    J = white[..., None] * factor.jacobian(p.ravel())
    E = np.zeros((p.size, len(rows) * factor.rows))
    columns = np.arange(E.shape[1]).reshape(len(rows), factor.rows)
    np.add.at(E, (factor.columns[:, None, :], columns[:, :, None]), J)
    told = found.information.variances(E)[columns].max(axis=1)
    promise = np.square(whitened).sum(axis=1) / np.maximum(1.0 - told, 1e-6)
    order = np.argsort(-promise, kind="stable")
    return [int(k) for k in rows[order] if promise[np.searchsorted(rows, k)] > PROMISE * limit]


def _confirmed(net: Network, inlier: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """(m,) sightings of pairs that other inliers, either way, are of too."""
    n = len(net)
    low, high = np.minimum(net.observer, net.target), np.maximum(net.observer, net.target)
    _, which, count = np.unique(np.where(inlier, low * n + high, -1), return_inverse=True, return_counts=True)
    return np.asarray(count[which.ravel()] > 1)


def _left_out(
    net: Network, inlier: Bool[np.ndarray, " m"], position: Float[np.ndarray, "n d"], row: int, cfg: SwarmConfig
) -> tuple[float, float]:
    """What the chi-square of the other inliers near by loses without sighting `row`, and its own squared residual."""
    kept = inlier.copy()
    kept[row] = False
    near = np.zeros(len(net), dtype=bool)
    near[[net.observer[row], net.target[row]]] = True
    for _ in range(HOPS):
        touched = kept & (near[net.observer] | near[net.target])
        near[net.observer[touched]] = near[net.target[touched]] = True
    inside = np.flatnonzero(kept & near[net.observer] & near[net.target])
    used = np.unique(np.concatenate([net.observer[inside], net.target[inside]]))
    core = np.zeros(len(net), dtype=bool)
    core[[net.observer[row], net.target[row]]] = True
    for _ in range(HOPS - 1):
        touched = kept & (core[net.observer] | core[net.target])
        core[net.observer[touched]] = core[net.target[touched]] = True
    at = np.full(len(net), -1)
    at[used] = np.arange(len(used))
    if (at[[net.observer[row], net.target[row]]] < 0).any():
        return 0.0, 0.0  # nothing else sights one of them
    anchors = {int(at[k]): position[k] for k in used if not core[k] or k in net.anchors}
    part = replace(
        net.select(inside),
        ids=tuple(net.ids[k] for k in used),
        observer=at[net.observer[inside]],
        target=at[net.target[inside]],
        anchors=anchors,
        distances=(),
    )
    before = position[used].ravel()
    solution, _, _ = refine(part, prepare(part, position[used]), cfg, everyone=True)
    factor = factors.bearing_factor(part)
    gain = float(factor.squares(before).sum() - factor.squares(solution.x).sum())
    alone = replace(
        net.select(np.array([row])),
        ids=part.ids,
        observer=at[net.observer[[row]]],
        target=at[net.target[[row]]],
        anchors={},
        distances=(),
    )
    return gain, float(factors.bearing_factor(alone).squares(solution.x)[0])
