"""Dense matrices in plain loops.

Small ones: compiled in a fraction of the time that linear algebra calls take. Symmetric ones, of which BLAS computes
one triangle. Fronts of a sparse factorisation, into which the updates of their children are added.
"""

from typing import TypeAlias

import numpy as np

from ._jit import kernel

Array: TypeAlias = np.ndarray


@kernel
def put(to: Array, new: Array) -> None:
    """`to` (n, m) becomes the first n rows and m columns of `new`. A loop: sliced assignment takes long to compile."""
    for i in range(to.shape[0]):
        for j in range(to.shape[1]):
            to[i, j] = new[i, j]


@kernel
def add_product(to: Array, A: Array, B: Array, factor: float) -> None:
    """`to += factor * A @ B`, in place; `to` is neither `A` nor `B`."""
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            a = factor * A[i, k]
            for j in range(B.shape[1]):
                to[i, j] += a * B[k, j]


@kernel
def product(A: Array, B: Array) -> Array:
    """`A @ B`, contiguous."""
    out = np.zeros((A.shape[0], B.shape[1]))
    add_product(out, A, B, 1.0)
    return out


@kernel
def transposed(A: Array) -> Array:
    """`A^T`, contiguous."""
    out = np.empty((A.shape[1], A.shape[0]))
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            out[j, i] = A[i, j]
    return out


@kernel
def solved(A: Array, B: Array) -> Array:
    """`A^-1 B` for a small positive definite A (n, n), by Cholesky."""
    n = A.shape[0]
    L, X = np.zeros((n, n)), B.copy()
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(total, 1e-300)) if i == j else total / L[j, j]
    for c in range(X.shape[1]):
        for i in range(n):
            for k in range(i):
                X[i, c] -= L[i, k] * X[k, c]
            X[i, c] /= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                X[i, c] -= L[k, i] * X[k, c]
            X[i, c] /= L[i, i]
    return X


LINE = 8  # numbers in a cache line


@kernel
def mirror(P: np.ndarray) -> None:
    """The triangle of P (n, n) above the diagonal becomes that below it, in place.

    Eight rows are read side by side, so that whole cache lines are written: more than twice as fast as one by one.
    """
    n = len(P)
    whole = n - n % LINE
    for i in range(0, whole, LINE):
        a, b, c, d = P[i], P[i + 1], P[i + 2], P[i + 3]
        e, f, g, h = P[i + 4], P[i + 5], P[i + 6], P[i + 7]
        for j in range(i):
            to = P[j, i : i + LINE]
            to[0], to[1], to[2], to[3] = a[j], b[j], c[j], d[j]
            to[4], to[5], to[6], to[7] = e[j], f[j], g[j], h[j]
        for j in range(i, i + LINE):
            for k in range(i, j):
                P[k, j] = P[j, k]
    for i in range(whole, n):
        for j in range(i):
            P[j, i] = P[i, j]


@kernel
def extend_add(front: np.ndarray, update: np.ndarray, where: np.ndarray) -> None:
    """`front[where, where] += update` on the lower triangles; `where` ascending, both Fortran-ordered."""
    for c in range(len(where)):
        col = where[c]
        for r in range(c, len(where)):
            front[where[r], col] += update[r, c]
