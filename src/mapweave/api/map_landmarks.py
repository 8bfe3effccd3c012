"""`map` of landmark logs: EKF-SLAM for every robot in its own frame, then all fused; `--online` meanwhile."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import ClassVar

import numpy as np

from ..core import se2
from ..core.config import config, load
from ..core.errors import DataError, UsageError
from ..core.findings import Finding, unused_by_all
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order, robot_key, robot_name
from ..core.records import Track
from ..core.workers import Progress, worker_pool
from ..fusion.compared_logs import mirror_images, scales_apart, unmirrored, with_copies_marked
from ..fusion.config import START_TOLERANCE, FuseConfig
from ..fusion.join import fuse
from ..fusion.online import OnlineFuser
from ..fusion.result import Fusion, placed_by, tie_by_starts
from ..io.fixes import read_points
from ..io.kept import parts
from ..io.landmark_logs import is_landmark_log, landmark_logs_of, read_landmark_logs
from ..io.table import Columns
from ..io.team_map import read_calibration
from ..landmarks.agreement import AgreementConfig, sifted, with_wheels_checked
from ..landmarks.config import EkfSlamConfig
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..landmarks.mapping import Growth, grow, without_impossible
from ..solve import SingularError
from ..team.clocks import of_another_time, on_camera_clock
from ..team.config import ONLINE_FAR, SMOOTHING_SOFTEN, OnlineConfig, PlacingConfig, SmoothingConfig
from ..team.georeference import FRAME_GIVEN, NOT_SMOOTHED, laid_team, seen_from_first, unused_fixes
from ..team.kidnapped import cut_kidnapped, with_stretches
from ..team.known import PlacePriors, framed
from ..team.mixed import regained
from ..team.online import OnlineMap, OnlineRun, OnlineStep, OnlineTeam
from ..team.smooth import Smoothed, smooth_on_one_clock, with_earlier_stamps
from ..team.team_map import TeamMap, at_every_stamp, in_first_frame, with_further_rooms
from .map_options import LANDMARK_METHODS, MapOptions
from .team import TeamResult, Watch, carried, fuse_online, team_maps, team_result, times_of

NO_STEP = OnlineStep(0, 0, 0, 0.0)
FULL = 3  # landmarks in common by which two maps are laid over each other
STEP = 0.05  # share of what is left that a step of the solver is told to be: a smoothing makes twenty to sixty


def smooth_online(
    logs: Sequence[LandmarkLog],
    grown: Sequence[Growth],
    fusing: FuseConfig,
    smoothing: SmoothingConfig,
    cfg: OnlineConfig,
    calibration: Mapping[str, Mapping[str, tuple[float, float]]],
    looks: Sequence[float],
    on_progress: Progress,
) -> OnlineRun:
    """All rows taken in, a step after the other in order of time.

    grown: each log's maps at `looks` [s] with their poses; the filters' own time is not in that of the steps.
    """
    wheels = [log for log in logs if log.odometry is not None and len(log)]
    first, last = min(log.span[0] for log in logs if len(log)), max(log.span[1] for log in logs if len(log))
    if not wheels:
        nothing = np.zeros(0)
        return OnlineRun(None, cfg.step, nothing, nothing, nothing, 0, (), 0, ())
    own = {log.robot: g.filtered for log, g in zip(logs, grown, strict=True)}
    team = OnlineTeam(wheels, own, smoothing, cfg, calibration)
    fuser = OnlineFuser(fusing, {log.robot: log.source for log in logs})
    seconds, lag, linearised, laid_out, growth = [], [], [], [], list[OnlineMap]()
    renewed, free = 0, first
    steps = np.arange(first + cfg.step, last + cfg.step, cfg.step)
    next_look = 0
    for k, stamp in enumerate(steps):
        t = min(float(stamp), last)
        began = perf_counter()
        looking = next_look < len(looks) and t >= looks[next_look]
        step = NO_STEP
        try:
            if looking:
                fuser = fuser.update(*[m for m in (g.maps[next_look] for g in grown) if m is not None])
                next_look += 1
                if _adopted(team, t, fuser):
                    laid_out.append(round(t - first, 3))
                on_progress("smoothing online", k, len(steps))
            step = team.advance(t)
        except SingularError:  # too little is known yet of something: it is laid out anew at the next look
            team.forget()
        seconds.append(perf_counter() - began)
        free = max(free, t) + seconds[-1]
        lag.append(free - (t - cfg.step))
        linearised.append(step.linearised)
        renewed += step.renewed
        if team.members and looking:
            growth.append(OnlineMap(t - first, len(team.members), team.landmarks))
    team.update_poses()
    on_progress("smoothing online", len(steps), len(steps))
    return OnlineRun(
        team, cfg.step, np.array(seconds), np.array(lag), np.array(linearised, float), renewed, tuple(laid_out),
        len(team.stretches), tuple(growth), waited=tuple(log.robot for log in logs if log.odometry is None),
        members=tuple(team.members),
    )  # fmt: skip


def _adopted(team: OnlineTeam, t: float, fuser: OnlineFuser) -> bool:
    """Whether the filters' fused map held robots, landmarks or labels that were new."""
    fused = fuser.largest
    if fused is None or not len(fused.map):
        return False
    factor = {d.robot: d.variance_factor or 1.0 for d in fuser.fusion.decisions}
    ways = {
        r: carried(fuser.latest[r].track, fused.frames[r], fused.frame_cov[r], fused.scales.get(r, 1.0), factor[r])
        for r in fused.robots
    }
    return team.adopt(t, fused.robots, fused.map, ways, fuser.fusion.labels)


