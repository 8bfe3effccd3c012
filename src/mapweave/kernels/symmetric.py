"""Large symmetric matrices, of which BLAS computes one triangle."""

import numpy as np

from ._jit import kernel

TILE = 32  # rows and columns moved at once: they stay in the fastest cache


@kernel
def mirror(P: np.ndarray) -> None:
    """The triangle of P (n, n) above the diagonal becomes that below it, in place."""
    n = len(P)
    for top in range(0, n, TILE):
        bottom = min(n, top + TILE)
        for left in range(0, bottom, TILE):
            for j in range(left, min(n, left + TILE)):
                row = P[j]
                for i in range(max(top, j + 1), bottom):
                    row[i] = P[i, j]
