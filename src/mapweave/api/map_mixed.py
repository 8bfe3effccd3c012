"""`map` of mixed teams: landmark logs, laser logs and tables of sightings become one map in one frame.

Of a team that drives, what its robots made apart is tied as `map` ties it before smoothing.
"""

import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config, load
from ..core.errors import DataError, MapweaveError, UsageError
from ..core.findings import Finding, Unused, Verdict, of_robot, shortly, unused_by_all, verdict, verdict_line
from ..core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from ..core.laser_log import LaserLog
from ..core.names import in_order, robot_key, robot_name
from ..core.version import __version__
from ..core.workers import no_progress, worker_pool
from ..fusion.compared_logs import with_copies_marked
from ..fusion.join import fuse
from ..fusion.result import Fusion
from ..io.directory import write_json
from ..io.fixes import read_points, write_georeferenced
from ..io.kept import parts
from ..io.laser_logs import read_laser
from ..io.laser_map import NAME, write_grid, write_laser_map
from ..io.local_map import write_local_map
from ..io.mixed_logs import MixedLogs, is_mixed, read_mixed_landmarks, sorted_logs
from ..io.ros_map import write_ros_map
from ..io.team_map import told_gaps, write_calibration, write_landmark_arrays, write_landmarks, write_tracks
from ..landmarks.agreement import sifted, with_wheels_checked
from ..landmarks.landmark_map import LocalMap
from ..landmarks.mapping import local_map, without_impossible
from ..laser.beam import beams
from ..laser.laser_map import GridMap, LaserMap
from ..laser.occupancy_mapper import render
from ..laser.sweep import swept_by_wheels
from ..live.joined import Apart, Joined, SightedAt, Tied
from ..mapping.config import LaserConfig
from ..mapping.laser_mapping import map_laser
from ..report.html import told_list
from ..report.result import ResultBase, Rows
from ..report.style import Target
from ..report.team import MixedStory, mixed_scene, words, write_mixed_report
from ..report.team_figures import headline_scores
from ..team.clocks import on_camera_clock
from ..team.config import ANOTHER_TIME
from ..team.georeference import seen_from_first
from ..team.kidnapped import Cut, cut_kidnapped, with_stretches
from ..team.known import PlacePriors
from ..team.mixed import MixedMap, first_layout, map_mixed, regained
from ..team.relation import SURE_THETA
from ..team.relative_frame import CLOCK_TOGETHER, PLACING_LEVER, UNMOVED, Body, Labels
from ..team.team_map import TeamMap, at_every_stamp
from ..team.walls import Scanned
from .evaluate import Evaluation, judged
from .map_landmarks import CameraTeamConfig, known_calibration
from .map_laser import first_part, grown, source_of
from .map_options import MapOptions
from .team import Watch, georeferences, team_maps


def carries(log: LandmarkLog, scanned: Mapping[str, Scanned]) -> str:
    """What a robot's logs hold, in words."""
    things = ["laser"] if log.robot in scanned else []
    if log.odometry is not None:
        things.append("wheels")
    if len(log.sightings):
        things.append("camera")
    if len(log.bearings):
        things.append("bearings")
    return ", ".join(things) or "nothing"


def findings_of(
    read: Sequence[LandmarkLog],
    lasers: Mapping[str, LaserMap],
    fusion: Fusion | None,
    mixed: MixedMap,
    apart: Mapping[str, float],
) -> tuple[Finding, ...]:
    out = [] if fusion is None else list(fusion.findings)
    for log in read:
        idle = log.robot in lasers
        out += of_robot([f for f in log.findings if not (idle and f.code == "saw-nothing")], log.robot)
    out += [found for robot, m in lasers.items() for found in of_robot(m.findings, robot)]
    out += [Finding("clock-apart", robot, value=gap, action="it stays apart") for robot, gap in apart.items()]
    own = {log.robot: len(log.sightings) + len(log.bearings) for log in read}
    for robot in mixed.layout.lost:
        why = "nothing that it saw, and nobody who saw it, tells where it was"
        if own.get(robot):
            why = f"its {own[robot]} sightings and those of it place it at too few moments to tell where it was"
        out.append(Finding("unplaced", robot, value=why))
    if others := [robot for component in mixed.components[1:] for robot in component.map.robots]:
        out.append(Finding("robots-apart", value=told_list(others)))
    for component in mixed.components:
        out += component.findings
    return (*out, *mixed.placed)


