"""What smoothing a whole team assumes of robots and sensors; one set of defaults for all of them."""

from dataclasses import field

from ..core.config import config


@config
class MotionNoise:
    """How far commands can be trusted, in commanded units; and how a robot moves whose commands nobody knows."""

    along: float = 0.05  # [m / sqrt(m)] of distance commanded
    across: float = 0.02  # [m / sqrt(m)]
    drift: float = 0.05  # [rad / sqrt(m)] heading over distance commanded
    turn: float = 0.1  # [rad / sqrt(rad)] heading over angle commanded
    rest_xy: float = 1e-3  # [m / sqrt(s)] always
    rest_theta: float = 1e-3  # [rad / sqrt(s)] always
    lost_xy: float = 0.06  # [m / sqrt(s)] while no command is known
    lost_theta: float = 0.3  # [rad / sqrt(s)]
    hold: float = 2.0  # [s] a command holds without a new one
    unknown_speed: float = 0.12  # [m/s] of a robot without odometry
    unknown_slip: float = 0.02  # [m/s] sideways, of the same
    unknown_spin: float = 0.35  # [rad/s]
    outlier: float = 2.5  # standard deviations from which a step counts less: robots are blocked now and then


@config
class CameraNoise:
    """How far sightings can be trusted: twice what they scatter by, since their errors last for seconds."""

    range_floor: float = 0.1  # [m]
    range_share: float = 0.09  # of the distance
    bearing: float = 0.028  # [rad]
    robot_range_floor: float = 0.22  # [m] of another robot, whose marks are not at its centre
    robot_bearing: float = 0.04  # [rad]
    outlier: float = 1.0  # standard deviations from which a sighting counts less: errors of ranges are skewed


@config
class CalibrationPrior:
    """What is known of each robot before its log is looked at: mean and standard deviation."""

    speed_scale: float = 1.0
    speed_scale_sd: float = 0.1
    turn_scale: float = 0.95
    turn_scale_sd: float = 0.2
    lag: float = 0.15  # [s] from command to motion
    lag_sd: float = 0.1
    bearing_bias: float = 0.0  # [rad]
    bearing_bias_sd: float = 0.02
    range_scale: float = 1.0
    range_scale_sd: float = 0.02


@config
class SmoothingConfig:
    """The table `[smoothing]` of a landmark configuration."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    camera: CameraNoise = field(default_factory=CameraNoise)
    calibration: CalibrationPrior = field(default_factory=CalibrationPrior)
    robot_sightings: bool = True  # whether sightings of other robots tie trajectories
    longest_step: float = 2.0  # [s] between two poses that are estimated
    shortest_step: float = 0.5  # [s] between two poses that are estimated; sightings between go by the nearest
    cluster: float = 20.0  # [s] errors of one robot are taken to be independent after this long
    memory: float = 5.0  # [s] over which errors of one robot's sightings of one landmark are taken to hang together
    position_floor: float = 0.01  # [m] added to every standard deviation of a place
    heading_floor: float = 0.003  # [rad]
    max_iterations: int = 40
