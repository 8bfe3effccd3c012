"""The factorised information matrix: solving with it, and reading covariances out of it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from ..core.gaussian import symmetrise
from .cholesky import Cholesky, NotPositiveError
from .fronts import Elimination

CHUNK = 256  # right-hand sides solved together


class SingularError(ArithmeticError):
    """The information matrix has no inverse: something is not observed, or the gauge is free."""


@dataclass(frozen=True, slots=True)
class Information:
    """An information matrix over n variables with its sparse factor; its inverse is the covariance."""

    matrix: sp.csc_matrix
    factor: Any = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, elimination: Elimination | None = None) -> "Information":
        """`matrix` (symmetric, positive definite, both triangles stored) factorised; raises SingularError.

        With an `elimination` made for this pattern the factor is multifrontal: many times faster on large graphs.
        """
        try:
            if elimination is not None:
                return cls(matrix, Cholesky.of(matrix, elimination))
            factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except (RuntimeError, NotPositiveError) as error:  # the first is SuperLU's own word for a zero pivot
            raise SingularError(str(error)) from None
        return cls(matrix, factor)

    def dissected(
        self, group: Int[np.ndarray, " n"], coordinates: Float[np.ndarray, "n d"] | None = None
    ) -> "Information":
        """The same matrix factorised by nested dissection: `blocks` of all groups then cost little more.

        group: which variables belong together (a pose, a point), by any number; coordinates: where each variable lies
        (in space, in time), those of one group alike; found from the pattern when None. Raises SingularError.
        """
        first = np.unique(group, return_index=True)[1]
        where = None if coordinates is None else coordinates[first]
        return Information.of(self.matrix, Elimination.of(self.matrix, group, where))

    @property
    def size(self) -> int:
        return int(self.matrix.shape[0])

    @property
    def factor_bytes(self) -> int:
        """What the two triangular factors hold: eight bytes a value and four an index."""
        return 12 * int(self.factor.nnz)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """`matrix^-1 b` for b (n,) or (n, c)."""
        return np.asarray(self.factor.solve(np.ascontiguousarray(b, dtype=float)))

    def pivots(self) -> Float[np.ndarray, " n"]:
        """The pivots of elimination: all positive exactly when the matrix is positive definite."""
        return self.factor.pivots() if isinstance(self.factor, Cholesky) else np.asarray(self.factor.U.diagonal())

    def logdet(self) -> float:
        """Log det of the information; the covariance's is its negative. Raises SingularError when not positive."""
        pivots = self.pivots()
        if not (pivots > 0).all():
            raise SingularError("the information matrix is not positive definite")
        return float(np.log(pivots).sum())

    def columns(self, index: Int[np.ndarray, " k"]) -> Float[np.ndarray, "n k"]:
        """The columns `index` of the covariance."""
        out = np.empty((self.size, len(index)))
        for start in range(0, len(index), CHUNK):
            part = index[start : start + CHUNK]
            unit = np.zeros((self.size, len(part)))
            unit[part, np.arange(len(part))] = 1.0
            out[:, start : start + len(part)] = self.solve(unit)
        return out

    def covariance(self, index: Int[np.ndarray, " k"] | None = None) -> Float[np.ndarray, "k k"]:
        """The joint covariance over the variables `index` (all when None), symmetric."""
        index = np.arange(self.size) if index is None else np.asarray(index)
        P = np.empty((len(index), len(index)))
        for start in range(0, len(index), CHUNK):
            P[:, start : start + CHUNK] = self.columns(index[start : start + CHUNK])[index]
        return symmetrise(P)

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """For each row of `index`, the covariance over those k variables: marginals without the full inverse."""
        if isinstance(self.factor, Cholesky) and self.factor.together(index):
            return self.factor.blocks(index)
        b, k = index.shape
        out = np.empty((b, k, k))
        step = max(1, CHUNK // k)
        for start in range(0, b, step):
            part = index[start : start + step]
            C = self.columns(part.ravel()).reshape(self.size, len(part), k)
            out[start : start + step] = C[part[:, :, None], np.arange(len(part))[:, None, None], np.arange(k)]
        return np.asarray(0.5 * (out + out.swapaxes(1, 2)))