def robot_metrics(
    log: LandmarkLog, local: LocalMap | None, laser: LaserMap | None, findings: Sequence[Finding]
) -> dict[str, Any]:
    """What `metrics.json` tells of every robot, whatever it carries.

    sightings: of landmarks and robots, or the scans of a robot that has a laser alone; local: its own landmark map.
    """
    seen, scans = len(log.sightings) + len(log.bearings), 0 if laser is None else len(laser.scans)
    odometry = "none" if laser is None else laser.odometry
    mine = [found for found in findings if found.robot == robot_key(log.robot)]
    return {
        "source": log.source,
        "verdict": verdict(mine),
        "odometry": odometry if log.odometry is None else "velocity",
        "sightings": seen or scans,
        "scans": scans,
        "dropped": {**({} if laser is None else laser.dropped), **(log.dropped if local is None else local.dropped)},
        "down_weighted": 0 if local is None else local.down_weighted,
        "nis_median": None if local is None else local.nis_median,
        "warnings": [found.text for found in mine],
    }


def mixed_metrics(
    mixed: MixedMap,
    kinds: Mapping[str, str],
    robots: Mapping[str, Mapping[str, Any]],
    findings: Sequence[Finding],
    unused: Sequence[Unused],
    seed: int,
) -> dict[str, Any]:
    """`robots`: of each, what `robot_metrics` tells."""
    return {
        "version": __version__,
        "seed": seed,
        "verdict": verdict(findings),
        "findings": [found.row() for found in findings],
        "unused": [left.row() for left in unused],
        "robots": {
            robot_key(r): {
                **robots[r],
                "carries": kind,
                "clock": {"ahead": mixed.clocks[r].ahead, "sd": mixed.clocks[r].sd} if r in mixed.clocks else None,
            }
            for r, kind in kinds.items()
        },
        "components": [[robot_key(r) for r in s.map.robots] for s in mixed.components],
        "lost": [robot_key(r) for r in mixed.layout.lost],
        "ties": [
            {
                "a": [robot_key(r) for r in tie.a],
                "b": [robot_key(r) for r in tie.b],
                "agree": tie.agree,
                "of": tie.of,
                "by": tie.by,
                "clock": tie.clock,
            }
            for tie in mixed.layout.ties
        ],
        "through": [
            {
                "robots": [robot_key(r) for r in path.robots],
                "sightings": list(path.sightings),
                "landmarks": list(path.landmarks),
            }
            for path in mixed.paths
        ],
        "refined": [
            {
                "status": s.status,
                "iterations": s.iterations,
                "poses": s.poses,
                "factors": dict(s.used),
                "refused": s.refused or None,
            }
            for s in mixed.components
        ],
        "left_out": told_gaps([s.map for s in mixed.components]),
        **({"georeference": placed} if (placed := georeferences(mixed.components)) else {}),
        "fusion": [merge.row() for merge in mixed.merges],
        "warnings": [found.told for found in findings],
    }


METHODS = ("graph",)
PLAIN = LaserConfig(feature="none")


@config
class MixedMapConfig(CameraTeamConfig):
    """Settings of `map` for mixed teams."""

    laser: LaserConfig = field(default_factory=lambda: PLAIN)


