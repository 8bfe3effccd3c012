"""A least-squares problem as plain arrays: one vector of variables, factors vectorised by type, robust kernels.

A kernel says what a squared whitened residual costs and how much its factor still counts; all equal the square near
zero, and `k` is in standard deviations.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.se2 import wrap_angle

Values = Float[np.ndarray, " m"]


@runtime_checkable
class Kernel(Protocol):
    """`s` (m,): squared whitened norms. `weight` is the derivative of `cost`, in (0, 1], and scales the information.

    `fading` is `-s` times the derivative of `weight`, 0 or more: what the cost's own curvature lacks of it.
    """

    def cost(self, s: Values) -> Values: ...
    def weight(self, s: Values) -> Values: ...
    def fading(self, s: Values) -> Values: ...


@dataclass(frozen=True, slots=True)
class Huber:
    """Square inside `k`, linear outside: an outlier pulls with bounded force."""

    k: float = 1.345

    def cost(self, s: Values) -> Values:
        return np.where(s <= self.k**2, s, 2.0 * self.k * np.sqrt(s) - self.k**2)

    def weight(self, s: Values) -> Values:
        return np.asarray(self.k / np.maximum(np.sqrt(s), self.k))

    def fading(self, s: Values) -> Values:
        return np.where(s <= self.k**2, 0.0, 0.5 * self.weight(s))


@dataclass(frozen=True, slots=True)
class Cauchy:
    """Logarithmic: an outlier's pull fades as it goes away."""

    k: float = 2.385

    def cost(self, s: Values) -> Values:
        return np.asarray(self.k**2 * np.log1p(s / self.k**2))

    def weight(self, s: Values) -> Values:
        return 1.0 / (1.0 + s / self.k**2)

    def fading(self, s: Values) -> Values:
        w = self.weight(s)
        return np.asarray(w * (1.0 - w))


@dataclass(frozen=True, slots=True)
class GemanMcClure:
    """Bounded by k^2: a gross outlier stops pulling. Needs a good start."""

    k: float = 3.0

    def cost(self, s: Values) -> Values:
        return self.k**2 * s / (self.k**2 + s)

    def weight(self, s: Values) -> Values:
        return (self.k**2 / (self.k**2 + s)) ** 2

    def fading(self, s: Values) -> Values:
        return np.asarray(2.0 * self.weight(s) * s / (self.k**2 + s))


Vector = Float[np.ndarray, " n"]
Retract = Callable[[np.ndarray, np.ndarray], np.ndarray]


@runtime_checkable
class Term(Protocol):
    """m factors of one shape, each over d scalar variables: all the solver needs to know.

    columns: (m, d) which entries of x each touches (a fixed entry may appear); size: rows of residual in all, for
    the degrees of freedom. `costs(x)`: (m,) robust costs, their sum is minimised; `squares(x)`: (m,) squared whitened
    norms; `normal(x)`: information (m, d, d) and gradient (m, d), both with the robust weight in them (half the
    derivative of the sum of costs).
    """

    @property
    def columns(self) -> Int[np.ndarray, "m d"]: ...
    @property
    def size(self) -> int: ...
    def squares(self, x: Vector) -> Float[np.ndarray, " m"]: ...
    def costs(self, x: Vector) -> Float[np.ndarray, " m"]: ...
    def normal(self, x: Vector) -> tuple[Float[np.ndarray, "m d d"], Float[np.ndarray, "m d"]]: ...