def closing_start(run: OnlineRun, filters: TeamMap, far: float) -> TeamMap:
    """The map as it stood when the logs ended, in the frame of `filters`, which has what was not smoothed yet.

    far: [m] root mean square between the landmarks of both, from which it is `filters`.
    """
    team = run.team
    if team is None or not team.members:
        return filters
    now, start = team.landmarks, filters.landmarks
    both = [name for name in start.ids if name in now.ids]
    if len(both) < FULL:
        return filters
    T = se2.align(now.select(both).mean, start.select(both).mean)
    off = se2.act(T, now.select(both).mean) - start.select(both).mean
    if not np.square(off).sum(axis=1).mean() < far**2:
        return filters
    ways = {r: team.way(r) for r in team.members if r in filters.robots}
    smoothed = {r: _within(filters.tracks[r], Track(way.t, se2.compose(T, way.pose))) for r, way in ways.items()}
    tracks = {**filters.tracks, **smoothed}
    place = dict(zip(now.ids, se2.act(T, now.mean), strict=True))
    mean = np.array([place.get(name, p) for name, p in zip(start.ids, start.mean, strict=True)])
    head = filters.robots[0]
    if head in ways:  # the frame is its first pose
        back = se2.inverse(tracks[head].pose[0])
        tracks = {r: Track(track.t, se2.compose(back, track.pose)) for r, track in tracks.items()}
        mean = se2.act(back, mean)
    return replace(filters, landmarks=LandmarkMap(start.ids, mean, start.cov, start.frame), tracks=tracks)


def _within(whole: Track, way: Track) -> Track:
    """`way`, and `whole` before and after: of a robot that was put down elsewhere one stretch alone is smoothed."""
    before, after = whole.t < way.t[0], whole.t > way.t[-1]
    parts = [(whole.t[before], whole.pose[before]), (way.t, way.pose), (whole.t[after], whole.pose[after])]
    t, pose = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Track(t, pose)


