"""What placing and smoothing a whole team assume of robots and sensors; one set of defaults for all of them.

And how it is smoothed while its logs play.
"""

from dataclasses import field, replace
from typing import ClassVar

from ..core.config import config
from ..core.errors import ConfigError

CLUSTER = 20.0  # [s] errors of one robot are taken to be independent after this long

MOTION_NOISE_HOLD = 2.0  # [s] a command holds without a new one
UNKNOWN_SPEED = 0.12  # [m/s] ahead, of a robot without odometry
UNKNOWN_SLIP = 0.02  # [m/s] sideways, of a robot without odometry
UNKNOWN_SPIN = 0.35  # [rad/s] turn rate of a robot without odometry
UNKNOWN_MEMORY = 6.0  # [s] for which a robot without odometry may keep its speed, where it tells no ranges
MOTION_NOISE_OUTLIER = 2.5  # standard deviations from which a step counts less: robots are blocked now and then

CLOCK_SUSPECT = 0.08  # [s] that a clock must seem off with trajectories held, to be looked at: a part of all
ANOTHER_TIME = 60.0  # [s] between the spans of two logs from which their clocks have nothing in common
CLOCK_LEAST = 0.5  # [s] from which a clock is off: less is within the lateness of cameras and commands
CLOCK_TRIED = 1.0  # standard deviations from which it is tried as it seems,
CLOCK_ROUNDS = 8  # smoothing again after each,
CLOCK_STILL = 0.05  # [s] until it moves no more
CLOCK_GAIN = 25.0  # cost that a clock put right must take away at least
CLOCK_SURE = 6.0  # standard deviations from which it is put right too,
GAIN_SURE = 35.0  # and the cost that it must take away then

SHARP_RANGE = 0.5  # of the error of a range, and
SHARP_BEARING = 0.4  # of a bearing, that is the sighting's own: as along tracks that are good

LONGEST_STEP = 30.0  # [s] to which the shortest step is made longer where poses are too many, at most
SMOOTHING_MEMORY = 5.0  # [s] over which errors of one robot's sightings of one landmark are taken to be correlated
SMOOTHING_GROUPS = 3.0  # of factors, for each landmark coordinate and calibration parameter, that a sandwich wants
FEW_RAISED = 0.5  # share added to what fewer groups tell, as of Morel, Bokossa and Neerchal (2003)
MOST_CORRECTED = 4.0  # largest factor for what landmarks and calibration took out of the residuals
POSITION_FLOOR = 0.01  # [m] added to every standard deviation of a place
HEADING_FLOOR = 0.003  # [rad] added to every standard deviation of a heading
SMOOTHING_SOFTEN = (8.0, 3.0)  # times as wide kernels are before the end, where starts are far off,
SMOOTHING_OTHERWISE = ((), (16.0, 4.0))  # and other ways to an end then: the best of all is taken
MINIMA_LEAD = 10.0  # cost, in what poses' covariances are inflated by, by which it must be better than another end
MINIMA_APART = 0.3  # [m], and
MINIMA_SURE = 3.0  # standard deviations, that a landmark or a robot lies apart in another end

ONLINE_STRETCH = 10.0  # [s] of a stretch, whose poses are eliminated together
ONLINE_WINDOW = 2  # stretches, the latest, that are linearised anew at every step
ONLINE_MOVE = 0.02  # [m], [rad] from which an older stretch is linearised anew when it has moved
ONLINE_RENEWED = 3  # older stretches that are linearised anew in one step, at most, those that moved most first
ONLINE_ITERATIONS = 3  # of Gauss-Newton in a step, at most
ONLINE_STILL = 0.002  # [m], [rad] of change at which a step ends
ONLINE_FAR = 1.0  # [m] root mean square from the filters' landmarks, beyond which closing begins with the filters'
ONLINE_SETTLE = 15  # iterations over everything when a robot has come in, at most


