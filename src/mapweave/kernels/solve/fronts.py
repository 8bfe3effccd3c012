"""Adding a child's update matrix into its parent front."""

import numpy as np

from .._jit import kernel


@kernel
def extend_add(front: np.ndarray, update: np.ndarray, where: np.ndarray) -> None:
    """`front[where, where] += update` on the lower triangles; `where` ascending, both Fortran-ordered."""
    for c in range(len(where)):
        col = where[c]
        for r in range(c, len(where)):
            front[where[r], col] += update[r, c]
