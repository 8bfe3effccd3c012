"""What EKF-SLAM assumes of a robot and its sensors; one set of defaults for the whole family of robots."""

from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.errors import ConfigError
from ..kernels.landmarks.ekf import Noise

REST_XY = 1e-4  # [m / sqrt(s)] of wandering in place, always there
REST_THETA = 1e-4  # [rad / sqrt(s)] of the heading

PIECE_GAP = 5.0  # [s] without a sighting after which a new piece of map is begun
TRACK_RANGE_INFLATION = 5.0  # of the variance of ranges where past poses are corrected by the finished map
TRACK_BEARING_INFLATION = 3.0  # and of bearings

LOST_XY = 0.06  # [m / sqrt(s)] while no command is known
LOST_THETA = 0.3  # [rad / sqrt(s)] of heading, while no command is known
SPEED_TIME = 30.0  # [s] a robot without commands keeps its speed
EKF_SLAM_SPIN = 0.35  # [rad/s] standard deviation of its turn rate
SPIN_TIME = 2.0  # [s] such a robot keeps its turn rate
EKF_SLAM_WANDER = 0.005  # [m / sqrt(s)] and [rad / sqrt(s)] such a robot wanders beside its speed and spin
PIECE_OLDER = 0.2  # share of new rows in the last piece, from which an intermediate map is made anew
PIECE_SIGHTINGS = 5  # of a landmark in a piece, before it helps to tie it
PIECE_FLOOR = 0.005  # [m] a piece is never surer of a landmark than this
PIECE_BASELINE = 0.5  # [m] between the landmarks that tie a piece when there are only two
PIECE_MISFIT = 1.0  # [m] root mean square of a rigid fit from which a piece is not even tried
PIECE_CHI2 = 9.0  # a degree of freedom, up to which a piece fits the others
EKF_SLAM_ASTRAY = 0.1  # [m/s] how fast a robot gets away from where it was while nothing is known of it
# what is left out of a finished map, and what is warned of
RESTLESS_SIGHTINGS = 20  # from which a landmark that keeps contradicting itself is left out
RESTLESS_SHARE = 0.5  # of its sightings down-weighted, from which it does
RESTLESS_MOST = 5  # landmarks left out so, one after the other: one that moves makes others look restless
WARN_DOWN_WEIGHTED = 0.3  # share of all sightings
WARN_NIS = 3.0  # median normalised innovation squared; 1.4 is expected


@config
class EkfSlamConfig:
    """Settings of landmark EKF-SLAM, table `[ekf]`: noise, gates, and what is known of each robot's calibration.

    Noise is that of commands and readings as they are logged; a prior is a mean and a standard deviation.

    A standard deviation of zero switches a calibration parameter off. The speed scale and the range scale are never
    estimated together: they collapse the map.
    """

    SIGNED: ClassVar[tuple[str, ...]] = ("bearing_bias",)
    odometry: bool = True  # whether commands are known at all; without them the robot wanders
    smooth: bool = True  # whether past poses are corrected by what came later, once the map is finished
    # how far commands can be trusted
    noise_along: float = 0.05  # [m / sqrt(m)] of distance commanded
    noise_across: float = 0.02  # [m / sqrt(m)] sideways, over distance commanded
    noise_drift: float = 0.05  # [rad / sqrt(m)] heading over distance commanded
    noise_turn: float = 0.1  # [rad / sqrt(rad)] heading over angle commanded
    hold: float = 2.0  # [s] a command holds without a new one
    # a robot without odometry: its speed and turn rate wander about zero
    speed: float = 0.08  # [m/s] standard deviation of its speed
    # the camera
    range_floor: float = 0.05  # [m] standard deviation of a range at no distance
    range_share: float = 0.045  # of the predicted distance
    bearing: float = 0.014  # [rad] standard deviation of a bearing
    range_inflation: float = 30.0  # of the variance: errors of one landmark's range last for seconds
    bearing_inflation: float = 10.0  # of the variance of bearings, for the same reason
    gate: float = 2.0  # normalised innovation from which a sighting counts less, never nothing
    far: float = 10.0  # normalised innovation from which it counts less by the square: a label misread
    agree: int = 3  # sightings of a new landmark that must agree on its place
    # rows beyond are broken and left out
    # calibration: prior mean and standard deviation
    speed_scale: float = 1.0  # true speed over commanded speed, prior mean
    speed_scale_sd: float = 0.0  # its standard deviation; 0: not estimated
    turn_scale: float = 0.95  # true turn rate over commanded, prior mean
    turn_scale_sd: float = 0.2  # its standard deviation; 0: not estimated
    lag: float = 0.15  # [s] from command to motion
    lag_sd: float = 0.1  # [s] its standard deviation; 0: not estimated
    bearing_bias: float = 0.0  # [rad] of every bearing, prior mean
    bearing_bias_sd: float = 0.02  # [rad] its standard deviation; 0: not estimated
    range_scale: float = 1.0  # measured range over true range, prior mean
    range_scale_sd: float = 0.03  # its standard deviation; 0: not estimated

    def __post_init__(self) -> None:
        if self.odometry and self.speed_scale_sd > 0 and self.range_scale_sd > 0:
            raise ConfigError(
                "speed_scale_sd and range_scale_sd: expected one of them 0, they collapse the map together"
            )


def calibration_prior(cfg: EkfSlamConfig) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "5"]]:
    """Means and standard deviations in the order of the state.

    Without odometry the first two are speed and turn rate themselves, and the sensor is taken as it is.
    """
    if not cfg.odometry:
        return np.array([0.0, 0.0, 0.0, 0.0, 1.0]), np.array([cfg.speed, EKF_SLAM_SPIN, 0.0, 0.0, 0.0])
    mean = np.array([cfg.speed_scale, cfg.turn_scale, cfg.lag, cfg.bearing_bias, cfg.range_scale])
    sd = np.array([cfg.speed_scale_sd, cfg.turn_scale_sd, cfg.lag_sd, cfg.bearing_bias_sd, cfg.range_scale_sd])
    return mean, sd


def noise(cfg: EkfSlamConfig) -> Noise:
    known = cfg.odometry
    camera = (cfg.range_floor, cfg.range_share, cfg.bearing, cfg.range_inflation, cfg.bearing_inflation)
    return Noise(
        cfg.noise_along, cfg.noise_across, cfg.noise_drift, cfg.noise_turn, REST_XY, REST_THETA,
        LOST_XY if known else EKF_SLAM_WANDER, LOST_THETA if known else EKF_SLAM_WANDER,
        cfg.hold, 0.0 if known else cfg.speed, SPEED_TIME, EKF_SLAM_SPIN, SPIN_TIME,
        *camera, cfg.gate, cfg.far, cfg.agree,
    )  # fmt: skip


def track_noise(cfg: EkfSlamConfig) -> Noise:
    """`noise` for correcting past poses."""
    return noise(cfg)._replace(range_inflation=TRACK_RANGE_INFLATION, bearing_inflation=TRACK_BEARING_INFLATION)
