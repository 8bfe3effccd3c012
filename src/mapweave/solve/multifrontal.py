"""Multifrontal Cholesky: a large sparse matrix factorised as a tree of small dense ones.

Nested dissection cuts the graph in halves, again and again, along thin separators. Eliminating the halves before their
separator keeps the factor small: for robots that see their neighbours, n log n entries in the plane and n^(4/3) in
space. Each piece is a front: the variables eliminated there and those of its ancestors they touch. Factor, solutions
and the blocks of the inverse on the pattern are dense matrix products, whatever the size of the whole.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse.csgraph import dijkstra, maximum_bipartite_matching

from ..kernels.dense import extend_add

LEAF = 48  # nodes that are not cut further
PIVOTS = 6  # nodes whose hop distances serve as coordinates


@dataclass(frozen=True, slots=True)
class Dissection:
    """`part` (n,): the piece each node belongs to, as in a heap: piece k separates those below 2k and 2k + 1."""

    part: Int[np.ndarray, " n"]


def dissect(graph: sp.csr_array, coordinates: Float[np.ndarray, "n d"] | None = None, leaf: int = LEAF) -> Dissection:
    """The pieces of `graph` (symmetric pattern), cut across `coordinates` (hop distances when None)."""
    n = graph.shape[0]
    x = hop_coordinates(graph) if coordinates is None else coordinates
    part = np.ones(n, dtype=np.int64)
    done = np.zeros(n, dtype=bool)  # in a separator or a leaf
    edges = graph.tocoo()
    row, col = edges.row, edges.col
    once = row < col
    row, col = row[once], col[once]
    while not done.all():
        size = np.bincount(part[~done])
        done |= size[np.minimum(part, len(size) - 1)] <= leaf
        if done.all():
            break
        upper = _upper_half(part, x, done)
        inside = (part[row] == part[col]) & ~done[row] & ~done[col]
        row, col = row[inside], col[inside]
        cut = upper[row] != upper[col]
        a = np.where(upper[row], col, row)[cut]  # lower ends
        b = np.where(upper[row], row, col)[cut]
        separator = _vertex_cover(a, b, n)
        moved = ~done & ~separator
        part[moved] = 2 * part[moved] + upper[moved]
        done |= separator
    return Dissection(part)


def hop_coordinates(graph: sp.csr_array) -> Float[np.ndarray, "n k"]:
    """Coordinates from the graph alone: smoothed hop distances to a few far-apart nodes, in principal axes."""
    n = graph.shape[0]
    hops = np.empty((n, PIVOTS))
    start = 0
    for k in range(PIVOTS):
        hops[:, k] = _hops(graph, start)
        start = int(np.argmax(hops[:, : k + 1].min(axis=1)))
    degree = np.maximum(np.diff(graph.indptr), 1)
    pattern = sp.csr_array((np.ones(graph.nnz), graph.indices, graph.indptr), shape=graph.shape)
    for _ in range(3):
        hops = 0.5 * hops + 0.5 * (pattern @ hops) / degree[:, None]
    centred = hops - hops.mean(axis=0)
    _, _, axes = np.linalg.svd(centred.T @ centred)
    return np.asarray(centred @ axes[:3].T)


def _hops(graph: sp.csr_array, start: int) -> Float[np.ndarray, " n"]:
    """Hop distance from `start`; nodes that cannot be reached lie beyond all others."""
    out = np.asarray(dijkstra(graph, indices=np.array([start]), unweighted=True))[0]
    reached = np.isfinite(out)
    return np.asarray(np.where(reached, out, out[reached].max() + 2.0))


def _upper_half(part: np.ndarray, x: np.ndarray, done: np.ndarray) -> np.ndarray:
    """Which nodes lie above the median of their piece along the piece's widest coordinate."""
    n = len(part)
    nodes = np.flatnonzero(~done)
    order = nodes[np.argsort(part[nodes], kind="stable")]
    pieces, first, count = np.unique(part[order], return_index=True, return_counts=True)
    low, high = np.minimum.reduceat(x[order], first), np.maximum.reduceat(x[order], first)
    axis = np.argmax(high - low, axis=1)
    which = np.repeat(np.arange(len(pieces)), count)
    ranked = order[np.lexsort((x[order, axis[which]], which))]
    upper = np.zeros(n, dtype=bool)
    upper[ranked] = np.arange(len(order)) - np.repeat(first, count) >= np.repeat(count, count) / 2
    return upper