@dataclass(frozen=True, slots=True, repr=False)
class MixedResult(ResultBase):
    """One map of a mixed team: `maps` as those of landmark logs, the largest first, `grids` beside each."""

    maps: tuple[TeamMap, ...]
    grids: tuple[GridMap | None, ...]
    local: tuple[LocalMap, ...]
    lasers: tuple[LaserMap, ...]
    story: MixedStory
    metrics: dict[str, Any]
    evaluation: Evaluation | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Of every robot, and of the whole."""
        return tuple(self.story.findings)

    @property
    def verdict(self) -> Verdict:
        """What the findings make of the result."""
        return verdict(self.findings)

    def size(self) -> dict[str, Any]:
        """How many robots and landmarks the largest map holds, how many maps there are, and the verdict."""
        first = self.maps[0]
        size = {"robots": len(first.robots), "maps": len(self.maps), "landmarks": len(first.landmarks)}
        return {**size, "verdict": self.verdict}

    def headline(self) -> Rows:
        where = {robot: k for k, team in enumerate(self.maps, 1) for robot in team.robots}
        kinds = self.story.kinds
        rows = [(robot_key(r), kinds[r], where.get(r)) for r in sorted(kinds, key=in_order)]
        return ("robot", "carries", "component"), rows

    def draw(self, target: Target) -> None:
        """Walls, landmarks and trajectories of the largest component."""
        mixed_scene(self.story, 0).draw(target)

    def lines(self) -> list[str]:
        first = self.maps[0]
        out = [f"{len(first.robots)} of {len(self.story.kinds)} robots in one map of {len(first.landmarks)} landmarks"]
        out += words(self.story)
        out += [f"warning: {text}" for text in shortly(self.findings, named=True)]
        return [*out, *self.story.lines, verdict_line(self.findings)]

    def write_into(self, folder: Path) -> None:
        """Landmarks, trajectories and occupancy of every component, local maps, report and, last, `metrics.json`."""
        _write_data(folder, self)
        write_mixed_report(folder, self.story, self.metrics.get("online", ()))
        write_json(folder / "metrics.json", self.metrics)

    def write_data(self, folder: Path) -> None:
        _write_data(folder, self)
        write_json(folder / "metrics.json", self.metrics)


def applies(logs: Sequence[Path]) -> bool:
    """Whether `logs` are of several kinds, or a table of sightings beside them."""
    return is_mixed(logs)


def map_logs(logs: Sequence[Path], options: MapOptions) -> MixedResult:
    """One map of all robots in `logs`."""
    _configured(options)
    by_kind = sorted_logs(logs, source_of(options.laser))
    read = read_mixed_landmarks(by_kind, options.laser.fixes)
    read, by_kind = _wanted(read, by_kind, options)
    _places(read, options)
    lasers = [read_laser(of.path, robot_key(robot), of.source) for robot, of in by_kind.lasers.items()]
    result = map_mixed_logs(read, lasers, options)
    every = options.fuse_every
    return result if every is None else _with_growth(result, read, lasers, every, options)


def _with_growth(
    result: "MixedResult",
    landmarks: Sequence[LandmarkLog],
    lasers: Sequence[LaserLog],
    every: float,
    options: MapOptions,
) -> "MixedResult":
    """The result, and how its map grew, each of the maps on the way as `map_mixed_logs` makes it."""
    landmarks = [log for log in landmarks if len(log)]
    alone = replace(options, fuse_every=None, truth=(), on_progress=no_progress)

    def look(until: list[float]) -> dict[str, Any]:
        seen = [log.until(t) for log, t in zip(landmarks, until[: len(landmarks)], strict=True)]
        cut = [log.cut(t, log.robot)[0] for log, t in zip(lasers, until[len(landmarks) :], strict=True)]
        seen, cut = [log for log in seen if len(log)], [log for log in cut if len(log.scans)]
        there = {robot_key(robot) for robot in [*(log.robot for log in seen), *(log.robot for log in cut)]}
        start = {key: pose for key, pose in options.start.items() if key in there}
        sd = {key: known for key, known in options.start_sd.items() if key in there}
        return map_mixed_logs(seen, cut, replace(alone, start=start, start_sd=sd)).size()

    spans = [*(log.span for log in landmarks), *((float(log.scan_t[0]), float(log.scan_t[-1])) for log in lasers)]
    rows = grown(spans, every, look, result.size(), options.on_progress)
    return replace(result, metrics={**result.metrics, "online": rows})


def map_mixed_logs(landmarks: Sequence[LandmarkLog], lasers: Sequence[LaserLog], options: MapOptions) -> MixedResult:
    """One map of logs that were read: what each robot drove and saw, and the scans of those with a laser."""
    cfg = _configured(options)
    watch = Watch()
    scans = {robot_name(log.robot): _shared(log, options) for log in lasers}
    scans = {robot: scans[robot] for robot in sorted(scans, key=in_order)}
    there = {log.robot for log in landmarks}
    nothing = [LandmarkLog(r, None, NOTHING_SEEN, source=log.source) for r, log in scans.items() if r not in there]
    read = sorted([*landmarks, *nothing], key=lambda log: in_order(log.robot))
    read = [_without(log, _robots_seen(log) - {*there, *scans}) for log in read]
    where = [*(log.source for log in scans.values()), *(log.source for log in landmarks)]
    sources = dict.fromkeys(Path(source).name for source in where if source)
    known, places = known_calibration(read, options), _places(read, options)
    watch.lap("read")
    own_maps = _lasers(scans, cfg.laser, options)
    apart = _apart(read, scans, ANOTHER_TIME)
    read = [log.share(options.share.get(robot_key(log.robot), 1.0)) for log in read]
    read = [on_camera_clock(log) for log in with_copies_marked(read)]
    stamps = {log.robot: log.stamps for log in read}
    read = [without_contradicted(log, cfg) for log in read]
    seeing = [x for x in read if x.robot not in apart and maps_landmarks(x)]
    cut = _cut(seeing, *_filtered(seeing, cfg, options), cfg, options.seed)
    local, fusion = cut.local, cut.fusion
    watch.lap("estimate")
    whole = team_maps(local, fusion) if local else ()
    maps, cut_logs, lost = with_stretches(whole, cut, cfg.smoothing, cfg.placing)
    cut_of = {log.robot: log for log in cut_logs}
    read = [cut_of.get(log.robot, log) for log in read]
    mapped = [team for team in maps if len(team.landmarks)]
    labels: Mapping[str, Mapping[str, str]] = {} if not local else fusion.labels
    fitted, back = regained(mapped, [log for log in read if log.robot not in apart], labels, cfg.smoothing, cfg.placing)
    scanned = {
        m: Scanned(laser_map.graph, laser_map.track) for m, laser_map in own_maps.items() if laser_map.graph is not None
    }
    options.on_progress("whole team", 0, 1)
    mixed = map_mixed(
        [log for log in read if log.robot in scanned or log.robot not in apart],
        scanned,
        fitted,
        labels,
        cfg.smoothing,
        cfg.placing,
        known,
        [robot for robot in scanned if robot not in apart],
        refine=options.refine,
        laser=None if options.laser.no_merge else cfg.laser,
        known=places,
        fixes={robot: log.fixes for robot, log in scans.items() if log.fixes is not None},
    )
    mixed = _finished(mixed, stamps, places)
    options.on_progress("whole team", 1, 1)
    watch.lap("smooth")
    grids = tuple(_grid(s.map, scans, mixed, cfg.laser) for s in mixed.components)
    watch.lap("grid")
    carried = [found for m in local if cut_of[m.robot].cuts for found in of_robot(m.findings, m.robot)]
    told = findings_of(read, own_maps, fusion if local else None, mixed, apart)
    findings = tuple(dict.fromkeys((*carried, *lost, *back, *told)))
    beside = [*((m.source, m.unused) for m in own_maps.values()), *((log.source, log.unused) for log in read)]
    unused = unused_by_all(beside)
    kinds = {log.robot: carries(log, scanned) for log in read}
    own = {m.robot: m for m in local}
    robots = {x.robot: robot_metrics(x, own.get(x.robot), own_maps.get(x.robot), findings) for x in read}
    story = MixedStory(f"One map from {', '.join(sources)}", mixed, grids, kinds, (), findings)
    result = MixedResult(
        maps=tuple(s.map for s in mixed.components),
        grids=grids,
        local=tuple(local),
        lasers=tuple(own_maps.values()),
        story=story,
        metrics=mixed_metrics(mixed, kinds, robots, findings, unused, options.seed),
    )
    result = _scored(result, options)
    watch.lap("evaluate")
    return replace(result, metrics={**result.metrics, "timing": {k: round(v, 4) for k, v in watch.seconds.items()}})


def _places(read: Sequence[LandmarkLog], options: MapOptions) -> PlacePriors:
    """What `--start` and `--survey` say of places; raises UsageError for a robot that is not there."""
    names = [log.robot for log in read]
    for key in options.start:
        if robot_name(key) not in names:
            raise UsageError(f"--start: no robot {key}; there are {', '.join(map(robot_key, names))}")
    starts = {robot_name(key): pose for key, pose in options.start.items()}
    sd = {robot_name(key): value for key, value in options.start_sd.items()}
    points = {} if options.survey is None else read_points(options.survey)
    return PlacePriors.of(starts, sd, points, names)


def _finished(mixed: MixedMap, stamps: Mapping[str, np.ndarray], places: PlacePriors) -> MixedMap:
    """With a pose at every one of `stamps` [s], in the frame of the lowest robot's first pose where none is known."""
    ahead = {robot: clock.ahead for robot, clock in mixed.clocks.items()}
    whole = [replace(s, map=at_every_stamp(s.map, stamps, ahead)) for s in mixed.components]
    return replace(mixed, components=tuple(whole if places else map(seen_from_first, whole)))


