"""The numbers of a multifrontal factorisation: factor, solutions, and blocks of the inverse."""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dpotri

from ..kernels.solve.fronts import extend_add
from .fronts import Elimination, Front


class NotPositiveError(ArithmeticError):
    """A pivot was not positive: the matrix is not positive definite."""


@dataclass(frozen=True, slots=True)
class Cholesky:
    """`matrix = L L^T`, kept front by front: L11 (p, p) lower and L21 (q, p)."""

    elimination: Elimination
    L11: list[np.ndarray] = field(repr=False)
    L21: list[np.ndarray] = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, elimination: Elimination) -> "Cholesky":
        """`matrix` (the pattern `elimination` was made for) factorised; raises NotPositiveError."""
        fronts = elimination.fronts
        updates: dict[int, np.ndarray] = {}
        L11, L21 = [], []
        for i, f in enumerate(fronts):
            F = _assemble(f, matrix.data, fronts, updates)
            L, info = dpotrf(F[: f.p, : f.p], lower=1, clean=1)
            if info:
                raise NotPositiveError(f"pivot {info} of front {i} is not positive")
            below = F[f.p :, : f.p]
            if len(f.index) > f.p:
                below = dtrsm(1.0, L, below, side=1, lower=1, trans_a=1)
                updates[i] = dsyrk(-1.0, below, beta=1.0, c=F[f.p :, f.p :], lower=1)
            L11.append(L)
            L21.append(below)
        return cls(elimination, L11, L21)

    @property
    def nnz(self) -> int:
        """Numbers kept."""
        return sum(a.size for a in self.L11) + sum(a.size for a in self.L21)

    def pivots(self) -> Float[np.ndarray, " n"]:
        """The pivots of elimination, by variable."""
        out = np.empty(self.elimination.size)
        for f, L in zip(self.elimination.fronts, self.L11, strict=True):
            out[f.index[: f.p]] = np.square(np.diagonal(L))
        return out

    def solve(self, b: np.ndarray) -> np.ndarray:
        """`matrix^-1 b` for b (n,) or (n, c)."""
        x = np.array(b, dtype=float, order="C")
        if not x.size:
            return x
        x = x.reshape(self.elimination.size, -1)
        parts = list(zip(self.elimination.fronts, self.L11, self.L21, strict=True))
        for f, L, below in parts:
            y = dtrsm(1.0, L, x[f.index[: f.p]], lower=1)
            x[f.index[: f.p]] = y
            if len(below):
                x[f.index[f.p :]] -= below @ y
        for f, L, below in reversed(parts):
            y = x[f.index[: f.p]]
            if len(below):
                y = y - below.T @ x[f.index[f.p :]]
            x[f.index[: f.p]] = dtrsm(1.0, L, y, lower=1, trans_a=1)
        return x.reshape(np.shape(b))

    def together(self, index: Int[np.ndarray, "b k"]) -> bool:
        """Whether the variables of each row are eliminated in one front, so that `blocks` can answer."""
        home, _ = self._homes()
        return bool((home[index] == home[index[:, :1]]).all())

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """Blocks of the inverse over each row of `index`, whose variables must be `together`.

        Selected inversion: from the root down, each front's part of the inverse follows from its parent's.
        """
        fronts = self.elimination.fronts
        home, local = self._homes()
        at = home[index[:, 0]]
        rows = np.argsort(at, kind="stable")
        ends = np.searchsorted(at[rows], np.arange(len(fronts) + 1))
        parent = {c: i for i, f in enumerate(fronts) for c in f.children}
        out = np.empty((*index.shape, index.shape[1]))
        Z: dict[int, np.ndarray] = {}
        for i in reversed(range(len(fronts))):
            full = self._inverse(i, Z[parent[i]] if i in parent else None)
            mine = rows[ends[i] : ends[i + 1]]
            j = local[index[mine]]
            out[mine] = full[j[:, :, None], j[:, None, :]]
            if fronts[i].children:
                Z[i] = full
            if i in parent and fronts[parent[i]].children[0] == i:  # the last of its siblings
                del Z[parent[i]]
        return out

    def _homes(self) -> tuple[np.ndarray, np.ndarray]:
        """For each variable the front that eliminates it and its place there."""
        home = np.empty(self.elimination.size, dtype=np.int64)
        local = np.empty(self.elimination.size, dtype=np.int64)
        for i, f in enumerate(self.elimination.fronts):
            home[f.index[: f.p]] = i
            local[f.index[: f.p]] = np.arange(f.p)
        return home, local

    def _inverse(self, i: int, above: np.ndarray | None) -> np.ndarray:
        """The inverse over the variables of front `i`, symmetric and full."""
        f, L, below = self.elimination.fronts[i], self.L11[i], self.L21[i]
        k, p = len(f.index), f.p
        Z = np.empty((k, k), order="F")
        own, _ = dpotri(L, lower=1)
        own = np.tril(own) + np.tril(own, -1).T
        if above is not None and k > p:
            W = dtrsm(1.0, L, below, side=1, lower=1)
            Z22 = above[np.ix_(f.into_parent, f.into_parent)]
            Z21 = -Z22 @ W
            own -= W.T @ Z21
            Z[p:, :p], Z[:p, p:], Z[p:, p:] = Z21, Z21.T, Z22
        Z[:p, :p] = 0.5 * (own + own.T)
        return Z


def _assemble(f: Front, data: np.ndarray, fronts: tuple[Front, ...], updates: dict[int, np.ndarray]) -> np.ndarray:
    k = len(f.index)
    flat = np.zeros(k * k)
    flat[f.place] = data[f.slot]
    F = flat.reshape(k, k, order="F")
    for c in f.children:
        extend_add(F, np.asfortranarray(updates.pop(c)), fronts[c].into_parent)
    return F
