"""Everything one robot hands over: its submap, where it drove, and how far it can be trusted."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core.records import Track, frozen
from .submap import Submap


@dataclass(frozen=True, slots=True)
class RobotSightings:
    """Sightings of other robots: t: (n,) [s]; target: robot names; range: (n,) [m]; bearing: (n,) [rad]."""

    t: Float[np.ndarray, " n"]
    target: tuple[str, ...]
    range: Float[np.ndarray, " n"]
    bearing: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in ("t", "range", "bearing"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


NO_ROBOT_SIGHTINGS = RobotSightings(np.zeros(0), (), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class LocalMap:
    """One robot's own map in `local_k` (its first pose), as an estimator leaves it and `fuse` takes it.

    `sightings` counts those each landmark was made of; `calibration` holds the sensor parameters estimated, by
    name, as (value, standard deviation); `log_hash` tells two runs over the same log from two logs.
    """

    robot: str
    submap: Submap
    track: Track
    sightings: Mapping[str, int]
    robot_sightings: RobotSightings = NO_ROBOT_SIGHTINGS
    odometry: str = "velocity"
    source: str = ""
    log_hash: str = ""
    nis_median: float | None = None
    down_weighted: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    calibration: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
