"""Maps of landmarks: named points with their joint covariance, alone or with what belongs to them.

`Submap`: with the robot in it. `LocalMap`: all that one robot hands over. `GlobalMap`: with every robot's frame in it.

`View`: where a sensor looked, and how surely what stands there is in its map: evidence of what is not there. How
far and how wide a sensor sees, and how often it sights what it has in view, is read off the robot's own log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import SightingTable
from ..core.records import Track, freeze

EVERY = 1.0  # [s] from one look to the next, at least: sooner, it sees what it saw before
LOOKS = 2000  # at most, spread over the log: bounds the time
RIM = 0.05  # share of sightings on either side that are left out of the view: there a landmark is seen now and then
SUREST = 0.9  # that what was in view ever so often is in the map: some things stand behind others


@dataclass(frozen=True, slots=True)
class View:
    """What a sensor sees: up to `reach` [m], between the bearings `right` and `left` [rad], at a `rate` of looks.

    `left` is not below `right`, so that of a sensor that looks backwards one of them lies beyond half a turn.
    """

    reach: float
    right: float
    left: float
    rate: float

    def looks(self, track: Track, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "l n"]:
        """Which of n points, in the track's frame, each of l looks along it had in view (1) or not (0)."""
        seen = se2.act(se2.inverse(track.pose[_rows(track)])[:, None], points)
        within = self.within(np.hypot(seen[..., 0], seen[..., 1]), np.arctan2(seen[..., 1], seen[..., 0]))
        return np.asarray(within, dtype=float)

    def within(self, far: Float[np.ndarray, "*n"], bearing: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Whether what is so `far` [m] at a `bearing` [rad] is in view."""
        off = np.abs(se2.wrap_angle(bearing - 0.5 * (self.right + self.left)))
        return np.asarray((far <= self.reach) & (off <= 0.5 * (self.left - self.right)))

    def mapped(self, track: Track, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """The probability that landmarks at n points, in the track's frame, are in the map of who drove it."""
        return np.asarray(SUREST * (1 - (1 - self.rate) ** self.looks(track, points).sum(axis=0)))


def _rows(track: Track) -> np.ndarray:
    """The poses at which a look counts: `EVERY` seconds apart, or as many as `LOOKS` leaves."""
    since = track.t - track.t[0]
    every = max(EVERY, float(since[-1]) / LOOKS)
    looks = every * np.arange(int(since[-1] // every) + 1)
    return np.unique(np.searchsorted(since, np.minimum(looks, since[-1])))


def view_of(track: Track, seen: SightingTable, ids: Sequence[str], mean: Float[np.ndarray, "n 2"]) -> View | None:
    """The view of who drove `track`, saw `seen` and put landmarks `ids` at `mean`; None where too little tells it."""
    number = {name: k for k, name in enumerate(ids)}
    which = np.array([number.get(name, -1) for name in seen.ids], dtype=np.intp)[seen.what]
    known = (which >= 0) & np.isfinite(seen.range)
    if len(track.t) < 2 or not known.any():
        return None
    reach = float(np.quantile(seen.range[known], 1 - RIM))
    ahead = float(np.angle(np.exp(1j * seen.bearing[known]).sum()))  # of the sensor, not of the robot
    off = np.quantile(se2.wrap_angle(seen.bearing[known] - ahead), [RIM, 1 - RIM])
    right, left = float(ahead + off[0]), float(ahead + off[1])
    view = View(reach, right, left, 1.0)
    looks = view.looks(track, mean).sum()
    if not looks:
        return None
    inside = known & view.within(seen.range, seen.bearing)
    look = np.searchsorted(track.t[_rows(track)], seen.t[inside], side="right")
    sighted = len(np.unique(look * len(ids) + which[inside]))
    return View(reach, right, left, float(min(sighted / looks, 1.0)))


@dataclass(frozen=True, slots=True)
class LandmarkMap:
    """n landmarks in one frame. mean: (n, 2) [m]; cov: (2n, 2n) [m^2], joint, order x1 y1 x2 y2 ..."""

    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    frame: str = "map"

    def __post_init__(self) -> None:
        freeze(self, "mean", "cov")
        if self.cov.shape != (2 * len(self.ids), 2 * len(self.ids)) or len(set(self.ids)) != len(self.ids):
            msg = f"{len(self.ids)} ids (distinct), covariance {self.cov.shape}: they do not belong together"
            raise ValueError(msg)

    def __len__(self) -> int:
        return len(self.ids)

    def select(self, ids: Sequence[str]) -> "LandmarkMap":
        """The marginal over `ids`, in that order."""
        where = {name: i for i, name in enumerate(self.ids)}
        index = np.array([where[name] for name in ids], dtype=np.intp)
        rows = (2 * index[:, None] + np.arange(2)).ravel()
        return LandmarkMap(tuple(ids), self.mean[index], self.cov[np.ix_(rows, rows)], self.frame)

    def moved(self, T_new_old: Float[np.ndarray, "3"], frame: str) -> "LandmarkMap":
        """The same map expressed in `frame` through an exactly known transform."""
        C = np.kron(np.eye(len(self)), se2.rotation(float(T_new_old[2])))
        return LandmarkMap(self.ids, se2.act(T_new_old, self.mean), C @ self.cov @ C.T, frame)


@dataclass(frozen=True, slots=True)
class Submap:
    """Robot pose and n landmarks in `frame` (`local_k`: the first pose). cov: (3 + 2n, 3 + 2n), pose first."""

    robot: str
    pose: Float[np.ndarray, "3"]
    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    frame: str

    def __post_init__(self) -> None:
        freeze(self, "pose", "mean", "cov")
        size = 3 + 2 * len(self.ids)
        if self.cov.shape != (size, size) or self.mean.shape != (len(self.ids), 2):
            msg = f"{len(self.ids)} ids do not belong to mean {self.mean.shape} and covariance {self.cov.shape}"
            raise ValueError(msg)

    @property
    def landmarks(self) -> LandmarkMap:
        """The landmarks alone, the pose marginalised away."""
        return LandmarkMap(self.ids, self.mean, self.cov[3:, 3:], self.frame)


@dataclass(frozen=True, slots=True)
class RobotSightings:
    """Sightings of other robots: t: (n,) [s]; target: robot names; range: (n,) [m]; bearing: (n,) [rad]."""

    t: Float[np.ndarray, " n"]
    target: tuple[str, ...]
    range: Float[np.ndarray, " n"]
    bearing: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        freeze(self, "t", "range", "bearing")


NO_ROBOT_SIGHTINGS = RobotSightings(np.zeros(0), (), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class LocalMap:
    """One robot's own map in `local_k` (its first pose), as an estimator leaves it and `fuse` takes it.

    `sightings` counts those each landmark was made of, `first_seen` holds the stamp [s] of the first of them;
    `calibration` holds the sensor parameters estimated, by name, as (value, standard deviation); `log_hash` tells two
    runs over the same log from two logs; `restless`: names left out of the map, since they had no fixed place in it;
    `view`: what its sensor sees, where its log tells.
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
    findings: tuple[Finding, ...] = ()
    first_seen: Mapping[str, float] = field(default_factory=dict)
    restless: tuple[str, ...] = ()
    view: View | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' texts."""
        return tuple(f.text for f in self.findings)


@dataclass(frozen=True, slots=True)
class GlobalMap:
    """`G = [XL_1 .. XL_M, m_1 .. m_n]`: frames (M, 3) = `T_map_local`, landmarks (n, 2), cov (3M + 2n, 3M + 2n).

    apart: pairs of ids, each sorted, that a robot has told apart and that are therefore never one landmark.
    """

    robots: tuple[str, ...]
    frames: Float[np.ndarray, "r 3"]
    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    apart: frozenset[tuple[str, str]] = frozenset()

    def __post_init__(self) -> None:
        freeze(self, "frames", "mean", "cov")
        size = 3 * len(self.robots) + 2 * len(self.ids)
        if self.cov.shape != (size, size):
            msg = (
                f"{len(self.robots)} frames and {len(self.ids)} landmarks do not belong to covariance {self.cov.shape}"
            )
            raise ValueError(msg)

    @property
    def landmarks(self) -> LandmarkMap:
        """The landmarks alone, frames marginalised away."""
        k = 3 * len(self.robots)
        return LandmarkMap(self.ids, self.mean, self.cov[k:, k:], "map")

    def frame_of(self, robot: str) -> Float[np.ndarray, "3"]:
        return np.asarray(self.frames[self.robots.index(robot)])

    def pose_in_map(self, robot: str, pose_local: Float[np.ndarray, "... 3"]) -> np.ndarray:
        """`T_map_robot` from a pose in the robot's current submap."""
        return se2.compose(self.frame_of(robot), pose_local)


def known_starts(robots: tuple[str, ...], starts: Float[np.ndarray, "r 3"]) -> GlobalMap:
    """No landmark yet; every submap frame at the robot's exactly known start."""
    return GlobalMap(robots, starts, (), np.zeros((0, 2)), np.zeros((3 * len(robots), 3 * len(robots))))
