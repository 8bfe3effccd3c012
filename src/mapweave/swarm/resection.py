"""Robots in space that share no axes and are seldom sighted: where they may stand, and what else fits as well.

One that nobody sees stands where it sees three others as they stand, which leaves up to four places and attitudes. From
each the whole swarm is refined anew; those whose chi-square is hardly larger are answers, too.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.attitude import Headings, headings, nearest
from .alternatives import Dense
from .config import SWARM_SELDOM
from .network import BearingNetwork
from .result import OtherAnswer, SwarmEstimate

Refined = Callable[[Float[np.ndarray, "n 3"], Headings], OtherAnswer]
STARTS = 32  # places from which one robot is resected
SPREAD = 1.5  # standard deviation of those, of the deviation of what it sees
RESECTING = 80  # steps of Levenberg-Marquardt from each
ONE_PLACE = 1e-3  # of that deviation, or of a usual sighting, below which two places are one
UNLIKELY = 9.2  # chi-square above the best one's from which on an answer is none: a likelihood a hundred times less
LEAST_SEEN = 3  # others that a robot sees if it is to be resected where nobody sees it
LEAST_MADE = 2  # sightings of its own that turn it


def poses(
    net: BearingNetwork, k: int, position: Float[np.ndarray, "n 3"], heading: Headings, rows: Int[np.ndarray, " r"]
) -> tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"], Float[np.ndarray, " c"]]:
    """Places of robot k, how it is turned there, and chi-squares: where its sightings `rows` fit best, and as well.

    All others stand, turned, as given. The best comes first; with exactly three sightings there are up to four.
    """
    i, j = net.observer[rows], net.target[rows]
    robots, where = np.unique(np.concatenate([[k], i, j]), return_inverse=True)
    at = int(where[0])
    i, j = np.split(where[1:], 2)
    others = {int(a): position[b] for a, b in enumerate(robots.tolist()) if b != k}
    near = replace(
        net.select(rows), ids=tuple(map(str, robots.tolist())), observer=i, target=j, anchors=others, distances=()
    )
    q = np.array(list(others.values()))
    middle, spread = q.mean(axis=0), max(float(q.std(axis=0).max()), 1e-9)
    start = np.repeat(np.column_stack([position[robots], heading[robots]])[None], STARTS, axis=0)
    start[:, at, :3] = middle + SPREAD * spread * np.random.default_rng(0).normal(size=(STARTS, 3))
    own = i == at
    u = position[robots[j[own]]] - start[:, at, None, :3]
    u /= np.maximum(np.linalg.norm(u, axis=2, keepdims=True), 1e-12)
    start[:, at, 3:] = headings(nearest(np.einsum("srk,rl->skl", u, near.direction[own])))
    free = 6 * at + np.arange(6)
    dense = Dense(near, start[0].ravel(), free, 1e3 * spread)
    x, chi2, _ = dense.descended(start.reshape(STARTS, -1), np.ones((STARTS, len(rows))), RESECTING)
    x = x.reshape(STARTS, -1, 6)[:, at]
    kept: list[int] = []
    for s in np.argsort(chi2, kind="stable").tolist():
        apart = [np.linalg.norm(x[s, :3] - x[c, :3]) > ONE_PLACE * spread for c in kept]
        if chi2[s] <= chi2.min() + UNLIKELY and all(apart):
            kept.append(s)
    return x[kept, :3], x[kept, 3:], chi2[kept]


def resected(
    net: BearingNetwork,
    position: Float[np.ndarray, "n 3"],
    placed: Bool[np.ndarray, " n"],
    heading: Headings,
    known: Bool[np.ndarray, " n"],
) -> tuple[Headings, Bool[np.ndarray, " n"]]:
    """Headings also of robots that are not `placed` and see three of those that are, of the `poses` that fit best."""
    rows = np.flatnonzero(placed[net.target] & ~placed[net.observer] & ~known[net.observer])
    pairs = np.unique(net.observer[rows] * len(net) + net.target[rows])
    fresh = np.bincount(pairs // len(net), minlength=len(net)) >= LEAST_SEEN
    out = np.array(heading)
    for k in np.flatnonzero(fresh).tolist():
        out[k] = poses(net, k, position, heading, rows[net.observer[rows] == k])[1][0]
    return out, known | fresh


def other_answers(net: BearingNetwork, estimate: SwarmEstimate, refined: Refined) -> tuple[OtherAnswer, ...]:
    """The answers that fit about as well as `estimate`, the best first: one robot that is seldom sighted elsewhere.

    refined: positions, headings and chi-square of the minimum near others. None where an axis is common.
    """
    if net.axis or net.dim == 2 or estimate.heading is None or not np.any(net.sigma > 0):
        return ()
    p, inside = estimate.position, estimate.localisable
    told = inside[net.observer] & inside[net.target]
    degree = np.bincount(np.concatenate([net.observer[told], net.target[told]]), minlength=len(net))
    firm = estimate.anchor | (degree > SWARM_SELDOM)  # others may move with the robot that is asked
    span = float(np.median(np.linalg.norm(p[net.target] - p[net.observer], axis=1)))
    found: list[OtherAnswer] = []
    for k in np.flatnonzero(inside & ~estimate.anchor).tolist():
        rows = np.flatnonzero(
            told & (((net.observer == k) & firm[net.target]) | ((net.target == k) & firm[net.observer]))
        )
        own = np.count_nonzero(net.observer[rows] == k)
        if not LEAST_SEEN <= len(rows) <= SWARM_SELDOM or own < LEAST_MADE:
            continue
        for place, turn in zip(*poses(net, k, p, estimate.heading, rows)[:2], strict=True):
            if np.linalg.norm(place - p[k]) <= ONE_PLACE * span:
                continue
            there, turned = p.copy(), np.array(estimate.heading)
            there[k], turned[k] = place, turn
            other = refined(there, turned)
            known = [p, *(one.position for one in found)]
            apart = min(float(np.linalg.norm(other.position - q, axis=1).max()) for q in known)
            if other.chi2 <= estimate.chi2 + UNLIKELY and apart > ONE_PLACE * span:
                found.append(other)
    return tuple(sorted(found, key=lambda one: one.chi2))
