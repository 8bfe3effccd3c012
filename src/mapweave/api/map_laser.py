"""Laser logs become maps, each log on its own: poses at every stamp, occupancy, the light walls send back.

And going on from a finished result: which of its robots a further log belongs to, or that it is a new one.

And how a map grew while the logs played: what the first so many seconds of all of them give, again and again.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config import config, load
from ..core.errors import DataError, MapweaveError, ReaderError, UsageError
from ..core.findings import Finding
from ..core.laser_log import LaserLog
from ..core.names import robot_name
from ..core.paths import path_of
from ..core.workers import Progress, no_progress, worker_pool
from ..io.decisions import NAME, read_decisions
from ..io.kept import part, parts
from ..io.laser_logs import LaserSource, is_bag, is_laser_log, read_laser, robots_of
from ..io.laser_state import LaserState, read_laser_states
from ..io.ros_map import YAML_SUFFIXES, read_ros_map
from ..io.saved_result import read_result
from ..laser.laser_map import LaserMap
from ..mapping.config import LaserConfig
from ..mapping.decisions import Decisions
from ..mapping.known_map import known_map
from ..mapping.laser_mapping import elsewhere_from, map_laser
from .laser_result import LaserResult, laser_metrics, scored, woven_result
from .map_options import LaserOptions, MapOptions

MOST_LOOKS = 1000  # maps that are made on the way, at most

Span = tuple[float, float]
Look = Callable[[list[float]], dict[str, Any]]


def grown(
    spans: Sequence[Span], every: float, look: Look, at_last: dict[str, Any], on_progress: Progress
) -> list[dict[str, Any]]:
    """What `look` tells of the logs up to every moment, `every` seconds apart, `t` [s] after the first row of all.

    spans: first and last stamp of each log; look: takes the stamp up to which each log is asked; at_last: what it would
    tell of them whole. Logs that nobody recorded at the same time are each asked up to as long after its own beginning.
    What cannot be mapped yet is told as `refused`. Raises UsageError where that were more than `MOST_LOOKS` maps.
    """
    first, last = np.array(spans, dtype=float).T
    began = np.full(len(first), first.min()) if first.max() < last.min() else first
    whole = float((last - began).max())
    if whole / every > MOST_LOOKS:
        raise UsageError(f"--every: {every:g} s of {whole:.0f} s are over {MOST_LOOKS} maps on the way")
    times = np.arange(every, whole, every)
    rows = []
    for k, t in enumerate(times.tolist()):
        on_progress("growth", k, len(times))
        try:
            row = look((began + t).tolist())
        except MapweaveError as error:
            row = {"robots": 0, "maps": 0, "refused": str(error)}
        rows.append({"t": t, **row})
    on_progress("growth", len(times), len(times))
    return [*rows, {"t": whole, **at_last}]


Job = tuple[Path | LaserLog, str, LaserSource, LaserConfig, int, float]

OF_RECORDINGS = ("--scan-topic", "--odom-topic", "--fixes", "--height")  # options that no text log has a use for


@config
class LaserMapConfig:
    """Settings of `map` for laser logs: the table `[laser]` of the configuration file."""

    laser: LaserConfig = LaserConfig()


def applies(log: Path) -> bool:
    return is_laser_log(log)


def map_logs(logs: Sequence[Path | LaserLog], options: MapOptions) -> LaserResult:
    """The maps of `logs`, files or logs that are read already; robot K is the K-th of their robots.

    A recording may hold several robots. The maps of the graph method are woven, those of the others stand each alone.
    """
    before = options.laser.resume
    if before is not None:
        return _going_on(path_of(before, "resume"), logs, options)
    cfg = _configured(options)
    held = _robots(logs, options, [])
    jobs = [(log, key, source, cfg, options.seed, options.share.get(key, 1.0)) for key, (log, source) in held.items()]
    idle = _of_recordings(logs, options)
    maps = tuple(_with_idle_options(local_map, options, idle) for local_map in _mapped(jobs, options))
    if cfg.method != "graph":
        result = scored(LaserResult(maps, laser_metrics(maps, options.seed)), options.truth)
    else:
        result = _woven(maps, cfg, options, options.starts(), ())
    every = options.fuse_every
    return result if every is None else _with_growth(result, held, every, options)


def _with_growth(
    result: LaserResult, held: Mapping[str, tuple[Path | LaserLog, LaserSource]], every: float, options: MapOptions
) -> LaserResult:
    """The result, and how its map grew, each of the maps on the way as `map_logs` makes it of what came until then."""
    logs = {key: _read(log, key, source, options.share.get(key, 1.0)) for key, (log, source) in held.items()}
    alone = replace(options, fuse_every=None, robots=None, share={}, truth=(), decisions=None, on_progress=no_progress)

    def look(until: list[float]) -> dict[str, Any]:
        cut = {key: log.cut(t, key)[0] for (key, log), t in zip(logs.items(), until, strict=True)}
        there = {key: log for key, log in cut.items() if len(log.scans)}
        number = {key: str(k) for k, key in enumerate(there, 1)}
        start = {number[key]: pose for key, pose in options.start.items() if key in there}
        sd = {number[key]: known for key, known in options.start_sd.items() if key in there}
        return map_logs(list(there.values()), replace(alone, start=start, start_sd=sd)).size()

    spans = [(float(log.scan_t[0]), float(log.scan_t[-1])) for log in logs.values()]
    rows = grown(spans, every, look, result.size(), options.on_progress)
    return replace(result, metrics={**result.metrics, "online": rows})


def _going_on(before: Path, logs: Sequence[Path | LaserLog], options: MapOptions) -> LaserResult:
    """The result in `before` with further logs: what one run of all logs would have given."""
    if options.fuse_every is not None:
        raise UsageError("--every: of logs that are mapped from their beginning, not with --resume")
    state = state_before(before)
    cfg = _configured(options)
    if cfg.method != "graph":
        raise UsageError(f"--resume: goes on with --method graph, found {cfg.method}")
    held = _robots(logs, options, [m.robot for m in state.maps])
    read = [_read(log, key, source, options.share.get(key, 1.0)) for key, (log, source) in held.items()]
    resumption = resumed(before, state, read)
    sources = [source for _, source in held.values()]
    jobs = [
        (log, robot, source, cfg, options.seed, 1.0)
        for log, robot, source in zip(read, resumption.robots, sources, strict=True)
    ]
    made = _mapped(jobs, options, state.maps)
    idle = _of_recordings(logs, options)
    maps = resumption.maps([_with_idle_options(local_map, options, idle) for local_map in made])
    return _woven(maps, cfg, options, {**state.starts, **options.starts()}, resumption.notes, resumption.said)


def state_before(before: Path) -> LaserState:
    """What further logs are added to: a finished result and what was decided on it, or the walls of a `map.yaml`."""
    if before.suffix.lower() in YAML_SUFFIXES and not before.is_dir():
        return LaserState((known_map(read_ros_map(before).grid(), str(before)),), {})
    state, file = read_laser_states(before), before / NAME
    if not file.is_file():  # what somebody said in it would be lost
        raise ReaderError(file, "no such file: the result is not whole, copy all of it")
    said = read_decisions(file)
    if not said.edited:
        return state
    return replace(state, maps=getattr(read_result(before), "before", ()) or state.maps, said=said)


def _woven(
    maps: Sequence[LaserMap],
    cfg: LaserConfig,
    options: MapOptions,
    starts: Mapping[str, Sequence[float]],
    notes: Sequence[str],
    said: Decisions | None = None,
) -> LaserResult:
    return woven_result(
        maps,
        cfg,
        seed=options.seed,
        starts=starts,
        merge=not options.laser.no_merge,
        truth=options.truth,
        notes=notes,
        jobs=options.jobs,
        executor=options.executor,
        decisions=said if options.decisions is None else options.decisions,
        on_progress=options.on_progress,
    )


def result_of(maps: Sequence[LaserMap], cfg: LaserConfig, *, seed: int = 0) -> LaserResult:
    """The result of maps that were made already by the settings `cfg`: those of the graph method woven."""
    if cfg.method != "graph":
        return LaserResult(tuple(maps), laser_metrics(maps, seed))
    return woven_result(maps, cfg, seed=seed)


def _robots(
    logs: Sequence[Path | LaserLog], options: MapOptions, there: Sequence[str]
) -> dict[str, tuple[Path | LaserLog, LaserSource]]:
    """Key of each robot asked for -> its log and where in it; numbers follow those that are `there`."""
    source = source_of(options.laser)
    robots = [(log, of) for log in logs for of in sources_of(log, source)]
    held = dict(zip(next_robots(there, len(robots)), robots, strict=True))
    wanted = list(held) if options.robots is None else list(options.robots)
    if missing := [name for name in wanted if name not in held]:
        raise DataError(f"--robots: there is no robot {missing[0]} among {len(held)} robots of {len(logs)} logs")
    return {name: held[name] for name in wanted}


def sources_of(log: Path | LaserLog, source: LaserSource) -> list[LaserSource]:
    """Where in `log` each of its robots is."""
    names = (None,) if isinstance(log, LaserLog) else robots_of(log, source)
    return [replace(source, name=name) for name in names]


def source_of(asked: LaserOptions) -> LaserSource:
    """Which topics or columns are read and where the scanner stands, as asked. Raises UsageError for what cannot be."""
    asked.check()
    return LaserSource(
        scan_topic=asked.scan_topic,
        odom_topic=asked.odom_topic,
        sensor_pose=asked.sensor_pose,
        mirrored=asked.mirrored,
        height=asked.height,
        fixes=asked.fixes,
        table=asked.table(),
    )


def map_one(
    path: Path | LaserLog,
    robot: str,
    source: LaserSource,
    cfg: LaserConfig,
    seed: int,
    share: float = 1.0,
    on_progress: Progress = no_progress,
) -> LaserMap:
    """The map of one log, or of the first `share` of its time."""
    name = robot_name(robot)
    on_progress(f"{name}: reading", 0, None)
    log = _read(path, robot, source, share)
    on_progress(f"{name}: reading", 1, 1)
    local_map = map_laser(log, cfg, seed, on_progress)
    return replace(local_map, called=source.name or "")


def _read(path: Path | LaserLog, robot: str, source: LaserSource, share: float) -> LaserLog:
    whole = replace(path, robot=robot) if isinstance(path, LaserLog) else read_laser(path, robot, source)
    return first_part(whole, share)


def first_part(log: LaserLog, share: float) -> LaserLog:
    """The log until the first `share` of its time span has passed."""
    if share >= 1.0:
        return log
    stamps = log.stamps()
    end = stamps[0] + share * (stamps[-1] - stamps[0])
    return log.cut(float(np.nextafter(end, np.inf)), log.robot)[0]


def _configured(options: MapOptions) -> LaserConfig:
    """What is asked for."""
    asked = options.laser
    given = {
        "method": options.method,
        "resolution": options.resolution,
        "particles": asked.particles,
        "feature": asked.feature,
        "likelihood": asked.likelihood,
        "resample": asked.resample,
        "graph": {"loops": False if asked.no_loops else None, "hypotheses": asked.particles},
    }
    cfg = load(LaserMapConfig, options.config, {"laser": given}).laser
    cfg.check()
    return cfg


def _mapped(jobs: Sequence[Job], options: MapOptions, there: Sequence[LaserMap] = ()) -> list[LaserMap]:
    """The map of each log; where one goes on in another place, as where two drives are in one file, of each part.

    A part is a robot of its own, numbered after all others; one whose scans are those of a map that is `there` already
    keeps its number.
    """
    made = {m.robot: (job, m) for job, m in zip(jobs, _worked(jobs, options), strict=True)}
    told: dict[str, list[Finding]] = {}
    while cuts := [(job, m, t) for job, m in made.values() if (t := elsewhere_from(m)) is not None]:
        parts: list[Job] = []
        for (log, robot, source, cfg, seed, share), _, t in cuts:
            whole = _read(log, robot, source, share)
            taken = [*made, *(job[1] for job in parts)]
            before, after = whole.cut(t, next_robots([*taken, *(m.robot for m in there)], 1)[0])
            own = next((m.robot for m in there if m.robot not in taken and _begins_as(after, m)), after.robot)
            after = replace(after, robot=own)
            parts += [(side, side.robot, source, cfg, seed, 1.0) for side in (before, after)]
            told.setdefault(robot, []).append(Finding("log-parted", robot, (t, t), robot_name(after.robot)))
        made |= {m.robot: (job, m) for job, m in zip(parts, _worked(parts, options), strict=True)}
    return [replace(m, findings=(*m.findings, *told.get(m.robot, ()))) for _, m in made.values()]


def _worked(jobs: Sequence[Job], options: MapOptions) -> list[LaserMap]:
    with worker_pool(options.jobs, len(jobs), options.executor) as executor:
        if executor is None:
            return [part(map_one, *job, on_progress=options.on_progress) for job in jobs]
        if options.executor is None:  # processes of our own share the cores
            jobs = [_with_threads(job, max(1, (os.cpu_count() or 1) // min(options.jobs, len(jobs)))) for job in jobs]
        return parts(map_one, jobs, executor, "robots", options.on_progress)


def _with_threads(job: Job, threads: int) -> Job:
    path, robot, source, cfg, seed, share = job
    return path, robot, source, replace(cfg, threads=cfg.threads or threads), seed, share


def _of_recordings(logs: Sequence[Path | LaserLog], options: MapOptions) -> list[str]:
    """The options that were given for recordings alone, where no log is one."""
    if any(not isinstance(log, Path) or is_bag(log) for log in logs):
        return []
    return [name for name in options.laser.given() if name in OF_RECORDINGS]


def _with_idle_options(local_map: LaserMap, options: MapOptions, of_recordings: Sequence[str]) -> LaserMap:
    """With a word about options that mean nothing to this method, or to this kind of log."""
    alone = "each laser log is mapped on its own"
    woven = "laser maps are woven by their graphs"
    asked: list[tuple[str, object]] = [
        ("--weights", options.weights),
        ("--no-refine", not options.refine),
        ("--online", options.online),
        ("--calibration", options.calibration),
    ]
    if local_map.method != "graph":
        asked += [
            ("--start", options.start),
            ("--no-merge", options.laser.no_merge),
            ("--decisions", options.decisions),
        ]
    idle = [name for name, given in asked if given]
    why = woven if local_map.method == "graph" else alone
    whys = {**dict.fromkeys(idle, why), **dict.fromkeys(of_recordings, "the log is no recording of ROS")}
    more = tuple(Finding("option-idle", local_map.robot, value={"option": n, "value": w}) for n, w in whys.items())
    if local_map.method != "graph" and local_map.fixes is not None:
        told = Finding("fixes-unused", local_map.robot, value="the graph method alone lays maps by them")
        more = (*more, told)
    return replace(local_map, findings=(*local_map.findings, *more))


@dataclass(frozen=True, slots=True)
class Resumed:
    """What stands when going on. robots: the key each log is mapped under; notes: what was found, in words."""

    state: LaserState
    robots: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def said(self) -> Decisions | None:
        """What was decided on the result, also of a robot whose log has become longer and has another digest."""
        said = self.state.said
        logs = {} if said is None else {robot: of for robot, of in said.logs.items() if robot not in self.robots}
        return None if said is None else replace(said, logs=logs)

    def maps(self, fresh: Sequence[LaserMap]) -> tuple[LaserMap, ...]:
        """Every robot's map: the old ones, those that went on in their place, then the new ones."""
        by_robot = {local_map.robot: local_map for local_map in fresh}
        old = [by_robot.pop(local_map.robot, local_map) for local_map in self.state.maps]
        return (*old, *by_robot.values())


