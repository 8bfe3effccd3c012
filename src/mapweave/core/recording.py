"""A whole team's landmark recording with its truth: what a simulator makes and a writer puts into files."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .arrays import frozen


@dataclass(frozen=True, slots=True)
class RobotRecording:
    """One robot's rows.

    odometry: (n, 3) t [s], v [m/s], w [rad/s] as commanded; sightings: stamps (m,) [s], barcodes (m,), range and
    bearing (m, 2) [m, rad]; truth: (k, 4) t [s], x, y [m], theta [rad] in the survey's frame.
    """

    number: int
    odometry: Float[np.ndarray, "n 3"]
    stamps: Float[np.ndarray, " m"]
    barcodes: Int[np.ndarray, " m"]
    sightings: Float[np.ndarray, "m 2"]
    truth: Float[np.ndarray, "k 4"]

    def __post_init__(self) -> None:
        for name in ("odometry", "stamps", "sightings", "truth"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "barcodes", frozen(self.barcodes, np.int64))


@dataclass(frozen=True, slots=True)
class TeamRecording:
    """barcodes: of every subject, robots first; landmarks: subject -> surveyed (x, y) [m]."""

    barcodes: Mapping[int, int]
    landmarks: Mapping[int, tuple[float, float]]
    robots: tuple[RobotRecording, ...]