def closed(run: OnlineRun, start: TeamMap, done: Smoothed, seconds: float) -> OnlineRun:
    """`run` with what closing it took and moved: both maps laid over each other by their landmarks."""
    a, b = start.landmarks, done.map.landmarks
    if run.team is None or done.refused or len(a) < FULL:
        return replace(run, closing=seconds)
    T = se2.align(a.mean, b.select(a.ids).mean)
    off = se2.act(T, a.mean) - b.select(a.ids).mean
    ways = []
    for robot in run.team.members:
        if robot in start.tracks and robot in done.map.tracks:
            before, after = start.tracks[robot], done.map.tracks[robot]
            played = run.team.way(robot).t
            there = (after.t >= played[0]) & (after.t <= played[-1])
            was = se2.compose(T, se2.interpolate(after.t[there], before.t, before.pose))
            ways.append(np.square(was[:, :2] - after.pose[there, :2]).sum(axis=1))
    ways_moved = float(np.sqrt(np.concatenate(ways).mean())) if ways else None
    return replace(
        run, closing=seconds, landmarks_moved=float(np.sqrt(np.square(off).sum(axis=1).mean())), ways_moved=ways_moved
    )


@config
class CameraTeamConfig:
    """Settings of `map` for robots with cameras: each field is the table of that name in the configuration file."""

    POSITIVE: ClassVar[tuple[str, ...]] = (  # numbers that divide
        *("ekf.far", "ekf.speed_scale", "ekf.turn_scale", "ekf.bearing", "placing.bearing"),
        *("smoothing.camera.bearing", "smoothing.camera.robot_bearing", "smoothing.longest_step"),
        *(f"smoothing.calibration.{name}" for name in ("speed_scale", "turn_scale", "range_scale")),
    )
    agreement: AgreementConfig = field(default_factory=AgreementConfig)
    ekf: EkfSlamConfig = field(default_factory=EkfSlamConfig)
    fuse: FuseConfig = field(default_factory=FuseConfig)
    placing: PlacingConfig = field(default_factory=PlacingConfig)
    smoothing: SmoothingConfig = field(default_factory=SmoothingConfig)


@config
class LandmarkMapConfig(CameraTeamConfig):
    """Settings of `map` for landmark logs."""

    online: OnlineConfig = field(default_factory=OnlineConfig)


def applies(log: Path) -> bool:
    """Folders and zip files with `Barcodes.dat`, `RobotN_*.dat` or CSV sightings."""
    return is_landmark_log(log)


def map_logs(logs: Sequence[Path], options: MapOptions) -> TeamResult:
    """One map of all robots in `logs`."""
    cfg = _configured(options)
    watch = Watch()
    options.on_progress("reading", 0, 1)
    read = _read(logs, options)
    options.on_progress("reading", 1, 1)
    return _map_read(read, cfg, options, f"One map from {', '.join(p.name for p in logs)}", watch)


def map_tables(
    odometry: Columns | None, sightings: Columns, options: MapOptions, cfg: LandmarkMapConfig | None = None
) -> TeamResult:
    """One map of all robots in two tables with the columns of `odometry.csv` and `sightings.csv`."""
    cfg = cfg or _configured(options)
    watch = Watch()
    wanted = None if options.robots is None else [_number(key) for key in options.robots]
    read = list(landmark_logs_of(odometry, sightings, wanted))
    return _map_read(read, cfg, options, "One map from tables in memory", watch)


def map_landmark_logs(logs: Sequence[LandmarkLog], options: MapOptions, title: str) -> TeamResult:
    """One map of logs in memory, as those who read them from files get it."""
    return _map_read(logs, _configured(options), options, title, Watch())


def _configured(options: MapOptions) -> LandmarkMapConfig:
    if options.method not in (None, *LANDMARK_METHODS):
        raise UsageError(f"--method: landmark logs know {', '.join(LANDMARK_METHODS)}, found {options.method!r}")
    return load(LandmarkMapConfig, options.config, {"fuse": {"weights": options.weights}})


