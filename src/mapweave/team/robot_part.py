"""What one robot brings into its team's problem, and where that stands among the variables."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from ..core.landmark_log import LandmarkLog
from .commanded_motion import CommandedMotion
from .instants import Instants

PARAMETERS = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")
SPEED, TURN, LAG, BIAS, RANGE = range(len(PARAMETERS))


@dataclass(frozen=True, slots=True)
class RobotPart:
    """What one robot brings: its log, when its pose is estimated, and where that stands among the variables.

    start: entry of its first pose; parameters: entry of its first calibration parameter; motion: None without odometry.
    """

    log: LandmarkLog
    instants: Instants
    start: int
    parameters: int
    motion: CommandedMotion | None

    @property
    def robot(self) -> str:
        return self.log.robot

    def pose_columns(self, k: Int[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
        """The entries of x that hold the poses at the instants `k`."""
        return np.asarray(self.start + 3 * k[:, None] + np.arange(3))
