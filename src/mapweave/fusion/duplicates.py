"""Landmarks of a map that cannot be told apart become one."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial import cKDTree

from ..core import se2
from ..core.gaussian import symmetrise
from ..core.records import owned
from ..landmarks.global_map import GlobalMap
from ..landmarks.pairing import pairing_probabilities
from .map_and_submap import CANDIDATES, FLOOR, lessened

SURE = 0.9  # probability above which two landmarks count as one
DENSITY = 4e-4  # [1/m^2] landmarks expected, times the chance that one beside a new one went unseen
GATE = 18.42  # D^2, 0.9999 of chi-square with 2 degrees of freedom


def merge_duplicates(
    G: GlobalMap, gate: float = GATE, reach: float = 3.0, density: float = DENSITY, sure: float = SURE
) -> tuple[GlobalMap, tuple[tuple[str, str], ...]]:
    """`G` with landmarks fused that are surely one: D^2 below `gate`, nearer than `reach` [m], never told apart.

    sure, density: see `pairing_probabilities`. The older name stays; the pairs come back as (kept, gone).
    """
    state = _Merging(G)
    merged: list[tuple[str, str]] = []
    while (pair := state.surest(gate, reach, density, sure)) is not None:
        state.merge(*pair)
        merged.append((G.ids[pair[0]], G.ids[pair[1]]))
    return (state.map() if merged else G), tuple(merged)


def told(a: str, b: str) -> tuple[str, str]:
    """The two ids as `GlobalMap.apart` holds them."""
    return (a, b) if a < b else (b, a)


class _Merging:
    """A map being conditioned on landmarks being one: mean `x`, covariance `P - U^T U`, the landmarks in `keep`."""

    def __init__(self, G: GlobalMap) -> None:
        self.G, self.P, self.first = G, G.cov, 3 * len(G.robots)
        self.x = np.concatenate([G.frames.ravel(), G.mean.ravel()])
        self.U = np.zeros((0, len(self.x)))
        self.keep = np.arange(len(G.ids))
        self.apart = G.apart

    def surest(self, gate: float, reach: float, density: float, sure: float) -> tuple[int, int] | None:
        """The pair most probably one landmark, if that is more probable than `sure`, the older landmark first."""
        marks, ids = self.x[self.first :].reshape(-1, 2), self.G.ids
        if len(self.keep) < 2:
            return None
        near = [(int(self.keep[min(k)]), int(self.keep[max(k)])) for k in cKDTree(marks[self.keep]).query_pairs(reach)]
        pairs = [(a, b) for a, b in sorted(near) if told(ids[a], ids[b]) not in self.apart]
        D2 = [float((e := marks[a] - marks[b]) @ np.linalg.solve(self._spread(a, b), e)) for a, b in pairs]
        pairs = [pairs[k] for k in np.argsort(D2, kind="stable")[:CANDIDATES] if gate > D2[k]]
        if not pairs:
            return None
        a, b = np.array(pairs, dtype=np.intp).T
        i, j = ((self.first + 2 * k[:, None] + np.arange(2)).ravel() for k in (a, b))
        HU = self.U[:, i] - self.U[:, j]
        HP = self.P[i] - self.P[j]
        p = pairing_probabilities(np.array(pairs), marks[a] - marks[b], HP[:, i] - HP[:, j] - HU.T @ HU, density)
        best = int(np.argmax(p))
        return pairs[best] if p[best] > sure else None

    def merge(self, a: int, b: int) -> None:
        """Conditions the map on landmarks a and b being one point, and drops b."""
        i, j = self.first + 2 * a, self.first + 2 * b
        HU = self.U[:, i : i + 2] - self.U[:, j : j + 2]
        HP = self.P[i : i + 2] - self.P[j : j + 2] - HU.T @ self.U
        L = np.linalg.cholesky(self._spread(a, b))
        U = solve_triangular(L, HP, lower=True, check_finite=False)
        self.x += solve_triangular(L, self.x[j : j + 2] - self.x[i : i + 2], lower=True, check_finite=False) @ U
        self.x[2 : self.first : 3] = se2.wrap_angle(self.x[2 : self.first : 3])
        self.U = np.vstack([self.U, U])
        self.keep = self.keep[self.keep != b]
        kept, gone = self.G.ids[a], self.G.ids[b]
        self.apart = frozenset(told(*(kept if name == gone else name for name in pair)) for pair in self.apart)

    def _spread(self, a: int, b: int) -> np.ndarray:
        """The covariance of the difference of two landmarks, never singular."""
        i, j = (slice(self.first + 2 * k, self.first + 2 * k + 2) for k in (a, b))
        HU = self.U[:, i] - self.U[:, j]
        S = self.P[i, i] + self.P[j, j] - self.P[i, j] - self.P[j, i] - HU.T @ HU
        return np.asarray(symmetrise(S) + FLOOR * np.eye(2))

    def map(self) -> GlobalMap:
        """The map of the landmarks kept."""
        rows = np.append(np.arange(self.first), (self.first + 2 * self.keep[:, None] + np.arange(2)).ravel())
        P = lessened(self.P, self.U)[np.ix_(rows, rows)]
        frames, mean = self.x[: self.first].reshape(-1, 3), self.x[self.first :].reshape(-1, 2)[self.keep]
        return GlobalMap(self.G.robots, frames, tuple(self.G.ids[k] for k in self.keep), mean, owned(P), self.apart)
