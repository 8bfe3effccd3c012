"""Everything one laser robot hands over: where it drove, what every scan did to the estimate, its map."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.records import Track, frozen
from .grid import GridMap, IntensityCalibration
from .robot_graph import RobotGraph


@dataclass(frozen=True, slots=True)
class ScanRecords:
    """One row a scan, in the order the scans came.

    t: (n,) [s]; host: who wrote it; pose: (n, 3) in the track's frame; innovation: (n, 3), matched pose seen from the
    pose odometry predicted [m, m, rad]; beams: returns in the scan; matches: returns that found a partner;
    decision: "first", "matched", "odometry" (the gate or too few matches refused the match), "skipped" (the robot
    had hardly moved) or "empty" (no returns); n_eff: effective number of particles, NaN where no weights changed;
    resampled: (n,); information: (n, 3, 3), of each pose seen from the one before [1/m^2, 1/rad^2], where the method
    gives it (row 0 tells nothing).
    """

    t: Float[np.ndarray, " n"]
    host: tuple[str, ...]
    pose: Float[np.ndarray, "n 3"]
    innovation: Float[np.ndarray, "n 3"]
    beams: Int[np.ndarray, " n"]
    matches: Int[np.ndarray, " n"]
    decision: tuple[str, ...]
    n_eff: Float[np.ndarray, " n"]
    resampled: Bool[np.ndarray, " n"]
    information: Float[np.ndarray, "n 3 3"] | None = None

    def __post_init__(self) -> None:
        if self.information is not None:
            object.__setattr__(self, "information", frozen(self.information))
        for name in ("t", "pose", "innovation", "n_eff"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        for name in ("beams", "matches"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int64))
        object.__setattr__(self, "resampled", frozen(self.resampled, np.bool_))

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, slots=True)
class LaserMap:
    """One robot's laser map in `local_k` (its first pose), as an estimator leaves it.

    method: "graph", "particle", "gated" or "icp"; feature: the one really used (`none` when the log's intensity says
    nothing); odometry: "poses" or "none"; dead_reckoning: odometry alone at the same stamps, None without odometry;
    graph: keyframes, steps and closures, None of the other methods.
    """

    robot: str
    method: str
    feature: str
    track: Track
    grid: GridMap
    scans: ScanRecords
    odometry: str = "poses"
    dead_reckoning: Track | None = None
    calibration: IntensityCalibration | None = None
    particles: int = 1
    source: str = ""
    log_hash: str = ""
    dropped: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)
    graph: RobotGraph | None = None