@config
class MotionNoise:
    """How far commands can be trusted, in commanded units; and how a robot moves whose commands nobody knows."""

    along: float = 0.05  # [m / sqrt(m)] error ahead, over the distance commanded
    across: float = 0.02  # [m / sqrt(m)] error sideways
    drift: float = 0.05  # [rad / sqrt(m)] error of heading over the distance commanded
    turn: float = 0.1  # [rad / sqrt(rad)] error of heading over the angle commanded


@config
class CameraNoise:
    """How far sightings can be trusted: twice what they scatter by, since their errors last for seconds."""

    range_floor: float = 0.1  # [m] error of a range to a landmark close by
    range_share: float = 0.09  # error of a range as a share of the distance
    bearing: float = 0.028  # [rad] error of a bearing to a landmark
    robot_range_floor: float = 0.22  # [m] error of a range to another robot, whose marks are not at its centre
    robot_bearing: float = 0.04  # [rad] error of a bearing to another robot


@config
class CalibrationPrior:
    """What is known of each robot before its log is looked at: mean and standard deviation; 0 holds the mean."""

    SIGNED: ClassVar[tuple[str, ...]] = ("bearing_bias",)
    speed_scale: float = 1.0  # speed driven over speed commanded
    speed_scale_sd: float = 0.1  # its standard deviation
    turn_scale: float = 0.95  # turn rate driven over turn rate commanded
    turn_scale_sd: float = 0.2  # its standard deviation
    lag: float = 0.15  # [s] from command to motion
    lag_sd: float = 0.1  # [s] its standard deviation
    bearing_bias: float = 0.0  # [rad] bearing read less the true one
    bearing_bias_sd: float = 0.02  # [rad] its standard deviation
    range_scale: float = 1.0  # range read over the true one
    range_scale_sd: float = 0.02  # its standard deviation


@config
class SmoothingConfig:
    """The table `[smoothing]` of a landmark configuration."""

    motion: MotionNoise = field(default_factory=MotionNoise)
    camera: CameraNoise = field(default_factory=CameraNoise)
    calibration: CalibrationPrior = field(default_factory=CalibrationPrior)
    robot_sightings: bool = True  # whether sightings of other robots tie trajectories
    longest_step: float = 2.0  # [s] between two poses that are estimated
    shortest_step: float = 0.5  # [s] between two poses that are estimated; sightings between go by the nearest
    most_poses: int = 50_000  # that are estimated, about, fewer of over 100 robots: beyond it steps are longer

    def __post_init__(self) -> None:
        if self.shortest_step > LONGEST_STEP:
            told = f"expected {LONGEST_STEP:g} s or less, found {self.shortest_step}"
            raise ConfigError(f"smoothing.shortest_step: {told}")


@config
class OnlineConfig:
    """The table `[online]` of a landmark configuration."""

    step: float = 1.0  # [s] of the logs that are taken in at once
    fuse_every: float = 10.0  # [s] between two looks at which robots and landmarks are connected

    def __post_init__(self) -> None:
        for name in ("step", "fuse_every"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name}: expected a number above 0, found {getattr(self, name)}")
        if self.step > ONLINE_STRETCH:
            raise ConfigError(f"step: expected {ONLINE_STRETCH:g} s or less, found {self.step}")


@config
class PlacingConfig:
    """When frames are tied; noise is that of sightings and of the tracks they are made from together."""

    range_floor: float = 0.25  # [m] error of a range,
    range_share: float = 0.1  # and as a share of it
    bearing: float = 0.08  # [rad] error of a bearing
    sure_xy: float = 0.6  # [m] sd of a tie, at most
    window: float = 12.0  # [s] over which bare wheels are trusted,
    window_still: float = 1.2  # [s] over which a robot without wheels is taken to stand
    loose_share: float = 0.25  # share of a loose robot's sightings that must agree with where they place it


def sharpened(cfg: PlacingConfig) -> PlacingConfig:
    """The same with the noise of sightings alone, as from tracks that are good."""
    s = SHARP_RANGE
    return replace(
        cfg, range_floor=s * cfg.range_floor, range_share=s * cfg.range_share, bearing=SHARP_BEARING * cfg.bearing
    )
