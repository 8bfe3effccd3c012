"""One map from the logs of a team: which kind of log it is decides who maps, and an executor where."""

import logging
from collections.abc import Iterator, Mapping, Sequence, Sized
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

from ..core.errors import DataError, EstimateError, UsageError, VerdictError
from ..core.findings import verdict_line
from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from ..core.names import in_order
from ..core.paths import AnyConfig, checked_arguments, kind_of, path_of
from ..core.workers import Progress, no_progress, one_blas_thread
from ..io.directory import check_target, result_directory
from ..io.kept import kept_parts
from ..io.laser_logs import is_bag, recordings_in
from ..io.table import Columns, columns_of
from ..io.unknown import not_known
from .in_memory import Truths, decisions_of_argument, truth_files
from .map_options import LANDMARK_METHODS, LaserOptions, MapOptions, expect_there, key_of
from .read import Log, parts_of
from .result import MapResult

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future


WAIT = 10.0  # [s] for the scheduler, and for a first worker


class ClusterExecutor(Executor):
    """Tasks on the workers of a Dask client. What is lost with its worker is tried elsewhere by Dask itself."""

    def __init__(self, client: Any) -> None:
        self.executor = client.get_executor(pure=False)

    def submit(self, fn: "Callable[..., Any]", /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = self.executor.submit(fn, *args, **kwargs)
        return future


@contextmanager
def cluster_executor(address: str, executor: Executor | None) -> Iterator[Executor]:
    """An executor on the cluster whose scheduler is at `address` (`tcp://host:8786`), closed at the end.

    Raises UsageError where an `executor` is given too, Dask is not installed, nobody answers there, or no worker is
    there; EstimateError where the workers are lost on the way.
    """
    if executor is not None:
        raise UsageError("--cluster: expected it or an executor, found both")
    try:
        from distributed import Client  # noqa: PLC0415  (an extra)
        from distributed.client import FutureCancelledError  # noqa: PLC0415
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError:
        raise UsageError("--cluster: Dask is not installed: install mapweave with the extra [cluster]") from None
    with _quiet():
        try:
            client = Client(address, timeout=WAIT, set_as_default=False)
        except (OSError, TimeoutError, ValueError, TypeError) as error:
            raise UsageError(f"--cluster {address}: no Dask scheduler answers there ({_why(error)})") from None
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            client.close()
            raise UsageError(f"--cluster {address}: the scheduler there has no worker") from None
        try:
            yield ClusterExecutor(client)
        except (KilledWorker, FutureCancelledError, OSError) as error:
            if isinstance(error, OSError) and error.filename is not None:  # a file of ours, not the network
                raise
            raise EstimateError(f"--cluster {address}: its workers were lost: {_why(error)}") from None
        finally:
            client.close()


def _why(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


@contextmanager
def _quiet() -> Iterator[None]:
    """Within, Dask's own log lines are not printed: what matters comes as one error."""
    log = logging.getLogger("distributed")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


@runtime_checkable
class Mapper(Protocol):
    """A module that maps one kind of log. `applies` looks at names and first lines only."""

    __name__: str

    def applies(self, log: Path) -> bool: ...
    def map_logs(self, logs: Sequence[Path], options: MapOptions) -> MapResult: ...


LASER, RANGES, LANDMARKS = "mapweave.api.map_laser", "mapweave.api.ranges", "mapweave.api.map_landmarks"
MAPPERS: tuple[str, ...] = (
    # asked in this order; the first that applies to every log maps them
    LANDMARKS,
    RANGES,
    LASER,
)


@checked_arguments
@one_blas_thread()
def map(  # noqa: A001  (the verb)
    logs: Path | str | LaserLog | Log | Sequence[Path | str | LaserLog | Log] | None = None,
    out: Path | str | None = None,
    *,
    scans: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    odometry: Columns | Sequence[Columns] | None = None,
    sightings: Columns | None = None,
    robots: Sequence[str | int] | None = None,
    method: str | None = None,
    weights: str | None = None,
    share: Mapping[str, float] | Mapping[int, float] | None = None,
    start: Mapping[str, Sequence[float]] | Mapping[int, Sequence[float]] | None = None,
    truth: Truths | None = None,
    resolution: float | None = None,
    config: AnyConfig | None = None,
    seed: int = 0,
    jobs: int = 1,
    every: float | None = None,
    fuse_every: float | None = None,
    refine: bool = True,
    online: bool = False,
    calibration: Path | str | None = None,
    survey: Path | str | None = None,
    decisions: Path | str | Mapping[str, Any] | None = None,
    radios: Mapping[str, str] | None = None,
    laser: LaserOptions | None = None,
    mcap: bool = False,
    strict: bool = False,
    force: bool = False,
    executor: Executor | None = None,
    cluster: str | None = None,
    on_progress: Progress = no_progress,
) -> MapResult:
    """Make one map of the logs of a team, each robot mapped on its own and all of them joined.

    Written to `out` if given. The result holds one map a component (robots that could be tied together), every robot's
    trajectory in it, the covariances, and why each robot was or was not merged. The same seed gives the same result,
    whatever `jobs` and `executor`.

    Parameters
    ----------
    logs
        MRCLAM data sets (folder or zip), folders of `odometry.csv` and `sightings.csv`, laser logs (.bag, .db3, .mcap,
        CARMEN and others), what `read` gave, or `LaserLog`s in memory. Logs of several kinds together, and tables of
        commands and sightings beside them, are a mixed team. Leave it out where tables are given.
    scans
        Laser scans in memory: `t` (m,) [s], `ranges` (m, n) [m], `angles` (n,) [rad] evenly spaced, and optionally
        `intensities` (m, n) and `range_max` [m]; several robots as a list.
    odometry
        Beside `scans`: columns t [s], x [m], y [m], theta [rad], or a list of such. Beside `sightings`: t [s], robot,
        v [m/s], w [rad/s].
    sightings
        Landmarks in memory: columns t [s], robot, id, range [m], bearing [rad] counter-clockwise from ahead.
    robots
        Use these robots only, by key or number, in any order: `["1", "3"]`, `[1, 3]` (all).
    method
        How each robot maps: `ekf` for landmarks; of laser logs graph (which alone closes loops and makes one map of
        several robots), particle, gated or icp.
    weights
        How much each robot's map counts: constant, paper, diagonal, full, full-scaled or naive (full-scaled).
    share
        Robot key -> first share of its time span that is used, in (0, 1] (1).
    start
        Robot key -> its first pose in the map [m, m, rad], where that is known; of laser logs and mixed teams the
        standard deviation of its place [m] may follow, and what was seen may overrule it.
    truth
        What `evaluate` takes; used for scoring alone, after the estimate.
    resolution
        Cell of the occupancy map [m] (0.1). Laser logs and mixed teams.
    config
        Settings as `configuration("map")` prints them: a TOML file, its tables as mappings, or an object of
        a configuration class; options here win.
    jobs
        How many robots are worked on at once, in processes of our own (1).
    every
        Also make the map of what came until then every so many seconds [s] of the logs, and tell in `metrics["online"]`
        how it grew (not at all). Of all but landmark logs each is made anew, without `decisions`.
    fuse_every
        The same, as it was called when landmark logs alone had it: one of both.
    refine
        Smooth the whole team at the end: all trajectories, landmarks and calibrations in one problem (True). Landmark
        logs alone.
    online
        Smooth already while the logs play, in order of time, and tell what each step took and how far the map was
        behind (False). Landmark logs alone.
    calibration
        What is known of the robots beforehand, as `calibration.json` holds it; no sd, or 0, holds a value (nothing).
    survey
        Landmarks whose places are known: `id,x,y` or `id,x,y,sd` [m]; their frame is the map's (none).
    decisions
        What is said of pairs of robots and of places: a `decisions.toml` of this result, edited, or what such a file
        holds (nothing). Laser logs alone.
    radios
        Radio -> the robot it is on, where their names do not say it (by name, else by number). Recordings of ranges
        alone.
    laser
        Options for laser logs alone.
    mcap
        Also write `result.mcap` into `out`: map, trajectories, landmarks and walls as messages for RViz and Foxglove
        (False).
    strict
        Raise VerdictError unless the verdict is good, once all is written (False).
    cluster
        The address of a Dask scheduler (`tcp://host:8786`) in place of `jobs`: each log's own map is made on its
        workers, which see laser logs under the same paths. Needs the extra `[cluster]`.

    Raises
    ------
    ReaderError
        For a log that is missing or damaged, with file and line (or table and row).
    DataError
        For logs that cannot give a map, or hold no robot that `robots` names.
    EstimateError
        For an estimate that failed.
    UsageError
        For options that cannot be; ConfigError for a configuration that is refused. Nothing is written then.
    VerdictError
        For a result that is not good, where `strict` was asked for; it holds the result.

    Examples
    --------
    >>> team = simulate_landmarks("team", robots=2, landmarks=8, minutes=0.5, seed=1)
    >>> result = map("team", "out", truth="team")
    >>> result.maps[0].robots
    ('robot1', 'robot2')
    >>> result.maps[0].landmarks.mean.shape
    (7, 2)
    """
    if every is not None and fuse_every is not None:
        raise UsageError("--every, --fuse-every: are the same, expected one of both")
    options = MapOptions(
        robots=None if robots is None else tuple(sorted({key_of(robot) for robot in robots}, key=in_order)),
        method=method,
        weights=weights,
        share={key_of(robot): part for robot, part in (share or {}).items()},
        start={key_of(robot): _start(key_of(robot), numbers) for robot, numbers in (start or {}).items()},
        start_sd={key_of(robot): float(numbers[3]) for robot, numbers in (start or {}).items() if len(numbers) > 3},
        resolution=resolution,
        config=config,
        seed=seed,
        jobs=jobs,
        fuse_every=fuse_every if every is None else every,
        refine=refine,
        online=online,
        calibration=None if calibration is None else Path(calibration),
        survey=None if survey is None else Path(survey),
        decisions=decisions_of_argument(decisions),
        radios=dict(radios or {}),
        laser=laser or LaserOptions(),
        executor=executor,
        on_progress=on_progress,
    )
    several = list(logs) if isinstance(logs, Sequence) and not isinstance(logs, str) else [] if logs is None else [logs]
    with kept_parts():
        with truth_files(truth) as true:
            options = replace(options, truth=true)
            options.check()
            if true:
                from .evaluate import expect_truth  # noqa: PLC0415  (only who has truth waits for it)

                expect_truth(true)
            if out is not None:
                check_target(Path(out), force=force, reads=(*several, *true, options.config, options.survey))
            elif mcap:
                raise UsageError("mcap: expected a folder to write to (out), found none")
            if logs is not None and not (scans is None and odometry is None and sightings is None):
                raise UsageError("expected either logs or tables in memory (scans, odometry, sightings), found both")
            with nullcontext(executor) if cluster is None else cluster_executor(cluster, executor) as workers:
                options = replace(options, executor=workers)
                result = _in_memory(scans, odometry, sightings, options) if logs is None else _of_logs(several, options)
        if out is not None:
            with result_directory(Path(out), force=force) as work:
                result.write_into(work)
                if mcap:
                    from ..io.mcap import write_result_mcaps  # noqa: PLC0415  (only who asks for it waits for it)

                    write_result_mcaps(work)
                result.finish(work)
    if strict and result.verdict != "good":
        raise VerdictError(verdict_line(result.findings), result)
    return result


def _of_logs(logs: Sequence[Path | str | LaserLog | Log], options: MapOptions) -> MapResult:
    """The map of files, or of logs that are in memory already."""
    logs = parts_of(logs)
    if any(isinstance(log, LaserLog | LandmarkLog) for log in logs):
        return _of_read(logs, options)
    paths = [path_of(log, "logs", "paths, LaserLogs or what read gave") for log in logs]
    expect_there(paths)
    if options.laser.columns is not None and paths:
        return _laser(paths, options)
    if _is_mixed(paths):
        if options.decisions is not None:
            raise UsageError("--decisions: only for laser logs, found a mixed team")
        from .map_mixed import map_logs  # noqa: PLC0415  (each kind of log imports what it needs)

        return map_logs(paths, options)
    paths = [recording for path in paths for recording in recordings_in(path)]
    mapper = _mapper(paths, options.method)
    _expect_fitting(mapper, paths[0], options)
    return mapper.map_logs(paths, options)


def _expect_fitting(mapper: Mapper, log: Path, options: MapOptions) -> None:
    """Raises UsageError for an option that logs of another kind have."""
    tagged = mapper.__name__ in {LANDMARKS, RANGES} and is_bag(log)
    given = [option for option in options.laser_alone() if not (tagged and option == "--fixes")]
    if given and mapper.__name__ != LASER:
        raise UsageError(f"{', '.join(given)}: only for laser logs, found {log}")
    if options.start_sd and mapper.__name__ != LASER:
        raise UsageError(f"--start: expected x,y,theta, found a sigma too: only for laser logs, found {log}")
    if options.radios and mapper.__name__ != RANGES:
        raise UsageError(f"--radios: only for recordings of ranges, found {log}")
    if options.survey is not None and mapper.__name__ == LASER:
        raise UsageError(f"--survey: only for landmarks, found {log}")


def _of_read(logs: Sequence[object], options: MapOptions) -> MapResult:
    """The map of logs that were read already, all of one kind."""
    lasers = [log for log in logs if isinstance(log, LaserLog)]
    if len(lasers) == len(logs):
        return _laser(lasers, options)
    seen = [log for log in logs if isinstance(log, LandmarkLog)]
    if len(seen) < len(logs):
        raise UsageError("logs: expected files, or logs in memory of one kind, found both; a mixed team is of files")
    if given := options.laser_alone():
        raise UsageError(f"{', '.join(given)}: only for laser logs, found landmarks")
    from .map_landmarks import map_landmark_logs  # noqa: PLC0415  (each kind of log imports what it needs)

    wanted = options.robots
    if missing := [key for key in wanted or () if key not in {key_of(log.robot) for log in seen}]:
        raise DataError(f"--robots: there is no robot {missing[0]}")
    chosen = [log for log in seen if wanted is None or key_of(log.robot) in wanted]
    return map_landmark_logs(chosen, options, "One map from logs in memory")


def _is_mixed(paths: Sequence[Path]) -> bool:
    from ..io.mixed_logs import is_mixed  # noqa: PLC0415

    return is_mixed(paths)


def _in_memory(scans: object, odometry: object, sightings: object, options: MapOptions) -> MapResult:
    """The map of tables: sightings of landmarks, or the scans of one robot or of several."""
    if (scans is None) == (sightings is None):
        which = "both" if scans is not None else "neither"
        raise UsageError(f"expected logs, or scans of a laser, or sightings of landmarks, found {which}")
    if sightings is not None:
        from .map_landmarks import map_tables  # noqa: PLC0415  (each kind of log imports what it needs)

        if isinstance(odometry, list | tuple):
            raise UsageError("odometry: expected one table of all robots (t,robot,v,w), found several")
        rows = None if odometry is None else columns_of(odometry, "odometry")
        if given := options.laser_alone():
            raise UsageError(f"{', '.join(given)}: only for laser logs, found sightings")
        return map_tables(rows, columns_of(sightings, "sightings"), options)
    from ..io.laser_arrays import laser_log_of  # noqa: PLC0415
    from .map_laser import source_of  # noqa: PLC0415

    each = list(scans) if isinstance(scans, list | tuple) else [scans]
    drives = list(odometry) if isinstance(odometry, list | tuple) else [odometry] * min(1, len(each))
    if len(drives) != len(each):
        raise UsageError(f"expected as many tables of odometry as of scans, found {len(drives)} and {len(each)}")
    source = source_of(options.laser)
    names = [str(k) for k in range(1, len(each) + 1)]
    tables = [None if drive is None else columns_of(drive, "odometry") for drive in drives]
    given_logs = zip(each, tables, names, strict=True)
    return _laser([laser_log_of(_scans(one), drive, name, source) for one, drive, name in given_logs], options)


def _scans(given: object) -> Mapping[str, Any]:
    if isinstance(given, Mapping):
        return given
    raise UsageError(f"scans: expected columns by name, or a list of such, found {kind_of(given)}")


def _laser(logs: Sequence[Path | LaserLog], options: MapOptions) -> MapResult:
    from .map_laser import map_logs  # noqa: PLC0415

    return map_logs(logs, options)


def _mapper(logs: Sequence[Path], method: str | None) -> Mapper:
    if not logs:
        raise UsageError("expected a log, found none")
    if method in LANDMARK_METHODS and all(is_bag(path) for path in logs):  # its scans, if any, are left aside
        return cast("Mapper", import_module(MAPPERS[0]))
    for where in MAPPERS:
        mapper = cast("Mapper", import_module(where))
        fits = [mapper.applies(path) for path in logs]
        if all(fits):
            return mapper
        if any(fits):
            raise not_known(logs[fits.index(False)])
    raise not_known(logs[0])


def _start(robot: str, numbers: Sequence[float]) -> tuple[float, float, float]:
    found = len(numbers) if isinstance(numbers, Sized) else kind_of(numbers)
    if found not in {3, 4}:
        raise UsageError(f"--start of robot {robot}: expected x, y, theta or x, y, theta, sigma, found {found}")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])
