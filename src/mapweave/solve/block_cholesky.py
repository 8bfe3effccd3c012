"""Sparse Cholesky of a matrix whose variables come in threes, as planar poses do: ordered once, factorised often.

Fill is kept small by a minimum-degree order over the poses. Of a graph that is a few long trajectories with constraints
between them the factor has a tenth of the numbers of a nested dissection's; that of dense surfaces is better cut in
halves.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from ..kernels.block_cholesky import block_cholesky, block_inverse, block_solve, elimination_tree, factor_columns
from .elimination import least_fill
from .multifrontal import NotPositiveError

BLOCK = 3  # variables that go together


@dataclass(frozen=True, slots=True)
class BlockOrder:
    """The order in which a matrix of one pattern is factorised, and where its entries go.

    order: (n,) which block is eliminated when; start, rows: the blocks above the diagonal, by column of the reordered
    matrix; diagonal (n, 3, 3) and above (b, 3, 3): the slot of each of their entries in the matrix's data; parent:
    elimination tree; begin: (n + 1,) where each column of the factor starts.
    """

    order: Int[np.ndarray, " n"]
    start: Int[np.ndarray, " n1"]
    rows: Int[np.ndarray, " b"]
    diagonal: Int[np.ndarray, "n 3 3"]
    above: Int[np.ndarray, "b 3 3"]
    parent: Int[np.ndarray, " n"]
    begin: Int[np.ndarray, " n1"]

    @classmethod
    def of(cls, matrix: sp.csc_matrix) -> "BlockOrder":
        """For the pattern of `matrix` (symmetric, both triangles, sorted), whose blocks are stored whole."""
        n = matrix.shape[0] // BLOCK
        first = matrix.indptr[: BLOCK * n : BLOCK]
        count = matrix.indptr[1 : BLOCK * n + 1 : BLOCK] - first  # entries of a block column's first column
        lead = _ranges(first, count)[::BLOCK]  # of each block the slot of its entry (0, 0)
        col = np.repeat(np.arange(n), count // BLOCK)
        row = matrix.indices[lead] // BLOCK
        order = least_fill(sp.csr_array((np.ones(len(row)), (row, col)), shape=(n, n)), np.ones(n, bool))
        rank = np.empty(n, dtype=np.int64)
        rank[order] = np.arange(n)
        slot = lead[:, None, None] + np.arange(BLOCK)[:, None] + count[col][:, None, None] * np.arange(BLOCK)
        r, c = rank[row], rank[col]
        on = np.flatnonzero(r == c)
        off = np.flatnonzero(r < c)
        off = off[np.lexsort((r[off], c[off]))]
        start = np.concatenate([[0], np.cumsum(np.bincount(c[off], minlength=n))]).astype(np.int64)
        rows = r[off].astype(np.int64)
        parent = elimination_tree(start, rows)
        begin = factor_columns(start, rows, parent)
        return cls(order, start, rows, slot[on[np.argsort(r[on])]], slot[off], parent, begin)


def _ranges(first: Int[np.ndarray, " n"], count: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """first[0], first[0] + 1, ... of `count[0]` numbers, then those of the next."""
    ends = np.cumsum(count)
    return np.asarray(np.repeat(first - (ends - count), count) + np.arange(int(ends[-1]) if len(ends) else 0))


@dataclass(frozen=True, slots=True)
class BlockCholesky:
    """`A = L L^T` of the reordered matrix: L_diagonal (n, 3, 3) lower, L (m, 3, 3) below, by column."""

    order: BlockOrder
    L_diagonal: Float[np.ndarray, "n 3 3"] = field(repr=False)
    L: Float[np.ndarray, "m 3 3"] = field(repr=False)
    L_rows: Int[np.ndarray, " m"] = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, order: BlockOrder) -> "BlockCholesky":
        """`matrix` (the pattern `order` was made for) factorised; raises NotPositiveError."""
        n, m = len(order.order), int(order.begin[-1])
        diagonal, L = np.zeros((n, BLOCK, BLOCK)), np.empty((m, BLOCK, BLOCK))
        rows = np.empty(m, dtype=np.int64)
        data = matrix.data
        failed = block_cholesky(
            data[order.diagonal],
            data[order.above],
            order.start,
            order.rows,
            order.parent,
            order.begin,
            diagonal,
            L,
            rows,
        )
        if failed >= 0:
            raise NotPositiveError(f"a pivot of block {order.order[failed]} is not positive")
        return cls(order, diagonal, L, rows)

    @property
    def nnz(self) -> int:
        """Numbers kept."""
        return int(self.L_diagonal.size + self.L.size)

    def pivots(self) -> Float[np.ndarray, " n"]:
        """The pivots of elimination, by variable."""
        out = np.empty((len(self.order.order), BLOCK))
        out[self.order.order] = np.square(np.diagonal(self.L_diagonal, axis1=1, axis2=2))
        return out.ravel()

    def together(self, index: Int[np.ndarray, "b k"]) -> bool:
        """Whether the variables of each row are of one block, so that `blocks` can answer."""
        block = index // BLOCK
        return bool((block == block[:, :1]).all())

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """Blocks of the inverse over each row of `index`, whose variables must be `together`."""
        Z, _ = self._inverse()
        local = index % BLOCK
        return np.asarray(Z[(index[:, 0] // BLOCK)[:, None, None], local[:, :, None], local[:, None, :]])

    def pairs(
        self, first: Int[np.ndarray, " p"], second: Int[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "p 3 3"]]:
        """Of the inverse the diagonal block of every block of variables, and that of `first` (rows) and `second`.

        Each pair is of different blocks that the matrix ties.
        """
        diagonal, below = self._inverse()
        rank = np.empty(len(self.order.order), dtype=np.int64)
        rank[self.order.order] = np.arange(len(rank))
        a, b = rank[first], rank[second]
        column, row = np.minimum(a, b), np.maximum(a, b)
        n = len(rank)
        kept = np.repeat(np.arange(n), np.diff(self.order.begin)) * n + self.L_rows
        out = below[np.searchsorted(kept, column * n + row)]
        return diagonal, np.where((a > b)[:, None, None], out, out.swapaxes(1, 2))

    def _inverse(self) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "m 3 3"]]:
        """Diagonal blocks of the inverse, by block of variables, and those where L has one."""
        diagonal, below = block_inverse(self.L_diagonal, self.L, self.order.begin, self.L_rows)
        Z = np.empty_like(diagonal)
        Z[self.order.order] = 0.5 * (diagonal + diagonal.swapaxes(1, 2))
        return Z, below

    def solve(self, b: np.ndarray) -> np.ndarray:
        """`matrix^-1 b` for b (n,) or (n, c)."""
        if not np.size(b):
            return np.array(b, dtype=float)
        order = self.order.order
        x = np.ascontiguousarray(np.reshape(b, (len(order), BLOCK, -1))[order], dtype=float)
        block_solve(self.L_diagonal, self.L, self.order.begin, self.L_rows, x)
        out = np.empty_like(x)
        out[order] = x
        return out.reshape(np.shape(b))
