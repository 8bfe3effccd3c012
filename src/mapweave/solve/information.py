"""The information matrix: where every factor's block lands in it, its factorisation, solutions and covariances."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

from ..core.gaussian import symmetrise
from ..kernels.pattern import pattern_slots
from .block_cholesky import BLOCK, BlockCholesky, BlockOrder
from .elimination import Elimination
from .multifrontal import Cholesky, NotPositiveError
from .problem import Problem


@dataclass(frozen=True, slots=True)
class Pattern:
    """The sparsity of the information matrix over the free variables, and the slot of every block entry."""

    size: int
    indptr: Int[np.ndarray, " p"]
    indices: Int[np.ndarray, " nnz"]
    slots: tuple[np.ndarray, ...]  # for each term, (m d d,): its slot in the data, or nnz for a fixed variable
    rows: tuple[np.ndarray, ...]  # for each term, (m d,): its row of the gradient, or `size` for a fixed variable
    diagonal: Int[np.ndarray, " f"]
    elimination: Elimination | BlockOrder | None = None

    @classmethod
    def of(cls, problem: Problem) -> "Pattern":
        """The pattern of `problem`; valid as long as columns and fixed entries stay the same."""
        n = len(problem.x0)
        free = problem.free
        size = len(free)
        position = np.full(n, size, dtype=np.int64)
        position[free] = np.arange(size)
        rows = [position[term.columns] for term in problem.terms]
        wide = [np.full(len(r), r.shape[1]) for r in rows]
        width = np.concatenate([np.zeros(0, np.int64), *wide]).astype(np.int64)
        begin, room = (np.concatenate([[0], np.cumsum(w)]).astype(np.int64) for w in (width, width**2))
        flat = np.concatenate([np.zeros(0, np.int64), *(r.ravel() for r in rows)])
        indptr, indices, slots, diagonal = pattern_slots(flat, begin, room, size)
        ends = np.cumsum([r.size * r.shape[1] for r in rows])
        return cls(
            size=size,
            indptr=indptr.astype(np.int32),
            indices=indices.astype(np.int32),
            slots=tuple(np.split(slots, ends[:-1])) if rows else (),
            rows=tuple(r.ravel() for r in rows),
            diagonal=diagonal,
        )

    def dissected(self, group: Int[np.ndarray, " f"]) -> "Pattern":
        """The same pattern, to be factorised by nested dissection: pays from some thousand variables on.

        group: (f,) which variables belong together (a pose, a point), by any number; their joint covariances are
        then cheap for all groups at once.
        """
        return replace(self, elimination=Elimination.of(self.matrix(np.ones(len(self.indices))), group))

    def least_fill(self, group: Int[np.ndarray, " f"], last: Bool[np.ndarray, " f"]) -> "Pattern":
        """The same pattern, to be factorised in an order of little fill: for long paths with constraints between them.

        group: (f,) as for `dissected`; last: (f,) which groups come after all others, since they touch most of them.
        """
        return replace(self, elimination=Elimination.least_fill(self.matrix(np.ones(len(self.indices))), group, last))

    def in_threes(self) -> "Pattern":
        """The same pattern, to be factorised over blocks of three variables in a row: for planar pose graphs.

        The free variables are whole poses, and every factor touches whole poses.
        """
        if self.size % BLOCK:
            raise ValueError(f"variables in threes: expected a multiple of 3, found {self.size}")
        return replace(self, elimination=BlockOrder.of(self.matrix(np.ones(len(self.indices)))))

    def assemble(
        self, blocks: Sequence[np.ndarray], gradients: Sequence[np.ndarray]
    ) -> tuple[sp.csc_matrix, Float[np.ndarray, " f"]]:
        """The information matrix and the gradient over the free variables: all terms' parts added up."""
        return self.added(zip(blocks, gradients, strict=True))

    def added(self, parts: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[sp.csc_matrix, Float[np.ndarray, " f"]]:
        """As `assemble`, of (blocks, gradients) of one term after the other: no two need to be held at a time."""
        data, g = np.zeros(len(self.indices) + 1), np.zeros(self.size + 1)
        for slot, row, (block, gradient) in zip(self.slots, self.rows, parts, strict=True):
            _scatter(data, slot, block.ravel())
            _scatter(g, row, gradient.ravel())
        return self.matrix(data[:-1]), g[:-1]

    def matrix(self, data: Float[np.ndarray, " nnz"]) -> sp.csc_matrix:
        H = sp.csc_matrix((data, self.indices, self.indptr), shape=(self.size, self.size))
        H.has_sorted_indices = True
        return H


def _scatter(into: np.ndarray, where: np.ndarray, values: np.ndarray) -> None:
    """`values` added at `where`, places that come twice twice; the cost follows the smaller of the two."""
    if 4 * len(where) > len(into):
        into += np.bincount(where, weights=values, minlength=len(into))
    else:
        np.add.at(into, where, values)


CHUNK = 256  # right-hand sides solved together


class SingularError(ArithmeticError):
    """The information matrix has no inverse: something is not observed, or the gauge is free."""


@dataclass(frozen=True, slots=True)
class Information:
    """An information matrix over n variables with its sparse factor; its inverse is the covariance."""

    matrix: sp.csc_matrix
    factor: Any = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, elimination: Elimination | BlockOrder | None = None) -> "Information":
        """`matrix` (symmetric, positive definite, both triangles stored) factorised; raises SingularError.

        With an `elimination` made for this pattern the factor is multifrontal or of blocks: many times faster on large
        graphs.
        """
        try:
            if isinstance(elimination, BlockOrder):
                return cls(matrix, BlockCholesky.of(matrix, elimination))
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
        own = isinstance(self.factor, Cholesky | BlockCholesky)
        return self.factor.pivots() if own else np.asarray(self.factor.U.diagonal())

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
        if isinstance(self.factor, Cholesky | BlockCholesky) and self.factor.together(index):
            return self.factor.blocks(index)
        b, k = index.shape
        out = np.empty((b, k, k))
        step = max(1, CHUNK // k)
        for start in range(0, b, step):
            part = index[start : start + step]
            C = self.columns(part.ravel()).reshape(self.size, len(part), k)
            out[start : start + step] = C[part[:, :, None], np.arange(len(part))[:, None, None], np.arange(k)]
        return np.asarray(0.5 * (out + out.swapaxes(1, 2)))
