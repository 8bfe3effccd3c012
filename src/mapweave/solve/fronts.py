"""Multifrontal Cholesky: a large sparse matrix factorised as a tree of small dense ones.

Each piece of a nested dissection is a front: the variables eliminated there and those of its ancestors they touch.
Factor, solutions and the inverse's blocks on the pattern are dense matrix products, whatever the size of the whole.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from .dissection import dissect


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
