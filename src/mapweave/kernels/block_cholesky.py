"""Sparse Cholesky over blocks of three variables, row by row: `A = L L^T` in the order given.

Blocks lie column by column: those of column j are `start[j]:start[j + 1]`, rows ascending. Row k of L follows from the
rows above by a triangular solve that visits what the elimination tree says [Davis06, ch. 4].
"""

import numpy as np

from ._jit import kernel


@kernel
def elimination_tree(start: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(n,) the column each is a child of, -1 for a root; columns hold the rows above the diagonal."""
    n = start.shape[0] - 1
    parent = np.full(n, -1, np.int64)
    ancestor = np.full(n, -1, np.int64)
    for k in range(n):
        for p in range(start[k], start[k + 1]):
            i = rows[p]
            while i != -1 and i < k:
                above = ancestor[i]
                ancestor[i] = k
                if above == -1:
                    parent[i] = k
                i = above
    return parent


@kernel
def reach(
    k: int, start: np.ndarray, rows: np.ndarray, parent: np.ndarray, mark: np.ndarray, path: np.ndarray, out: np.ndarray
) -> int:
    """Where row k of L is not zero: out[top:], children before parents; returns top. mark: (n,) of earlier rows."""
    top = out.shape[0]
    mark[k] = k
    for p in range(start[k], start[k + 1]):
        i, depth = rows[p], 0
        while mark[i] != k:
            path[depth] = i
            depth += 1
            mark[i] = k
            i = parent[i]
        while depth > 0:
            depth -= 1
            top -= 1
            out[top] = path[depth]
    return int(top)


@kernel
def factor_columns(start: np.ndarray, rows: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """(n + 1,) where each column of L begins; its diagonal block is not counted."""
    n = start.shape[0] - 1
    count = np.zeros(n + 1, np.int64)
    mark, path, out = np.full(n, -1, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        top = reach(k, start, rows, parent, mark, path, out)
        for t in range(top, n):
            count[out[t] + 1] += 1
    return np.cumsum(count)


@kernel
def put_block(to: np.ndarray, t: int, A: np.ndarray, a: int, factor: float) -> None:
    """`to[t] = factor A[a]`, both 3x3. A loop: sliced assignment takes long to compile."""
    for x in range(3):
        for y in range(3):
            to[t, x, y] = factor * A[a, x, y]


@kernel
def take_product(to: np.ndarray, t: int, A: np.ndarray, a: int, B: np.ndarray, b: int) -> None:
    """`to[t] -= A[a] B[b]`, all 3x3."""
    for x in range(3):
        u, v, w = A[a, x, 0], A[a, x, 1], A[a, x, 2]
        to[t, x, 0] -= u * B[b, 0, 0] + v * B[b, 1, 0] + w * B[b, 2, 0]
        to[t, x, 1] -= u * B[b, 0, 1] + v * B[b, 1, 1] + w * B[b, 2, 1]
        to[t, x, 2] -= u * B[b, 0, 2] + v * B[b, 1, 2] + w * B[b, 2, 2]


@kernel
def take_transposed(to: np.ndarray, t: int, A: np.ndarray, a: int, B: np.ndarray, b: int) -> None:
    """`to[t] -= A[a]^T B[b]`, all 3x3."""
    for x in range(3):
        u, v, w = A[a, 0, x], A[a, 1, x], A[a, 2, x]
        to[t, x, 0] -= u * B[b, 0, 0] + v * B[b, 1, 0] + w * B[b, 2, 0]
        to[t, x, 1] -= u * B[b, 0, 1] + v * B[b, 1, 1] + w * B[b, 2, 1]
        to[t, x, 2] -= u * B[b, 0, 2] + v * B[b, 1, 2] + w * B[b, 2, 2]


@kernel
def below_by(Y: np.ndarray, D: np.ndarray, i: int, X: np.ndarray) -> None:
    """`Y[0] = D[i]^-1 X[i]` for D[i] lower, and X[i] zero."""
    for b in range(3):
        Y[0, 0, b] = X[i, 0, b] / D[i, 0, 0]
        Y[0, 1, b] = (X[i, 1, b] - D[i, 1, 0] * Y[0, 0, b]) / D[i, 1, 1]
        Y[0, 2, b] = (X[i, 2, b] - D[i, 2, 0] * Y[0, 0, b] - D[i, 2, 1] * Y[0, 1, b]) / D[i, 2, 2]
        X[i, 0, b] = X[i, 1, b] = X[i, 2, b] = 0.0


@kernel
def spread(X: np.ndarray, L: np.ndarray, L_rows: np.ndarray, first: int, end: int, Y: np.ndarray) -> None:
    """`X[r] -= L[p] Y[0]` for the blocks first:end of L and their rows r. Y is read once: that is the speed of it."""
    y00, y01, y02 = Y[0, 0, 0], Y[0, 0, 1], Y[0, 0, 2]
    y10, y11, y12 = Y[0, 1, 0], Y[0, 1, 1], Y[0, 1, 2]
    y20, y21, y22 = Y[0, 2, 0], Y[0, 2, 1], Y[0, 2, 2]
    for p in range(first, end):
        r = L_rows[p]
        for a in range(3):
            u, v, w = L[p, a, 0], L[p, a, 1], L[p, a, 2]
            X[r, a, 0] -= u * y00 + v * y10 + w * y20
            X[r, a, 1] -= u * y01 + v * y11 + w * y21
            X[r, a, 2] -= u * y02 + v * y12 + w * y22


@kernel
def root_of(D: np.ndarray, k: int) -> bool:
    """D[k], 3x3 symmetric, becomes its lower Cholesky factor; False when it is not positive definite."""
    a = D[k, 0, 0]
    if not a > 0.0:
        return False
    l00 = np.sqrt(a)
    l10, l20 = D[k, 1, 0] / l00, D[k, 2, 0] / l00
    b = D[k, 1, 1] - l10 * l10
    if not b > 0.0:
        return False
    l11 = np.sqrt(b)
    l21 = (D[k, 2, 1] - l20 * l10) / l11
    c = D[k, 2, 2] - l20 * l20 - l21 * l21
    if not c > 0.0:
        return False
    D[k, 0, 0], D[k, 1, 0], D[k, 1, 1] = l00, l10, l11
    D[k, 2, 0], D[k, 2, 1], D[k, 2, 2] = l20, l21, np.sqrt(c)
    D[k, 0, 1] = D[k, 0, 2] = D[k, 1, 2] = 0.0
    return True


@kernel
def block_cholesky(
    diagonal: np.ndarray,
    above: np.ndarray,
    start: np.ndarray,
    rows: np.ndarray,
    parent: np.ndarray,
    begin: np.ndarray,
    L_diagonal: np.ndarray,
    L: np.ndarray,
    L_rows: np.ndarray,
) -> int:
    """L_diagonal (n, 3, 3), lower, L (m, 3, 3) and their rows, filled; -1, or the block whose pivot is not positive.

    diagonal: (n, 3, 3) and above: those of A above it, by column as `start` and `rows` say. A column of L begins at
    `begin`.
    """
    n = diagonal.shape[0]
    end = begin[:-1].copy()
    mark, path, out = np.full(n, -1, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    X, Y = np.zeros((n, 3, 3)), np.empty((1, 3, 3))
    for k in range(n):
        top = reach(k, start, rows, parent, mark, path, out)
        put_block(L_diagonal, k, diagonal, k, 1.0)
        for p in range(start[k], start[k + 1]):
            put_block(X, rows[p], above, p, 1.0)
        for t in range(top, n):
            i = out[t]
            below_by(Y, L_diagonal, i, X)
            spread(X, L, L_rows, begin[i], end[i], Y)
            take_transposed(L_diagonal, k, Y, 0, Y, 0)
            L_rows[end[i]] = k
            for a in range(3):
                for b in range(3):
                    L[end[i], a, b] = Y[0, b, a]
            end[i] += 1
        if not root_of(L_diagonal, k):
            return k
    return -1


@kernel
def lower_solve(D: np.ndarray, j: int, x: np.ndarray) -> None:
    """`x[j]` (3, c) becomes `D[j]^-1 x[j]` for D[j] lower."""
    for q in range(x.shape[2]):
        x[j, 0, q] /= D[j, 0, 0]
        x[j, 1, q] = (x[j, 1, q] - D[j, 1, 0] * x[j, 0, q]) / D[j, 1, 1]
        x[j, 2, q] = (x[j, 2, q] - D[j, 2, 0] * x[j, 0, q] - D[j, 2, 1] * x[j, 1, q]) / D[j, 2, 2]


@kernel
def upper_solve(D: np.ndarray, j: int, x: np.ndarray) -> None:
    """`x[j]` (3, c) becomes `D[j]^-T x[j]` for D[j] lower."""
    for q in range(x.shape[2]):
        x[j, 2, q] /= D[j, 2, 2]
        x[j, 1, q] = (x[j, 1, q] - D[j, 2, 1] * x[j, 2, q]) / D[j, 1, 1]
        x[j, 0, q] = (x[j, 0, q] - D[j, 1, 0] * x[j, 1, q] - D[j, 2, 0] * x[j, 2, q]) / D[j, 0, 0]


@kernel
def block_solve(L_diagonal: np.ndarray, L: np.ndarray, begin: np.ndarray, L_rows: np.ndarray, x: np.ndarray) -> None:
    """`x` (n, 3, c) becomes `A^-1 x`."""
    n, c = x.shape[0], x.shape[2]
    for j in range(n):
        lower_solve(L_diagonal, j, x)
        for p in range(begin[j], begin[j + 1]):
            r = L_rows[p]
            for a in range(3):
                u, v, w = L[p, a, 0], L[p, a, 1], L[p, a, 2]
                for q in range(c):
                    x[r, a, q] -= u * x[j, 0, q] + v * x[j, 1, q] + w * x[j, 2, q]
    for j in range(n - 1, -1, -1):
        for p in range(begin[j], begin[j + 1]):
            r = L_rows[p]
            for a in range(3):
                u, v, w = L[p, 0, a], L[p, 1, a], L[p, 2, a]
                for q in range(c):
                    x[j, a, q] -= u * x[r, 0, q] + v * x[r, 1, q] + w * x[r, 2, q]
        upper_solve(L_diagonal, j, x)


@kernel
def lower_inverse(D: np.ndarray, j: int, out: np.ndarray) -> None:
    """`out[0] = D[j]^-1` for D[j] lower."""
    for b in range(3):
        out[0, b, b] = 1.0 / D[j, b, b]
    out[0, 1, 0] = -D[j, 1, 0] * out[0, 0, 0] * out[0, 1, 1]
    out[0, 2, 1] = -D[j, 2, 1] * out[0, 1, 1] * out[0, 2, 2]
    out[0, 2, 0] = -(D[j, 2, 0] * out[0, 0, 0] + D[j, 2, 1] * out[0, 1, 0]) * out[0, 2, 2]


@kernel
def block_inverse(
    L_diagonal: np.ndarray, L: np.ndarray, begin: np.ndarray, L_rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3, 3) diagonal blocks of `A^-1` and (m, 3, 3) those where L has one: from the last column to the first."""
    n, m = L_diagonal.shape[0], L.shape[0]
    out, Z = np.zeros((n, 3, 3)), np.zeros((m, 3, 3))
    W, inv = np.zeros((m, 3, 3)), np.zeros((1, 3, 3))  # W: L times the inverse of its diagonal block, negative
    for j in range(n - 1, -1, -1):
        lower_inverse(L_diagonal, j, inv)
        b, e = begin[j], begin[j + 1]
        for p in range(b, e):
            take_product(W, p, L, p, inv, 0)
        for p in range(b, e):
            r = L_rows[p]
            take_product(Z, p, out, r, W, p)
            s = begin[r]
            for q in range(p + 1, e):
                while L_rows[s] != L_rows[q]:
                    s += 1
                take_product(Z, q, Z, s, W, p)
                take_transposed(Z, p, Z, s, W, q)
        for p in range(b, e):
            put_block(Z, p, Z, p, -1.0)
        take_transposed(out, j, inv, 0, inv, 0)
        for p in range(b, e):
            take_transposed(out, j, W, p, Z, p)
        put_block(out, j, out, j, -1.0)
    return out, Z