def _map_read(
    logs: Sequence[LandmarkLog], cfg: LandmarkMapConfig, options: MapOptions, title: str, watch: Watch
) -> TeamResult:
    once = with_copies_marked(_shared(list(logs), options))
    on_time = [on_camera_clock(log) for log in once]
    read = [sifted(without_impossible(with_wheels_checked(log, cfg.ekf, cfg.agreement)), cfg.ekf) for log in on_time]
    watch.lap("read")
    fused, looked = (None if s is None else times_of(read, s) for s in _every(cfg, options))
    times = sorted({*(fused or ()), *(looked or ())})
    grown = _local_maps(read, cfg, times, options)
    mirrored = mirror_images([g.whole for g in grown])
    if mirrored:
        read = [unmirrored(log) if log.robot in mirrored else log for log in read]
        again = iter(_local_maps([log for log in read if log.robot in mirrored], cfg, times, options))
        grown = [next(again) if log.robot in mirrored else g for log, g in zip(read, grown, strict=True)]
    builders, placing, local = _Builders(cfg), cfg.placing, [g.whole for g in grown]
    cut = cut_kidnapped(read, local, builders.join(local), cfg.smoothing, placing, builders.mapper, builders.join)
    watch.lap("estimate")
    local, fusion = list(cut.local), cut.fusion
    online: tuple[OnlineMap, ...] = ()
    if times:
        anew = [
            g if main is log else _grown(main, cfg.ekf, times, _with_tracks(cfg, options))
            for g, log, main in zip(grown, read, cut.main, strict=True)
        ]
        grown = [replace(g, whole=m) for g, m in zip(anew, local, strict=True)]
    if fused is not None:
        fusion, online = fuse_online(cut.main, [g.at(fused) for g in grown], cfg.fuse, fused, options.on_progress)
    starts = {robot_name(key): pose for key, pose in options.start.items()}
    fusion = tie_by_starts(fusion, starts, START_TOLERANCE)
    maps, stretches, stretch_findings = with_stretches(team_maps(local, fusion), cut, cfg.smoothing, placing)
    rooms: tuple[Finding, ...] = ()
    if any(log.odometry is None for log in cut.main):
        first, rooms = with_further_rooms(maps[0], local, cut.main, placing, builders.mapper, builders.join, team_maps)
        maps = (first, *maps[1:])
    scales = () if options.calibration or options.survey else _scales_apart(read, local, maps)
    fusion = replace(fusion, findings=(*fusion.findings, *stretch_findings, *rooms, *_wrong_clocks(read), *scales))
    watch.lap("fuse")
    run = None
    known = known_calibration(read, options)
    if looked is not None:
        at = [g.at(looked) for g in grown]
        run = smooth_online(cut.main, at, cfg.fuse, cfg.smoothing, cfg.online, known, looked, options.on_progress)
        watch.lap("online")
    smoothed, run = (
        _smoothed(maps, stretches, fusion, cfg, known, options, run, placing) if options.refine else ((), run)
    )
    fusion = placed_by(fusion, "single sightings", [m.robots for m in maps], [s.map.robots for s in smoothed])
    smoothed, fusion = _laid(smoothed, stretches, fusion, cfg, known, options)
    stamps = {log.robot: log.stamps for log in on_time}
    maps = tuple(at_every_stamp(m, stamps, {}) for m in maps)
    smoothed = tuple(
        replace(s, map=at_every_stamp(s.map, stamps, {r: c.ahead for r, c in s.clocks.items()})) for s in smoothed
    )
    if options.survey is None and not options.start:
        maps = tuple(in_first_frame(m) for m in maps)
        smoothed = tuple(map(seen_from_first, smoothed))
    watch.lap("smooth")
    run = None if run is None else replace(run, team=None)
    result = team_result(title, options.seed, local, fusion, options.truth, online, watch, maps, smoothed, run)
    return replace(result, unused=tuple(unused_by_all((log.source, log.unused) for log in logs)))


