"""Laser logs become maps, each log on its own: poses at every stamp, occupancy, the light walls send back."""

import os
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config import config, load
from ..core.errors import UsageError
from ..core.laser_log import LaserLog
from ..core.names import robot_name
from ..core.records import Track
from ..core.version import __version__
from ..core.workers import Progress, no_progress, worker_pool
from ..io.directory import write_json
from ..io.laser_logs import LaserSource, is_laser_log, read_laser, robots_of
from ..io.laser_map import write_laser_map
from ..io.tum import read_tum, write_track_covariance, write_tum
from ..laser.config import LaserConfig
from ..laser.laser_map import LaserMap
from ..laser.mapping import map_laser
from ..report.laser import write_laser_report
from ..report.laser_figures import aligned, draw_map
from ..report.result import ResultBase, Rows
from ..report.style import Target
from .evaluate import Evaluation, judged
from .map_options import MapOptions

Job = tuple[Path | LaserLog, str, LaserSource, LaserConfig, int, float]


@config
class LaserMapConfig:
    """The table `[laser]` of a configuration file, for `map` and `localize`."""

    laser: LaserConfig = LaserConfig()


@dataclass(frozen=True, slots=True, repr=False)
class LaserResult(ResultBase):
    """One map a log. `metrics` are those of `metrics.json`; `evaluation` is there when truth was given."""

    maps: tuple[LaserMap, ...]
    metrics: dict[str, Any]
    evaluation: Evaluation | None = None
    truth: Mapping[str, Track] = field(default_factory=dict)

    def draw(self, target: Target) -> None:
        """The first robot's map with its trajectory."""
        first = self.maps[0]
        truth = self.truth.get(first.robot)
        draw_map(target, first, None if truth is None else aligned(truth, first.track))

    def headline(self) -> Rows:
        head = ("robot", "scans", "method", "feature", "map [m]")
        rows = []
        for made in self.maps:
            x0, x1, y0, y1 = made.grid.extent
            rows.append((made.robot, len(made.scans), made.method, made.feature, f"{x1 - x0:.0f} x {y1 - y0:.0f}"))
        return head, rows

    def write_into(self, folder: Path) -> None:
        """All files of the contract; with one robot its own stand at the top level too."""
        _write_data(folder, self.maps, self.metrics)
        told = [] if self.evaluation is None else self.evaluation.lines()
        write_laser_report(folder, self.maps, self.truth, told)
        if len(self.maps) == 1:
            for path in sorted((folder / "local" / robot_name(self.maps[0].robot)).iterdir()):
                (folder / path.name).write_bytes(path.read_bytes())

    def lines(self) -> list[str]:
        lines = []
        for made in self.maps:
            refused = Counter(made.scans.decision)["odometry"]
            x0, x1, y0, y1 = made.grid.extent
            lines.append(
                f"{robot_name(made.robot)}: {len(made.scans)} scans, {made.method}, feature {made.feature}, "
                f"map {x1 - x0:.0f} x {y1 - y0:.0f} m, {refused} matches refused"
            )
            lines += [f"{robot_name(made.robot)}: {warning}" for warning in made.warnings]
        lines += [f"warning: {text}" for text in self.metrics.get("warnings", ())]
        return lines + ([] if self.evaluation is None else self.evaluation.lines())


def applies(log: Path) -> bool:
    return is_laser_log(log)


def map_logs(logs: Sequence[Path | LaserLog], options: MapOptions) -> LaserResult:
    """The maps of `logs`, files or logs that are read already; robot K is the K-th of their robots.

    A recording may hold several robots.
    """
    cfg = _configured(options)
    source = source_of(options)
    robots = [(log, replace(source, name=name)) for log in logs for name in _names(log, source)]
    names = [str(k) for k in range(1, len(robots) + 1)]
    wanted = names if options.robots is None else list(options.robots)
    if missing := [name for name in wanted if name not in names]:
        raise UsageError(f"--robots: there is no robot {missing[0]} among {len(names)} robots of {len(logs)} logs")
    held = dict(zip(names, robots, strict=True))
    jobs = [(held[name][0], name, held[name][1], cfg, options.seed, options.share.get(name, 1.0)) for name in wanted]
    maps = tuple(_told(made, options) for made in _worked(jobs, options))
    metrics = _metrics(maps, options)
    for name in wanted:
        if (called := held[name][1].name) is not None:
            metrics["robots"][name]["name"] = called
    if not options.truth:
        return LaserResult(maps, metrics)
    with tempfile.TemporaryDirectory() as folder:
        _write_data(Path(folder), maps, metrics)
        score = judged(Path(folder), options.truth)
    known = {made.robot: _true_track(options.truth, k) for k, made in enumerate(maps)}
    truth = {robot: track for robot, track in known.items() if track is not None}
    if score.unscored:
        metrics["warnings"] = [*metrics.get("warnings", ()), f"the truth: nothing to score: {score.unscored}"]
    return LaserResult(maps, metrics | {"evaluation": score.as_json()}, score, truth)


def result_of(maps: Sequence[LaserMap], *, seed: int = 0) -> LaserResult:
    """The result of maps that were made already, each of them on its own."""
    return LaserResult(tuple(maps), _metrics(maps, MapOptions(seed=seed)))


def _names(log: Path | LaserLog, source: LaserSource) -> tuple[str | None, ...]:
    return (None,) if isinstance(log, LaserLog) else tuple(robots_of(log, source))