def _configured(options: MapOptions) -> MixedMapConfig:
    if options.method not in (None, *METHODS):
        raise UsageError(f"--method: mixed teams know {', '.join(METHODS)}, found {options.method!r}")
    idle = {
        "--online": options.online,
        "--radios": options.radios,
        "--likelihood": options.laser.likelihood,
        "--resample": options.laser.resample,
        "--resume": options.laser.resume,
    }
    if given := [name for name, value in idle.items() if value]:
        raise UsageError(f"{', '.join(given)}: not for mixed teams")
    asked = options.laser
    laser = {
        "method": "graph",
        "feature": asked.feature or "none",
        "particles": asked.particles,
        "resolution": options.resolution,
        "graph": {"loops": False if asked.no_loops else None},
    }
    cfg = load(MixedMapConfig, options.config, {"fuse": {"weights": options.weights}, "laser": laser})
    cfg.laser.check()
    return cfg


def _wanted(read: list[LandmarkLog], logs: MixedLogs, options: MapOptions) -> tuple[list[LandmarkLog], MixedLogs]:
    """The logs of the robots asked for, without sightings of others.

    Raises DataError for one that is asked for and not there, UsageError for a `--share` of such a one.
    """
    names = [log.robot for log in read]
    asked: list[tuple[str, Iterable[str], type[MapweaveError]]] = [
        ("--robots", options.robots or (), DataError),
        ("--share", options.share, UsageError),
    ]
    for option, given, wrong in asked:
        for key in given:
            if robot_name(key) not in names:
                raise wrong(f"{option}: no robot {key}; there are {', '.join(map(robot_key, names))}")
    if options.robots is None:
        return read, logs
    chosen = {robot_name(key) for key in options.robots}
    lasers = {robot: laser for robot, laser in logs.lasers.items() if robot in chosen}
    others = set(names) - chosen
    return [_without(log, others) for log in read if log.robot in chosen], replace(logs, lasers=lasers)


