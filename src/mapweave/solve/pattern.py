"""Where every factor's block lands in the sparse information matrix: found once, used at each step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from .fronts import Elimination
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
    elimination: Elimination | None = None

    @classmethod
    def of(cls, problem: Problem) -> "Pattern":
        """The pattern of `problem`; valid as long as columns and fixed entries stay the same."""
        n = len(problem.x0)
        free = problem.free
        size = len(free)
        position = np.full(n, size, dtype=np.int64)
        position[free] = np.arange(size)
        rows = [position[term.columns] for term in problem.terms]
        span = size + 1
        keys = [(r[:, None, :] * span + r[:, :, None]).ravel() for r in rows]  # column-major: sorted keys are CSC
        diagonal_keys = np.arange(size, dtype=np.int64) * (span + 1)
        flat = np.concatenate([*keys, diagonal_keys])
        distinct, inverse = np.unique(flat, return_inverse=True)
        column, row = distinct // span, distinct % span
        inside = (column < size) & (row < size)
        slot = np.where(inside, np.cumsum(inside) - 1, np.count_nonzero(inside))
        where = slot[inverse.ravel()].astype(np.int64)
        ends = np.cumsum([len(k) for k in keys])
        parts = np.split(where, ends)
        indptr = np.concatenate([[0], np.cumsum(np.bincount(column[inside], minlength=size))])
        return cls(
            size=size,
            indptr=indptr.astype(np.int32),
            indices=row[inside].astype(np.int32),
            slots=tuple(parts[:-1]),
            rows=tuple(r.ravel() for r in rows),
            diagonal=parts[-1],
        )

    def dissected(self, group: Int[np.ndarray, " f"]) -> "Pattern":
        """The same pattern, to be factorised by nested dissection: pays from some thousand variables on.

        group: (f,) which variables belong together (a pose, a point), by any number; their joint covariances are
        then cheap for all groups at once.
        """
        return replace(self, elimination=Elimination.of(self.matrix(np.ones(len(self.indices))), group))

    def assemble(
        self, blocks: Sequence[np.ndarray], gradients: Sequence[np.ndarray]
    ) -> tuple[sp.csc_matrix, Float[np.ndarray, " f"]]:
        """The information matrix and the gradient over the free variables: all terms' parts added up."""
        data, g = np.zeros(len(self.indices) + 1), np.zeros(self.size + 1)
        for slot, row, block, gradient in zip(self.slots, self.rows, blocks, gradients, strict=True):
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
