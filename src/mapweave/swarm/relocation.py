"""Robots that fell in with wrong sightings, put where most of their sightings meet.

A descent from outside leaves a robot where it started when a few wrong sightings hold it there: the kernel's cost has a
minimum at each place where two of its rays cross. Against neighbours held in place all these crossings can be tried.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from .config import ROBUST, RobustConfig
from .factors import bearing_factor
from .network import BearingNetwork


def relocated(
    net: BearingNetwork, position: Float[np.ndarray, "n d"], limit: float, cfg: RobustConfig = ROBUST
) -> Float[np.ndarray, "n d"]:
    """`position`, robots with many sightings beyond `limit` (squared, whitened) put where fewer are.

    Each is moved to the crossing of two of its rays with the least sum of squared residuals cut off at `limit`, if that
    is less than where it stands. Robots of which few sightings disagree, and anchors, stay. Common axes are assumed.
    """
    p = np.array(position, dtype=float)
    order = np.argsort(np.concatenate([net.observer, net.target]), kind="stable")
    ends = np.searchsorted(np.concatenate([net.observer, net.target])[order], np.arange(len(net) + 1))
    factor = bearing_factor(net)
    for _ in range(cfg.relocations):
        wrong = factor.squares(p.ravel()) > limit
        share = _share(net, wrong)
        suspects = np.flatnonzero((share > cfg.suspect) & ~net.is_anchor)
        moved = False
        for k in suspects[np.argsort(-share[suspects], kind="stable")].tolist():
            rows = order[ends[k] : ends[k + 1]] % len(net.observer)
            better = _best_crossing(net, p, k, rows[: cfg.crossings_of], limit)
            if better is not None:
                p[k], moved = better, True
        if not moved:
            break
    return p


def unsupported(net: BearingNetwork, outlier: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " k"]:
    """Robots with sightings called wrong whose other sightings do not outnumber them, or only just give a position.

    What was called wrong there could as well be right: nothing is left over that tells.
    """
    both = np.concatenate([net.observer, net.target])
    wrong = np.bincount(both[np.concatenate([outlier, outlier])], minlength=len(net))
    right = np.bincount(both, minlength=len(net)) - wrong
    unknown = net.dim + (0 if net.axis else 1)
    few = (right <= wrong) | ((net.dim - 1) * right <= unknown)
    return np.flatnonzero((wrong > 0) & few & ~net.is_anchor)


def _share(net: BearingNetwork, wrong: Bool[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
    """By robot, the share of its sightings that are `wrong`."""
    both = np.concatenate([net.observer, net.target])
    count = np.bincount(both, minlength=len(net))
    return np.asarray(np.bincount(both[np.concatenate([wrong, wrong])], minlength=len(net)) / np.maximum(count, 1))


def _best_crossing(
    net: BearingNetwork, p: Float[np.ndarray, "n d"], k: int, rows: Int[np.ndarray, " r"], limit: float
) -> Float[np.ndarray, " d"] | None:
    """The crossing of two rays of robot k at which its sightings `rows` cost least; None where none beats its place."""
    other = np.where(net.observer[rows] == k, net.target[rows], net.observer[rows])
    u = net.direction[rows]
    across = np.eye(net.dim) - u[:, :, None] * u[:, None, :]
    pulled = np.einsum("rab,rb->ra", across, p[other])
    i, j = np.triu_indices(len(rows), 1)
    A = across[i] + across[j]
    crossing = np.linalg.det(A) > 1e-4  # of rays that are not parallel
    i, j, A = i[crossing], j[crossing], A[crossing]
    if not len(i):
        return None
    tried = np.linalg.solve(A, (pulled[i] + pulled[j])[..., None])[..., 0]
    costs = _costs(net, k, rows, p[other], np.vstack([p[k], tried]), limit)
    best = int(np.argmin(costs))
    return None if best == 0 or costs[best] > costs[0] - limit else tried[best - 1]


def _costs(
    net: BearingNetwork,
    k: int,
    rows: Int[np.ndarray, " r"],
    other: Float[np.ndarray, "r d"],
    places: Float[np.ndarray, "c d"],
    limit: float,
) -> Float[np.ndarray, " c"]:
    """The squared residuals of the sightings `rows`, each cut off at `limit`, with robot k at each of `places`."""
    away = np.where(net.observer[rows] == k, 1.0, -1.0)[:, None] * (other - places[:, None, :])
    seen = net.direction[rows]
    along = np.einsum("crd,rd->cr", away, seen)
    across = np.linalg.norm(away - along[..., None] * seen, axis=2)
    miss = np.arctan2(across, along) / net.sigma[rows]
    return np.asarray(np.minimum(miss * miss, limit).sum(axis=1))
