"""The joint information of all robots of a swarm: one sparse matrix that every covariance among them comes from."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from ..core.gaussian import symmetrise
from ..core.records import frozen
from ..solve import Information


@dataclass(frozen=True, slots=True)
class JointInformation:
    """The information matrix (s, s) over `width` scalars a robot: its coordinates, then its heading where it has one.

    held: (s,) entries that are known (anchors) or fixed to hold the gauge; they have no rows of their own.
    """

    matrix: sp.csc_matrix
    held: Bool[np.ndarray, " s"]
    width: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "held", frozen(self.held, bool))

    def covariance(self, E: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "k k"]:
        """The covariance of the linear functions of the state whose gradients are the columns of E."""
        free = ~self.held
        known = Information.of(sp.csc_matrix(self.matrix[free][:, free]))
        return symmetrise(E[free].T @ known.solve(E[free]))

    def nees(self, error: Float[np.ndarray, "n d"], wanted: Bool[np.ndarray, " n"]) -> tuple[float, int]:
        """`e^T P^-1 e` over the positions of the robots `wanted` jointly, and its degrees of freedom.

        P is their joint covariance; the others, and headings, are marginalised out, and held entries do not count.
        """
        n, d = error.shape
        scored = np.zeros((n, self.width), dtype=bool)
        scored[wanted, :d] = True
        free = ~self.held
        keep, rest = np.flatnonzero(scored.ravel() & free), np.flatnonzero(~scored.ravel() & free)
        full = np.zeros((n, self.width))
        full[:, :d] = np.where(wanted[:, None], error, 0.0)
        e = full.ravel()[keep]
        A = sp.csr_matrix(self.matrix)
        value = float(e @ (A[keep][:, keep] @ e))
        g = A[rest][:, keep] @ e
        if np.any(g):
            value -= float(g @ Information.of(sp.csc_matrix(A[rest][:, rest])).solve(g))
        return value, len(keep)
