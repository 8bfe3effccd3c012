"""Landmark mapping while a robot drives: velocities and sightings in as they come, pose and landmarks out."""

from pathlib import Path

import numpy as np

from ..core.config import load
from ..core.errors import DataError, EstimateError, UsageError
from ..core.names import robot_key, robot_name
from ..core.paths import AnyConfig
from ..core.records import Event, Odometry, Sightings
from ..core.run import Runner
from ..core.se2 import wrap_angle
from ..core.workers import one_blas_thread
from ..landmarks import ekf_slam
from ..landmarks.ekf_slam import EkfSlamState
from ..landmarks.landmark_map import LandmarkMap
from ..laser.scan_odometry import PoseEstimate
from .map_landmarks import LandmarkMapConfig, map_tables
from .map_options import MapOptions
from .team import TeamResult


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

    def __init__(self, config: AnyConfig | None = None, *, robot: str = "1") -> None:
        self.cfg = load(LandmarkMapConfig, config)
        if not robot_key(robot).isdecimal():
            raise UsageError(f"robot: expected a whole number, found {robot!r}")
        self.robot = robot_name(robot)
        self._runner = Runner(ekf_slam, self.cfg.ekf, 0)
        self._latest = -np.inf
        self._driven: list[tuple[float, float, float]] = []
        self._seen: list[tuple[float, str, float, float]] = []

    def add_odometry(self, t: float, v: float, w: float) -> PoseEstimate:
        """The pose at `t` [s] and its covariance, before the velocities take effect.

        v [m/s] ahead and w [rad/s] to the left hold from `t` until the next row. Raises DataError for a row that is not
        finite or older than the latest.
        """
        self._check(t, v, w)
        self._push(t, Odometry(np.array([t], float), np.array([v], float), np.array([w], float)))
        self._driven.append((float(t), float(v), float(w)))
        return self.pose

    def add_sighting(self, t: float, landmark: str, distance: float, bearing: float) -> PoseEstimate:
        """The pose at `t` [s] and its covariance, after `landmark` was seen at `distance` [m] under `bearing` [rad].

        bearing: counter-clockwise from ahead; a landmark called `robotK` is another robot, kept for merging. Raises
        DataError for a row that is not finite, has no name, or is older than the latest.
        """
        self._check(t, distance, bearing)
        if not landmark.strip():
            raise DataError(f"sighting at {t} s: expected a name, found none")
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