def _vertex_cover(a: np.ndarray, b: np.ndarray, n: int) -> np.ndarray:
    """The fewest nodes that touch every edge a-b of a bipartite graph (Koenig's theorem), as a mask of n."""
    left, a = np.unique(a, return_inverse=True)
    right, b = np.unique(b, return_inverse=True)
    graph = sp.csr_array((np.ones(len(a)), (a, b)), shape=(len(left), len(right)))
    match = maximum_bipartite_matching(graph, perm_type="column")  # left -> right, or -1
    mate = np.full(len(right), -1)
    mate[match[match >= 0]] = np.flatnonzero(match >= 0)
    seen_left, seen_right = match < 0, np.zeros(len(right), dtype=bool)
    fresh = seen_left
    while fresh.any():  # alternating paths from the unmatched left nodes
        reach = np.zeros(len(right), dtype=bool)
        reach[b[fresh[a]]] = True
        reach &= ~seen_right
        seen_right |= reach
        fresh = np.zeros(len(left), dtype=bool)
        back = mate[reach]
        fresh[back[back >= 0]] = True
        fresh &= ~seen_left
        seen_left |= fresh
    cover = np.zeros(n, dtype=bool)
    cover[left[~seen_left]] = True
    cover[right[seen_right]] = True
    return cover


@dataclass(frozen=True, slots=True)
class Front:
    """index: (p + q,) variables, the p eliminated here first; slots of the matrix's data and where they go."""

    index: Int[np.ndarray, " k"]
    p: int
    slot: Int[np.ndarray, " e"]
    place: Int[np.ndarray, " e"]  # flat, in the Fortran-ordered front
    children: tuple[int, ...]
    into_parent: Int[np.ndarray, " q"]  # where the q others stand in the parent front


@dataclass(frozen=True, slots=True)
class Elimination:
    """The order in which a matrix of one pattern is factorised; children stand before their parents."""

    size: int
    fronts: tuple[Front, ...]

    @classmethod
    def of(
        cls,
        matrix: sp.csc_matrix,
        group: Int[np.ndarray, " n"] | None = None,
        coordinates: Float[np.ndarray, "g d"] | None = None,
    ) -> "Elimination":
        """For the pattern of `matrix` (symmetric, both triangles, sorted); `group`: variables kept together.

        coordinates: one row a group, where the groups lie; found from the pattern when None.
        """
        n = matrix.shape[0]
        if n == 0:
            return cls(0, ())
        group = np.arange(n) if group is None else np.unique(group, return_inverse=True)[1].ravel()
        column = np.repeat(np.arange(n), np.diff(matrix.indptr))
        many = int(group.max(initial=-1)) + 1
        pairs = np.unique(group[matrix.indices].astype(np.int64) * many + group[column])
        row, col = pairs // many, pairs % many
        graph = sp.csr_array((np.ones(len(row), dtype=np.int8), (row, col)), shape=(many, many))
        part = dissect(graph, coordinates).part[group]
        return cls(n, _fronts(matrix, column, part))


def _fronts(matrix: sp.csc_matrix, column: np.ndarray, part: np.ndarray) -> tuple[Front, ...]:
    """Fronts deepest first: pieces are numbered as in a heap, so descending numbers put children before parents."""
    n = len(part)
    pieces = np.unique(part)[::-1]
    rank = np.empty(n, dtype=np.int64)  # elimination position
    order = np.lexsort((np.arange(n), -part))
    rank[order] = np.arange(n)
    begin = np.concatenate([[0], np.cumsum(np.unique(-part, return_counts=True)[1])])
    lower = np.flatnonzero(rank[matrix.indices] >= rank[column])
    by_piece = lower[np.argsort(rank[column[lower]], kind="stable")]
    ends = np.searchsorted(rank[column[by_piece]], begin)
    place_of = {int(k): i for i, k in enumerate(pieces)}
    boundary: list[np.ndarray] = []
    children: list[list[int]] = [[] for _ in pieces]
    raw = []
    for i, k in enumerate(pieces):
        slot = by_piece[ends[i] : ends[i + 1]]
        touched = [rank[matrix.indices[slot]], *(boundary[c] for c in children[i])]
        last = begin[i + 1]
        others = np.unique(np.concatenate(touched))
        others = others[others >= last]
        boundary.append(others)
        raw.append((np.concatenate([np.arange(begin[i], last), others]), int(last - begin[i]), slot))
        if len(others):
            up = int(k) // 2
            while up not in place_of:
                up //= 2
            children[place_of[up]].append(i)
    parent = {c: i for i, below in enumerate(children) for c in below}
    out = []
    for i, (index, p, slot) in enumerate(raw):
        r, c = rank[matrix.indices[slot]], rank[column[slot]]
        place = np.searchsorted(index, r) + len(index) * np.searchsorted(index, c)
        into = np.searchsorted(raw[parent[i]][0], boundary[i]) if i in parent else np.zeros(0, dtype=np.int64)
        out.append(Front(order[index], p, slot, place, tuple(children[i]), into))
    return tuple(out)


class NotPositiveError(ArithmeticError):
    """A pivot was not positive: the matrix is not positive definite."""


