"""Small dense fronts of a sparse Cholesky factor, a whole run of them in one call.

Front i holds the variables `index[begin[i]:begin[i + 1]]`, the first `own[i]` of which it eliminates. Its part of the
factor lies in `L` from `panel[i]`: (own, own), then (others, own), both column after column. What it gives its parent,
a lower triangle over the others, lies in `updates` from `room[i]`, each of them at the place `into` in the parent. Its
children are `children[family[i]:family[i + 1]]`.
"""

from typing import NamedTuple

import numpy as np

from ._jit import kernel


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
