"""Who saw whom in which direction: the one table that readers, the simulator and every swarm estimator share."""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .errors import UsageError
from .records import freeze

_ANGLE = re.compile(r"^\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(deg|rad)\s*$")


@dataclass(frozen=True, slots=True)
class BearingTable:
    """A table of m bearings among n robots; row k: `ids[observer[k]]` saw `ids[target[k]]` along `direction[k]`.

    direction: (m, d) unit vectors, d = 2 or 3, in the common axes when `axis`, else in the observer's own frame;
    sigma: (m,) [rad], NaN where the table does not say; t: (m,) [s], or None when nothing is stamped.
    """

    ids: tuple[str, ...]
    observer: Int[np.ndarray, " m"]
    target: Int[np.ndarray, " m"]
    direction: Float[np.ndarray, "m d"]
    sigma: Float[np.ndarray, " m"]
    t: Float[np.ndarray, " m"] | None = None
    axis: bool = True

    def __post_init__(self) -> None:
        freeze(self, "observer", "target", dtype=np.int64)
        freeze(self, "direction", "sigma", "t")

    @property
    def dim(self) -> int:
        return int(self.direction.shape[1])

    def bearing(self) -> Float[np.ndarray, " m"]:
        """Angles in the x-y plane, in (-pi, pi] [rad]."""
        return np.asarray(np.arctan2(self.direction[:, 1], self.direction[:, 0]))

    def rows(self, keep: np.ndarray) -> "BearingTable":
        """The rows that `keep` (mask or indices) names; all robots stay."""
        t = None if self.t is None else self.t[keep]
        return BearingTable(
            self.ids, self.observer[keep], self.target[keep], self.direction[keep], self.sigma[keep], t, self.axis
        )


def parse_angle(text: str) -> float:
    """`0.5deg` or `0.0087rad` in radians; raises UsageError for a bare number, which could be either."""
    match = _ANGLE.match(text)
    if match is None:
        raise UsageError(f"angle {text!r}: expected a positive number with its unit, such as 0.5deg or 0.0087rad")
    value = float(match[1])
    if value <= 0.0:
        raise UsageError(f"angle {text!r}: expected a positive number")
    return float(np.deg2rad(value)) if match[2] == "deg" else value


def unit(angle: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 2"]:
    """Unit vectors of angles [rad] from +x, counter-clockwise."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


def unit3(azimuth: Float[np.ndarray, " m"], elevation: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """Unit vectors of azimuth (from +x, counter-clockwise) and elevation (up from the x-y plane) [rad]."""
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
