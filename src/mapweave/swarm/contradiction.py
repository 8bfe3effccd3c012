"""Sightings that cannot both be true, and sightings that share no axis."""

import numpy as np
from jaxtyping import Bool, Float

from ..core.bearings import BearingTable

GATE = 6.0 * np.sqrt(2.0)  # standard deviations between two sightings of the same pair
FEW = 5  # mutual pairs below which nothing is said about axes


def contradictions(table: BearingTable, sigma: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Which rows contradict another of the same observer, target and stamp.

    Of two that contradict, both; of three or more, those far from the median direction of all. sigma: (m,) [rad].
    """
    n = len(table.ids)
    key = table.observer * n + table.target
    stamp = np.zeros(len(key)) if table.t is None else table.t
    order = np.lexsort((stamp, key))
    same = (key[order][1:] == key[order][:-1]) & (stamp[order][1:] == stamp[order][:-1])
    bad = np.zeros(len(key), dtype=bool)
    if not same.any():
        return bad
    edges = np.flatnonzero(np.concatenate([[True], ~same, [True]]))
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if high - low < 2:
            continue
        rows = order[low:high]
        u = table.direction[rows]
        if high - low == 2:
            off = np.full(2, _angle(u[:1], u[1:])[0])
        else:
            middle = np.median(u, axis=0)
            off = _angle(u, middle[None, :])
        bad[rows] = off > GATE * sigma[rows]
        if high - low == 2:
            bad[rows] = bad[rows].any()
    return bad


def shares_an_axis(table: BearingTable, sigma: Float[np.ndarray, " m"]) -> bool:
    """False when mutual sightings plainly do not point at each other: every robot has axes of its own."""
    n = len(table.ids)
    forth, back = table.observer * n + table.target, table.target * n + table.observer
    _, a, b = np.intersect1d(forth, back, return_indices=True)
    mutual = table.observer[a] < table.target[a]
    a, b = a[mutual], b[mutual]
    if len(a) < FEW:
        return True
    off = _angle(table.direction[a], -table.direction[b])
    return bool(np.median(off) <= max(0.5, 20.0 * float(np.median(sigma))))


def _angle(a: Float[np.ndarray, "k d"], b: Float[np.ndarray, "l d"]) -> Float[np.ndarray, " k"]:
    """Angles [rad] between rows; b need not be of unit length."""
    dot = np.sum(a * b, axis=1)
    across = np.sqrt(np.maximum(np.sum(a * a, axis=1) * np.sum(b * b, axis=1) - dot * dot, 0.0))
    return np.asarray(np.arctan2(across, dot))
