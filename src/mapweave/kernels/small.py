"""Algebra of small dense matrices in plain loops: it compiles in a fraction of the time linear algebra calls take."""

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
