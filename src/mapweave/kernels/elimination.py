"""A sparse Cholesky factor: what it will look like before any number is known, then its fronts, in one call.

Nodes (one or several variables each) stand in the order of elimination; columns hold the nodes above the diagonal.
A supernode is a run of nodes that are eliminated together, as one dense front.

Front i holds the variables `index[begin[i]:begin[i + 1]]`, the first `own[i]` of which it eliminates. Its part of the
factor lies in `L` from `panel[i]`: (own, own), then (others, own), both column after column. What it gives its parent,
a lower triangle over the others, lies in `updates` from `room[i]`, each of them at the place `into` in the parent. Its
children are `children[family[i]:family[i + 1]]`.
"""

from typing import NamedTuple

import numpy as np

from ._jit import kernel
from .block_cholesky import reach

SMALL, MIDDLE = 12, 48  # variables of a supernode
SMALL_ZEROS, MIDDLE_ZEROS, MOST_ZEROS = 0.5, 0.25, 0.05  # share of a front that may be zeros stored for nothing


@kernel
def node_graph(
    indptr: np.ndarray, indices: np.ndarray, node: np.ndarray, first: np.ndarray, members: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The graph of the nodes: (n + 1,) starts and the neighbours of each, itself left out.

    node: of every variable; members: the variables by node, those of node a are `members[first[a]:first[a + 1]]`.
    """
    n = first.shape[0] - 1
    start, mark = np.zeros(n + 1, np.int64), np.full(n, -1, np.int64)
    many = 0
    for a in range(n):
        mark[a] = a
        for m in range(first[a], first[a + 1]):
            for s in range(indptr[members[m]], indptr[members[m] + 1]):
                b = node[indices[s]]
                if mark[b] != a:
                    mark[b] = a
                    many += 1
        start[a + 1] = many
    rows = np.empty(many, np.int64)
    mark[:] = -1
    many = 0
    for a in range(n):
        mark[a] = a
        for m in range(first[a], first[a + 1]):
            for s in range(indptr[members[m]], indptr[members[m] + 1]):
                b = node[indices[s]]
                if mark[b] != a:
                    mark[b] = a
                    rows[many] = b
                    many += 1
    return start, rows


@kernel
def above_diagonal(start: np.ndarray, rows: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The graph in the order of elimination: of every column the rows above the diagonal."""
    n = order.shape[0]
    rank, begin = np.empty(n, np.int64), np.zeros(n + 1, np.int64)
    for k in range(n):
        rank[order[k]] = k
    out = np.empty(rows.shape[0] // 2, np.int64)
    many = 0
    for k in range(n):
        for s in range(start[order[k]], start[order[k] + 1]):
            if rank[rows[s]] < k:
                out[many] = rank[rows[s]]
                many += 1
        begin[k + 1] = many
    return begin, out


@kernel
def children_first(parent: np.ndarray, size: np.ndarray) -> np.ndarray:
    """An order in which every node follows its subtree at once, the heaviest child first.

    parent: (n,), above its children or -1; size: of each node.
    """
    n = parent.shape[0]
    weight = size.copy()
    for k in range(n):
        if parent[k] >= 0:
            weight[parent[k]] += weight[k]
    head, after = np.full(n + 1, -1, np.int64), np.full(n, -1, np.int64)
    by_weight = np.argsort(weight, kind="mergesort")
    for s in range(n):  # the lightest is put in first, so the heaviest stands at the head
        k = by_weight[s]
        p = parent[k] if parent[k] >= 0 else n
        after[k] = head[p]
        head[p] = k
    out, stack = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    top, many = 0, 0
    stack[0] = n
    while top >= 0:
        k = stack[top]
        below = head[k]
        if below >= 0:
            head[k] = after[below]
            top += 1
            stack[top] = below
        else:
            top -= 1
            if k < n:
                out[many] = k
                many += 1
    return out


@kernel
def supernodes(parent: np.ndarray, height: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(s + 1,) where each supernode begins: nodes with the same rows, and runs of few enough zeros.

    height: (n,) variables below each node's own in its column of the factor; size: variables of each node.
    """
    n = parent.shape[0]
    begin = np.empty(n + 1, np.int64)
    many = 0
    for k in range(n):
        joins = k > 0 and parent[k - 1] == k and height[k - 1] == height[k] + size[k]
        if not joins:
            begin[many] = k
            many += 1
    begin[many] = n
    wide, high = np.zeros(many, np.int64), np.empty(many, np.int64)  # columns; rows below them
    zeros = np.zeros(many)
    for s in range(many):
        for k in range(begin[s], begin[s + 1]):
            wide[s] += size[k]
        high[s] = height[begin[s + 1] - 1]
    keep = np.ones(many, np.bool_)
    above = many - 1  # the supernode that begins right after s, with all that was joined to it
    for s in range(many - 2, -1, -1):
        last = begin[s + 1] - 1
        if parent[last] == last + 1:
            w, h = wide[s] + wide[above], high[above]
            more = zeros[s] + zeros[above] + wide[s] * (wide[above] + h - high[s])
            share = more / (0.5 * w * (w + 1) + w * h)
            if share < MOST_ZEROS or (w <= SMALL and share < SMALL_ZEROS) or (w <= MIDDLE and share < MIDDLE_ZEROS):
                wide[s], high[s], zeros[s] = w, h, more
                keep[above] = False
        above = s
    out = np.empty(many + 1, np.int64)
    kept = 0
    for s in range(many):
        if keep[s]:
            out[kept] = begin[s]
            kept += 1
    out[kept] = n
    return out[: kept + 1]


@kernel
def with_room(found: np.ndarray, room: int) -> np.ndarray:
    """`found`, or twice as much room (and again) with the same at its beginning, so that there is room enough."""
    while room > found.shape[0]:
        wider = np.empty(2 * found.shape[0], np.int64)
        wider[: found.shape[0]] = found
        found = wider
    return found


@kernel
def gather(rows: np.ndarray, last: int, s: int, mark: np.ndarray, out: np.ndarray, found: int) -> int:
    """Those of `rows` from `last` on that do not yet bear the mark s, put to `out[found:]` and marked; how many."""
    for r in rows:
        if r >= last and mark[r] != s:
            mark[r] = s
            out[found] = r
            found += 1
    return found


@kernel
def supernode_rows(
    begin: np.ndarray, start: np.ndarray, rows: np.ndarray, parent: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Starts, and the nodes after each supernode that it touches, itself or through its children (ascending).

    start, rows: the graph above the diagonal, by column; parent: of each supernode, later than it, or -1.
    """
    many, n = begin.shape[0] - 1, begin[-1]
    below = np.zeros(n + 1, np.int64)
    for e in range(rows.shape[0]):
        below[rows[e] + 1] += 1
    below = np.cumsum(below)
    later, end = np.empty(rows.shape[0], np.int64), below[:-1].copy()
    for k in range(n):
        for e in range(start[k], start[k + 1]):
            later[end[rows[e]]] = k
            end[rows[e]] += 1
    out, at = np.empty(4 * n + 16, np.int64), np.zeros(many + 1, np.int64)
    mark = np.full(n, -1, np.int64)
    head, after = np.full(many, -1, np.int64), np.full(many, -1, np.int64)
    for s in range(many):
        last, first = begin[s + 1], at[s]
        found = first
        out = with_room(out, found + n - last)
        found = gather(later[below[begin[s]] : below[last]], last, s, mark, out, found)
        c = head[s]
        while c >= 0:
            found = gather(out[at[c] : at[c + 1]], last, s, mark, out, found)
            c = after[c]
        out[first:found] = np.sort(out[first:found])
        at[s + 1] = found
        if parent[s] >= 0:
            after[s] = head[parent[s]]
            head[parent[s]] = s
    return at, out[: at[many]].copy()


@kernel
def column_heights(start: np.ndarray, rows: np.ndarray, parent: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(n,) how many variables stand below each node's own in its column of the factor; size: variables of each."""
    n = size.shape[0]
    out = np.zeros(n, np.int64)
    mark, path, row = np.full(n, -1, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        for t in range(reach(k, start, rows, parent, mark, path, row), n):
            out[row[t]] += size[k]
    return out


@kernel
def expanded(nodes: np.ndarray, first: np.ndarray, members: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, ...]:
    """The variables of `nodes` one after the other, and how many each of the stretches `starts` of nodes holds."""
    count = np.zeros(starts.shape[0] - 1, np.int64)
    many = 0
    for s in range(count.shape[0]):
        for e in range(starts[s], starts[s + 1]):
            count[s] += first[nodes[e] + 1] - first[nodes[e]]
        many += count[s]
    out = np.empty(many, np.int64)
    many = 0
    for e in range(starts[0], starts[-1]):
        for m in range(first[nodes[e]], first[nodes[e] + 1]):
            out[many] = members[m]
            many += 1
    return out, count


@kernel
def rooms(
    parent: np.ndarray, family: np.ndarray, children: np.ndarray, begin: np.ndarray, own: np.ndarray
) -> np.ndarray:
    """(2, fronts) where each update lies on a stack, and each part of the inverse; the last column: how much room.

    Fronts follow their subtrees at once. A part of the inverse is needed until all children of its front have theirs.
    """
    many = own.shape[0]
    out, top = np.zeros((2, many + 1), np.int64), 0
    for i in range(many):
        if family[i] < family[i + 1]:
            top = out[0, children[family[i]]]
        out[0, i] = top
        top += (begin[i + 1] - begin[i] - own[i]) ** 2
        out[0, many] = max(out[0, many], top)
    for i in range(many - 1, -1, -1):
        p = parent[i]
        if p >= 0:
            out[1, i] = out[1, p]
            if children[family[p]] != i:  # its siblings come later
                out[1, i] += (begin[p + 1] - begin[p]) ** 2
        out[1, many] = max(out[1, many], out[1, i] + (begin[i + 1] - begin[i]) ** 2)
    return out


@kernel
def places(
    indptr: np.ndarray,
    indices: np.ndarray,
    rank: np.ndarray,
    begin: np.ndarray,
    index: np.ndarray,
    own: np.ndarray,
    family: np.ndarray,
    children: np.ndarray,
    panel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the numbers go: slots of the matrix's data, their places among all panels, and fronts into their parents.

    rank: (n,) of every variable; front i holds the variables `index[begin[i]:begin[i + 1]]`, the first `own[i]` its
    own; the two parts of its panel, (own, own) and (others, own), begin at `panel[i]`, each column after column.
    into: beside `index`, the place in the parent of each variable that is not the front's own.
    """
    local = np.full(rank.shape[0], -1, np.int64)
    into = np.zeros(index.shape[0], np.int64)
    half = (indices.shape[0] + rank.shape[0]) // 2
    slot, place = np.empty(half, np.int64), np.empty(half, np.int64)
    found = 0
    for i in range(own.shape[0]):
        b, p, q = begin[i], own[i], begin[i + 1] - begin[i] - own[i]
        for a in range(p + q):
            local[index[b + a]] = a
        for c in children[family[i] : family[i + 1]]:
            for e in range(begin[c] + own[c], begin[c + 1]):
                into[e] = local[index[e]]
        for a in range(p):
            v = index[b + a]
            for s in range(indptr[v], indptr[v + 1]):
                if rank[indices[s]] >= rank[v]:
                    r = local[indices[s]]
                    slot[found] = s
                    place[found] = panel[i] + (a * p + r if r < p else p * p + a * q + r - p)
                    found += 1
    return slot[:found], place[:found], into


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


@kernel
def take_column(to: np.ndarray, by: np.ndarray, factor: float) -> None:
    """`to -= factor by`."""
    for r in range(to.shape[0]):
        to[r] -= factor * by[r]


@kernel
def take_four(
    to: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, u: float, v: float, w: float, z: float
) -> None:
    """`to -= u a + v b + w c + z d`."""
    for r in range(to.shape[0]):
        to[r] -= u * a[r] + v * b[r] + w * c[r] + z * d[r]


@kernel
def take_columns(
    to: np.ndarray, A: np.ndarray, rows: int, first: int, B: np.ndarray, step: int, at: int, m: int
) -> None:
    """`to -= A[first:, :m] B[at, :m]^T`, A of so many `rows` and B of `step`, both column after column."""
    n, j = to.shape[0], 0
    while j + 4 <= m:
        a, b = j * rows + first, j * step + at
        take_four(
            to,
            A[a : a + n],
            A[a + rows : a + rows + n],
            A[a + 2 * rows : a + 2 * rows + n],
            A[a + 3 * rows : a + 3 * rows + n],
            B[b],
            B[b + step],
            B[b + 2 * step],
            B[b + 3 * step],
        )
        j += 4
    while j < m:
        take_column(to, A[j * rows + first : j * rows + first + n], B[j * step + at])
        j += 1


@kernel
def add_update(update: np.ndarray, into: np.ndarray, P: np.ndarray, p: int, R: np.ndarray, q: int) -> None:
    """A child's update (its lower triangle) added to the panel P of its parent and to the rest R (q, q)."""
    w = into.shape[0]
    near = 0  # of the parent's own
    while near < w and into[near] < p:
        near += 1
    for a in range(near):
        c = into[a]
        for b in range(a, near):
            P[c * p + into[b]] += update[a * w + b]
        at = p * p + c * q - p
        for b in range(near, w):
            P[at + into[b]] += update[a * w + b]
    for a in range(near, w):
        at = (into[a] - p) * q - p
        for b in range(a, w):
            R[at + into[b]] += update[a * w + b]


@kernel
def factor_columns(P: np.ndarray, p: int, q: int) -> bool:
    """The panel P (p and q rows, p columns) factorised in place; False where a pivot is not positive."""
    below = P[p * p :]
    for j in range(p):
        take_columns(P[j * p + j : (j + 1) * p], P, p, j, P, p, j, j)
        if not P[j * p + j] > 0.0:
            return False
        d = np.sqrt(P[j * p + j])
        P[j * p + j] = d
        for r in range(j * p + j + 1, (j + 1) * p):
            P[r] /= d
        column = below[j * q : (j + 1) * q]
        take_columns(column, below, q, 0, P, p, j, j)
        for r in range(q):
            column[r] /= d
    return True


class Fronts(NamedTuple):
    """Where each front stands: its variables, how many are its own, their places in its parent, its panel of L."""

    begin: np.ndarray
    own: np.ndarray
    into: np.ndarray
    panel: np.ndarray
    L: np.ndarray


@kernel
def factor_fronts(
    first: int,
    last: int,
    fronts: Fronts,
    family: np.ndarray,
    children: np.ndarray,
    room: np.ndarray,
    updates: np.ndarray,
    rest: np.ndarray,
) -> int:
    """The fronts first:last factorised in place; -1, or the front with a pivot that is not positive.

    rest: scratch for the largest update.
    """
    begin, own, into, panel, L = fronts
    for i in range(first, last):
        p = own[i]
        q = begin[i + 1] - begin[i] - p
        P = L[panel[i] : panel[i + 1]]
        below = P[p * p :]
        lonely = family[i] == family[i + 1]
        R = updates[room[i] : room[i] + q * q] if lonely else rest[: q * q]
        R[:] = 0.0
        for c in children[family[i] : family[i + 1]]:
            w = begin[c + 1] - begin[c] - own[c]
            add_update(updates[room[c] : room[c] + w * w], into[begin[c] + own[c] : begin[c + 1]], P, p, R, q)
        if not factor_columns(P, p, q):
            return i
        for a in range(q):
            take_columns(R[a * q + a : (a + 1) * q], below, q, a, below, q, a, p)
        if not lonely:
            updates[room[i] : room[i] + q * q] = R
    return -1


@kernel
def forward_fronts(
    first: int,
    last: int,
    begin: np.ndarray,
    own: np.ndarray,
    index: np.ndarray,
    panel: np.ndarray,
    L: np.ndarray,
    x: np.ndarray,
) -> None:
    """Every row of x (c, n) carried past the fronts first:last: `L^-1 x`. Zeros cost nothing."""
    v = np.empty(0)
    for i in range(first, last):
        at, p = index[begin[i] : begin[i + 1]], own[i]
        k = at.shape[0]
        q = k - p
        P = L[panel[i] : panel[i + 1]]
        if v.shape[0] < k:
            v = np.empty(2 * k)
        for c in range(x.shape[0]):
            zeros = 0
            while zeros < p and x[c, at[zeros]] == 0.0:
                zeros += 1
            if zeros == p:
                continue
            for r in range(k):
                v[r] = x[c, at[r]]
            for j in range(p):
                v[j] /= P[j * p + j]
                take_column(v[j + 1 : p], P[j * p + j + 1 : (j + 1) * p], v[j])
            take_columns(v[p:k], P[p * p :], q, 0, v, 1, 0, p)
            for r in range(k):
                x[c, at[r]] = v[r]


@kernel
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Sum of products; four sums side by side, which is faster than one."""
    n = a.shape[0]
    s, t, u, v, r = 0.0, 0.0, 0.0, 0.0, 0
    while r + 4 <= n:
        s += a[r] * b[r]
        t += a[r + 1] * b[r + 1]
        u += a[r + 2] * b[r + 2]
        v += a[r + 3] * b[r + 3]
        r += 4
    while r < n:
        s += a[r] * b[r]
        r += 1
    return float((s + t) + (u + v))


@kernel
def backward_fronts(
    first: int,
    last: int,
    begin: np.ndarray,
    own: np.ndarray,
    index: np.ndarray,
    panel: np.ndarray,
    L: np.ndarray,
    x: np.ndarray,
) -> None:
    """Every row of x (c, n) carried back from front last - 1 to first: `L^-T x`."""
    v = np.empty(0)
    for i in range(last - 1, first - 1, -1):
        at, p = index[begin[i] : begin[i + 1]], own[i]
        k = at.shape[0]
        q = k - p
        P = L[panel[i] : panel[i + 1]]
        below = P[p * p :]
        if v.shape[0] < k:
            v = np.empty(2 * k)
        for c in range(x.shape[0]):
            for r in range(k):
                v[r] = x[c, at[r]]
            for j in range(p - 1, -1, -1):
                known = dot(below[j * q : (j + 1) * q], v[p:k]) + dot(P[j * p + j + 1 : (j + 1) * p], v[j + 1 : p])
                v[j] = (v[j] - known) / P[j * p + j]
                x[c, at[j]] = v[j]


@kernel
def copy_known(full: np.ndarray, p: int, Z: np.ndarray, wide: int, where: np.ndarray) -> None:
    """The rows and columns of `full` from p on become those `where` of Z, (wide, wide) row after row."""
    for a in range(where.shape[0]):
        row = Z[where[a] * wide : (where[a] + 1) * wide]
        for b in range(where.shape[0]):
            full[p + a, p + b] = row[where[b]]


@kernel
def inverse_columns(full: np.ndarray, P: np.ndarray, p: int) -> None:
    """The first p rows and columns of an inverse whose others are known, from the last to the first.

    The recursion of Takahashi, Fagan and Chin (1973).
    """
    k = full.shape[0]
    q, column = k - p, np.empty(k)
    for j in range(p - 1, -1, -1):
        d = P[j * p + j]
        column[j + 1 : p] = P[j * p + j + 1 : (j + 1) * p] / d
        column[p:] = P[p * p + j * q : p * p + (j + 1) * q] / d
        to = full[j, j + 1 :]
        for r in range(j + 1, k):
            take_column(to, full[r, j + 1 :], column[r])
        full[j, j] = 1.0 / (d * d) - dot(column[j + 1 :], to)
        full[j + 1 :, j] = to


@kernel
def inverse_fronts(
    first: int,
    last: int,
    fronts: Fronts,
    parent: np.ndarray,
    room: np.ndarray,
    Z: np.ndarray,
    asked: np.ndarray,
    ends: np.ndarray,
    local: np.ndarray,
    out: np.ndarray,
) -> None:
    """The inverse over the variables of each front from last - 1 down to first, full and symmetric, in Z from `room`.

    A parent's must be there already; its last child's may take its place. asked[ends[i]:ends[i + 1]]: the rows of `out`
    (b, m, m) wanted of front i, over its variables `local` (b, m).
    """
    begin, own, into, panel, L = fronts
    m = local.shape[1]
    for i in range(last - 1, first - 1, -1):
        k, p, up = begin[i + 1] - begin[i], own[i], parent[i]
        q = k - p
        full = np.zeros((k, k))
        if q:
            copy_known(full, p, Z[room[up] :], begin[up + 1] - begin[up], into[begin[i] + p : begin[i + 1]])
        inverse_columns(full, L[panel[i] : panel[i + 1]], p)
        Z[room[i] : room[i] + k * k] = full.ravel()
        for e in range(ends[i], ends[i + 1]):
            for a in range(m):
                for b in range(m):
                    out[asked[e], a, b] = full[local[asked[e], a], local[asked[e], b]]
