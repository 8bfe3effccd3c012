"""Where every robot of a swarm is, how well that is known jointly, and who cannot be told."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from ..core.attitude import Headings
from ..core.gaussian import symmetrise
from ..core.records import freeze
from ..solve import Information


@dataclass(frozen=True, slots=True)
class JointInformation:
    """The information matrix (s, s) over `width` scalars a robot: coordinates, then its turn where it has one.

    held: (s,) entries that are known (anchors) or fixed to hold the gauge; they have no rows of their own.
    """

    matrix: sp.csc_matrix
    held: Bool[np.ndarray, " s"]
    width: int

    def __post_init__(self) -> None:
        freeze(self, "held", dtype=bool)

    def covariance(self, E: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "k k"]:
        """The covariance of the linear functions of the state whose gradients are the columns of E."""
        free = ~self.held
        known = Information.of(sp.csc_matrix(self.matrix[free][:, free]))
        return symmetrise(E[free].T @ known.solve(E[free]))

    def variances(self, E: Float[np.ndarray, "s k"]) -> Float[np.ndarray, " k"]:
        """The variance of each of the functions whose gradients are the columns of E."""
        free = ~self.held
        known = Information.of(sp.csc_matrix(self.matrix[free][:, free]))
        return np.asarray(np.einsum("sk,sk->k", E[free], known.solve(E[free])))

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


class SwarmStatus(StrEnum):
    """How the estimator ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    FAILED = "failed"  # positions are the last finite ones


FLOAT = 8  # bytes of a number in a message


@dataclass(frozen=True, slots=True)
class Traffic:
    """What the robots said to each other: rounds in step, messages between two robots, bytes in all."""

    rounds: int
    messages: int
    bytes: int

    def __add__(self, other: "Traffic") -> "Traffic":
        return Traffic(self.rounds + other.rounds, self.messages + other.messages, self.bytes + other.bytes)


@dataclass(frozen=True, slots=True)
class OtherAnswer:
    """Places [m] and headings [rad] of all robots, in the estimate's gauge, that the sightings fit with `chi2`."""

    position: Float[np.ndarray, "n d"]
    heading: Headings
    chi2: float

    def __post_init__(self) -> None:
        freeze(self, "position", "heading")


@dataclass(frozen=True, slots=True)
class SwarmEstimate:
    """n robots in the order of the network's ids.

    position: (n, d) [m] (in units of the gauge where scale is free), best guess also for robots not localisable;
    heading: (n,) [rad], in space (n, 3) rotation vectors that carry own axes into the common ones, where no axis was
    common, else None; heading_var: of turns about the common axes [rad^2], NaN where nothing tells; cov: (n, d, d),
    zero for anchors, NaN for robots not localisable, None when left out; localisable: (n,), anchors included, up to the
    gauge; gauge: what was free and how it was fixed, "" when anchors fix all; null_space: free directions of the
    sightings with anchors and distances held;
    chi2, dof: of the inliers' whitened residuals; outlier: (m,) sightings not used: judged wrong, or made by a robot
    whose heading nothing tells; reliable: whether all this may be trusted, `warnings` say why not; weak_anchors:
    nearly all variance lies in one mode (share `mode_share`); others: answers that fit about as well, the best first.
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
    status: SwarmStatus
    reliable: bool
    warnings: tuple[str, ...] = ()
    heading: Headings | None = None
    heading_var: Headings | None = None
    weak_anchors: bool = False
    mode_share: float | None = None
    traffic: Traffic | None = None
    information: JointInformation | None = None
    gauge_motions: Float[np.ndarray, "s g"] | None = None
    gauge_conditions: Float[np.ndarray, "s g"] | None = None
    others: tuple[OtherAnswer, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "position", "cov", "heading", "heading_var", "gauge_motions", "gauge_conditions")
        freeze(self, "localisable", "anchor", "outlier", dtype=bool)

    @property
    def not_localisable(self) -> tuple[str, ...]:
        return tuple(name for name, ok in zip(self.ids, self.localisable, strict=True) if not ok)

    def joint(self, robots: Sequence[int] | np.ndarray) -> Float[np.ndarray, "k k"]:
        """Joint covariance [m^2] of the positions of `robots` (indices, all localisable), coordinates together.

        In the gauge named; anchors have zero rows. Raises ValueError when the estimate carries no information matrix.
        """
        if self.information is None:
            raise ValueError("this estimate carries no information matrix")
        width, chosen = self.information.width, np.asarray(robots, dtype=np.intp)
        rows = (width * chosen[:, None] + np.arange(self.dim)).ravel()
        E = np.zeros((self.information.matrix.shape[0], len(rows)))
        E[rows, np.arange(len(rows))] = 1.0
        if self.gauge_motions is not None and self.gauge_conditions is not None:
            G, C = self.gauge_motions, self.gauge_conditions
            E -= C @ np.linalg.solve(G.T @ C, G.T @ E)
        return self.information.covariance(E)

    def nees(self, truth: Float[np.ndarray, "n d"]) -> tuple[float, int]:
        """`e^T P^-1 e` over all localisable free robots jointly, and its degrees of freedom; no gauge may be free."""
        if self.information is None or self.gauge:
            raise ValueError("no information matrix, or a gauge that truth does not share")
        return self.information.nees(self.position - truth, self.localisable)
