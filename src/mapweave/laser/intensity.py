"""How a scanner's intensity depends on where the light came back from."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core.records import frozen


@dataclass(frozen=True, slots=True)
class IntensityCalibration:
    """How intensity falls with range and incidence: `log I = log rho + log_gain(r) + exponent log c`.

    knots: (k,) ranges [m]; log_gain: (k,) at the knots, linear between, held outside; exponent: p; scale: the
    intensity of q = 1 at gain 1; residual: robust standard deviation of the fit in log units; samples: returns used.
    residual_by_range: (k,) median absolute residual near each knot.
    """

    knots: Float[np.ndarray, " k"]
    log_gain: Float[np.ndarray, " k"]
    exponent: float
    scale: float
    residual: float
    samples: int
    residual_by_range: Float[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name in ("knots", "log_gain", "residual_by_range"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def gain(self, r: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(np.exp(np.interp(r, self.knots, self.log_gain)))