def _robots_seen(log: LandmarkLog) -> set[str]:
    return {name for name in (*log.sightings.ids, *log.bearings.ids) if robot_key(name) != name}


def _without(log: LandmarkLog, robots: Collection[str]) -> LandmarkLog:
    """The log without sightings of `robots`, which are counted: they drive, and are no landmarks."""

    def kept(table: SightingTable) -> SightingTable:
        return table.select(np.array([name not in robots for name in table.ids], bool)[table.what])

    sightings, bearings = kept(log.sightings), kept(log.bearings)
    gone = len(log.sightings) + len(log.bearings) - len(sightings) - len(bearings)
    if not gone:
        return log
    dropped = {**log.dropped, "sighting of a robot left out": gone}
    return replace(log, sightings=sightings, bearings=bearings, dropped=dropped)


def without_contradicted(log: LandmarkLog, cfg: MixedMapConfig) -> LandmarkLog:
    """The log without rows that cannot be, or that its other rows contradict."""
    return sifted(without_impossible(with_wheels_checked(log, cfg.ekf, cfg.agreement)), cfg.ekf)


def maps_landmarks(log: LandmarkLog) -> bool:
    """Whether the robot saw anything with its range that is no robot."""
    return any(not name.startswith("robot") for name in log.sightings.counts())