def next_robots(there: Sequence[str], count: int) -> list[str]:
    """Keys for so many new robots: the numbers after the greatest there is."""
    last = max((int(robot) for robot in there if robot.isdecimal()), default=0)
    return [str(last + k) for k in range(1, count + 1)]


def resumed(folder: Path, state: LaserState, logs: Sequence[LaserLog]) -> Resumed:
    """What the result in `folder` makes of further `logs`.

    A log that begins with all the scans of one that is in the result already is that log, longer: its robot is mapped
    anew and keeps its number; the others get the next numbers. Raises DataError for a log that is in the result as it
    is, and for two that go on from the same robot.
    """
    robots: list[str] = []
    notes: list[str] = []
    fresh = next_robots([local_map.robot for local_map in state.maps], len(logs))
    for log in logs:
        own = next((local_map for local_map in state.maps if _begins_as(log, local_map)), None)
        if own is None:
            robots.append(fresh.pop(0))
            continue
        name, n = robot_name(own.robot), len(own.scans)
        if n == len(log.scans):
            raise DataError(f"{log.source}: these scans are in {folder} already, as {name}")
        if own.robot in robots:
            raise DataError(f"{log.source}: two logs begin as that of {name} in {folder}, expected one")
        robots.append(own.robot)
        notes.append(f"{name}: its log goes on, from scan {n + 1} to {len(log.scans)}")
    return Resumed(state, tuple(robots), tuple(notes))


def _begins_as(log: LaserLog, local_map: LaserMap) -> bool:
    n = len(local_map.scans)
    return 0 < n <= len(log.scans) and local_map.scan_hash == log.scan_hash(n)