def _scales_apart(
    logs: Sequence[LandmarkLog], local: Sequence[LocalMap], maps: Sequence[TeamMap]
) -> tuple[Finding, ...]:
    """Where robots whose cameras tell ranges made maps of scales that are apart; others have theirs from the team."""
    ranging = {log.robot for log in logs if len(log.sightings)}
    return scales_apart([m for m in local if m.robot in ranging], [m.robots for m in maps])


def _wrong_clocks(logs: Sequence[LandmarkLog]) -> list[Finding]:
    return [
        Finding("clock-apart", robot, value=gap, action="what they saw of each other is not used")
        for robot, gap in of_another_time(logs).items()
    ]


def _every(cfg: LandmarkMapConfig, options: MapOptions) -> tuple[float | None, float | None]:
    """How often maps are fused for the growth, and how often for smoothing online [s]."""
    return options.fuse_every, cfg.online.fuse_every if options.online else None


def known_calibration(logs: Sequence[LandmarkLog], options: MapOptions) -> dict[str, dict[str, tuple[float, float]]]:
    """What `--calibration` says of the robots of `logs`; raises UsageError where it names another.

    A team's calibration serves some of its robots as well: with `--robots` the others are passed over.
    """
    known = {} if options.calibration is None else read_calibration(options.calibration)
    names = {log.robot for log in logs}
    if options.robots is not None:
        known = {robot: values for robot, values in known.items() if robot in names}
    for robot in known:
        if robot not in names:
            there = ", ".join(sorted(map(robot_key, names), key=in_order))
            raise UsageError(f"--calibration {options.calibration}: no robot {robot_key(robot)}; there are {there}")
    return known


@dataclass(frozen=True, slots=True)
class _Builders:
    """How local maps are made, and fused, where logs are looked at again."""

    cfg: LandmarkMapConfig

    def mapper(self, log: LandmarkLog) -> LocalMap:
        return _grown(log, self.cfg.ekf, (), False).whole

    def join(self, maps: Sequence[LocalMap]) -> Fusion:
        return fuse(maps, self.cfg.fuse, {m.robot: m.source for m in maps})


@dataclass(slots=True)
class _Steps:
    """Tells of each step of the solver: how many there will be nobody knows, so each is a share of what is left."""

    on_progress: Progress
    component: int
    of: int
    left: float = 1.0

    def __call__(self) -> None:
        self.left *= 1.0 - STEP
        self.on_progress("smoothing", self.component + 1.0 - self.left, self.of)


def _smoothed(
    maps: Sequence[TeamMap],
    logs: Sequence[LandmarkLog],
    fusion: Fusion,
    settings: LandmarkMapConfig,
    known: Mapping[str, Mapping[str, tuple[float, float]]],
    options: MapOptions,
    run: OnlineRun | None,
    placing: PlacingConfig,
) -> tuple[tuple[Smoothed, ...], OnlineRun | None]:
    """Every component, smoothed as a whole; the largest from where `run`, if there was one, had it."""
    out, cfg = [], settings.smoothing
    maps, back = regained(maps, logs, fusion.labels, cfg, placing)
    places = None if options.survey is None else PlacePriors.of({}, {}, read_points(options.survey), ())
    if places is not None:
        maps = tuple(framed(team, places) for team in maps)
    for k, team in enumerate(maps):
        options.on_progress("smoothing", k, len(maps))
        carried = any(log.cuts for log in logs if log.robot in team.robots)
        far = SMOOTHING_SOFTEN if carried or (back and k == 0) else ()
        start = team if run is None or k else closing_start(run, team, ONLINE_FAR)
        began = perf_counter()
        start = start if places is None else framed(start, places)
        told = _Steps(options.on_progress, k, len(maps))
        done = smooth_on_one_clock(start, logs, fusion.labels, cfg, known, far, places, told)
        if done.refused and start is not team:
            done = smooth_on_one_clock(team, logs, fusion.labels, cfg, known, far, places, told)
        notes = (
            *done.notes,
            *(back if k == 0 else ()),
            *(() if places is None else places.contradicted(done.map)),
        )
        if run is not None and k == 0:
            run = closed(run, start, done, perf_counter() - began)
        out.append(replace(done, notes=notes))
    options.on_progress("smoothing", len(maps), len(maps))
    return tuple(out), run


