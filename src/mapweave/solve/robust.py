"""Robust kernels: what a squared whitened residual costs, and how much its factor still counts.

All equal the square near zero; `k` is in standard deviations.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

Values = Float[np.ndarray, " m"]


@runtime_checkable
class Kernel(Protocol):
    """`s` (m,): squared whitened norms. `weight` is the derivative of `cost`, in (0, 1], and scales the information."""

    def cost(self, s: Values) -> Values: ...
    def weight(self, s: Values) -> Values: ...


@dataclass(frozen=True, slots=True)
class Huber:
    """Square inside `k`, linear outside: an outlier pulls with bounded force."""

    k: float = 1.345

    def cost(self, s: Values) -> Values:
        return np.where(s <= self.k**2, s, 2.0 * self.k * np.sqrt(s) - self.k**2)

    def weight(self, s: Values) -> Values:
        return np.asarray(self.k / np.maximum(np.sqrt(s), self.k))


@dataclass(frozen=True, slots=True)
class Cauchy:
    """Logarithmic: an outlier's pull fades as it goes away."""

    k: float = 2.385

    def cost(self, s: Values) -> Values:
        return np.asarray(self.k**2 * np.log1p(s / self.k**2))

    def weight(self, s: Values) -> Values:
        return 1.0 / (1.0 + s / self.k**2)


@dataclass(frozen=True, slots=True)
class GemanMcClure:
    """Bounded by k^2: a gross outlier stops pulling. Needs a good start."""

    k: float = 3.0

    def cost(self, s: Values) -> Values:
        return self.k**2 * s / (self.k**2 + s)

    def weight(self, s: Values) -> Values:
        return (self.k**2 / (self.k**2 + s)) ** 2