def _shared(log: LaserLog, options: MapOptions) -> LaserLog:
    """The share of the log that is asked for, of robot `K`."""
    key = robot_key(log.robot)
    return first_part(replace(log, robot=key), options.share.get(key, 1.0))


def _lasers(logs: Mapping[str, LaserLog], cfg: LaserConfig, options: MapOptions) -> dict[str, LaserMap]:
    """Every laser robot's own map, in the order of `logs`."""
    with worker_pool(options.jobs, len(logs), options.executor) as pool:
        if pool is None:
            return {r: map_laser(log, cfg, options.seed, options.on_progress) for r, log in logs.items()}
        running = {robot: pool.submit(map_laser, log, cfg, options.seed) for robot, log in logs.items()}
        return {robot: done.result() for robot, done in running.items()}


def _apart(read: Sequence[LandmarkLog], scans: Mapping[str, LaserLog], far: float) -> dict[str, float]:
    """Robots whose log is `far` [s] or more from every other robot's -> the gap [s] to the nearest."""
    spans: dict[str, tuple[float, float]] = {}
    for log in read:
        if log.robot in scans:
            stamps = scans[log.robot].stamps()
            spans[log.robot] = (float(stamps[0]), float(stamps[-1]))
        elif len(log):
            spans[log.robot] = log.span
    out = {}
    for robot, (first, last) in spans.items():
        gaps = [max(a - last, first - b) for other, (a, b) in spans.items() if other != robot]
        if gaps and min(gaps) > far:
            out[robot] = min(gaps)
    if len(out) == len(spans) > 1:
        raise DataError(
            "no two logs are of the same time: "
            + "; ".join(f"{robot} {a:.0f} to {b:.0f} s" for robot, (a, b) in spans.items())
        )
    return out


def _cut(logs: Sequence[LandmarkLog], local: Sequence[LocalMap], fusion: Fusion, cfg: MixedMapConfig, seed: int) -> Cut:
    """The team with the logs of kidnapped robots cut."""
    mapper, join = partial(local_map, cfg=cfg.ekf, seed=seed), partial(fuse, cfg=cfg.fuse)
    return cut_kidnapped(logs, local, fusion, cfg.smoothing, cfg.placing, mapper, join)


def _filtered(seeing: Sequence[LandmarkLog], cfg: MixedMapConfig, options: MapOptions) -> tuple[list[LocalMap], Fusion]:
    jobs = [(log, cfg.ekf, options.seed) for log in seeing]
    with worker_pool(options.jobs, len(jobs), options.executor) as pool:
        local = parts(local_map, jobs, pool, "local maps", options.on_progress)
    return local, fuse(local, cfg.fuse)


