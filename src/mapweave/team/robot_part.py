"""What one robot brings into its team's problem, and where that stands among the variables."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from ..core.landmark_log import LandmarkLog, SightingTable
from ..laser.robot_graph import RobotGraph
from .commanded_motion import CommandedMotion
from .instants import Instants

PARAMETERS = ("speed_scale", "turn_scale", "lag", "bearing_bias", "range_scale")
SPEED, TURN, LAG, BIAS, RANGE = range(len(PARAMETERS))


@dataclass(frozen=True, slots=True)
class RobotPart:
    """What one robot brings: its log, when its pose is estimated, and where that stands among the variables.

    start: entry of its first pose; parameters: entry of its first calibration parameter; motion: None without odometry;
    scans: its keyframes, which are its instants then, or None without a laser.
    """

    log: LandmarkLog
    instants: Instants
    start: int
    parameters: int
    motion: CommandedMotion | None
    scans: RobotGraph | None = None

    @property
    def seen(self) -> SightingTable:
        """All it saw, with and without a range (NaN there)."""
        return all_seen(self.log)

    @property
    def robot(self) -> str:
        return self.log.robot

    def pose_columns(self, k: Int[np.ndarray, " m"]) -> Int[np.ndarray, "m 3"]:
        """The entries of x that hold the poses at the instants `k`."""
        return np.asarray(self.start + 3 * k[:, None] + np.arange(3))


def all_seen(log: LandmarkLog) -> SightingTable:
    """The sightings with a range and, after them, those by bearing alone."""
    with_range, without = log.sightings, log.bearings
    if not len(without):
        return with_range
    if not len(with_range):
        return without
    what = np.concatenate([with_range.what, without.what + len(with_range.ids)])
    t, z, b = (
        np.concatenate([getattr(with_range, name), getattr(without, name)]) for name in ("t", "range", "bearing")
    )
    return SightingTable(t, what, z, b, (*with_range.ids, *without.ids))