def _laid(
    smoothed: Sequence[Smoothed],
    logs: Sequence[LandmarkLog],
    fusion: Fusion,
    cfg: LandmarkMapConfig,
    known: Mapping[str, Mapping[str, tuple[float, float]]],
    options: MapOptions,
) -> tuple[tuple[Smoothed, ...], Fusion]:
    """The components where fixes lay them, and the fusion with what is to be said of that."""
    given = options.survey is not None or bool(options.start)
    if given or not options.refine:
        told = unused_fixes(logs, FRAME_GIVEN if given else NOT_SMOOTHED)
        return tuple(smoothed), replace(fusion, findings=(*fusion.findings, *told))
    ahead = {robot: clock.ahead for s in smoothed for robot, clock in s.clocks.items()}
    on_time = [with_earlier_stamps(log, ahead.get(log.robot, 0.0)) for log in logs]
    laid = laid_team(smoothed, on_time, fusion.labels, cfg.smoothing, known)
    after = placed_by(fusion, "fixes", [s.map.robots for s in smoothed], [s.map.robots for s in laid.components])
    return laid.components, replace(after, findings=(*after.findings, *laid.findings))


def _read(logs: Sequence[Path], options: MapOptions) -> list[LandmarkLog]:
    """All logs, in the order of their robots' numbers."""
    wanted = None if options.robots is None else [_number(key) for key in options.robots]
    if len(logs) == 1:
        return list(read_landmark_logs(logs[0], wanted, fixes=options.laser.fixes))
    read: dict[str, LandmarkLog] = {}
    for place, path in enumerate(logs, 1):
        for log in read_landmark_logs(path, place=place, fixes=options.laser.fixes):
            if log.robot in read:
                raise DataError(f"{path}: {log.robot} is in {read[log.robot].source} too: two data sets are mixed")
            read[log.robot] = log
    names = sorted(read, key=in_order) if wanted is None else [f"robot{k}" for k in wanted]
    for name in names:
        if name not in read:
            raise DataError(f"{logs[0]}: no {name}; there are {', '.join(sorted(read, key=in_order))}")
    return [read[name] for name in names]


def _shared(logs: list[LandmarkLog], options: MapOptions) -> list[LandmarkLog]:
    """The logs, those of `--share` cut."""
    names = [log.robot for log in logs]
    for option, given in (("--share", options.share), ("--start", options.start)):
        for key in given:
            if robot_name(key) not in names:
                raise UsageError(f"{option}: no robot {key}; there are {', '.join(map(robot_key, names))}")
    return [log.share(options.share.get(robot_key(log.robot), 1.0)) for log in logs]


def _local_maps(
    logs: Sequence[LandmarkLog], cfg: LandmarkMapConfig, times: Sequence[float], options: MapOptions
) -> list[Growth]:
    """A local map a robot, in the order of `logs`, whoever works on them; and those on the way at `times`."""
    jobs = [(log, cfg.ekf, tuple(times), _with_tracks(cfg, options)) for log in logs]
    with worker_pool(options.jobs, len(jobs), options.executor) as pool:
        return parts(_grown, jobs, pool, "local maps", options.on_progress)


def _with_tracks(cfg: LandmarkMapConfig, options: MapOptions) -> bool:
    """Whether maps on the way are needed with all poses until then."""
    return cfg.fuse.robot_sightings or options.online


def _grown(log: LandmarkLog, cfg: EkfSlamConfig, times: Sequence[float], tracks: bool) -> Growth:  # noqa: FBT001
    return grow(log, cfg, times, tracks=tracks)


def _number(key: str) -> int:
    if not key.isdecimal():
        raise UsageError(f"--robots: expected numbers as 1,2, found {key!r}")
    return int(key)