def _grid(team: TeamMap, scans: Mapping[str, LaserLog], mixed: MixedMap, cfg: LaserConfig) -> GridMap | None:
    """What all lasers of a component saw, laid at the poses found."""
    seen, poses, sensors = [], [], []
    for robot in team.robots:
        if robot not in scans:
            continue
        log, track = swept_by_wheels(scans[robot], cfg.beam, cfg.front_end), team.tracks[robot]
        clock = mixed.clocks[robot].ahead if robot in mixed.clocks else 0.0
        at = np.clip(np.searchsorted(track.t, log.scan_t - clock - 1e-6), 0, len(track.t) - 1)
        seen += [beams(scan, "none", None, cfg.beam) for scan in log.scans]
        poses.append(track.pose[at])
        sensors += [scan.T_robot_sensor for scan in log.scans]
    if not seen:
        return None
    return render(seen, np.concatenate(poses), np.array(sensors), cfg.resolution, "map")


def _scored(result: MixedResult, options: MapOptions) -> MixedResult:
    """With its score, where truth was given; truth is read here, when nothing is left to estimate."""
    if not options.truth:
        return result
    with tempfile.TemporaryDirectory() as folder:
        result.write_data(Path(folder))
        score = judged(Path(folder), options.truth)
    metrics = score.as_json()
    left = (Finding("truth-unscored", value=score.unscored),) if score.unscored else ()
    findings = (*result.story.findings, *left)
    return replace(
        result,
        story=replace(
            result.story, lines=tuple(score.lines()), findings=findings, scores=tuple(headline_scores(metrics))
        ),
        metrics={
            **result.metrics,
            "findings": [found.row() for found in findings],
            "warnings": [found.told for found in findings],
            "evaluation": metrics,
        },
        evaluation=score,
    )


def _write_data(folder: Path, result: MixedResult) -> None:
    placed = [s.georeference for s in result.story.map.components]
    for k, (team, grid, where) in enumerate(zip(result.maps, result.grids, placed, strict=True), 1):
        home = folder if k == 1 else folder / "components" / str(k)
        home.mkdir(parents=True, exist_ok=True)
        write_landmarks(home, team)
        write_tracks(home, team)
        if where is not None:
            write_georeferenced(home, where, team.tracks, grid, team.landmarks)
        if grid is not None:
            write_ros_map(home, grid, None if where is None else where.row())
            write_grid(home / NAME, grid, None, "none")
    for local in result.local:
        write_local_map(folder / "local" / local.robot, local)
        write_landmark_arrays(folder / "local" / local.robot, local.submap.landmarks)
    for laser_map in result.lasers:
        write_laser_map(folder / "local" / robot_name(laser_map.robot), laser_map)
    calibrations = {robot: known for s in result.story.map.components for robot, known in s.calibration.items()}
    write_calibration(folder / "calibration.json", calibrations, result.story.map.components[0].prior)


TOGETHER = CLOCK_TOGETHER * PLACING_LEVER  # times the sd that independent sightings would give a tie

Anchors = Mapping[str, Float[np.ndarray, "3"]]


def join_apart(apart: Apart, landmarks: Sequence[LandmarkLog], cfg: MixedMapConfig, seed: int = 0) -> Joined:
    """What sightings tie of a mixed team.

    landmarks: what robots without a laser told so far. Laser robots are each by itself, whatever walls say of them, as
    sightings overrule walls.
    """
    read = [without_contradicted(on_camera_clock(log), cfg) for log in with_copies_marked(list(landmarks))]
    mapped, frames, labels = _landmark_maps(read, cfg, seed)
    lasers = [Body({robot: way}, {}, own_clock=True) for robot, way in apart.ways.items()]
    layout = first_layout(read, lasers, mapped, labels, cfg.smoothing, cfg.placing)
    anchors = {**frames, **{robot: way.pose[0] for robot, way in apart.ways.items()}}
    tied: dict[str, Tied] = {}
    sighted: dict[str, SightedAt] = {}
    for body in layout.bodies:
        first = _first(body, anchors, apart)
        if first is not None:
            tied |= _ties(body, first, anchors, apart)
            sighted |= _placed(body, first, anchors, apart, cfg.placing.sure_xy)
    words = [
        f"{_called(tie.a, apart)} and {_called(tie.b, apart)}: tied by {tie.agree} of {tie.of} sightings"
        for tie in layout.ties
    ]
    return Joined(tied, sighted, words, cfg.placing.sure_xy)


