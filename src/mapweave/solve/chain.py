"""Least squares along a chain: stretches of time that share their ends with their neighbours, and hubs with all.

Each stretch is reduced to what it says of its first end, its last end and the hubs (landmarks, sensors): its Schur
complement, taken where it was linearised. A pass forward eliminates end after end, a pass back gives every end; a
stretch that is linearised anew changes nothing before it. That is Gauss-Newton over the whole, in pieces.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve

from ..core.gaussian import symmetrise
from .information import Information, SingularError


@dataclass(frozen=True, slots=True)
class SchurComplement:
    """What a stretch says of the e variables that it shares, its own i variables eliminated at x.

    shared, own: entries of the stretch's x (n,); S (e, e), b (e,): information over the shared ones, and information
    times value; K (i, e), k (i,): the own ones are `x_own - k - K (shared - x_shared)`.
    """

    x: Float[np.ndarray, " n"]
    shared: Int[np.ndarray, " e"]
    own: Int[np.ndarray, " i"]
    S: Float[np.ndarray, "e e"]
    b: Float[np.ndarray, " e"]
    K: Float[np.ndarray, "i e"]
    k: Float[np.ndarray, " i"]

    @classmethod
    def of(
        cls,
        H: sp.csc_matrix,
        g: Float[np.ndarray, " n"],
        x: Float[np.ndarray, " n"],
        shared: Int[np.ndarray, " e"],
    ) -> "SchurComplement":
        """The link of a stretch with information H (n, n) and gradient g at x.

        Raises SingularError where what it shares does not tell its own variables.
        """
        rest = np.ones(len(x), bool)
        rest[shared] = False
        own = np.flatnonzero(rest)
        across = H[own][:, shared].toarray()
        both = np.column_stack([across, g[own]])
        solved = Information.of(sp.csc_matrix(H[own][:, own])).solve(both) if len(own) else both
        K, k = solved[:, :-1], solved[:, -1]
        S = symmetrise(H[shared][:, shared].toarray() - across.T @ K)
        return cls(x, shared, own, S, S @ x[shared] - (g[shared] - across.T @ k), K, k)

    def inside(self, shared: Float[np.ndarray, " e"]) -> Float[np.ndarray, " n"]:
        """The whole stretch, where its shared variables are `shared`."""
        out = self.x.copy()
        out[self.shared] = shared
        out[self.own] = self.x[self.own] - self.k - self.K @ (shared - self.x[self.shared])
        return out


@dataclass(frozen=True, slots=True)
class Gauss:
    """Information and information times value, over the ends that come in (first) and all hubs."""

    Lambda: Float[np.ndarray, "n n"]
    eta: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class Passed:
    """A link eliminated. on: the information it leaves on what follows; w - W rest: the a variables that came in."""

    on: Gauss
    W: Float[np.ndarray, "a r"]
    w: Float[np.ndarray, " a"]


def passed(entry: Gauss, link: SchurComplement, ends_in: int, ends_out: int, hubs: Int[np.ndarray, " h"]) -> Passed:
    """The chain past `link`, the `ends_in` variables that came in eliminated; raises SingularError.

    link shares, in this order: the ends in, `ends_out` ends that go on, and the hubs that stand at `hubs` of all.
    """
    m = len(entry.eta) - ends_in
    n = ends_in + ends_out + m
    Lambda, eta = np.zeros((n, n)), np.zeros(n)
    came = np.concatenate([np.arange(ends_in), ends_in + ends_out + np.arange(m)])
    Lambda[np.ix_(came, came)] += entry.Lambda
    eta[came] += entry.eta
    at = np.concatenate([np.arange(ends_in + ends_out), ends_in + ends_out + hubs])
    Lambda[np.ix_(at, at)] += link.S
    eta[at] += link.b
    A, B = Lambda[:ends_in, :ends_in], Lambda[:ends_in, ends_in:]
    solved = solve(A, np.column_stack([B, eta[:ends_in]]))
    W, w = solved[:, :-1], solved[:, -1]
    return Passed(Gauss(symmetrise(Lambda[ends_in:, ends_in:] - B.T @ W), eta[ends_in:] - B.T @ w), W, w)


def solve(A: Float[np.ndarray, "n n"], b: Float[np.ndarray, "n *k"]) -> Float[np.ndarray, "n *k"]:
    """`A^-1 b`, scaled to a unit diagonal; raises SingularError where A is not positive definite."""
    if not len(A):
        return b
    d = np.diag(A)
    if not (d > 0).all():
        raise SingularError("something in the chain is not observed")
    s = 1.0 / np.sqrt(d)
    try:
        factor = cho_factor(A * s[:, None] * s, lower=True, check_finite=False)
    except np.linalg.LinAlgError as error:
        raise SingularError(str(error)) from None
    by = s if b.ndim == 1 else s[:, None]
    return np.asarray(by * cho_solve(factor, by * b, check_finite=False))
