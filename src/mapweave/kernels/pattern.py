"""Where the blocks of factors land in a sparse symmetric matrix."""

import numpy as np

from ._jit import kernel


@kernel
def factors_of(flat: np.ndarray, begin: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each variable stands in factors: (size + 1,) starts, the factor and the place in it of each mention.

    Factor f touches the variables `flat[begin[f]:begin[f + 1]]`; `size` and above is none.
    """
    start = np.zeros(size + 1, np.int64)
    for v in flat:
        if v < size:
            start[v + 1] += 1
    start = np.cumsum(start)
    end, many = start[:-1].copy(), start[-1]
    factor, place = np.empty(many, np.int64), np.empty(many, np.int64)
    for f in range(begin.shape[0] - 1):
        for e in range(begin[f], begin[f + 1]):
            v = flat[e]
            if v < size:
                factor[end[v]], place[end[v]] = f, e - begin[f]
                end[v] += 1
    return start, factor, place


@kernel
def rows_of(v: int, flat: np.ndarray, begin: np.ndarray, factors: np.ndarray, mark: np.ndarray, out: np.ndarray) -> int:
    """The variables that share one of `factors` with v, and v, put to the beginning of `out`; how many."""
    out[0], many = v, 1
    mark[v] = v
    for f in factors:
        for e in range(begin[f], begin[f + 1]):
            r = flat[e]
            if r < mark.shape[0] and mark[r] != v:
                mark[r] = v
                out[many] = r
                many += 1
    return many


@kernel
def pattern_slots(
    flat: np.ndarray, begin: np.ndarray, room: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Column starts and ascending rows of the matrix, every block entry's slot in its data, and the diagonal's.

    The block of factor f, row after row, is `slots[room[f]:room[f + 1]]`; an entry of no variable has the slot after
    the last.
    """
    start, factor, place = factors_of(flat, begin, size)
    mark, found = np.full(size, -1, np.int64), np.empty(size + 1, np.int64)
    indptr = np.zeros(size + 1, np.int64)
    for v in range(size):
        many = rows_of(v, flat, begin, factor[start[v] : start[v + 1]], mark, found)
        indptr[v + 1] = indptr[v] + many
    indices, diagonal = np.empty(indptr[size], np.int64), np.empty(size, np.int64)
    slots = np.full(room[-1], indptr[size], np.int64)
    mark[:] = -1
    slot = np.empty(size + 1, np.int64)
    for v in range(size):
        many = rows_of(v, flat, begin, factor[start[v] : start[v + 1]], mark, found)
        rows = np.sort(found[:many])
        indices[indptr[v] : indptr[v + 1]] = rows
        for k in range(many):
            slot[rows[k]] = indptr[v] + k
        diagonal[v] = slot[v]
        for m in range(start[v], start[v + 1]):
            f = factor[m]
            wide = begin[f + 1] - begin[f]
            for i in range(wide):
                r = flat[begin[f] + i]
                if r < size:
                    slots[room[f] + i * wide + place[m]] = slot[r]
    return indptr, indices, slots, diagonal
