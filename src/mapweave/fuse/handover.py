"""A robot hands its submap over: constrained fusion into the global map, after which the submap starts empty.

It replaces [Yuan09]'s eq. 14, which covers neither new landmarks, nor the next frame, nor the rest of the submap:
the joint state of map and submap is conditioned on "a landmark both know is one point", then mapped forward whole.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from ..core import se2
from ..core.gaussian import symmetrise
from ..maps.global_map import GlobalMap
from ..maps.submap import Submap

ITERATIONS = 10  # at most; with little noise two suffice
SETTLED = 1e-6  # [m], [rad]
GATE = 18.42  # D^2, 0.9999 of chi-square with 2 degrees of freedom


@dataclass(frozen=True, slots=True)
class Handover:
    """The global map afterwards; what each submap landmark is called there; (kept, dropped) of duplicates merged."""

    map: GlobalMap
    names: tuple[str, ...]
    matched: tuple[bool, ...]
    merged: tuple[tuple[str, str], ...] = ()


def hand_over(G: GlobalMap, L: Submap, *, known: bool, gate: float = GATE, prefix: str = "") -> Handover:
    """`G` with all that `L` knows: matched landmarks fused, the others added, the robot's frame moved to its pose.

    With `known` identities equal ids are one landmark; otherwise the best pair inside `gate` is fused first, one to
    one, distances computed anew after each, and near duplicates in the map are merged at the end. Unknown landmarks
    are named `prefix` and a number. Other robots' submaps are not touched: they are independent of `L`.
    """
    n_g = len(G.cov)
    mu = _Joint(G, L)
    pairs: dict[int, int] = {}
    if known:
        where = {name: k for k, name in enumerate(G.ids)}
        pairs = {i: where[name] for i, name in enumerate(L.ids) if name in where}
        if pairs:
            mu.constrain(list(pairs.items()))
    else:
        while True:
            best = mu.best_pair(pairs, gate)
            if best is None:
                break
            mu.constrain([best])
            pairs[best[0]] = best[1]
    out, names = _forward(G, L, mu, pairs, n_g, known=known, prefix=prefix)
    merged: tuple[tuple[str, str], ...] = ()
    if not known:
        out, merged = merge_duplicates(out, gate)
        renamed = {gone: kept for kept, gone in merged}
        names = tuple(_follow(name, renamed) for name in names)
    return Handover(out, names, tuple(i in pairs for i in range(len(L.ids))), merged)


class _Joint:
    """`Y = [G; L]` with `P = blkdiag(P_G, P_L)`, being conditioned."""

    def __init__(self, G: GlobalMap, L: Submap) -> None:
        self.frames, self.marks = G.frames.copy(), G.mean.copy()
        self.pose, self.points = L.pose.copy(), L.mean.copy()
        n = len(G.cov)
        self.P = np.zeros((n + len(L.cov), n + len(L.cov)))
        self.P[:n, :n], self.P[n:, n:] = G.cov, L.cov
        self.j = G.robots.index(L.robot)
        self.f0, self.m0, self.r0, self.l0 = 3 * self.j, 3 * len(G.robots), n, n + 3
        self.angles = np.array([*range(2, self.m0, 3), n + 2])

    def residuals(self, pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
        """`h = l_i - T^-1(XL_j, m_g)` stacked (2k,) and its Jacobian (2k, size)."""
        g = self.frames[self.j]
        c, s = np.cos(g[2]), np.sin(g[2])
        C = np.array([[c, s], [-s, c]])
        H = np.zeros((2 * len(pairs), len(self.P)))
        h = np.zeros(2 * len(pairs))
        for k, (i, m) in enumerate(pairs):
            d = self.marks[m] - g[:2]
            local = C @ d
            row = slice(2 * k, 2 * k + 2)
            h[row] = self.points[i] - local
            H[row, self.f0 : self.f0 + 2] = C
            H[row, self.f0 + 2] = (s * d[0] - c * d[1], c * d[0] + s * d[1])
            H[row, self.m0 + 2 * m : self.m0 + 2 * m + 2] = -C
            H[row, self.l0 + 2 * i : self.l0 + 2 * i + 2] = np.eye(2)
        return h, H

    def constrain(self, pairs: list[tuple[int, int]]) -> None:
        """One update of all of Y with `h = 0`, without noise, linearised anew where it ends up until it stays there.

        Only the columns `h` depends on are multiplied, so the cost is one pass over P whatever the number of rounds.
        """
        start = self._vector()
        for _ in range(ITERATIONS):
            h, H = self.residuals(pairs)
            moved = self._vector() - start
            moved[self.angles] = se2.wrap_angle(moved[self.angles])
            used = np.flatnonzero(H.any(axis=0))
            PH = self.P[:, used] @ H[:, used].T
            S = symmetrise(H[:, used] @ PH[used])
            w, V = np.linalg.eigh(S + 1e-12 * np.trace(S) / len(S) * np.eye(len(S)))
            W = PH @ (V / np.sqrt(np.maximum(w, 1e-300)))
            dx = -W @ ((V / np.sqrt(np.maximum(w, 1e-300))).T @ (h - H @ moved))
            self._set(start + dx)
            if np.abs(dx - moved).max() < SETTLED:
                break
        self.P -= W @ W.T

    def _vector(self) -> np.ndarray:
        return np.concatenate([self.frames.ravel(), self.marks.ravel(), self.pose, self.points.ravel()])

    def _set(self, x: np.ndarray) -> None:
        x[self.angles] = se2.wrap_angle(x[self.angles])
        self.frames = x[: self.m0].reshape(-1, 3)
        self.marks = x[self.m0 : self.r0].reshape(-1, 2)
        self.pose = x[self.r0 : self.l0]
        self.points = x[self.l0 :].reshape(-1, 2)

    def best_pair(self, taken: dict[int, int], gate: float) -> tuple[int, int] | None:
        """The pair of least D^2 below `gate` among landmarks of neither side used yet."""
        free_l = [i for i in range(len(self.points)) if i not in taken]
        used = set(taken.values())
        free_g = [m for m in range(len(self.marks)) if m not in used]
        if not free_l or not free_g:
            return None
        pairs = [(i, m) for i in free_l for m in free_g]
        h, H = self.residuals(pairs)
        E = h.reshape(-1, 2)
        near = np.hypot(E[:, 0], E[:, 1])
        order = np.argsort(near)[: min(len(pairs), 4 * len(free_l) + 8)]
        best, least = None, gate
        for k in order:
            Hk = H[2 * k : 2 * k + 2]
            D2 = float(E[k] @ np.linalg.solve(Hk @ self.P @ Hk.T + 1e-12 * np.eye(2), E[k]))
            if least > D2:
                best, least = pairs[int(k)], D2
        return best


def _forward(
    G: GlobalMap, L: Submap, mu: _Joint, pairs: dict[int, int], n_g: int, *, known: bool, prefix: str
) -> tuple[GlobalMap, tuple[str, ...]]:
    """`XL_j <- XL_j (+) r_j`, unmatched landmarks `XL_j,old (+) l_i`: one Jacobian over all of Y."""
    old = mu.frames[mu.j].copy()
    new = [i for i in range(len(L.ids)) if i not in pairs]
    rows = np.zeros((3 + 2 * len(new), 6 + 2 * len(new)))  # of the Jacobian, where it is not the identity
    rows[:3, :3], rows[:3, 3:6] = se2.compose_jacobians(old, mu.pose)
    C = se2.rotation(float(old[2]))
    for k, i in enumerate(new):
        row = slice(3 + 2 * k, 5 + 2 * k)
        x, y = mu.points[i]
        rows[row, :2] = np.eye(2)
        rows[row, 2] = C @ np.array([-y, x])
        rows[row, 6 + 2 * k : 8 + 2 * k] = C
    columns = np.concatenate(
        [
            mu.f0 + np.arange(3),
            mu.r0 + np.arange(3),
            *(mu.l0 + 2 * i + np.arange(2) for i in new),
        ]
    )
    P = np.empty((n_g + 2 * len(new),) * 2)
    P[:n_g, :n_g] = mu.P[:n_g, :n_g]
    changed = np.concatenate([mu.f0 + np.arange(3), n_g + np.arange(2 * len(new))])
    cross = rows @ mu.P[columns, :n_g]
    P[changed, :n_g] = cross
    P[:n_g, changed] = cross.T
    P[np.ix_(changed, changed)] = symmetrise(rows @ mu.P[np.ix_(columns, columns)] @ rows.T)
    frames = mu.frames.copy()
    frames[mu.j] = se2.compose(old, mu.pose)
    taken = set(G.ids)
    names: list[str] = []
    for i, name in enumerate(L.ids):
        label = G.ids[pairs[i]] if i in pairs else name if known else _unused(prefix, taken)
        taken.add(label)
        names.append(label)
    mean = np.vstack([mu.marks, se2.act(old, mu.points[new])]) if new else mu.marks
    ids = (*G.ids, *(names[i] for i in new))
    return GlobalMap(G.robots, frames, ids, mean, P), tuple(names)


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
        a, b = pair
        k = 3 * len(G.robots)
        H = np.zeros((2, len(G.cov)))
        H[:, k + 2 * a : k + 2 * a + 2] = np.eye(2)
        H[:, k + 2 * b : k + 2 * b + 2] = -np.eye(2)
        PH = G.cov @ H.T
        K = np.linalg.solve(symmetrise(H @ PH) + 1e-12 * np.eye(2), PH.T).T
        dx = K @ (G.mean[b] - G.mean[a])
        A = np.eye(len(G.cov)) - K @ H
        P = symmetrise(A @ G.cov @ A.T)
        frames = G.frames + dx[:k].reshape(-1, 3)
        frames[:, 2] = se2.wrap_angle(frames[:, 2])
        mean = G.mean + dx[k:].reshape(-1, 2)
        merged.append((G.ids[a], G.ids[b]))
        keep = np.array([i for i in range(len(G.ids)) if i != b], dtype=np.intp)
        rows = np.concatenate([np.arange(k), (k + 2 * keep[:, None] + np.arange(2)).ravel()])
        G = replace(G, frames=frames, ids=tuple(G.ids[i] for i in keep), mean=mean[keep], cov=P[np.ix_(rows, rows)])


def _nearest_duplicate(G: GlobalMap, gate: float, reach: float) -> tuple[int, int] | None:
    if len(G.ids) < 2:
        return None
    k = 3 * len(G.robots)
    best, least = None, gate
    for a, b in cKDTree(G.mean).query_pairs(reach):
        e = G.mean[a] - G.mean[b]
        i, j = slice(k + 2 * a, k + 2 * a + 2), slice(k + 2 * b, k + 2 * b + 2)
        S = G.cov[i, i] + G.cov[j, j] - G.cov[i, j] - G.cov[j, i]
        D2 = float(e @ np.linalg.solve(S + 1e-12 * np.eye(2), e))
        if least > D2:
            best, least = (min(a, b), max(a, b)), D2
    return best


def _unused(prefix: str, taken: set[str]) -> str:
    k = len(taken)
    while f"{prefix}{k}" in taken:
        k += 1
    return f"{prefix}{k}"


def _follow(name: str, renamed: dict[str, str]) -> str:
    while name in renamed:
        name = renamed[name]
    return name


def pose_in_map(G: GlobalMap, L: Submap) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """`T_map_robot` and its covariance: frame and submap are independent."""
    k = 3 * G.robots.index(L.robot)
    frame = G.frames[G.robots.index(L.robot)]
    A, B = se2.compose_jacobians(frame, L.pose)
    return se2.compose(frame, L.pose), symmetrise(A @ G.cov[k : k + 3, k : k + 3] @ A.T + B @ L.cov[:3, :3] @ B.T)
