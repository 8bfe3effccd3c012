"""The order in which a sparse matrix is factorised, and the dense fronts that it takes: found once for a pattern.

By nested dissection a graph is cut in halves, again and again, along thin separators. Eliminating the halves before
their separator keeps a factor small: for robots that see their neighbours, n log n entries in the plane and n^(4/3) in
space.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse.csgraph import dijkstra, maximum_bipartite_matching
from scipy.sparse.linalg import splu

from ..kernels.block_cholesky import elimination_tree
from ..kernels.dense import extend_add
from ..kernels.elimination import (
    Fronts,
    above_diagonal,
    backward_fronts,
    children_first,
    column_heights,
    expanded,
    factor_fronts,
    forward_fronts,
    inverse_fronts,
    node_graph,
    places,
    rooms,
    supernode_rows,
    supernodes,
)

FEWEST = 3  # nodes for which any order is good
LEAF = 48  # nodes that are not cut further
PIVOTS = 6  # nodes whose hop distances serve as coordinates
LARGE = 4_000_000  # multiplications from which a front is one for BLAS


def least_fill(graph: sp.csr_array, chosen: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """The `chosen` nodes of `graph` (symmetric, with its diagonal) in an order of minimum degree."""
    at = np.flatnonzero(chosen)
    n = len(at)
    if n < FEWEST:
        return at
    tied = sp.csc_matrix(graph[at][:, at], dtype=float)
    tied.data[:] = -1.0
    tied.setdiag(1.0 + np.diff(tied.indptr))  # dominated by the diagonal
    factor = splu(tied, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return at[np.argsort(factor.perm_c)].astype(np.int64)


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
        split = ~done & ~separator
        part[split] = 2 * part[split] + upper[split]
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
class Nodes:
    """The variables of a matrix in nodes that are eliminated together, and the graph of these.

    members: (n,) variables by node, those of node a are `members[first[a]:first[a + 1]]`; start, rows: the neighbours
    of each node, itself left out.
    """

    first: Int[np.ndarray, " a1"]
    members: Int[np.ndarray, " n"]
    start: Int[np.ndarray, " a1"]
    rows: Int[np.ndarray, " e"]

    @classmethod
    def of(cls, matrix: sp.csc_matrix, group: Int[np.ndarray, " n"] | None) -> "Nodes":
        """For the pattern of `matrix` (symmetric, both triangles); group: the node of each variable, by any number."""
        n = matrix.shape[0]
        node = np.arange(n) if group is None else np.unique(group, return_inverse=True)[1].ravel().astype(np.int64)
        first = np.concatenate([[0], np.cumsum(np.bincount(node))]).astype(np.int64)
        members = np.argsort(node, kind="stable")
        return cls(first, members, *node_graph(matrix.indptr, matrix.indices, node, first, members))

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def graph(self) -> sp.csr_array:
        """The graph as a matrix, with its diagonal."""
        row = np.repeat(np.arange(len(self)), np.diff(self.start))
        row, col = np.concatenate([row, np.arange(len(self))]), np.concatenate([self.rows, np.arange(len(self))])
        return sp.csr_array((np.ones(len(row), dtype=np.int8), (row, col)), shape=(len(self), len(self)))


@dataclass(frozen=True, slots=True)
class Elimination:
    """The order in which a matrix of one pattern is factorised, front by front, each right after its subtree.

    Front i holds the variables `index[begin[i]:begin[i + 1]]`, the first `own[i]` eliminated there. parent: (fronts,)
    to which front it hands on, or -1; into: beside `index`, where the others stand there; its children are
    `children[family[i]:family[i + 1]]`. The number `slot` of the matrix's data goes to `place` among all panels, of
    which front i has `panel[i]:panel[i + 1]`. room: (2, fronts + 1), where its update lies on a stack, and its part of
    the inverse; large: which are left to BLAS, the others are taken by runs in one compiled call.
    """

    size: int
    begin: Int[np.ndarray, " f1"]
    own: Int[np.ndarray, " f"]
    index: Int[np.ndarray, " m"] = field(repr=False)
    parent: Int[np.ndarray, " f"]
    into: Int[np.ndarray, " m"] = field(repr=False)
    family: Int[np.ndarray, " f1"]
    children: Int[np.ndarray, " c"]
    panel: Int[np.ndarray, " f1"]
    room: Int[np.ndarray, "2 f1"]
    slot: Int[np.ndarray, " e"] = field(repr=False)
    place: Int[np.ndarray, " e"] = field(repr=False)
    large: Bool[np.ndarray, " f"]

    @classmethod
    def of(
        cls,
        matrix: sp.csc_matrix,
        group: Int[np.ndarray, " n"] | None = None,
        coordinates: Float[np.ndarray, "g d"] | None = None,
    ) -> "Elimination":
        """By nested dissection, for the pattern of `matrix` (symmetric, both triangles, sorted): few wide fronts.

        group: variables kept together; coordinates: one row a group, where the groups lie; found from the pattern when
        None.
        """
        nodes = Nodes.of(matrix, group)
        part = dissect(nodes.graph, coordinates).part if len(nodes) else np.zeros(0, np.int64)
        depth = np.floor(np.log2(part)).astype(np.int64)
        leftmost = part << (depth.max(initial=0) - depth)  # of the leaves below, were all as deep
        order = np.lexsort((-depth, -leftmost))
        piece = part[order]
        starts = np.flatnonzero(np.concatenate([[True], piece[1:] != piece[:-1], [True]])) if len(part) else [0]
        place_of = {int(k): i for i, k in enumerate(piece[starts[:-1]])}
        above = np.array([_above(int(k), place_of) for k in piece[starts[:-1]]], dtype=np.int64)
        return cls._built(matrix, nodes, order, np.asarray(starts, dtype=np.int64), above, blas=True)

    @classmethod
    def least_fill(
        cls, matrix: sp.csc_matrix, group: Int[np.ndarray, " n"] | None, last: Bool[np.ndarray, " n"]
    ) -> "Elimination":
        """In an order of minimum degree: many small fronts, for long trajectories with constraints between them.

        group: variables kept together, by any number; last: which of them (whole groups) are eliminated after all
        others, because they touch most of them.
        """
        nodes = Nodes.of(matrix, group)
        n, size = len(nodes), np.diff(nodes.first)
        at_end = last[nodes.members[nodes.first[:-1]]] if n else np.zeros(0, bool)
        order = np.concatenate([least_fill(nodes.graph, ~at_end), np.flatnonzero(at_end)])
        parent = elimination_tree(*above_diagonal(nodes.start, nodes.rows, order))
        order = order[children_first(parent, size[order])]
        start, rows = above_diagonal(nodes.start, nodes.rows, order)
        parent = elimination_tree(start, rows)
        begin = supernodes(parent, column_heights(start, rows, parent, size[order]), size[order])
        home = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
        up = parent[begin[1:] - 1]
        return cls._built(matrix, nodes, order, begin, np.where(up >= 0, home[up], -1), blas=False)

    @classmethod
    def _built(
        cls,
        matrix: sp.csc_matrix,
        nodes: Nodes,
        order: np.ndarray,
        starts: np.ndarray,
        parent: np.ndarray,
        *,
        blas: bool,
    ) -> "Elimination":
        """The fronts of supernodes (those of `order` between `starts`) whose parents are known."""
        n, many = matrix.shape[0], len(starts) - 1
        at, below = supernode_rows(starts, *above_diagonal(nodes.start, nodes.rows, order), parent)
        mine, own = expanded(order, nodes.first, nodes.members, starts)
        theirs, others = expanded(order[below], nodes.first, nodes.members, at)
        begin = np.concatenate([[0], np.cumsum(own + others)]).astype(np.int64)
        index = np.empty(begin[-1], np.int64)
        is_own = np.arange(len(index)) - np.repeat(begin[:-1], own + others) < np.repeat(own, own + others)
        index[is_own], index[~is_own] = mine, theirs
        rank = np.empty(n, np.int64)
        rank[mine] = np.arange(n)
        children = np.argsort(parent, kind="stable")[np.count_nonzero(parent < 0) :]
        family = np.concatenate([[0], np.cumsum(np.bincount(parent[parent >= 0], minlength=many))]).astype(np.int64)
        panel = np.concatenate([[0], np.cumsum(own * (own + others))]).astype(np.int64)
        room = rooms(parent, family, children, begin, own)
        slot, place, into = places(matrix.indptr, matrix.indices, rank, begin, index, own, family, children, panel)
        large = np.full(many, blas) | (own * (own + others) ** 2 > LARGE)
        return cls(n, begin, own, index, parent, into, family, children, panel, room, slot, place, large)

    def __len__(self) -> int:
        return len(self.own)

    def runs(self) -> Iterator[tuple[int, int]]:
        """The fronts from first to last, one by one where they are large, else as many as follow each other."""
        cuts = np.flatnonzero(self.large[1:] | self.large[:-1]) + 1 if len(self) else np.zeros(0, np.int64)
        ends = [0, *cuts.tolist(), len(self)] if len(self) else [0]
        yield from pairwise(ends)

    def front(self, i: int) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " q"]]:
        """The variables of front i: its own, and the others."""
        middle = self.begin[i] + self.own[i]
        return self.index[self.begin[i] : middle], self.index[middle : self.begin[i + 1]]

    def homes(self) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """For each variable the front that eliminates it and its place there."""
        rows = np.diff(self.begin)
        front = np.repeat(np.arange(len(self)), rows)
        local = np.arange(len(self.index)) - np.repeat(self.begin[:-1], rows)
        own = local < np.repeat(self.own, rows)
        home, place = np.empty(self.size, np.int64), np.empty(self.size, np.int64)
        home[self.index[own]], place[self.index[own]] = front[own], local[own]
        return home, place


def _above(piece: int, place_of: dict[int, int]) -> int:
    """Where the nearest piece above stands, pieces being numbered as in a heap; -1 for the topmost."""
    piece //= 2
    while piece and piece not in place_of:
        piece //= 2
    return place_of.get(piece, -1)


class NotPositiveError(ArithmeticError):
    """A pivot was not positive: the matrix is not positive definite."""


@dataclass(frozen=True, slots=True)
class Cholesky:
    """`matrix = L L^T`, front by front: L11 (p, p) lower, then L21 (q, p), both column after column."""

    elimination: Elimination
    L: Float[np.ndarray, " m"] = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, elimination: Elimination) -> "Cholesky":
        """`matrix` (the pattern `elimination` was made for) factorised; raises NotPositiveError."""
        e = elimination
        L = np.zeros(int(e.panel[-1]))
        L[e.place] = matrix.data[e.slot]
        fronts = Fronts(e.begin, e.own, e.into, e.panel, L)
        updates = np.empty(int(e.room[0, -1]))
        rest = np.empty(int((np.diff(e.begin) - e.own)[~e.large].max(initial=0)) ** 2)
        for a, b in e.runs():
            if e.large[a]:
                failed = a if _factorised(e, a, L, updates) else -1
            else:
                failed = factor_fronts(a, b, fronts, e.family, e.children, e.room[0], updates, rest)
            if failed >= 0:
                raise NotPositiveError(f"a pivot of front {failed} is not positive")
        return cls(e, L)

    @property
    def nnz(self) -> int:
        """Numbers kept."""
        return len(self.L)

    def panels(self, i: int) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, "q p"]]:
        """L11 and L21 of front i."""
        return _panels(self.elimination, i, self.L)

    def pivots(self) -> Float[np.ndarray, " n"]:
        """The pivots of elimination, by variable."""
        e = self.elimination
        home, local = e.homes()
        return np.asarray(np.square(self.L[e.panel[home] + local * (e.own[home] + 1)]))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """`matrix^-1 b` for b (n,) or (n, c)."""
        e, x = self.elimination, self._forward(b)
        for a, c in reversed(list(e.runs()) if x.size else []):
            if e.large[a]:
                (L11, L21), (own, others) = self.panels(a), e.front(a)
                y = x[:, own].T
                if len(others):
                    y = y - L21.T @ x[:, others].T
                x[:, own] = dtrsm(1.0, L11, y, lower=1, trans_a=1).T
            else:
                backward_fronts(a, c, e.begin, e.own, e.index, e.panel, self.L, x)
        return np.ascontiguousarray(x.T).reshape(np.shape(b))

    def squares(self, b: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " c"]:
        """`b^T matrix^-1 b` of each column of b: half the work of `solve`, less where a column is mostly zero."""
        return np.asarray(np.square(self._forward(b)).sum(axis=1))

    def _forward(self, b: np.ndarray) -> Float[np.ndarray, "c n"]:
        """`L^-1 b` for b (n,) or (n, c), a row for each column."""
        e = self.elimination
        x = np.array(np.reshape(b, (e.size, -1 if e.size else 1)).T, dtype=float, order="C")
        for a, c in e.runs() if x.size else ():
            if e.large[a]:
                (L11, L21), (own, others) = self.panels(a), e.front(a)
                y = dtrsm(1.0, L11, x[:, own].T, lower=1)
                x[:, own] = y.T
                if len(others):
                    x[:, others] -= (L21 @ y).T
            else:
                forward_fronts(a, c, e.begin, e.own, e.index, e.panel, self.L, x)
        return x

    def together(self, index: Int[np.ndarray, "b k"]) -> bool:
        """Whether the variables of each row are eliminated in one front, so that `blocks` can answer."""
        home, _ = self.elimination.homes()
        return bool((home[index] == home[index[:, :1]]).all())

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """Blocks of the inverse over each row of `index`, whose variables must be `together`.

        Selected inversion: from the root down, each front's part of the inverse follows from its parent's.
        """
        e = self.elimination
        home, place = e.homes()
        local = np.ascontiguousarray(place[index])
        asked = np.argsort(home[index[:, 0]], kind="stable")
        ends = np.searchsorted(home[index[asked, 0]], np.arange(len(e) + 1))
        out = np.empty((*index.shape, index.shape[1]))
        Z, fronts = np.empty(int(e.room[1, -1])), Fronts(e.begin, e.own, e.into, e.panel, self.L)
        for a, b in reversed(list(e.runs())):
            if e.large[a]:
                full = self._inverse(a, Z)
                k, at = len(full), int(e.room[1, a])
                Z[at : at + k * k] = full.ravel()
                mine = asked[ends[a] : ends[a + 1]]
                j = local[mine]
                out[mine] = full[j[:, :, None], j[:, None, :]]
            else:
                inverse_fronts(a, b, fronts, e.parent, e.room[1], Z, asked, ends, local, out)
        return out

    def _inverse(self, i: int, known: Float[np.ndarray, " z"]) -> Float[np.ndarray, "k k"]:
        """The inverse over the variables of front `i`, symmetric and full; that of its parent is `known`."""
        e = self.elimination
        L, below = self.panels(i)
        p, k = len(L), len(L) + len(below)
        Z = np.empty((k, k))
        own, _ = dpotri(L, lower=1)
        own = np.tril(own) + np.tril(own, -1).T
        if k > p:
            up = int(e.parent[i])
            wide, at = int(e.begin[up + 1] - e.begin[up]), int(e.room[1, up])
            into = e.into[e.begin[i] + p : e.begin[i + 1]]
            W = dtrsm(1.0, L, below, side=1, lower=1)
            Z22 = known[at : at + wide * wide].reshape(wide, wide)[np.ix_(into, into)]
            Z21 = -Z22 @ W
            own -= W.T @ Z21
            Z[p:, :p], Z[:p, p:], Z[p:, p:] = Z21, Z21.T, Z22
        Z[:p, :p] = 0.5 * (own + own.T)
        return Z


def _panels(e: Elimination, i: int, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, at = int(e.own[i]), int(e.panel[i])
    middle = at + p * p
    return L[at:middle].reshape(p, p, order="F"), L[middle : e.panel[i + 1]].reshape(-1, p, order="F")


def _factorised(e: Elimination, i: int, L: np.ndarray, updates: np.ndarray) -> bool:
    """Front i factorised by BLAS, in place; True where a pivot is not positive."""
    p, k = int(e.own[i]), int(e.begin[i + 1] - e.begin[i])
    q = k - p
    L11, L21 = _panels(e, i, L)
    F = np.zeros((k, k), order="F")
    F[:p, :p], F[p:, :p] = L11, L21
    for c in e.children[e.family[i] : e.family[i + 1]]:
        into = e.into[e.begin[c] + e.own[c] : e.begin[c + 1]]
        at, w = int(e.room[0, c]), len(into)
        extend_add(F, updates[at : at + w * w].reshape(w, w, order="F"), into)
    L11[...], info = dpotrf(F[:p, :p], lower=1, clean=1)
    if info:
        return True
    if q:
        L21[...] = dtrsm(1.0, L11, F[p:, :p], side=1, lower=1, trans_a=1)
        at = int(e.room[0, i])
        updates[at : at + q * q].reshape(q, q, order="F")[...] = dsyrk(-1.0, L21, beta=1.0, c=F[p:, p:], lower=1)
    return False
