"""Estimators fed by hand: a robot is mapped while it drives, with landmarks or with a laser; the map at any time."""

from pathlib import Path
from time import perf_counter

import numpy as np

from ..core.config import load
from ..core.errors import ConfigError, DataError, EstimateError, UsageError
from ..core.names import robot_key, robot_name
from ..core.paths import AnyConfig, checked_arguments
from ..core.records import Event, Odometry, Sightings
from ..core.run import Runner
from ..core.se2 import wrap_angle
from ..core.workers import Progress, no_progress, one_blas_thread
from ..io.laser_arrays import NOWHERE, LaserStream, Numbers
from ..io.laser_state import LaserState
from ..io.table import A_NAME, is_name
from ..landmarks import ekf_slam
from ..landmarks.ekf_slam import EkfSlamState
from ..landmarks.landmark_map import LandmarkMap
from ..landmarks.mapping import MOST_BEARING, MOST_RANGE, MOST_SPEED, MOST_TURN
from ..laser.beam import IntensityCalibration
from ..laser.config import GEOMETRY, Feature
from ..laser.laser_map import GridMap
from ..laser.occupancy_mapper import render_keyframes
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import PoseEstimate
from ..mapping.laser_mapping import choose_feature, map_laser, map_session, with_calibrated_wheels
from ..mapping.session import LaserSession
from .laser_result import LaserResult, woven_result
from .map_landmarks import LandmarkMapConfig, map_tables
from .map_laser import LaserMapConfig, next_robots, result_of, resumed, state_before
from .map_options import MapOptions
from .team import TeamResult


def _numbered(robot: str) -> str:
    """The key of `robot`. Raises UsageError where it is no whole number."""
    if not robot_key(robot).isdecimal():
        raise UsageError(f"robot: expected a whole number, found {robot!r}")
    return robot_key(robot)


class LandmarkSlam:
    """One robot's landmark map as it grows, by the code that `map` runs on a log.

    Feed it with `add_odometry` and `add_sighting` in order of time; ask it at any time, further rows may come after.
    Poses are [x, y, theta] [m, m, rad] in the frame of the robot's first pose. What `result` gives is, to the byte,
    what `map` makes of the same rows as tables.

    Parameters
    ----------
    config
        Settings as `map` takes them (the defaults). A robot without wheels
        needs `odometry = false` in its table `[ekf]`.
    robot
        The robot's key, a whole number: `"2"` is robot 2.

    Raises
    ------
    ConfigError
        For settings that cannot be; UsageError for a robot that has no number.

    Examples
    --------
    >>> slam = LandmarkSlam()
    >>> for k in range(10):
    ...     pose, cov = slam.add_odometry(0.1 * k, 0.5, 0.0)
    ...     pose, cov = slam.add_sighting(0.1 * k, "post", 2.0 - 0.05 * k, 0.0)
    >>> slam.landmarks().ids
    ('post',)
    """

    @checked_arguments
    def __init__(self, config: AnyConfig | None = None, *, robot: str = "1") -> None:
        self.cfg = load(LandmarkMapConfig, config)
        self.robot = robot_name(_numbered(robot))
        self._runner = Runner(ekf_slam, self.cfg.ekf, 0)
        self._latest = -np.inf
        self._driven: list[tuple[float, float, float]] = []
        self._seen: list[tuple[float, str, float, float]] = []

    @checked_arguments
    def add_odometry(self, t: float, v: float, w: float) -> PoseEstimate:
        """The pose at `t` [s] and its covariance, before the velocities take effect.

        v [m/s] ahead and w [rad/s] to the left hold from `t` until the next row. Raises DataError for a row that is not
        finite, beyond any robot, or older than the latest.
        """
        self._check(t, v, w)
        if abs(v) > MOST_SPEED or abs(w) > MOST_TURN:
            raise DataError(f"row at {t} s: expected velocities of a robot, found ({v}, {w})")
        self._push(t, Odometry(np.array([t], float), np.array([v], float), np.array([w], float)))
        self._driven.append((float(t), float(v), float(w)))
        return self.pose

    @checked_arguments
    def add_sighting(self, t: float, landmark: str, distance: float, bearing: float) -> PoseEstimate:
        """The pose at `t` [s] and its covariance, after `landmark` was seen at `distance` [m] under `bearing` [rad].

        bearing: counter-clockwise from ahead; a landmark called `robotK` is another robot, kept for merging. Raises
        DataError for a row that is not finite, has no name, is beyond any sensor, or is older than the latest.
        """
        self._check(t, distance, bearing)
        if not is_name(landmark.strip()):
            raise DataError(f"sighting at {t} s: expected {A_NAME}, found {landmark[:40]!r}")
        if not 0 < distance <= MOST_RANGE or abs(bearing) > MOST_BEARING:
            raise DataError(
                f"sighting at {t} s: expected a distance [m] and a bearing [rad], found ({distance}, {bearing})"
            )
        what = Sightings((landmark,), np.array([distance], float), np.array([bearing], float))
        self._push(t, what)
        self._seen.append((float(t), landmark, float(distance), float(bearing)))
        return self.pose

    @property
    def pose(self) -> PoseEstimate:
        """The latest pose and its covariance; zero before the first row."""
        state = self._state()
        if state is None:
            return PoseEstimate(np.zeros(3), np.zeros((3, 3)))
        submap = state.submap
        x, y, theta = submap.pose
        return PoseEstimate(np.array([x, y, wrap_angle(theta)]), np.array(submap.cov[:3, :3]))

    def landmarks(self) -> LandmarkMap:
        """The landmarks so far with their joint covariance."""
        state = self._state() or ekf_slam.initial(self.robot, self.cfg.ekf)
        return state.submap.landmarks

    @one_blas_thread()
    def result(self) -> TeamResult:
        """What `map` gives of these rows, past poses corrected and the whole drive smoothed.

        Raises DataError before the first sighting.
        """
        if not self._seen:
            raise DataError("no sighting came yet")
        t, names, distance, bearing = (list(column) for column in zip(*self._seen, strict=True))
        own = robot_key(self.robot)
        sightings = {"t": t, "robot": [own] * len(t), "id": names, "range": distance, "bearing": bearing}
        odometry = None
        if self._driven:
            stamps, v, w = (list(column) for column in zip(*self._driven, strict=True))
            odometry = {"t": stamps, "robot": [own] * len(stamps), "v": v, "w": w}
        return map_tables(odometry, sightings, MapOptions(), self.cfg)

    @checked_arguments
    def save(self, folder: Path | str, *, force: bool = False) -> TeamResult:
        """`result`, written to a folder as `map` writes it: `fuse`, `evaluate` and `view` read it.

        An earlier result there is replaced whole. Raises UsageError when something else stands there, unless `force`.
        """
        result = self.result()
        result.write(folder, force=force)
        return result

    def _state(self) -> EkfSlamState | None:
        return self._runner.states.get(self.robot)

    def _check(self, t: float, *values: float) -> None:
        try:
            finite = bool(np.isfinite([t, *values]).all())
        except TypeError:
            finite = False
        if not finite:
            raise DataError(f"row at {t} s: expected finite numbers, found ({', '.join(map(str, (t, *values)))})")
        if t < self._latest:
            raise DataError(f"row at {t} s: expected a stamp from the latest one on, {self._latest} s")

    def _push(self, t: float, record: Odometry | Sightings) -> None:
        try:
            self._runner.push(Event(float(t), self.robot, record))
        except ZeroDivisionError:
            raise EstimateError(f"{self.robot}: EKF-SLAM left finite numbers at {t} s") from None
        self._latest = float(t)