def _landmark_maps(
    read: Sequence[LandmarkLog], cfg: MixedMapConfig, seed: int
) -> tuple[Sequence[TeamMap], Anchors, Labels]:
    """Robots' landmark maps fused, the frames of robots in these, and what landmarks are called there."""
    local = [local_map(log, cfg.ekf, seed) for log in read if maps_landmarks(log)]
    if not local:
        return (), {}, {}
    fusion = fuse(local, cfg.fuse)
    whole = team_maps(local, fusion)
    mapped = [team for team in whole if len(team.landmarks)]
    fitted, _ = regained(mapped, read, fusion.labels, cfg.smoothing, cfg.placing)
    frames = {
        robot: component.frames[robot]
        for component, team in zip(fusion.components, whole, strict=False)  # robots that mapped nothing come after
        for robot in component.robots
        if any(fit.tracks.get(robot) is team.tracks[robot] for fit in fitted)  # else its sightings place it anew
    }
    return fitted, frames, fusion.labels


def _first(body: Body, anchors: Anchors, apart: Apart) -> str | None:
    """The robot beside which the others are told: the first laser robot, if there is one."""
    held = [robot for robot in body.robots if robot in anchors]
    return min(held, key=lambda robot: (robot not in apart.ways, in_order(robot)), default=None)


def _ties(body: Body, first: str, anchors: Anchors, apart: Apart) -> dict[str, Tied]:
    """By the team's names, robots with a map of their own beside `first`; the errors of two ties are independent.

    Of one tie they are not: sightings err together for seconds, and most where frames begin, far from where robots met.
    """
    base, spread = body.moves.get(first, UNMOVED)
    J = se2.inverse_jacobian(base)
    back, back_cov = se2.inverse(base), J @ spread @ J.T
    out = {}
    for robot in body.robots:
        if robot not in anchors or robot == first:
            continue
        T, cov = body.moves.get(robot, UNMOVED)
        at = se2.between(se2.compose(base, anchors[first]), se2.compose(T, anchors[robot]))
        whole = se2.composed_covariance(back, back_cov, T, cov)
        out[apart.called[robot]] = Tied(apart.called[first], np.asarray(at), TOGETHER**2 * whole)
    return out


def _placed(body: Body, first: str, anchors: Anchors, apart: Apart, sure_xy: float) -> dict[str, SightedAt]:
    """By the team's names, robots without a map beside `first`, where they told last that they were.

    Their covariance is the largest that sightings may have that place a robot.
    """
    base, _ = body.moves.get(first, UNMOVED)
    root = se2.compose(base, anchors[first])
    cov = np.diag([sure_xy**2, sure_xy**2, SURE_THETA**2])
    out = {}
    for robot in body.robots:
        if robot not in anchors:
            track = body.tracks[robot]
            t, told = apart.told.get(robot, (float(track.t[-1]), np.zeros(3)))
            pose = se2.interpolate(np.array([t]), track.t, track.pose)[0]
            out[apart.called[robot]] = SightedAt(apart.called[first], np.asarray(se2.between(root, pose)), cov, told)
    return out


def _called(robots: Sequence[str], apart: Apart) -> str:
    return ", ".join(apart.called[robot] for robot in sorted(robots, key=in_order))
