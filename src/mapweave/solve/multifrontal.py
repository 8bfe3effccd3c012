"""Multifrontal Cholesky: a large sparse matrix factorised as a tree of small dense ones.

Each front holds the variables eliminated there and those of its ancestors they touch. Factor, solutions and the blocks
of the inverse on the pattern are dense matrix products, whatever the size of the whole: those of large fronts are left
to BLAS, small ones are taken by runs in one compiled call.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dpotri

from ..kernels.dense import extend_add
from ..kernels.fronts import Fronts, backward_fronts, factor_fronts, forward_fronts, inverse_fronts
from .elimination import Elimination


class NotPositiveError(ArithmeticError):
    """A pivot was not positive: the matrix is not positive definite."""


@dataclass(frozen=True, slots=True)
class Cholesky:
    """`matrix = L L^T`, front by front: L11 (p, p) lower, then L21 (q, p), both column after column."""

    elimination: Elimination
    L: Float[np.ndarray, " m"] = field(repr=False)

    @classmethod
    def of(cls, matrix: sp.csc_matrix, elimination: Elimination) -> "Cholesky":
        """`matrix` (the pattern `elimination` was made for) factorised; raises NotPositiveError."""
        e = elimination
        L = np.zeros(int(e.panel[-1]))
        L[e.place] = matrix.data[e.slot]
        fronts = Fronts(e.begin, e.own, e.into, e.panel, L)
        updates = np.empty(int(e.room[0, -1]))
        rest = np.empty(int((np.diff(e.begin) - e.own)[~e.large].max(initial=0)) ** 2)
        for a, b in e.runs():
            if e.large[a]:
                failed = a if _factorised(e, a, L, updates) else -1
            else:
                failed = factor_fronts(a, b, fronts, e.family, e.children, e.room[0], updates, rest)
            if failed >= 0:
                raise NotPositiveError(f"a pivot of front {failed} is not positive")
        return cls(e, L)

    @property
    def nnz(self) -> int:
        """Numbers kept."""
        return len(self.L)

    def panels(self, i: int) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, "q p"]]:
        """L11 and L21 of front i."""
        return _panels(self.elimination, i, self.L)

    def pivots(self) -> Float[np.ndarray, " n"]:
        """The pivots of elimination, by variable."""
        e = self.elimination
        home, local = e.homes()
        return np.asarray(np.square(self.L[e.panel[home] + local * (e.own[home] + 1)]))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """`matrix^-1 b` for b (n,) or (n, c)."""
        e = self.elimination
        x = np.array(np.reshape(b, (e.size, -1 if e.size else 1)).T, dtype=float, order="C")
        runs = list(e.runs()) if x.size else []
        for a, c in runs:
            if e.large[a]:
                (L11, L21), (own, others) = self.panels(a), e.front(a)
                y = dtrsm(1.0, L11, x[:, own].T, lower=1)
                x[:, own] = y.T
                if len(others):
                    x[:, others] -= (L21 @ y).T
            else:
                forward_fronts(a, c, e.begin, e.own, e.index, e.panel, self.L, x)
        for a, c in reversed(runs):
            if e.large[a]:
                (L11, L21), (own, others) = self.panels(a), e.front(a)
                y = x[:, own].T
                if len(others):
                    y = y - L21.T @ x[:, others].T
                x[:, own] = dtrsm(1.0, L11, y, lower=1, trans_a=1).T
            else:
                backward_fronts(a, c, e.begin, e.own, e.index, e.panel, self.L, x)
        return np.ascontiguousarray(x.T).reshape(np.shape(b))

    def together(self, index: Int[np.ndarray, "b k"]) -> bool:
        """Whether the variables of each row are eliminated in one front, so that `blocks` can answer."""
        home, _ = self.elimination.homes()
        return bool((home[index] == home[index[:, :1]]).all())

    def blocks(self, index: Int[np.ndarray, "b k"]) -> Float[np.ndarray, "b k k"]:
        """Blocks of the inverse over each row of `index`, whose variables must be `together`.

        Selected inversion: from the root down, each front's part of the inverse follows from its parent's.
        """
        e = self.elimination
        home, place = e.homes()
        local = np.ascontiguousarray(place[index])
        asked = np.argsort(home[index[:, 0]], kind="stable")
        ends = np.searchsorted(home[index[asked, 0]], np.arange(len(e) + 1))
        out = np.empty((*index.shape, index.shape[1]))
        Z, fronts = np.empty(int(e.room[1, -1])), Fronts(e.begin, e.own, e.into, e.panel, self.L)
        for a, b in reversed(list(e.runs())):
            if e.large[a]:
                full = self._inverse(a, Z)
                k, at = len(full), int(e.room[1, a])
                Z[at : at + k * k] = full.ravel()
                mine = asked[ends[a] : ends[a + 1]]
                j = local[mine]
                out[mine] = full[j[:, :, None], j[:, None, :]]
            else:
                inverse_fronts(a, b, fronts, e.parent, e.room[1], Z, asked, ends, local, out)
        return out

    def _inverse(self, i: int, known: Float[np.ndarray, " z"]) -> Float[np.ndarray, "k k"]:
        """The inverse over the variables of front `i`, symmetric and full; that of its parent is `known`."""
        e = self.elimination
        L, below = self.panels(i)
        p, k = len(L), len(L) + len(below)
        Z = np.empty((k, k))
        own, _ = dpotri(L, lower=1)
        own = np.tril(own) + np.tril(own, -1).T
        if k > p:
            up = int(e.parent[i])
            wide, at = int(e.begin[up + 1] - e.begin[up]), int(e.room[1, up])
            into = e.into[e.begin[i] + p : e.begin[i + 1]]
            W = dtrsm(1.0, L, below, side=1, lower=1)
            Z22 = known[at : at + wide * wide].reshape(wide, wide)[np.ix_(into, into)]
            Z21 = -Z22 @ W
            own -= W.T @ Z21
            Z[p:, :p], Z[:p, p:], Z[p:, p:] = Z21, Z21.T, Z22
        Z[:p, :p] = 0.5 * (own + own.T)
        return Z


def _panels(e: Elimination, i: int, L: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, at = int(e.own[i]), int(e.panel[i])
    middle = at + p * p
    return L[at:middle].reshape(p, p, order="F"), L[middle : e.panel[i + 1]].reshape(-1, p, order="F")


def _factorised(e: Elimination, i: int, L: np.ndarray, updates: np.ndarray) -> bool:
    """Front i factorised by BLAS, in place; True where a pivot is not positive."""
    p, k = int(e.own[i]), int(e.begin[i + 1] - e.begin[i])
    q = k - p
    L11, L21 = _panels(e, i, L)
    F = np.zeros((k, k), order="F")
    F[:p, :p], F[p:, :p] = L11, L21
    for c in e.children[e.family[i] : e.family[i + 1]]:
        into = e.into[e.begin[c] + e.own[c] : e.begin[c + 1]]
        at, w = int(e.room[0, c]), len(into)
        extend_add(F, updates[at : at + w * w].reshape(w, w, order="F"), into)
    L11[...], info = dpotrf(F[:p, :p], lower=1, clean=1)
    if info:
        return True
    if q:
        L21[...] = dtrsm(1.0, L11, F[p:, :p], side=1, lower=1, trans_a=1)
        at = int(e.room[0, i])
        updates[at : at + q * q].reshape(q, q, order="F")[...] = dsyrk(-1.0, L21, beta=1.0, c=F[p:, p:], lower=1)
    return False