@dataclass(frozen=True, slots=True)
class Factor:
    """m factors with k residual rows each over d scalar variables, given by a function and its Jacobian.

    residual(x): (m, k), angles already wrapped; jacobian(x): (m, k, d), columns in the order of `columns` (a variable
    named twice in one factor gets the sum). sqrt_info: None (unit), (m or 1, k) one over the standard deviations, or
    (m or 1, k, k) W with W^T W the information. kernel: applied to each factor's squared whitened norm.
    """

    columns: Int[np.ndarray, "m d"]
    residual: Callable[[np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray], np.ndarray]
    rows: int
    sqrt_info: np.ndarray | None = None
    kernel: Kernel | None = None
    name: str = ""

    @property
    def size(self) -> int:
        return len(self.columns) * self.rows

    def whitened(self, x: Vector) -> Float[np.ndarray, "m k"]:
        r, W = self.residual(x), self.sqrt_info
        if W is None:
            return r
        return np.asarray(r * W if W.ndim == 2 else (W @ r[..., None])[..., 0])

    def squares(self, x: Vector) -> Float[np.ndarray, " m"]:
        return np.asarray(np.square(self.whitened(x)).sum(axis=1))

    def costs(self, x: Vector) -> Float[np.ndarray, " m"]:
        s = self.squares(x)
        return s if self.kernel is None else np.asarray(self.kernel.cost(s))

    def weights(self, x: Vector) -> Float[np.ndarray, " m"]:
        """How much each factor counts at x: 1 without a kernel, towards 0 for an outlier."""
        return np.ones(len(self.columns)) if self.kernel is None else self.kernel.weight(self.squares(x))

    def curvature(self, x: Vector) -> float:
        """What the costs are curved by over what their weights say, in the mean over factors and directions; 0 to 1.

        `normal` is what a solver needs, not the second derivative: a cost that flattens out is curved less than its
        weights say, by `2 fading / rows` in a direction drawn at random. An M-estimator errs by the inverse of this
        curvature (Huber, 1964, eq. 25; `E psi'` in place of `E w`).
        """
        if self.kernel is None or not len(self.columns):
            return 1.0
        s = self.squares(x)
        w = float(self.kernel.weight(s).sum())
        return max(0.0, 1.0 - 2.0 * float(self.kernel.fading(s).sum()) / (self.rows * w))

    def normal(self, x: Vector) -> tuple[Float[np.ndarray, "m d d"], Float[np.ndarray, "m d"]]:
        r, J, W = self.whitened(x), self.jacobian(x), self.sqrt_info
        if W is not None:
            J = W[..., None] * J if W.ndim == 2 else W @ J
        JT = J.swapaxes(1, 2)
        if self.kernel is not None:
            JT = JT * self.kernel.weight(np.square(r).sum(axis=1))[:, None, None]
        return np.asarray(JT @ J), np.asarray((JT @ r[..., None])[..., 0])


def wrapping(angles: Int[np.ndarray, " a"] | Sequence[int]) -> Retract:
    """The retraction that adds and then wraps the entries `angles` of x into (-pi, pi]."""
    where = np.asarray(angles, dtype=np.intp)

    def retract(x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        out = np.array(x + dx)
        out[where] = wrap_angle(out[where])
        return out

    return retract


def add(x: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """The plainest retraction: every variable is a number."""
    return np.asarray(x + dx)


@dataclass(frozen=True, slots=True)
class Problem:
    """Minimise the sum of all terms' costs over x, started at `x0`.

    fixed: (n,) True where an entry is held (the gauge, anchors), or None; retract(x, dx) -> x, with dx (n,).
    """

    x0: Vector
    terms: Sequence[Term]
    fixed: Bool[np.ndarray, " n"] | None = None
    retract: Retract = add

    @property
    def free(self) -> Int[np.ndarray, " f"]:
        """Which entries of x are estimated, ascending."""
        n = len(self.x0)
        return np.arange(n) if self.fixed is None else np.flatnonzero(~self.fixed)

    def cost(self, x: Vector) -> float:
        return float(sum(term.costs(x).sum() for term in self.terms))

    def chi2(self, x: Vector) -> float:
        """The sum of squared whitened residuals, without robust kernels."""
        return float(sum(term.squares(x).sum() for term in self.terms))

    @property
    def dof(self) -> int:
        """Rows of residual less variables estimated."""
        return sum(term.size for term in self.terms) - len(self.free)
