"""A robot followed in a map that was finished before."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from ..core import se2
from ..core.config import config as configuration
from ..core.config import load
from ..core.errors import UsageError
from ..core.laser_log import LaserLog
from ..core.paths import AnyConfig, checked_arguments, is_path, path_of
from ..core.records import Scan, Track
from ..core.run import robot_rng
from ..core.version import __version__
from ..core.workers import Progress, no_progress, one_blas_thread
from ..io.directory import check_target, no_result, write_json
from ..io.laser_arrays import NOWHERE, LaserStream, Numbers, laser_log_of
from ..io.laser_logs import LaserSource, read_laser
from ..io.laser_map import NAME, read_grid, write_scans
from ..io.ros_map import YAML_SUFFIXES, read_ros_map
from ..io.table import Columns, columns_of
from ..io.tum import read_tum, write_tum
from ..laser.beam import IntensityCalibration
from ..laser.config import GEOMETRY, Feature
from ..laser.laser_map import GridMap
from ..laser.localise import Localisation, LocaliseConfig, MapFollower, localise
from ..laser.localise_trust import Evidence
from ..laser.scan_odometry import PoseEstimate
from ..mapping.config import LaserConfig
from ..report.result import ResultBase, Rows, written
from ..report.small_pages import localisation_scene, write_localisation_report
from ..report.style import Target
from .in_memory import Truth, result_folder, truth_files
from .laser_result import LaserResult
from .map_laser import source_of
from .map_options import LaserOptions, expect_there

NEAR, NEAR_ANGLE = 0.5, np.radians(10.0)  # a start that errs by less than this, once found, was right


@configuration
class LocalizeJobConfig:
    """Settings of `localize`: the table `[laser]`, which may be that of `map` as it is, and `[localize]`."""

    READ: ClassVar[tuple[str, ...]] = (
        "laser.particles",
        "laser.beam.",
        "laser.cells.alpha",
        "laser.front_end.",
        "localize.",
    )
    laser: LaserConfig = LaserConfig()
    localize: LocaliseConfig = LocaliseConfig()


@dataclass(frozen=True, slots=True)
class StartScore:
    """Errors against a truth in the map's frame, over its stamps after the start was found.

    right: whether the median error there is under half a metre and ten degrees. Where it is not: the one motion
    `offset` [m, m, rad] of the truth that explains most of the error, and the median error after it [m].
    """

    n: int
    position_rmse: float | None
    position_median: float | None
    heading_median_deg: float | None
    right: bool | None
    offset: tuple[float, float, float] | None = None
    aligned_median: float | None = None

    def as_json(self) -> dict[str, Any]:
        shown = {name: getattr(self, name) for name in self.__slots__}
        if self.offset is None:
            del shown["offset"], shown["aligned_median"]
        return shown


@dataclass(frozen=True, slots=True, repr=False)
class LocalizeResult(ResultBase):
    """What `localize` gives: the trajectory in the map, whether the start was found, and whether to trust it.

    localisation: poses and the evidence for them; grid: the map; score: against truth, where truth was given.
    """

    localisation: Localisation
    grid: GridMap
    metrics: dict[str, Any]
    score: StartScore | None = None

    def draw(self, target: Target) -> None:
        """The map and the robot in it."""
        localisation_scene(self.localisation, self.grid).draw(target)

    def headline(self) -> Rows:
        metrics = {**self.metrics["localisation"], **({} if self.score is None else self.score.as_json())}
        return ("what", "value"), list(metrics.items())

    def write_into(self, folder: Path) -> None:
        write_json(folder / "metrics.json", self.metrics)
        write_tum(folder / "trajectories" / "robot1.tum", self.localisation.track)
        write_scans(folder / "scans.csv", self.localisation.scans)
        write_localisation_report(folder, self.localisation, self.grid, self.lines())

    def lines(self) -> list[str]:
        localisation = self.localisation
        if localisation.start == "given":
            start = "the start was given"
        elif localisation.found_t is None:
            start = "the start was not found"
        else:
            after = localisation.found_t - localisation.scans.t[0]
            start = f"the start was found after {after:.1f} s, {localisation.found_scans} scans"
        explained = f"the map explains {100 * localisation.matched:.0f} % of the returns"
        lines = [f"robot1: {start}; {explained}", *localisation.warnings]
        if localisation.doubt and localisation.found_t is not None:
            lines.insert(1, f"robot1: not to be trusted: {localisation.doubt}")
        if self.score is not None and self.score.n:
            judged = "right" if self.score.right else "wrong"
            lines.append(
                f"robot1: the start was {judged}: position error {self.score.position_rmse:.3f} m (median "
                f"{self.score.position_median:.3f} m, {self.score.heading_median_deg:.2f} deg), {self.score.n} poses"
            )
        return [*lines, *self.doubts()]

    def doubts(self) -> list[str]:
        """What makes the score itself doubtful: a truth of another time, or in another frame."""
        score = self.score
        if score is None:
            return []
        if not score.n:
            return ["warning: no pose of the truth lies between the start's being found and the log's end: no score"]
        if score.offset is None or score.aligned_median is None or score.aligned_median > NEAR:
            return []
        x, y, theta = score.offset
        return [
            (
                f"warning: moved by ({x:.2f} m, {y:.2f} m, {np.degrees(theta):.1f} deg) the truth agrees to "
                f"{score.aligned_median:.3f} m: it is in another frame than the map, or the robot was found at a place "
                "that looks the same"
            )
        ]


class Localizer:
    """Where a robot is in a finished map while it drives, by the code that `localize` runs on a log.

    Feed it with `add_scan`. Poses are [x, y, theta] [m, m, rad] in the map's frame. Before the place is found
    (`found`) they are those of the likeliest hypothesis, and their covariance is that of all. Scans are not kept, but
    for the last that the evidence is taken from.

    Parameters
    ----------
    map
        As for `localize`: what `map` wrote for one robot, its result, or a `map.yaml`.
    start
        The robot's first pose in the map [m, m, rad] (searched everywhere).
    config
        Settings as `configuration("localize")` prints them (the defaults).
    seed
        Of everything drawn at random (0).

    Raises
    ------
    ReaderError
        For a map that is missing or damaged; DataError for one without walls or free places.
    ConfigError
        For settings that cannot be; UsageError for a start that is no pose.

    Examples
    --------
    >>> drive = simulate_laser(world=CorridorConfig(distance=6.0), seed=1)
    >>> where = Localizer(map(drive.log, method="gated"), start=(0.0, 0.0, 0.0))
    >>> for t, scan in zip(drive.log.scan_t, drive.log.scans):
    ...     pose, cov = where.add_scan(t, scan.ranges, scan.angles(), odometry=scan.odometry, range_max=scan.range_max)
    >>> [round(float(x)) for x in pose[:2]], where.found
    ([6, 0], True)
    """

    @checked_arguments
    def __init__(
        self,
        map: Path | str | LaserResult,  # noqa: A002  (as of `localize`)
        *,
        start: Sequence[float] | None = None,
        config: AnyConfig | None = None,
        seed: int = 0,
    ) -> None:
        place = _start(start)
        grid, calibration, feature = _read_map(map)
        settings = load(LocalizeJobConfig, config)
        settings.laser.check()
        self._begun = partial(
            MapFollower, grid, cfg=settings.laser, start=place, rng=robot_rng(seed, "1"), how=settings.localize
        )
        self._follower = self._begun(GEOMETRY if calibration is None else Feature(feature, calibration))
        self._stream = LaserStream()

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
        """Where the robot is at this scan, and the covariance of that; arguments and errors as `LaserSlam.add_scan`.

        Intensities are used where the map has light; without any the robot is followed by geometry alone.
        """
        event = self._stream.add(
            t,
            ranges,
            angles,
            odometry=odometry,
            intensities=intensities,
            range_max=range_max,
            sensor_pose=sensor_pose,
        )
        count = len(self._stream)
        if count == 1 and intensities is None:
            self._follower = self._begun(GEOMETRY)
        if count > 1:
            self._stream.forget(range(count - 2, count - 1))
        self._follower.push(cast("Scan", event.record))
        return self.pose

    @property
    def pose(self) -> PoseEstimate:
        """The pose at the latest scan and its covariance, which is infinite before a scan was placed."""
        return PoseEstimate(self._follower.pose, self._follower.covariance)

    @property
    def found(self) -> bool:
        """Whether the hypotheses have become one; they part again where the map explains too little of the scans."""
        return self._follower.found_row is not None

    @one_blas_thread()
    def doubt(self) -> str:
        """Why the place is not to be trusted, empty where it is: the last scans against the map, and elsewhere in it.

        Other places are searched for in the whole map: ask once in a while, not at every scan.
        """
        return self._follower.doubt(self._follower.evidence())


@checked_arguments
@one_blas_thread()
def localize(
    log: Path | str | LaserLog | Mapping[str, Any],
    map: Path | str | LaserResult,  # noqa: A002  (the option's name)
    out: Path | str | None = None,
    *,
    odometry: Columns | None = None,
    start: Sequence[float] | None = None,
    truth: Truth | None = None,
    config: AnyConfig | None = None,
    laser: LaserOptions | None = None,
    seed: int = 0,
    force: bool = False,
    on_progress: Progress = no_progress,
) -> LocalizeResult:
    """Find and follow the robot of `log` in a finished laser map; written to `out` if given.

    The result says whether the start was found, since when, and whether it is to be trusted.

    Parameters
    ----------
    log
        A laser log, as for `map`: a file, a `LaserLog` in memory, or scans in memory with the columns of `map(scans=)`.
    map
        What `map` wrote for one robot, or its result; or the `map.yaml` of a map as ROS navigation's map server reads
        it, this program's own or another's: walls alone, in the frame that its `origin` tells.
    odometry
        Beside scans in memory: columns t [s], x [m], y [m], theta [rad] (none).
    start
        The robot's first pose in the map [m, m, rad] (searched everywhere).
    truth
        A TUM trajectory in the map's frame, or a `Track` or a table in memory with the columns t [s], x [m], y [m],
        theta [rad]; used for scoring alone; one in another frame is told.
    config
        Settings as `configuration("localize")` prints them: a TOML file, its tables as mappings, or an object of
        a configuration class; options here win.
    laser
        Options of laser logs.

    Raises
    ------
    ReaderError
        For a log, a map or a truth that is missing or damaged.
    DataError
        For a log without scans.
    UsageError
        For options that cannot be; ConfigError for a configuration that is refused. Nothing is written then.

    Examples
    --------
    >>> drive = simulate_laser("drive.mcap", CorridorConfig(distance=8.0), seed=1)
    >>> made = map("drive.mcap", "out", method="gated")
    >>> localize("drive.mcap", "out", start=(0.0, 0.0, 0.0)).metrics["localisation"]["trusted"]
    True
    """
    check_target(out, force=force, reads=(log, map, truth, config))
    place = _start(start)
    if not isinstance(log, LaserLog | Mapping):
        log = path_of(log, "log", "a path, a LaserLog or scans in memory")
    drive = None if odometry is None else columns_of(odometry, "odometry")
    true = None if truth is None else _true_track(truth)
    asked = laser or LaserOptions()
    grid, calibration, feature = _read_map(map)
    source = source_of(asked)
    settings = load(LocalizeJobConfig, config, {"laser": {"particles": asked.particles}})
    cfg = settings.laser
    cfg.check()
    recording = _recording(log, drive, source)
    wanted = asked.feature or feature
    if wanted not in {feature, "none"}:
        raise UsageError(f"--feature {wanted}: the map holds {feature}")
    rng = robot_rng(seed, recording.robot)
    localisation = localise(recording, grid, calibration, wanted, cfg, place, rng, on_progress, settings.localize)
    score = None if true is None else score_start(localisation, true)
    metrics = _metrics(localisation, str(map) if is_path(map) else "in memory", seed, score)
    metrics["unused"] = [left.row() for left in recording.unused]
    result = LocalizeResult(localisation, grid, metrics, score)
    return written(result, out, force=force)


def score_start(localisation: Localisation, truth: Track) -> StartScore:
    """The score of `localisation` against a truth in the same frame, without any alignment."""
    since = localisation.track.t[0] if localisation.found_t is None else localisation.found_t
    inside = (truth.t >= since) & (truth.t <= localisation.track.t[-1])
    if not inside.any():
        return StartScore(0, None, None, None, None)
    kept = np.hypot(*np.ptp(truth.pose[inside, :2], axis=0))
    at = se2.interpolate(truth.t[inside], localisation.track.t, localisation.track.pose)
    off = at - truth.pose[inside]
    far, turned = np.hypot(off[:, 0], off[:, 1]), np.abs(se2.wrap_angle(off[:, 2]))
    near, straight = float(np.median(far)), float(np.median(turned))
    right = bool(localisation.found_t is not None and near < NEAR and straight < NEAR_ANGLE)
    rmse, heading = float(np.sqrt((far**2).mean())), float(np.degrees(straight))
    if right or kept < NEAR:  # a robot that stands still tells nothing of its frame
        return StartScore(int(inside.sum()), rmse, near, heading, right)
    T = se2.align(truth.pose[inside, :2], at[:, :2])
    left = np.median(np.linalg.norm(se2.act(T, truth.pose[inside, :2]) - at[:, :2], axis=1))
    return StartScore(
        int(inside.sum()), rmse, near, heading, right, (float(T[0]), float(T[1]), float(T[2])), float(left)
    )


def _start(given: Sequence[float] | None) -> np.ndarray | None:
    if given is None:
        return None
    if len(given) != 3 or not np.isfinite(np.array(given, dtype=float)).all():
        raise UsageError(f"--start: expected x,y,theta, found {', '.join(map(str, given))}")
    return np.array(given, dtype=float)


def _read_map(given: object) -> tuple[GridMap, IntensityCalibration | None, str]:
    """The map with its calibration and feature; one in memory as it would be read back; a ROS map tells no light."""
    if is_path(given) and (path := Path(str(given))).suffix.lower() in YAML_SUFFIXES and not path.is_dir():
        return read_ros_map(path).grid(), None, "none"
    with result_folder(given, "map") as folder:
        return read_grid(_grid_path(folder))


def _true_track(given: object) -> Track:
    with truth_files(given) as files:
        if len(files) != 1:
            raise UsageError(f"truth: expected the trajectory of one robot, found {len(files)}")
        return read_tum(files[0])


def _recording(log: Path | LaserLog | Mapping[str, Any], odometry: Columns | None, source: LaserSource) -> LaserLog:
    if isinstance(log, Mapping):
        return laser_log_of(log, odometry, "1", source)
    if odometry is not None:
        raise UsageError("odometry: expected scans in memory beside it, found a log, which holds its own")
    if isinstance(log, LaserLog):
        return log
    expect_there((log,))
    return read_laser(log, "1", source)


def _grid_path(folder: Path) -> Path:
    """The map at the top of a result, else the only robot's own."""
    inside = [folder / NAME, *sorted(folder.glob(f"local/*/{NAME}"))]
    there = [path for path in inside if path.is_file()]
    if not there:
        raise no_result(folder, f"a laser map with {NAME}")
    if there[0] != folder / NAME and len(there) > 1:
        folders = ", ".join(str(path.parent) for path in there)
        raise UsageError(f"--map {folder}: holds {len(there)} maps; give one of {folders}")
    return there[0]


