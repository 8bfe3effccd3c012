"""Laser mapping while a robot drives: scans in as they come, the pose and its covariance out, a map at any time."""

from pathlib import Path
from time import perf_counter

from ..core.config import load
from ..core.errors import ConfigError, DataError
from ..core.paths import AnyConfig
from ..core.workers import Progress, no_progress, one_blas_thread
from ..io.laser_stream import NOWHERE, LaserStream, Numbers
from ..laser.beam import IntensityCalibration
from ..laser.config import GEOMETRY, Feature
from ..laser.laser_map import GridMap
from ..laser.occupancy_mapper import render_keyframes
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import PoseEstimate
from ..mapping.laser_mapping import choose_feature, map_laser, map_session, with_calibrated_wheels
from ..mapping.session import LaserSession
from .laser_result import LaserResult
from .map_laser import LaserMapConfig, result_of


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
        The robot's key: `"2"` is robot 2.
    seed
        Of everything drawn at random (0).

    Raises
    ------
    ConfigError
        For settings that cannot be.

    Examples
    --------
    >>> drive = simulate_laser(world=CorridorConfig(distance=4.0), seed=1)
    >>> slam = LaserSlam()
    >>> for t, scan in zip(drive.log.scan_t, drive.log.scans):
    ...     pose, cov = slam.add_scan(t, scan.ranges, scan.angles(), odometry=scan.odometry, range_max=scan.range_max)
    >>> [round(float(x)) for x in pose[:2]]
    [4, 0]
    """

    def __init__(
        self,
        config: AnyConfig | None = None,
        *,
        calibration: IntensityCalibration | None = None,
        robot: str = "1",
        seed: int = 0,
    ) -> None:
        cfg = load(LaserMapConfig, config).laser
        cfg.check()
        if cfg.method != "graph":
            raise ConfigError(f"method: expected graph for scans that come one by one, found {cfg.method}")
        self.cfg, self.robot, self.seed = cfg, robot, seed
        self._calibrated = calibration is not None and cfg.feature != "none"
        feature = Feature("normalised", calibration) if self._calibrated else GEOMETRY
        self._session = LaserSession(robot, cfg, seed, feature)
        self._stream = LaserStream(robot)
        self._spent = 0.0

    def __len__(self) -> int:
        """How many scans came."""
        return len(self._stream)

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

        Raises DataError before the first scan.
        """
        log = self._stream.log()
        feature = self._session.feature if self._calibrated else choose_feature(log, self.cfg)
        if feature.name == self._session.feature.name:
            local_map = map_session(self._session, log, feature, {"estimate": self._spent}, on_progress)
            local_map = with_calibrated_wheels(log, self.cfg, self.seed, local_map, on_progress)
        else:
            local_map = map_laser(log, self.cfg, self.seed, on_progress)
        return result_of([local_map], self.cfg, seed=self.seed)

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