class LaserSlam:
    """One robot's laser map as it grows, by the code that `map` with `method="graph"` runs on a log.

    Feed it with `add_scan`; ask it at any time, further scans may come after. Poses are [x, y, theta] [m, m, rad] in
    the frame of the first scan. The same scans give the same trajectory, to the byte, as `map` gives of their log.

    Light: how intensity falls with range can only be told from many scans. With a `calibration` (that of an earlier
    result, `result.maps[0].calibration`) it is used at once; without one the poses come from geometry, intensities are
    kept, and `result` calibrates them and works through the scans once more where `map` would have used them.

    Laps over laps: where the map knows a place well the graph grows no further, and without light the scans made there
    are not kept: the time a scan takes and the memory stay, but for the poses themselves.

    Parameters
    ----------
    config
        Settings as `map` takes them for laser logs (the defaults). The method must be `graph`.
    calibration
        Of this scanner's intensity, where it is known (from the log).
    robot
        The robot's key: `"2"` is robot 2 (`"1"`, with `resume` the next after those there).
    resume
        A saved result of the graph method, or a `map.yaml` of known walls, to go on from: `result` is what `map` with
        this `resume` makes of the same scans. Poses stay in the frame of the first scan until then.
    seed
        Of everything drawn at random (0).

    Raises
    ------
    ConfigError
        For settings that cannot be; ReaderError for a `resume` that is no such result.

    Examples
    --------
    >>> drive = simulate_laser(world=CorridorConfig(distance=4.0), seed=1)
    >>> slam = LaserSlam()
    >>> for t, scan in zip(drive.log.scan_t, drive.log.scans):
    ...     pose, cov = slam.add_scan(t, scan.ranges, scan.angles(), odometry=scan.odometry, range_max=scan.range_max)
    >>> [round(float(x)) for x in pose[:2]]
    [4, 0]
    """

    @checked_arguments
    def __init__(
        self,
        config: AnyConfig | None = None,
        *,
        calibration: IntensityCalibration | None = None,
        robot: str | None = None,
        resume: Path | str | None = None,
        seed: int = 0,
    ) -> None:
        cfg = load(LaserMapConfig, config).laser
        cfg.check()
        if cfg.method != "graph":
            raise ConfigError(f"method: expected graph for scans that come one by one, found {cfg.method}")
        self._resume = None if resume is None else Path(resume)
        self._before = LaserState((), {}) if self._resume is None else state_before(self._resume)
        robot = next_robots([there.robot for there in self._before.maps], 1)[0] if robot is None else _numbered(robot)
        self.cfg, self.robot, self.seed = cfg, robot, seed
        self._calibrated = calibration is not None and cfg.feature != "none"
        feature = Feature("normalised", calibration) if self._calibrated else GEOMETRY
        self._session = LaserSession(robot, cfg, seed, feature)
        self._stream = LaserStream(robot)
        self._spent = 0.0

    def __len__(self) -> int:
        """How many scans came."""
        return len(self._stream)

    @checked_arguments
    @one_blas_thread()
    def add_scan(
        self,
        t: float,
        ranges: Numbers,
        angles: Numbers,
        *,
        odometry: Numbers | None = None,
        intensities: Numbers | None = None,
        range_max: float = float("inf"),
        sensor_pose: Numbers = NOWHERE,
    ) -> PoseEstimate:
        """Where the robot is at this scan, and the covariance of that.

        Parameters
        ----------
        t
            The stamp [s], after that of the scan before.
        ranges
            (n,) [m]; those that are NaN, infinite, 0 or reach `range_max` are no returns.
        angles
            (n,) [rad], evenly spaced, counter-clockwise from ahead of the scanner.
        odometry
            `T_odom_robot` at `t` [m, m, rad]; of every scan or of none.
        intensities
            (n,), in the scanner's units; of every scan or of none.
        range_max
            [m] what the scanner says where nothing came back.
        sensor_pose
            `T_robot_sensor`: where the scanner stands on the robot [m, m, rad].

        Raises
        ------
        DataError
            For a scan that cannot be; the map is as before.
        """
        if self._calibrated and intensities is None:
            raise DataError(f"scan at {t} s: expected intensities beside their calibration, found none")
        began = perf_counter()
        event = self._stream.add(
            t,
            ranges,
            angles,
            odometry=odometry,
            intensities=intensities,
            range_max=range_max,
            sensor_pose=sensor_pose,
        )
        self._session.push(event)
        if intensities is None or self._calibrated:  # else calibrating them needs every scan
            self._stream.forget(self._session.unneeded)
        self._spent += perf_counter() - began
        return self._session.now

    @property
    def pose(self) -> PoseEstimate:
        """The pose at the latest scan and its covariance; zero before the first."""
        return self._session.now

    @one_blas_thread()
    def graph(self) -> RobotGraph:
        """The keyframes so far with their returns, steps and closures: what another robot needs to merge with.

        Raises DataError before the first scan.
        """
        return self._graph()

    @one_blas_thread()
    def map(self) -> GridMap:
        """The grid so far, of the keyframes' scans: quick, for looking at; that of `result` holds every scan.

        Raises DataError before the first scan.
        """
        return render_keyframes(self._graph(), self.cfg.resolution, f"local_{self.robot}")

    @one_blas_thread()
    def result(self, on_progress: Progress = no_progress) -> LaserResult:
        """What `map` gives of these scans, the last pass over everything made.

        Raises DataError before the first scan, and where these scans are in the result that was to go on already.
        """
        log = self._stream.log()
        there = None if self._resume is None else resumed(self._resume, self._before, [log])
        if there is not None and there.robots != (self.robot,):
            own = there.robots[0]
            raise DataError(f"{self._resume}: these scans go on as {own!r} there: expected robot={own!r} to begin with")
        feature = self._session.feature if self._calibrated else choose_feature(log, self.cfg)
        if feature.name == self._session.feature.name:
            local_map = map_session(self._session, log, feature, {"estimate": self._spent}, on_progress)
            local_map = with_calibrated_wheels(log, self.cfg, self.seed, local_map, on_progress)
        else:
            local_map = map_laser(log, self.cfg, self.seed, on_progress)
        if there is None:
            return result_of([local_map], self.cfg, seed=self.seed)
        maps, starts = there.maps([local_map]), self._before.starts
        return woven_result(
            maps,
            self.cfg,
            seed=self.seed,
            starts=starts,
            notes=there.notes,
            decisions=there.said,
            on_progress=on_progress,
        )

    @checked_arguments
    def save(self, folder: Path | str, *, force: bool = False) -> LaserResult:
        """`result`, written to a folder as `map` writes it: `localize`, `fuse`, `evaluate` and `view` read it.

        An earlier result there is replaced whole. Raises UsageError when something else stands there, unless `force`.
        """
        result = self.result()
        result.write(folder, force=force)
        return result

    def _graph(self) -> RobotGraph:
        graph = self._session.graph()
        if graph is None:
            raise DataError("no scan came yet")
        return graph