@dataclass(frozen=True, slots=True)
class Cholesky:
    """`matrix = L L^T`, kept front by front: L11 (p, p) lower and L21 (q, p)."""

    elimination: Elimination
    L11: list[np.ndarray] = field(repr=False)
    L21: list[np.ndarray] = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, elimination: Elimination) -> "Cholesky":
        """`matrix` (the pattern `elimination` was made for) factorised; raises NotPositiveError."""
        fronts = elimination.fronts
        updates: dict[int, np.ndarray] = {}
        L11, L21 = [], []
        for i, f in enumerate(fronts):
            F = _assemble(f, matrix.data, fronts, updates)
            L, info = dpotrf(F[: f.p, : f.p], lower=1, clean=1)
            if info:
                raise NotPositiveError(f"pivot {info} of front {i} is not positive")
            below = F[f.p :, : f.p]
            if len(f.index) > f.p:
                below = dtrsm(1.0, L, below, side=1, lower=1, trans_a=1)
                updates[i] = dsyrk(-1.0, below, beta=1.0, c=F[f.p :, f.p :], lower=1)
            L11.append(L)
            L21.append(below)
        return cls(elimination, L11, L21)

    @property
    def nnz(self) -> int:
        """Numbers kept."""
        return sum(a.size for a in self.L11) + sum(a.size for a in self.L21)

    def pivots(self) -> Float[np.ndarray, " n"]:
        """The pivots of elimination, by variable."""
        out = np.empty(self.elimination.size)
        for f, L in zip(self.elimination.fronts, self.L11, strict=True):
            out[f.index[: f.p]] = np.square(np.diagonal(L))
        return out

    def solve(self, b: np.ndarray) -> np.ndarray:
        """`matrix^-1 b` for b (n,) or (n, c)."""
        x = np.array(b, dtype=float, order="C")
        if not x.size:
            return x
        x = x.reshape(self.elimination.size, -1)
        parts = list(zip(self.elimination.fronts, self.L11, self.L21, strict=True))
        for f, L, below in parts:
            y = dtrsm(1.0, L, x[f.index[: f.p]], lower=1)
            x[f.index[: f.p]] = y
            if len(below):
                x[f.index[f.p :]] -= below @ y
        for f, L, below in reversed(parts):
            y = x[f.index[: f.p]]
            if len(below):
                y = y - below.T @ x[f.index[f.p :]]
            x[f.index[: f.p]] = dtrsm(1.0, L, y, lower=1, trans_a=1)
        return x.reshape(np.shape(b))

    def together(self, index: Int[np.ndarray, "b k"]) -> bool:
        """Whether the variables of each row are eliminated in one front, so that `blocks` can answer."""
        home, _ = self._homes()
        return bool((home[index] == home[index[:, :1]]).all())

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """Blocks of the inverse over each row of `index`, whose variables must be `together`.

        Selected inversion: from the root down, each front's part of the inverse follows from its parent's.
        """
        fronts = self.elimination.fronts
        home, local = self._homes()
        at = home[index[:, 0]]
        rows = np.argsort(at, kind="stable")
        ends = np.searchsorted(at[rows], np.arange(len(fronts) + 1))
        parent = {c: i for i, f in enumerate(fronts) for c in f.children}
        out = np.empty((*index.shape, index.shape[1]))
        Z: dict[int, np.ndarray] = {}
        for i in reversed(range(len(fronts))):
            full = self._inverse(i, Z[parent[i]] if i in parent else None)
            mine = rows[ends[i] : ends[i + 1]]
            j = local[index[mine]]
            out[mine] = full[j[:, :, None], j[:, None, :]]
            if fronts[i].children:
                Z[i] = full
            if i in parent and fronts[parent[i]].children[0] == i:  # the last of its siblings
                del Z[parent[i]]
        return out

    def _homes(self) -> tuple[np.ndarray, np.ndarray]:
        """For each variable the front that eliminates it and its place there."""
        home = np.empty(self.elimination.size, dtype=np.int64)
        local = np.empty(self.elimination.size, dtype=np.int64)
        for i, f in enumerate(self.elimination.fronts):
            home[f.index[: f.p]] = i
            local[f.index[: f.p]] = np.arange(f.p)
        return home, local

    def _inverse(self, i: int, above: np.ndarray | None) -> np.ndarray:
        """The inverse over the variables of front `i`, symmetric and full."""
        f, L, below = self.elimination.fronts[i], self.L11[i], self.L21[i]
        k, p = len(f.index), f.p
        Z = np.empty((k, k), order="F")
        own, _ = dpotri(L, lower=1)
        own = np.tril(own) + np.tril(own, -1).T
        if above is not None and k > p:
            W = dtrsm(1.0, L, below, side=1, lower=1)
            Z22 = above[np.ix_(f.into_parent, f.into_parent)]
            Z21 = -Z22 @ W
            own -= W.T @ Z21
            Z[p:, :p], Z[:p, p:], Z[p:, p:] = Z21, Z21.T, Z22
        Z[:p, :p] = 0.5 * (own + own.T)
        return Z


def _assemble(f: Front, data: np.ndarray, fronts: tuple[Front, ...], updates: dict[int, np.ndarray]) -> np.ndarray:
    k = len(f.index)
    flat = np.zeros(k * k)
    flat[f.place] = data[f.slot]
    F = flat.reshape(k, k, order="F")
    for c in f.children:
        extend_add(F, np.asfortranarray(updates.pop(c)), fronts[c].into_parent)
    return F