def source_of(options: MapOptions) -> LaserSource:
    """Which topics are read and where the scanner stands, as asked."""
    asked = options.laser
    return LaserSource(
        scan_topic=asked.scan_topic,
        odom_topic=asked.odom_topic,
        sensor_pose=asked.sensor_pose,
        mirrored=asked.mirrored,
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
    whole = replace(path, robot=robot) if isinstance(path, LaserLog) else read_laser(path, robot, source)
    log = first_part(whole, share)
    on_progress(f"{name}: reading", 1, 1)
    return map_laser(log, cfg, seed, _compiling_first(f"{name}: compiling (first run only)", on_progress))


def _compiling_first(compiling: str, on_progress: Progress) -> Progress:
    """`on_progress` that shows `compiling` until the first scan is done: so long a first run compiles kernels."""
    on_progress(compiling, 0, None)

    def told(stage: str, done: float, total: float | None = None) -> None:
        if done <= 1:
            on_progress(compiling, 1, 1)
        on_progress(stage, done, total)

    return told


def first_part(log: LaserLog, share: float) -> LaserLog:
    """The log until the first `share` of its time span has passed."""
    if share >= 1.0:
        return log
    stamps = log.stamps()
    end = stamps[0] + share * (stamps[-1] - stamps[0])
    scans = int(np.searchsorted(log.scan_t, end, side="right"))
    rows = log.odometry
    if rows is not None:
        keep = rows.t <= end
        rows = Track(rows.t[keep], rows.pose[keep], None, rows.frame)
    return replace(log, scan_t=log.scan_t[:scans], scans=log.scans[:scans], odometry=rows)


def _configured(options: MapOptions) -> LaserConfig:
    asked = options.laser
    given = {
        "method": options.method,
        "particles": asked.particles,
        "feature": asked.feature,
        "likelihood": asked.likelihood,
        "resample": asked.resample,
        "graph": {"loops": False if asked.no_loops else None, "hypotheses": asked.particles},
    }
    cfg = load(LaserMapConfig, options.config, {"laser": given}).laser
    cfg.check()
    return cfg


def _worked(jobs: Sequence[Job], options: MapOptions) -> list[LaserMap]:
    if len(jobs) == 1:
        return [map_one(*job, options.on_progress) for job in jobs]
    with worker_pool(options.jobs, len(jobs), options.executor) as executor:
        if executor is None:
            return [map_one(*job, options.on_progress) for job in jobs]
        if options.executor is None:  # processes of our own share the cores
            jobs = [_with_threads(job, max(1, (os.cpu_count() or 1) // min(options.jobs, len(jobs)))) for job in jobs]
        running = [executor.submit(map_one, *job) for job in jobs]
        maps = []
        for k, done in enumerate(running, 1):
            maps.append(done.result())
            options.on_progress("robots", k, len(jobs))
        return maps


def _with_threads(job: Job, threads: int) -> Job:
    path, robot, source, cfg, seed, share = job
    return path, robot, source, replace(cfg, threads=cfg.threads or threads), seed, share


def _told(made: LaserMap, options: MapOptions) -> LaserMap:
    """With a word about options that mean nothing to logs that are mapped each on its own."""
    asked = (
        ("--start", options.start),
        ("--fuse-every", options.fuse_every),
        ("--weights", options.weights),
        ("--no-refine", not options.refine),
        ("--calibration", options.calibration),
    )
    idle = [name for name, given in asked if given]
    more = tuple(f"{name} has no effect: each laser log is mapped on its own" for name in idle)
    return replace(made, warnings=(*made.warnings, *more))


def _metrics(maps: Sequence[LaserMap], options: MapOptions) -> dict[str, Any]:
    return {
        "version": __version__,
        "seed": options.seed,
        "robots": {made.robot: _robot_metrics(made) for made in maps},
        "components": [[made.robot] for made in maps],
        "fusion": [],
        "timing": {f"{robot_name(m.robot)} {stage}": spent for m in maps for stage, spent in m.timing.items()},
    }


def _robot_metrics(made: LaserMap) -> dict[str, Any]:
    decisions = Counter(made.scans.decision)
    c = made.calibration
    return {
        "source": made.source,
        "odometry": made.odometry,
        "sightings": len(made.scans),
        "dropped": dict(made.dropped),
        "down_weighted": decisions["odometry"],
        "nis_median": None,
        "warnings": list(made.warnings),
        "method": made.method,
        "feature": made.feature,
        "particles": made.particles,
        "log_hash": made.log_hash,
        "decisions": dict(sorted(decisions.items())),
        "calibration": None
        if c is None
        else {"exponent": c.exponent, "scale": c.scale, "residual": c.residual, "samples": c.samples},
    }


def _write_data(folder: Path, maps: Sequence[LaserMap], metrics: Mapping[str, Any]) -> None:
    write_json(folder / "metrics.json", dict(metrics))
    for made in maps:
        name = robot_name(made.robot)
        write_tum(folder / "trajectories" / f"{name}.tum", made.track)
        write_track_covariance(folder / "trajectories" / f"{name}.cov.csv", made.track)
        write_laser_map(folder / "local" / name, made)


def _true_track(paths: Sequence[Path], k: int) -> Track | None:
    """The k-th of several TUM files, or the only one for the only robot; None for other kinds of truth."""
    tum = [path for path in paths if path.suffix.lower() in (".tum", ".txt")]
    return read_tum(tum[k], "truth") if k < len(tum) else None
