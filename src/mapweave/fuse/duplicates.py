"""Landmarks of a map that cannot be told apart become one."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial import cKDTree

from ..core import se2
from ..core.arrays import owned
from ..core.gaussian import symmetrise
from ..maps.global_map import GlobalMap
from .joint import FLOOR, lessened

GATE = 18.42  # D^2, 0.9999 of chi-square with 2 degrees of freedom


def merge_duplicates(
    G: GlobalMap, gate: float = GATE, reach: float = 3.0
) -> tuple[GlobalMap, tuple[tuple[str, str], ...]]:
    """`G` with landmarks that cannot be told apart fused: D^2 below `gate` and nearer than `reach` [m].

    The older name stays; the pairs come back as (kept, gone).
    """
    merged: list[tuple[str, str]] = []
    while True:
        pair = _nearest_duplicate(G, gate, reach)
        if pair is None:
            return G, tuple(merged)
        merged.append((G.ids[pair[0]], G.ids[pair[1]]))
        G = _merge(G, *pair)


def _merge(G: GlobalMap, a: int, b: int) -> GlobalMap:
    """`G` conditioned on landmarks a and b being one point, and without b."""
    k = 3 * len(G.robots)
    i, j = k + 2 * a, k + 2 * b
    HP = G.cov[i : i + 2] - G.cov[j : j + 2]
    L = np.linalg.cholesky(symmetrise(HP[:, i : i + 2] - HP[:, j : j + 2]) + FLOOR * np.eye(2))
    U = solve_triangular(L, HP, lower=True, check_finite=False)
    dx = U.T @ solve_triangular(L, G.mean[b] - G.mean[a], lower=True, check_finite=False)
    frames = G.frames + dx[:k].reshape(-1, 3)
    frames[:, 2] = se2.wrap_angle(frames[:, 2])
    mean = np.delete(G.mean + dx[k:].reshape(-1, 2), b, axis=0)
    P = np.delete(np.delete(lessened(G.cov, U), [j, j + 1], axis=0), [j, j + 1], axis=1)
    return GlobalMap(G.robots, frames, G.ids[:b] + G.ids[b + 1 :], mean, owned(P))


def _nearest_duplicate(G: GlobalMap, gate: float, reach: float) -> tuple[int, int] | None:
    if len(G.ids) < 2:
        return None
    k = 3 * len(G.robots)
    best, least = None, gate
    for a, b in cKDTree(G.mean).query_pairs(reach):
        e = G.mean[a] - G.mean[b]
        i, j = slice(k + 2 * a, k + 2 * a + 2), slice(k + 2 * b, k + 2 * b + 2)
        S = G.cov[i, i] + G.cov[j, j] - G.cov[i, j] - G.cov[j, i]
        D2 = float(e @ np.linalg.solve(S + FLOOR * np.eye(2), e))
        if least > D2:
            best, least = (min(a, b), max(a, b)), D2
    return best
