"""A robot hands its submap over: constrained fusion into the global map, after which the submap starts empty.

It replaces [Yuan09]'s eq. 14, which covers neither new landmarks, nor the next frame, nor the rest of the submap:
the joint state of map and submap is conditioned on "a landmark both know is one point", then mapped forward whole.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import blas, block_diag, solve_triangular
from scipy.spatial import cKDTree

from ..core import se2
from ..core.config import config
from ..core.gaussian import solve_psd, symmetrise
from ..core.names import unused
from ..core.records import owned
from ..kernels.dense import mirror
from ..landmarks.association import pairing_probabilities
from ..landmarks.landmark_map import GlobalMap, Submap

PAIRING_DENSITY = 4e-4  # [1/m^2] landmarks expected, times the chance that one beside a new one went unseen
PAIRING_CANDIDATES = 40  # pairs weighed together, the nearest
PAIRING_REACH = 3.0  # [m] apart up to which two landmarks of the map may turn out to be one
PAIRING_APART = 10.0  # [m] apart from which two landmarks of one submap are never asked about again

JOINING_SD = (30.0, 30.0, 3.0)  # [m], [rad] of how a map lies before its links are used: no word beside theirs
ITERATIONS = 10  # at most; with little noise two suffice
CONVERGED = 1e-6  # [m], [rad]
FLOOR = 1e-12  # what keeps a constraint on things already certain solvable: [m^2], and as a share

Pairs = list[tuple[int, int]]  # (landmark of the submap, landmark of the map)


@config
class PairingConfig:
    """When two landmarks of unknown identity are one."""

    gate: float = 18.42  # D^2 of two landmarks taken for one, 0.9999 of chi-square with 2 degrees of freedom
    sure: float = 0.9  # probability above which two landmarks become one


PAIRING = PairingConfig()


class MapAndSubmap:
    """`Y = [G; L]`, mean `x`, covariance `blkdiag(P_G, P_L) - U^T U`: each constraint adds rows to `U` (k, size).

    Constraints touch few variables, so only their rows of the covariance are ever worked out; the map's own, large,
    is passed over once, when all constraints are in, by `map_covariance`.
    """

    def __init__(self, G: GlobalMap, L: Submap) -> None:
        self.P_g, self.P_l = G.cov, L.cov
        self.x = np.concatenate([G.frames.ravel(), G.mean.ravel(), L.pose, L.mean.ravel()])
        n, robots = len(G.cov), len(G.robots)
        self.frame = 3 * G.robots.index(L.robot) + np.arange(3)
        self.pose = n + np.arange(3)
        self.frames = self.x[: 3 * robots].reshape(-1, 3)
        self.marks = self.x[3 * robots : n].reshape(-1, 2)
        self.points = self.x[n + 3 :].reshape(-1, 2)
        self.angles = np.append(np.arange(2, 3 * robots, 3), n + 2)
        self.U = np.zeros((0, len(self.x)))

    def mark(self, m: Int[np.ndarray, "*k"]) -> Int[np.ndarray, "*k 2"]:
        """Where landmarks of the map stand in `x`."""
        return self.frames.size + 2 * m[..., None] + np.arange(2)

    def point(self, i: Int[np.ndarray, "*k"]) -> Int[np.ndarray, "*k 2"]:
        """Where landmarks of the submap stand in `x`."""
        return len(self.P_g) + 3 + 2 * i[..., None] + np.arange(2)

    def rows(self, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k size"]:
        """These rows of the covariance: first those of the map, then those of the submap."""
        n = len(self.P_g)
        k = int((index < n).sum())
        out = np.zeros((len(index), len(self.x)))
        out[:k, :n] = self.P_g[index[:k]]
        out[k:, n:] = self.P_l[index[k:] - n]
        if len(self.U):
            out -= self.U[:, index].T @ self.U
        return out

    def local(self, m: Int[np.ndarray, " k"]) -> tuple[np.ndarray, np.ndarray]:
        """`T^-1(XL_j, m_g)` of landmarks of the map (k, 2), and its derivative by frame and landmark (k, 2, 5)."""
        x, y, theta = self.x[self.frame]
        c, s = np.cos(theta), np.sin(theta)
        C = np.array([[c, s], [-s, c]])
        local = (self.marks[m] - (x, y)) @ C.T
        J = np.empty((len(m), 2, 5))
        J[:, :, :2], J[:, :, 3:] = -C, C
        J[:, 0, 2], J[:, 1, 2] = local[:, 1], -local[:, 0]
        return local, J

    def residuals(self, pairs: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`h = l_i - T^-1(XL_j, m_g)` stacked (2k,), its Jacobian (2k, 3 + 4k), and the variables its columns are."""
        i, m = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        k, each = len(pairs), np.arange(len(pairs))
        local, J = self.local(m)
        H = np.zeros((k, 2, 3 + 4 * k))
        H[:, :, :3] = -J[:, :, :3]
        for a in range(2):
            H[each, :, 3 + 2 * each + a] = -J[:, :, 3 + a]
            H[each, a, 3 + 2 * k + 2 * each + a] = 1.0
        used = np.concatenate([self.frame, self.mark(m).ravel(), self.point(i).ravel()])
        return (self.points[i] - local).ravel(), H.reshape(2 * k, -1), used

    def constrain(self, pairs: Pairs) -> None:
        """One update of all of Y with `h = 0`, without noise, linearised anew where it ends up until it stays there.

        `h` depends on few variables, so a round costs one product of their rows with a vector.
        """
        used = self.residuals(pairs)[2]
        rows = self.rows(used)
        block = rows[:, used]
        start, shift = self.x.copy(), np.zeros(len(self.x))
        for _ in range(ITERATIONS):
            h, H, _ = self.residuals(pairs)
            S = symmetrise(H @ block @ H.T)
            S[np.diag_indices_from(S)] += FLOOR * np.trace(S) / len(S) + 1e-300
            last, shift = shift, -(solve_psd(S, h - H @ shift[used]) @ H) @ rows
            self.x[:] = start + shift
            self.x[self.angles] = se2.wrap_angle(self.x[self.angles])
            if np.abs(shift - last).max() < CONVERGED:
                break
        U = solve_triangular(np.linalg.cholesky(S), H, lower=True, check_finite=False) @ rows
        self.U = np.vstack([self.U, U])

    def sure_pairs(self, taken: dict[int, int], cfg: PairingConfig) -> tuple[Pairs, frozenset[int]]:
        """Pairs of landmarks of neither side used yet, each one landmark with a probability above `cfg.sure`.

        With them those of the submap that are surely among the map's landmarks, though there is no telling which.
        """
        free_l = np.setdiff1d(np.arange(len(self.points)), list(taken))
        free_g = np.setdiff1d(np.arange(len(self.marks)), list(taken.values()))
        if not len(free_l) or not len(free_g):
            return [], frozenset()
        away = np.linalg.norm(self.points[free_l][:, None] - self.local(free_g)[0], axis=2).ravel()
        order = np.argsort(away)[: 8 * len(free_l) + 32]
        i, m = free_l[order // len(free_g)], free_g[order % len(free_g)]
        D2 = self._distances(i, m)
        order = np.argsort(D2)[: min(int((cfg.gate > D2).sum()), PAIRING_CANDIDATES)]
        i, m = i[order], m[order]
        if not len(i):
            return [], frozenset()
        pairs = list(zip(i.tolist(), m.tolist(), strict=True))
        h, H, used = self.residuals(pairs)
        S = symmetrise(H @ self.rows(used)[:, used] @ H.T)
        p = pairing_probabilities(np.stack([i, len(self.points) + m], axis=1), h.reshape(-1, 2), S, PAIRING_DENSITY)
        old = np.bincount(i, weights=p, minlength=len(self.points))
        torn = frozenset(int(k) for k in np.unique(i) if old[k] > cfg.sure and p[i == k].max() <= cfg.sure)
        return [pair for pair, q in zip(pairs, p, strict=True) if q > cfg.sure], torn

    def _distances(self, i: Int[np.ndarray, " k"], m: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """D^2 of submap landmark i[k] and map landmark m[k] being one point."""
        local, J = self.local(m)
        g = np.concatenate([np.broadcast_to(self.frame, (len(m), 3)), self.mark(m)], axis=1)
        p = self.point(i)
        U = self.U[:, p] - np.einsum("rkv,kav->rka", self.U[:, g], J)
        q = p - len(self.P_g)
        S = self.P_l[q[:, :, None], q[:, None]] + J @ self.P_g[g[:, :, None], g[:, None]] @ np.swapaxes(J, 1, 2)
        S += FLOOR * np.eye(2) - np.einsum("rka,rkb->kab", U, U)
        e = self.points[i] - local
        return np.asarray(np.einsum("ka,ka->k", e, np.linalg.solve(S, e[:, :, None])[:, :, 0]))

    def map_covariance(self, new: int) -> Float[np.ndarray, "m m"]:
        """The map's covariance as it is now, with room, zeros, for `new` more variables."""
        n = len(self.P_g)
        return lessened(self.P_g, self.U[:, :n], new)


def lessened(P: Float[np.ndarray, "n n"], U: Float[np.ndarray, "k n"], new: int = 0) -> Float[np.ndarray, "m m"]:
    """`P - U^T U`, exactly symmetric, with `new` rows and columns of zeros after it: one BLAS update of one triangle.

    Where `U` has no rows it is P, to the bit.
    """
    n = len(P)
    if new:
        out = np.zeros((n + new, n + new))
        out[:n, :n] = P
        U = np.hstack([U, np.zeros((len(U), new))])
    else:
        out = P.copy()
    if len(U):
        blas.dsyrk(-1.0, np.ascontiguousarray(U).T, 1.0, out.T, overwrite_c=1)  # in place: out.T is its own layout
        mirror(out)
    return out


def merge_duplicates(G: GlobalMap, cfg: PairingConfig = PAIRING) -> tuple[GlobalMap, tuple[tuple[str, str], ...]]:
    """`G` with landmarks fused that are surely one: D^2 below `gate`, nearer than `reach`, never told apart.

    The older name stays; the pairs come back as (kept, gone).
    """
    state = _Merging(G)
    merged: list[tuple[str, str]] = []
    while (pair := state.surest(cfg)) is not None:
        state.merge(*pair)
        merged.append((G.ids[pair[0]], G.ids[pair[1]]))
    return (state.map() if merged else G), tuple(merged)


def ordered_pair(a: str, b: str) -> tuple[str, str]:
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

    def surest(self, cfg: PairingConfig) -> tuple[int, int] | None:
        """The pair most probably one landmark, if that is more probable than `cfg.sure`, the older landmark first."""
        marks, ids = self.x[self.first :].reshape(-1, 2), self.G.ids
        if len(self.keep) < 2:
            return None
        near = [
            (int(self.keep[min(k)]), int(self.keep[max(k)]))
            for k in cKDTree(marks[self.keep]).query_pairs(PAIRING_REACH)
        ]
        pairs = [(a, b) for a, b in sorted(near) if ordered_pair(ids[a], ids[b]) not in self.apart]
        D2 = [float((e := marks[a] - marks[b]) @ np.linalg.solve(self._spread(a, b), e)) for a, b in pairs]
        pairs = [pairs[k] for k in np.argsort(D2, kind="stable")[:PAIRING_CANDIDATES] if cfg.gate > D2[k]]
        if not pairs:
            return None
        a, b = np.array(pairs, dtype=np.intp).T
        i, j = ((self.first + 2 * k[:, None] + np.arange(2)).ravel() for k in (a, b))
        HU = self.U[:, i] - self.U[:, j]
        HP = self.P[i] - self.P[j]
        p = pairing_probabilities(
            np.array(pairs), marks[a] - marks[b], HP[:, i] - HP[:, j] - HU.T @ HU, PAIRING_DENSITY
        )
        best = int(np.argmax(p))
        return pairs[best] if p[best] > cfg.sure else None

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
        self.apart = frozenset(ordered_pair(*(kept if name == gone else name for name in pair)) for pair in self.apart)

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


@dataclass(frozen=True, slots=True)
class Handover:
    """The global map afterwards; what each submap landmark is called there; (kept, dropped) of duplicates merged.

    names: `None` for a landmark left out. A dropped name may be given to another landmark later.
    """

    map: GlobalMap
    names: tuple[str | None, ...]
    matched: tuple[bool, ...]
    merged: tuple[tuple[str, str], ...] = ()


def hand_over(
    G: GlobalMap,
    L: Submap,
    *,
    known: bool,
    prefix: str = "",
    cfg: PairingConfig = PAIRING,
) -> Handover:
    """`G` with all that `L` knows: matched landmarks fused, the others added, the robot's frame moved to its pose.

    With `known` identities equal ids are one landmark. Otherwise pairs inside the gate of `cfg` are weighed together,
    over all ways to pair (`pairing_probabilities`), and those that are surely one are fused. A landmark that may be new
    is added, and merged later if it turns out to be an old one; one that is surely old, with no telling which, is left
    out. Landmarks of one submap were told apart by it and are never merged. Unknown landmarks are named `prefix` and a
    number. Other robots' submaps are not touched: they are independent.
    """
    Y = MapAndSubmap(G, L)
    pairs: dict[int, int] = {}
    torn: frozenset[int] = frozenset()
    if known:
        where = {name: k for k, name in enumerate(G.ids)}
        pairs = {i: where[name] for i, name in enumerate(L.ids) if name in where}
        if pairs:
            Y.constrain(list(pairs.items()))
    else:
        while True:
            sure, torn = Y.sure_pairs(pairs, cfg)
            if not sure:
                break
            Y.constrain(sure)
            pairs.update(sure)
    names = _names(G, L, pairs, torn, known=known, prefix=prefix)
    out = _forward(G, Y, names, [i for i, name in enumerate(names) if name is not None and i not in pairs])
    merged: tuple[tuple[str, str], ...] = ()
    if not known:
        out = replace(out, apart=out.apart | _apart(out, [name for name in names if name is not None], PAIRING_APART))
        out, merged = merge_duplicates(out, cfg)
        renamed = {gone: kept for kept, gone in merged}
        names = tuple(_follow(name, renamed) for name in names)
    return Handover(out, names, tuple(i in pairs for i in range(len(L.ids))), merged)


@dataclass(frozen=True, slots=True)
class JoinedMaps:
    """Two maps made one: what each landmark of the other is called in it; how the other lay; (kept, dropped) of
    duplicates merged.
    """

    map: GlobalMap
    names: tuple[str, ...]
    T_map_other: Float[np.ndarray, "3"]
    merged: tuple[tuple[str, str], ...] = ()


def join_maps(
    G: GlobalMap,
    other: GlobalMap,
    links: Int[np.ndarray, "k 2"],
    T: Float[np.ndarray, "3"],
    *,
    prefix: str = "",
    cfg: PairingConfig | None = None,
) -> JoinedMaps:
    """`G` with all that an independent map knows, whose frame nobody knew: conditioned on linked landmarks being one.

    links: landmarks of `other` and of `G`; T: about where `other` lies in `G`, which nothing but the links tells in the
    end; linearised anew where it ends up. Landmarks of the other that have no link keep their name, or are named
    `prefix` and a number where it is taken. With `cfg`, whose identities nobody knows, those of which it turns out that
    they are one are merged.
    """
    taken, names = set(G.ids), [""] * len(other.ids)
    for i, m in links.tolist():
        names[i] = G.ids[m]
    for i, name in enumerate(other.ids):
        if not names[i]:
            names[i] = name if name not in taken else unused(prefix, taken)
            taken.add(names[i])
    for _ in range(ITERATIONS):
        state = _Merging(_side_by_side(G, other, T))
        for i, m in links.tolist():
            state.merge(m, len(G.ids) + i)
        both = state.map()
        last, T = T, both.frames[-1]
        if np.abs(T - last).max() < CONVERGED:
            break
    both = without_frames(both, [len(both.robots) - 1])
    kept = (*G.ids, *(name for name in names if name not in G.ids))
    renamed = dict(zip(other.ids, names, strict=True))
    apart = G.apart | {ordered_pair(renamed[a], renamed[b]) for a, b in other.apart}
    out = replace(both, ids=kept, apart=apart)
    merged: tuple[tuple[str, str], ...] = ()
    if cfg is not None:
        out, merged = merge_duplicates(out, cfg)
    return JoinedMaps(out, tuple(names), T, merged)


def without_frames(G: GlobalMap, gone: list[int]) -> GlobalMap:
    """`G` with the frames numbered `gone` marginalised away."""
    k = np.setdiff1d(np.arange(len(G.robots)), gone)
    rows = np.concatenate([(3 * k[:, None] + np.arange(3)).ravel(), np.arange(3 * len(G.robots), len(G.cov))])
    robots = tuple(G.robots[i] for i in k)
    return GlobalMap(robots, G.frames[k], G.ids, G.mean, owned(G.cov[np.ix_(rows, rows)]), G.apart)


def _side_by_side(G: GlobalMap, other: GlobalMap, T: Float[np.ndarray, "3"]) -> GlobalMap:
    """Both maps in G's frame, T as one more frame after theirs, about which all but nothing is known."""
    a, b, n = len(G.robots), len(other.robots), len(other.ids)
    J = np.zeros((3 * b + 2 * n, 3 + 3 * b + 2 * n))
    for k, frame in enumerate(other.frames):
        row = slice(3 * k, 3 * k + 3)
        J[row, :3], J[row, 3 + 3 * k : 6 + 3 * k] = se2.compose_jacobians(T, frame)
    C = se2.rotation(float(T[2]))
    for k, (x, y) in enumerate(other.mean):
        row = slice(3 * b + 2 * k, 3 * b + 2 * k + 2)
        J[row, :2], J[row, 2], J[row, 3 + row.start : 3 + row.stop] = np.eye(2), C @ (-y, x), C
    P_T = np.diag(np.square(JOINING_SD))
    cross = J[:, :3] @ P_T
    P = block_diag(G.cov, P_T, symmetrise(cross @ J[:, :3].T + J[:, 3:] @ other.cov @ J[:, 3:].T))
    at, g = len(G.cov), 3 * a
    P[at + 3 :, at : at + 3], P[at : at + 3, at + 3 :] = cross, cross.T
    its = at + 3 + np.arange(len(J))
    order = np.concatenate([np.arange(g), its[: 3 * b], at + np.arange(3), np.arange(g, at), its[3 * b :]])
    return GlobalMap(
        (*G.robots, *other.robots, ""),
        np.vstack([G.frames, se2.compose(T, other.frames), T]),
        (*G.ids, *(f"other {k}" for k in range(n))),
        np.vstack([G.mean, se2.act(T, other.mean)]),
        owned(P[np.ix_(order, order)]),
    )


def _apart(G: GlobalMap, names: list[str], far: float) -> frozenset[tuple[str, str]]:
    """Pairs of landmarks that are surely two: one submap holds both. Those `far` [m] apart need no such word."""
    at = [G.mean[G.ids.index(name)] for name in names]
    return frozenset(
        ordered_pair(a, b)
        for (a, p), (b, q) in combinations(zip(names, at, strict=True), 2)
        if np.hypot(*(p - q)) < far
    )


def _names(
    G: GlobalMap, L: Submap, pairs: dict[int, int], torn: frozenset[int], *, known: bool, prefix: str
) -> tuple[str | None, ...]:
    """What the map calls each landmark of `L`."""
    taken = set(G.ids)
    names: list[str | None] = []
    for i, name in enumerate(L.ids):
        if i in torn:
            names.append(None)
            continue
        label = G.ids[pairs[i]] if i in pairs else name if known else unused(prefix, taken)
        taken.add(label)
        names.append(label)
    return tuple(names)


def _forward(G: GlobalMap, Y: MapAndSubmap, names: tuple[str | None, ...], new: list[int]) -> GlobalMap:
    """`XL_j <- XL_j (+) r_j`, unmatched landmarks `XL_j,old (+) l_i`: one Jacobian over all of Y.

    It is the identity but for the frame and the landmarks `new`: only their rows and columns change.
    """
    old, pose, points = Y.x[Y.frame], Y.x[Y.pose], Y.points[new]
    J = np.zeros((3 + 2 * len(new), 6 + 2 * len(new)))
    J[:3, :3], J[:3, 3:6] = se2.compose_jacobians(old, pose)
    C = se2.rotation(float(old[2]))
    for k, (x, y) in enumerate(points):
        row = slice(3 + 2 * k, 5 + 2 * k)
        J[row, :2] = np.eye(2)
        J[row, 2] = C @ np.array([-y, x])
        J[row, 6 + 2 * k : 8 + 2 * k] = C
    columns = np.concatenate([Y.frame, Y.pose, Y.point(np.array(new, dtype=np.intp)).ravel()])
    rows = J @ Y.rows(columns)
    n = len(G.cov)
    P = Y.map_covariance(2 * len(new))
    changed = np.concatenate([Y.frame, n + np.arange(2 * len(new))])
    P[changed, :n] = rows[:, :n]
    P[:n, changed] = rows[:, :n].T
    P[np.ix_(changed, changed)] = symmetrise(rows[:, columns] @ J.T)
    frames = Y.frames.copy()
    frames[Y.frame[0] // 3] = se2.compose(old, pose)
    mean = np.vstack([Y.marks, se2.act(old, points)])
    return GlobalMap(G.robots, frames, (*G.ids, *(str(names[i]) for i in new)), mean, owned(P), G.apart)


def _follow(name: str | None, renamed: dict[str, str]) -> str | None:
    while name is not None and name in renamed:
        name = renamed[name]
    return name


def pose_in_map(G: GlobalMap, L: Submap) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """`T_map_robot` and its covariance: frame and submap are independent."""
    k = 3 * G.robots.index(L.robot)
    frame = G.frames[G.robots.index(L.robot)]
    cov = se2.composed_covariance(frame, G.cov[k : k + 3, k : k + 3], L.pose, L.cov[:3, :3])
    return se2.compose(frame, L.pose), symmetrise(cov)