def _evidence(seen: Evidence) -> dict[str, Any]:
    x, y, theta = (None, None, None) if seen.rival is None else seen.rival.tolist()
    rival = None if x is None else {"x": x, "y": y, "theta": theta, "score_ratio": seen.ratio}
    return {"explained": seen.explained, "through_walls": seen.through, "light": seen.light, "next_place": rival}


def _metrics(localisation: Localisation, where: str, seed: int, score: StartScore | None) -> dict[str, Any]:
    after = None if localisation.found_t is None else localisation.found_t - float(localisation.scans.t[0])
    metrics: dict[str, Any] = {
        "version": __version__,
        "seed": seed,
        "robots": {
            "1": {
                "source": localisation.source,
                "sightings": len(localisation.scans),
                "dropped": dict(localisation.dropped),
                "warnings": list(localisation.warnings),
                "feature": localisation.feature,
                "particles": localisation.particles,
            }
        },
        "localisation": {
            "map": where,
            "start": localisation.start,
            "found": localisation.found_t is not None,
            "found_after_s": after,
            "found_after_scans": localisation.found_scans,
            "matched": localisation.matched,
            "trusted": localisation.trusted,
            "doubt": localisation.doubt or None,
            "evidence": None if localisation.evidence is None else _evidence(localisation.evidence),
        },
        "timing": dict(localisation.timing),
    }
    return metrics if score is None else metrics | {"evaluation": score.as_json()}
