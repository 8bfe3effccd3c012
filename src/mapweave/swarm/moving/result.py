"""What tracking a swarm needs to be told, and what it gives."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.config import config
from ...core.errors import ConfigError
from ...core.records import freeze
from ...solve import Solution

TRACK_MERGE = 0.002  # [s]; stamps closer than this are one instant
SCALE_V = 0.0  # prior of the scale of each robot's v about 1; 0: trusted as it is
TRACK_WINDOW = 20.0  # [s] by which a start without common axes is grown
TRACK_OUTLIER = 4.0  # standard deviations beyond which a sighting is an outlier, with a kernel
FIRST_INSTANTS = 3  # instants that are smoothed together before filtering begins
TRACK_RELINEARISE = 3  # times that one instant's sightings are linearised by the filter
TRACK_ENOUGH = 6  # sightings that place a robot, where a start without common axes is grown
GROW_KERNEL = 3.0  # [standard deviations] Cauchy kernel on sightings for that start, where `kernel` is 0
TRACK_MEETING = 1.5  # times the error of one sighting, with what wheels turn astray in a `window`, and
MEETING_FLOOR = 0.01  # [rad] more: rms error up to which a meeting of two robots is believed
MEETING_OUTLIER = 3.0  # times that error: a sighting further off counts as this much off
LEAST_KERNEL = 0.1  # standard deviations: a narrower kernel believes no sighting


@config
class TrackConfig:
    """Settings of `locate` for robots that move, table `[motion]`.

    Odometry noise is white: its standard deviation over dt is (floor + share |v|) sqrt(dt).
    """

    acceleration: float = 0.02  # [m^2/s^3] white-noise acceleration density of each axis, without odometry
    speed: float = 3.0  # [m/s] prior of each axis of the first velocity, without odometry
    slip_floor: float = 0.01  # [m/sqrt(s)] noise of the distance driven, at rest too
    slip: float = 0.1  # [sqrt(s)] and so much of the speed more
    turn_floor: float = 0.01  # [rad/sqrt(s)] noise of the heading, at rest too
    turn: float = 0.1  # [sqrt(s)] and so much of the turn rate more
    scale_w: float = 0.0  # the same of its w
    kernel: float = 0.0  # Cauchy kernel on sightings [standard deviations]; 0: none

    def __post_init__(self) -> None:
        if 0 < self.kernel < LEAST_KERNEL:
            raise ConfigError(f"kernel: expected 0 or at least {LEAST_KERNEL:g}, found {self.kernel}")


@dataclass(frozen=True, slots=True)
class RobotTrajectory:
    """One robot over time. t: (k,) [s]; position: (k, d) [m]; cov: (k, d, d) or None; heading: (k,) [rad] or None."""

    t: Float[np.ndarray, " k"]
    position: Float[np.ndarray, "k d"]
    cov: Float[np.ndarray, "k d d"] | None = None
    heading: Float[np.ndarray, " k"] | None = None

    def __post_init__(self) -> None:
        freeze(self, "t", "position", "cov", "heading")


def without_outliers(
    squares: Float[np.ndarray, " m"], rows: int, solution: Solution, cfg: TrackConfig
) -> tuple[Bool[np.ndarray, " m"], float, int]:
    """Which sightings (by their squared whitened residuals) are outliers, and chi2 and dof without them."""
    out = np.asarray((squares > TRACK_OUTLIER**2) & (cfg.kernel > 0.0))
    return out, solution.chi2 - float(squares[out].sum()), solution.dof - rows * int(out.sum())


@dataclass(frozen=True, slots=True)
class SwarmTrack:
    """All robots over time.

    tracks: by robot index; chi2, dof: of the whitened sightings and motions, without the sightings that are `outlier`
    (m,), beyond `TrackConfig.outlier` standard deviations and looked for only with a robust kernel; gauge: what was
    free and how it was held, "" when anchors fix all; scale: by robot index, the factors found on its odometry's v and
    w.
    """

    tracks: Mapping[int, RobotTrajectory]
    method: str
    converged: bool
    iterations: int
    chi2: float
    dof: int
    outlier: Bool[np.ndarray, " m"]
    gauge: str = ""
    warnings: tuple[str, ...] = ()
    scale: Mapping[int, tuple[float, float]] | None = None

    def localisable(self, robot: int) -> bool:
        """Whether `robot` (index) has a track, at its surest position better known than the swarm is wide."""
        one = self.tracks.get(robot)
        if one is None:
            return False
        if one.cov is None:
            return True
        everywhere = np.concatenate([each.position for each in self.tracks.values()])
        width = float(np.linalg.norm(np.quantile(everywhere, 0.9, axis=0) - np.quantile(everywhere, 0.1, axis=0)))
        return bool(np.sqrt(np.trace(one.cov, axis1=1, axis2=2)).min() <= width)
