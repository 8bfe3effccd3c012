"""The options of `map`, in Python's own types; and how the command line spells them."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import ConfigError, ReaderError, UsageError
from ..core.names import robot_key
from ..core.paths import AnyConfig, is_path
from ..core.workers import Progress, no_progress

if TYPE_CHECKING:
    from ..io.scan_table import ScanTable

WEIGHTS = ("constant", "paper", "diagonal", "full", "full-scaled", "naive")
LANDMARK_METHODS, LASER_METHODS = ("ekf",), ("particle", "graph", "gated", "icp")


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserOptions:
    """Options of `map` and `localize` for laser logs; None leaves it to the configuration or the log.

    Parameters
    ----------
    particles
        How many hypotheses `method` particle carries (100); also of graph where intensity distinguishes places.
    feature
        What is used of the intensity of returns: normalised, raw or none (normalised where there is intensity).
    likelihood
        How a scan weights a hypothesis: matched, or paper (as printed by Hara et al.).
    resample
        Resample when the effective number of hypotheses falls below this share (0.5); 1 is always.
    scan_topic
        The LaserScan or PointCloud2 topic of a ROS recording, when there are several.
    odom_topic
        The odometry or tf topic of a ROS recording, when there are several.
    sensor_pose
        The pose of the scanner on the robot, `T_robot_sensor` [m, m, rad].
    mirrored
        The beams of the log run clockwise.
    height
        What of point clouds is a scan: from [m] to [m] above the floor (0.2 above the floor to 0.5 above the scanner).
    fixes
        Topics of a ROS recording that tell where the robot was, one a robot: satellite fixes, or poses by others
        (motion capture), which then are input and no truth (satellite fixes alone); none: no fixes.
    no_loops
        The graph method looks for no old places.
    no_merge
        And every robot's map stays alone.
    resume
        A finished result of method graph to add the logs to, as new robots or as longer logs of its robots; or the
        `map.yaml` of known walls as map servers read it, which are robot0 there, in whose frame the result is.
    columns
        How text logs that are tables are read, a scan a row: t,x,y,theta,ranges in seconds, metres and radians. Also
        ranges:N, intensities:N, and - or -:N for columns that are not used. With `beams`.
    beams
        The angles of their first beam and from beam to beam [rad].
    """

    particles: int | None = None
    feature: str | None = None
    likelihood: str | None = None
    resample: float | None = None
    scan_topic: str | None = None
    odom_topic: str | None = None
    sensor_pose: tuple[float, float, float] | None = None
    mirrored: bool = False
    height: tuple[float, float] | None = None
    fixes: str | None = None
    no_loops: bool = False
    no_merge: bool = False
    resume: Path | str | None = None
    columns: str | None = None
    beams: tuple[float, float] | None = None

    def check(self) -> None:
        """Raises UsageError for columns, beams or heights that cannot be."""
        self.table()
        if self.height is not None:
            low, high = self.height if len(self.height) == 2 else (math.nan, math.nan)
            if not -math.inf < low < high < math.inf:
                raise UsageError(f"--height: expected LOW,HIGH in metres, HIGH above LOW, found {self.height}")

    def table(self) -> "ScanTable | None":
        """How rows of a table are read; raises UsageError for columns or beams that cannot be."""
        if self.columns is None and self.beams is None:
            return None
        if self.columns is None or self.beams is None:
            missing = "--beams FIRST,STEP" if self.beams is None else "--columns"
            raise UsageError(f"--columns and --beams: expected both, found no {missing}")
        from ..io.scan_table import scan_table  # noqa: PLC0415  (only who asks for it waits for numpy)

        return scan_table(self.columns, self.beams)

    def given(self) -> list[str]:
        """The options that were given, as the command line spells them."""
        return [f"--{name.replace('_', '-')}" for name in self.__slots__ if getattr(self, name) not in {None, False}]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapOptions:
    """What `map` was asked for. Robots are called by their key: `"2"` is robot 2.

    share: robot -> first part of its time span, in (0, 1]; start: robot -> its first pose in the map [m, m, rad];
    start_sd: robot -> standard deviation of that place [m], where it is told (laser logs and mixed teams); survey: a
    file of landmarks whose places are known; decisions: what is said of pairs of robots and of places, a file or what
    it holds; radios: radio -> the robot it is on; executor: where robots are worked on; None: here, or in `jobs`
    processes.
    """

    robots: tuple[str, ...] | None = None
    method: str | None = None
    weights: str | None = None
    share: Mapping[str, float] = field(default_factory=dict)
    start: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    start_sd: Mapping[str, float] = field(default_factory=dict)
    truth: tuple[Path, ...] = ()
    resolution: float | None = None
    config: AnyConfig | None = None
    seed: int = 0
    jobs: int = 1
    fuse_every: float | None = None
    refine: bool = True
    online: bool = False
    calibration: Path | None = None
    survey: Path | None = None
    decisions: Path | Mapping[str, Any] | None = None
    radios: Mapping[str, str] = field(default_factory=dict)
    laser: LaserOptions = field(default_factory=LaserOptions)
    executor: Executor | None = None
    on_progress: Progress = no_progress

    def check(self) -> None:
        """Raises UsageError naming the option that cannot be, ReaderError naming the file that is not there."""
        self._check_names()
        expect_config(self.config)
        self.laser.check()
        if self.seed < 0:  # on the command line before anything is imported that takes its time
            raise UsageError(f"--seed: expected 0 or more, found {self.seed}")
        if self.jobs < 1:
            raise UsageError(f"--jobs must be 1 or more, found {self.jobs}")
        if self.fuse_every is not None and not 0 < self.fuse_every < math.inf:
            raise UsageError(f"--every, --fuse-every: must be more than 0 seconds, found {self.fuse_every}")
        if self.online and not self.refine:
            raise UsageError("--online: smooths while the logs play, and --no-refine leaves smoothing out: one of both")
        if self.resolution is not None and not 0 < self.resolution < math.inf:
            raise UsageError(f"--resolution must be more than 0 m, found {self.resolution}")
        self._check_robots()
        files = (self.calibration, self.survey, self.decisions)
        expect_there((*self.truth, *(path for path in files if isinstance(path, Path))))

    def _check_robots(self) -> None:
        for robot, part in self.share.items():
            if not (isinstance(part, Real) and 0 < part <= 1):
                raise UsageError(f"--share of robot {robot} must be in (0, 1], found {part}")
        for robot, pose in self.start.items():
            if not all(map(math.isfinite, pose)):
                raise UsageError(f"--start of robot {robot}: expected finite numbers, found {pose}")
        for robot, sd in self.start_sd.items():
            if not 0 < sd < math.inf:
                raise UsageError(f"--start of robot {robot}: expected a sigma above 0 m, found {sd}")

    def laser_alone(self) -> list[str]:
        """The options for laser logs alone that were given, as the command line spells them."""
        beside = {"--resolution": self.resolution, "--decisions": self.decisions}
        return [*self.laser.given(), *(name for name, value in beside.items() if value is not None)]

    def _check_names(self) -> None:
        if self.weights not in {None, *WEIGHTS}:
            raise UsageError(f"--weights: expected one of {', '.join(WEIGHTS)}, found {self.weights!r}")
        if self.method not in {None, *LANDMARK_METHODS, *LASER_METHODS}:
            landmark, laser = ", ".join(LANDMARK_METHODS), ", ".join(LASER_METHODS)
            raise UsageError(
                f"--method: landmark logs know {landmark}; for laser logs expected one of {laser}, "
                f"found {self.method!r}"
            )

    def starts(self) -> dict[str, tuple[float, ...]]:
        """Robot -> x, y, theta, and sigma where that is told."""
        return {r: (*pose, self.start_sd[r]) if r in self.start_sd else pose for r, pose in self.start.items()}


def key_of(robot: object) -> str:
    """The key of a robot given by key, number or name: `"2"` of `2` and of `"robot2"`."""
    return robot_key(str(robot))


def expect_config(given: AnyConfig | None) -> None:
    """Raises ConfigError for a file that is not there."""
    if is_path(given) and not Path(str(given)).exists():
        raise ConfigError(f"{given}: No such file or directory")


def expect_there(paths: Sequence[Path]) -> None:
    """Raises ReaderError naming the first path where nothing lies, or a pipe: formats are told by looking twice."""
    for path in paths:
        if not path.exists():
            raise ReaderError(path, "no such file or folder")
        if path.is_fifo():
            raise ReaderError(path, "expected a file, found a pipe, which can be read but once")


def parse_robots(text: str | None) -> tuple[str, ...] | None:
    """`1,2` or `robot1,robot2` as keys; None when not given."""
    if text is None:
        return None
    keys = tuple(robot_key(word.strip()) for word in text.split(",") if word.strip())
    if not keys:
        raise UsageError(f"--robots: expected numbers as 1,2, found {text!r}")
    return keys


def parse_radios(text: str | None) -> dict[str, str]:
    """`n_7=turtle01,n_3=turtle03` as radio -> robot; raises UsageError for anything else, or a radio told twice."""
    out: dict[str, str] = {}
    for part in text.split(",") if text else ():
        radio, sign, robot = (word.strip() for word in part.partition("="))
        if not (radio and sign and robot) or radio in out:
            raise UsageError(f"--radios: expected RADIO=ROBOT,.., each radio once, found {text!r}")
        out[radio] = robot
    return out


def parse_shares(text: str | None) -> dict[str, float]:
    """`1:1.0,2:0.5` as robot -> share."""
    shares: dict[str, float] = {}
    for word in (text or "").split(","):
        if not word.strip():
            continue
        robot, colon, part = word.partition(":")
        try:
            shares[robot_key(robot.strip())] = float(part)
        except ValueError:
            raise UsageError(f"--share: expected robot:share as 2:0.5, found {word!r}") from None
        if not colon:
            raise UsageError(f"--share: expected robot:share as 2:0.5, found {word!r}")
    return shares


def parse_starts(words: Sequence[str] | None) -> dict[str, tuple[float, ...]]:
    """`robot2=x,y,theta` or `robot2=x,y,theta,sigma` each, as robot -> numbers."""
    starts: dict[str, tuple[float, ...]] = {}
    for word in words or ():
        robot, _, text = word.partition("=")
        try:
            numbers = tuple(float(n) for n in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in {3, 4}:
            raise UsageError(f"--start: expected robot2=x,y,theta or robot2=x,y,theta,sigma, found {word!r}")
        if not all(map(math.isfinite, numbers)):
            raise UsageError(f"--start: expected finite numbers, found {word!r}")
        starts[robot_key(robot.strip())] = numbers
    return starts
