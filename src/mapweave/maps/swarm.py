"""Where every robot of a swarm is, how well that is known, and who cannot be told."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.sparse.linalg import splu

from ..core.arrays import frozen


class Status(StrEnum):
    """How the estimator ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    FAILED = "failed"  # positions are the last finite ones


@dataclass(frozen=True, slots=True)
class Traffic:
    """What the robots said to each other: rounds in step, messages between two robots, bytes in all."""

    rounds: int
    messages: int
    bytes: int


@dataclass(frozen=True, slots=True)
class SwarmEstimate:
    """n robots in the order of the network's ids.

    position: (n, d) [m] (in units of the gauge where scale is free), best guess also for robots not localisable;
    heading: (n,) [rad] where no axis was common, else None; cov: (n, d, d), zero for anchors, NaN for robots not
    localisable, None when left out; localisable: (n,), anchors included, up to the gauge; gauge: what was free and how
    it was fixed, "" when anchors fix all; null_space: free directions of the sightings with anchors and distances held;
    chi2, dof: of the inliers' whitened residuals; outlier: (m,) sightings not used; reliable: whether all this may be
    trusted, `warnings` say why not; weak_anchors: nearly all variance lies in one mode (share `mode_share`).
    """

    ids: tuple[str, ...]
    dim: int
    method: str
    position: Float[np.ndarray, "n d"]
    cov: Float[np.ndarray, "n d d"] | None
    localisable: Bool[np.ndarray, " n"]
    anchor: Bool[np.ndarray, " n"]
    outlier: Bool[np.ndarray, " m"]
    gauge: str
    null_space: int
    iterations: int
    chi2: float
    dof: int
    status: Status
    reliable: bool
    warnings: tuple[str, ...] = ()
    heading: Float[np.ndarray, " n"] | None = None
    heading_var: Float[np.ndarray, " n"] | None = None
    weak_anchors: bool = False
    mode_share: float | None = None
    traffic: Traffic | None = None
    information: sp.csc_array | None = None
    gauge_basis: Float[np.ndarray, "s g"] | None = None

    def __post_init__(self) -> None:
        for name in ("position", "cov", "heading", "heading_var", "gauge_basis"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name)))
        for name in ("localisable", "anchor", "outlier"):
            object.__setattr__(self, name, frozen(getattr(self, name), bool))

    @property
    def not_localisable(self) -> tuple[str, ...]:
        return tuple(name for name, ok in zip(self.ids, self.localisable, strict=True) if not ok)

    @property
    def state_width(self) -> int:
        """Scalars a robot in `information`: its coordinates, then its heading where it has one."""
        return self.dim + (self.heading is not None)

    def joint(self, robots: Sequence[int] | np.ndarray) -> Float[np.ndarray, "k k"]:
        """Joint covariance [m^2] of the positions of `robots` (indices, all localisable), coordinates together.

        From the information matrix, in the gauge named; anchors have zero rows. Raises ValueError when the estimator
        left no information matrix.
        """
        if self.information is None:
            raise ValueError("this estimate carries no information matrix")
        width, chosen = self.state_width, np.asarray(robots, dtype=np.intp)
        rows = (width * chosen[:, None] + np.arange(self.dim)).ravel()
        E = np.zeros((self.information.shape[0], len(rows)))
        E[rows, np.arange(len(rows))] = 1.0
        lu = splu(
            self.information.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        held = np.repeat(self.anchor[chosen], self.dim)
        if self.gauge_basis is not None and self.gauge_basis.shape[1]:
            G = self.gauge_basis
            E = E - G @ (G.T @ E)
            S = lu.solve(E)
            out = E.T @ S
        else:
            out = lu.solve(E)[rows]
        out[held] = 0.0
        out[:, held] = 0.0
        return np.asarray(0.5 * (out + out.T))

    def nees(self, truth: Float[np.ndarray, "n d"]) -> tuple[float, int]:
        """`e^T P^-1 e` over all localisable free robots jointly, and its degrees of freedom (no gauge free)."""
        if self.information is None:
            raise ValueError("this estimate carries no information matrix")
        free = self.localisable & ~self.anchor
        width = self.state_width
        A = self.information.tocsr()
        keep = (width * np.flatnonzero(free)[:, None] + np.arange(self.dim)).ravel()
        rest = np.setdiff1d(np.arange(A.shape[0]), keep)
        e = (self.position - truth)[free].ravel()
        value = float(e @ (A[keep][:, keep] @ e))
        if len(rest):
            g = A[rest][:, keep] @ e
            if np.any(g):
                value -= float(g @ splu(A[rest][:, rest].tocsc()).solve(g))
        return value, len(e)
