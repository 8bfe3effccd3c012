"""Orders of little fill."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Int
from scipy.sparse.linalg import splu

FEWEST = 3  # nodes for which any order is good


def least_fill(graph: sp.csr_array, chosen: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """The `chosen` nodes of `graph` (symmetric, with its diagonal) in an order of minimum degree."""
    at = np.flatnonzero(chosen)
    n = len(at)
    if n < FEWEST:
        return at
    tied = sp.csc_matrix(graph[at][:, at], dtype=float)
    tied.data[:] = -1.0
    tied.setdiag(1.0 + np.diff(tied.indptr))  # dominated by the diagonal
    factor = splu(tied, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return at[np.argsort(factor.perm_c)].astype(np.int64)
