"""The information matrix: where every factor's block lands in it, its factorisation, solutions and covariances."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.linalg import splu

from ..core.gaussian import symmetrise
from ..kernels.block_cholesky import block_cholesky, block_inverse, block_solve, elimination_tree, factor_columns
from ..kernels.elimination import pattern_slots
from .elimination import Cholesky, Elimination, NotPositiveError, least_fill
from .problem import Problem

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
    def of(cls, data: Float[np.ndarray, " nnz"], order: BlockOrder) -> "BlockCholesky":
        """The matrix of these `data` (in the pattern `order` was made for) factorised; raises NotPositiveError."""
        n, m = len(order.order), int(order.begin[-1])
        diagonal, L = np.zeros((n, BLOCK, BLOCK)), np.empty((m, BLOCK, BLOCK))
        rows = np.empty(m, dtype=np.int64)
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
        data, g = self.summed(parts)
        return self.matrix(data), g

    def summed(
        self, parts: Iterable[tuple[np.ndarray, np.ndarray]]
    ) -> tuple[Float[np.ndarray, " nnz"], Float[np.ndarray, " f"]]:
        """As `added`, the data of the matrix alone."""
        data, g = np.zeros(len(self.indices) + 1), np.zeros(self.size + 1)
        for slot, row, (block, gradient) in zip(self.slots, self.rows, parts, strict=True):
            _scatter(data, slot, block.ravel())
            _scatter(g, row, gradient.ravel())
        return data[:-1], g[:-1]

    def factorised(self, data: Float[np.ndarray, " nnz"], added: Float[np.ndarray, " f"] | None = None) -> Any:
        """The factor, which can `solve`, of the matrix of these `data`, to whose diagonal `added` is; SingularError."""
        if added is not None:
            data = data.copy()
            data[self.diagonal] += added
        return _factor(data, self.elimination, lambda: self.matrix(data))

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


def _factor(
    data: Float[np.ndarray, " nnz"], elimination: Elimination | BlockOrder | None, whole: Callable[[], sp.csc_matrix]
) -> Any:
    """The factor of the matrix of these `data`, which is asked for `whole` only where blocks do not do."""
    try:
        if isinstance(elimination, BlockOrder):
            return BlockCholesky.of(data, elimination)
        if elimination is not None:
            return Cholesky.of(whole(), elimination)
        return splu(whole(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except (RuntimeError, NotPositiveError) as error:  # the first is SuperLU's own word for a zero pivot
        raise SingularError(str(error)) from None


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
        return cls(matrix, _factor(matrix.data, elimination, lambda: matrix))

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

    def squares(self, b: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " c"]:
        """`b^T matrix^-1 b` of each column of b."""
        if isinstance(self.factor, Cholesky):
            return self.factor.squares(b)
        return np.asarray((b * self.solve(b)).sum(axis=0))

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
