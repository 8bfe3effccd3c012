"""What robots say, as immutable records. A log, a simulator and a live session yield the same `Event`s.

Arrays enter records through one door: C-contiguous, float64, read-only.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .errors import ReaderError
from .se2 import IDENTITY

# least stamp since 1970 that is one in this unit: as seconds, they are of the year 5138 and later
SMALLER_UNITS = {"milliseconds": 1e11, "microseconds": 1e14, "nanoseconds": 1e17}


def frozen(values: Any, dtype: Any = np.float64) -> np.ndarray:
    """A C-contiguous read-only array of `dtype`; a copy is made only when the input is writable or differs."""
    a = np.ascontiguousarray(values, dtype=dtype)
    if a.flags.writeable:
        a = a.copy() if a is values or a.base is not None else a
        a.setflags(write=False)
    return a


def freeze(record: object, *names: str, dtype: Any = np.float64) -> None:
    """These arrays of a frozen dataclass that is being made are `frozen` now, but for those that are None."""
    for name in names:
        if (values := getattr(record, name)) is not None:
            object.__setattr__(record, name, frozen(values, dtype))


def expect_seconds(t: Float[np.ndarray, " n"], where: object) -> None:
    """Raises ReaderError naming `where` and the unit when stamps count in a smaller one."""
    size = float(np.median(np.abs(t))) if len(t) else 0.0
    units = [name for name, least in SMALLER_UNITS.items() if size >= least]
    if units:
        raise ReaderError(where, f"stamps are in {units[-1]} (half of them exceed {size:.3g}): expected seconds")


def owned(a: np.ndarray) -> np.ndarray:
    """`a`, made here and held by nobody else, read-only from now on: `frozen` takes it as it is, without a copy."""
    a.setflags(write=False)
    return a


@dataclass(frozen=True, slots=True)
class Odometry:
    """A packet of n >= 1 velocity rows, ascending in time; row i holds from t[i] until the next row.

    t: (n,) [s]; v: (n,) forward [m/s]; w: (n,) turn rate [rad/s], counter-clockwise. How rows are packed
    never changes a result.
    """

    t: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    w: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class OdometryPoses:
    """A packet of n >= 1 integrated odometry poses `T_odom_robot`, ascending in time. t: (n,) [s]; pose: (n, 3)."""

    t: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True)
class Sightings:
    """What one camera frame saw: ids (n), range: (n,) [m], bearing: (n,) [rad] CCW from robot x. One stamp."""

    ids: tuple[str, ...]
    range: Float[np.ndarray, " n"]
    bearing: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class LandmarkPacket:
    """A stretch of a landmark log in one packet: what its velocity rows and camera frames one by one would say.

    t: (n,) [s] of n >= 0 sightings, ascending; what: (n,) index into `ids`; range: (n,) [m]; bearing: (n,) [rad].
    """

    odometry: Odometry | None
    t: Float[np.ndarray, " n"]
    what: Int[np.ndarray, " n"]
    range: Float[np.ndarray, " n"]
    bearing: Float[np.ndarray, " n"]
    ids: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Scan:
    """One laser revolution.

    ranges: (n,) [m], always finite; `hit` (n,) says which are returns: elsewhere the range says nothing (a reader puts
    `range_max` there). intensities: (n,) in the sensor's units, or None; beam k points at
    `angle_min + k angle_increment` [rad], CCW from the sensor's x. n may change from scan to scan, and may hold no
    return at all. `odometry` is `T_odom_robot` at the scan's own stamp, or None when the log has no odometry.
    `heading` [rad] is the robot's by its gyroscope, from any zero: the turn since the scan before, where both have one.
    `motion` is the robot's from the first beam to the last [m, m, rad], in whose middle it has the scan's pose: what
    beams were taken from elsewhere is reckoned with; None where all are of one moment, or it is not known.
    """

    ranges: Float[np.ndarray, " n"]
    hit: Bool[np.ndarray, " n"]
    intensities: Float[np.ndarray, " n"] | None
    angle_min: float
    angle_increment: float
    range_max: float
    T_robot_sensor: Float[np.ndarray, "3"] = field(default_factory=lambda: IDENTITY)
    host: str = ""
    odometry: Float[np.ndarray, "3"] | None = None
    heading: float | None = None
    motion: Float[np.ndarray, "3"] | None = None

    def angles(self) -> Float[np.ndarray, " n"]:
        """Beam directions (n,) [rad] in the sensor frame."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges))


Record = Odometry | OdometryPoses | Sightings | LandmarkPacket | Scan


@dataclass(frozen=True, slots=True)
class Event:
    """`record` from `robot`, complete at time `t` [s] (a packet's last stamp)."""

    t: float
    robot: str
    record: Record


@dataclass(frozen=True, slots=True)
class Track:
    """A trajectory: poses along time.

    t: (n,) [s], strictly ascending; pose: (n, 3) in `frame`; cov: (n, 3, 3) over x, y, theta, or None.
    """

    t: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    cov: Float[np.ndarray, "n 3 3"] | None = None
    frame: str = "map"

    def __post_init__(self) -> None:
        freeze(self, "t", "pose")
        if self.cov is not None:
            object.__setattr__(self, "cov", frozen(self.cov))
