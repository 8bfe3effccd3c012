"""Nested dissection: a graph cut in halves, again and again, along thin separators.

Eliminating the halves before their separator keeps a factor small: for robots that see their neighbours, n log n
entries in the plane and n^(4/3) in space.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra, maximum_bipartite_matching

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
