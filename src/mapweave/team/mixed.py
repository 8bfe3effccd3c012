"""One problem for a team in which every robot carries something else: laid out in common frames, then smoothed."""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.fixes import Fixes
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..laser.robot_graph import RobotGraph
from ..mapping.config import LaserConfig
from ..mapping.merge import Merge
from .clocks import RobotClock, clock_of
from .config import SMOOTHING_SOFTEN, UNKNOWN_SPEED, UNKNOWN_SPIN, PlacingConfig, SmoothingConfig
from .georeference import FRAME_GIVEN, NOT_SMOOTHED, LaidTeam, laid_team, unused_fixes
from .known import PlacePriors, tied_by_known
from .relation import PLACING_INLIER, MutualSightings, point_seen, residuals
from .relative_frame import (
    CLOCK_FINE_STEP,
    FIXED_WINDOW,
    LOST_SHARE,
    PLACING_BETTER,
    PLACING_CLOCK_ROUNDS,
    PLACING_CLOCK_SURE,
    PLACING_LEAP,
    PLACING_UNSURE,
    REGAINED_SHARE,
    REGAINED_WINDOW,
    Body,
    Labels,
    Layout,
    Tie,
    agreeing_sightings,
    carried_by_wheels,
    lay_out,
    mutual_sightings,
)
from .robot_part import all_seen
from .smooth import Calibration, Smoothed, smooth
from .team_map import TeamMap
from .walls import CommonWalls, Scanned, common_walls, in_line

FEWEST_POSES = 2  # poses that make a trajectory
SHORTEST = 0.2  # [s] over which a speed can be told


class _Seen(NamedTuple):
    """Sightings that tie the robot to one other. by_it: the robot was the observer; ranged: with a distance."""

    t: Float[np.ndarray, " m"]
    agrees: Bool[np.ndarray, " m"]
    by_it: Bool[np.ndarray, " m"]
    ranged: Bool[np.ndarray, " m"]


def fixed_stretches(
    team: TeamMap,
    robots: Sequence[str],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
) -> tuple[TeamMap, tuple[Finding, ...]]:
    """The map with the paths of `robots` cut to the poses that sightings fix, and a finding for each that was cut.

    A pose is fixed where within `cfg.fixed_window` at least `cfg.lost_share` of the sightings agree with it, and those
    come from two others that saw it, or from three others that it saw or that saw it; a distance counts as one more.
    No pose is that lies within `cfg.fixed_window` of a leap. A robot of which less than two poses are fixed is left
    out of the map.
    """
    tracks, gaps, notes = dict(team.tracks), dict(team.left_out), []
    for robot in robots:
        track = team.tracks[robot]
        keep = _fixed(track, _partners(robot, team, logs, labels, cfg)) & ~_near_leaps(track)
        if keep.all():
            continue
        gone = int((~keep).sum())
        if keep.sum() < FEWEST_POSES:
            del tracks[robot]
            why = "too few sightings fix where it was"
            notes.append(Finding("unplaced", robot, value=why, action="it is left out"))
            continue
        cov = None if track.cov is None else track.cov[keep]
        tracks[robot] = Track(track.t[keep], track.pose[keep], cov, track.frame)
        gaps[robot] = _between_kept(track.t, keep)
        why = f"too few sightings fix where it was at {gone} of {len(keep)} poses"
        notes.append(Finding("unplaced", robot, value=why, action="they are left out"))
    names = tuple(name for name in team.robots if name in tracks)
    return replace(team, robots=names, tracks=tracks, left_out=gaps), tuple(notes)


def _between_kept(t: Float[np.ndarray, " n"], keep: Bool[np.ndarray, " n"]) -> tuple[tuple[float, float], ...]:
    """The spans between poses that are kept, one after the other, though poses between them are not."""
    kept = np.flatnonzero(keep)
    return tuple((float(t[a]), float(t[b])) for a, b in pairwise(kept) if b > a + 1)


def _partners(
    robot: str, team: TeamMap, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> list[_Seen]:
    """What ties the robot to every other robot and landmark."""
    own = Body({robot: team.tracks[robot]}, {})
    others = [Body({name: track}, {}) for name, track in team.tracks.items() if name != robot]
    others += [Body({}, {name: at}) for name, at in zip(team.landmarks.ids, team.landmarks.mean, strict=True)]
    sightings = [mutual_sightings(other, own, logs, labels) for other in others]
    return [_seen(z, cfg) for z in sightings if len(z)]


def _seen(z: MutualSightings, cfg: PlacingConfig) -> _Seen:
    miss = np.square(residuals(z, np.zeros(3), cfg)).sum(axis=-1)
    return _Seen(z.t, miss < PLACING_INLIER**2, ~z.forward, np.isfinite(z.range))


def _fixed(track: Track, partners: list[_Seen]) -> Bool[np.ndarray, " n"]:
    n = len(track.t)
    all_of_them, agreeing = np.zeros(n, int), np.zeros(n, int)
    saw_it, seen_by_it, distances = np.zeros(n, int), np.zeros(n, int), np.zeros(n, int)
    for s in partners:
        near = np.abs(track.t[:, None] - s.t[None, :]) <= FIXED_WINDOW
        good = near & s.agrees
        all_of_them += near.sum(axis=1)
        agreeing += good.sum(axis=1)
        forward = (good & ~s.by_it).any(axis=1)
        saw_it += forward
        seen_by_it += (good & s.by_it).any(axis=1) & ~forward
        distances += (good & s.ranged).any(axis=1)
    directions = (saw_it + distances >= 2) | (saw_it + seen_by_it + distances >= 3)
    return np.asarray(directions & (agreeing >= LOST_SHARE * all_of_them))


def _near_leaps(track: Track) -> Bool[np.ndarray, " n"]:
    """Which poses lie within `cfg.fixed_window` of two that the robot cannot have gone between."""
    step, dt = se2.between(track.pose[:-1], track.pose[1:]), np.maximum(np.diff(track.t), SHORTEST)
    fast = np.hypot(step[:, 0], step[:, 1]) > PLACING_LEAP * UNKNOWN_SPEED * dt
    leap = np.flatnonzero(fast | (np.abs(step[:, 2]) > PLACING_LEAP * UNKNOWN_SPIN * dt))
    near = (track.t[:, None] >= track.t[leap] - FIXED_WINDOW) & (track.t[:, None] <= track.t[leap + 1] + FIXED_WINDOW)
    return np.asarray(near.any(axis=1))


LEAST = 3  # sightings that connect two robots


@dataclass(frozen=True, slots=True)
class Path:
    """How two robots are connected: robots from one to the other, and what there is between each and the next.

    sightings: of each other, landmarks: that both saw.
    """

    robots: tuple[str, ...]
    sightings: tuple[int, ...]
    landmarks: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class MixedMap:
    """components: the largest first; layout: how their frames were found; paths: how laser robots are connected.

    clocks: of robots whose logs were found to be ahead of the others; merges: decisions on walls that lasers share;
    placed: what is to be said of fixes.
    """

    components: tuple[Smoothed, ...]
    layout: Layout
    paths: tuple[Path, ...]
    clocks: Mapping[str, RobotClock]
    merges: tuple[Merge, ...] = ()
    placed: tuple[Finding, ...] = ()


def map_mixed(
    logs: Sequence[LandmarkLog],
    scanned: Mapping[str, Scanned],
    mapped: Sequence[TeamMap],
    labels: Labels,
    smoothing: SmoothingConfig,
    placing: PlacingConfig,
    calibration: Mapping[str, Calibration] | None = None,
    own_clocks: Sequence[str] = (),
    *,
    refine: bool = True,
    laser: LaserConfig | None = None,
    known: PlacePriors | None = None,
    fixes: Mapping[str, Fixes] | None = None,
) -> MixedMap:
    """The map of a team from all that its robots saw.

    logs: what each robot drove and saw, one a robot, empty where it did neither; scanned: robots with a laser; mapped:
    what filters made of the robots that saw landmarks with their ranges; own_clocks: robots whose laser logs may have a
    clock of their own; laser: how maps of laser robots are woven by walls that they both saw; None: they are not.
    known: places known beforehand, whose frame becomes the map's; fixes: of laser robots, on the clocks of their scans,
    beside those in `logs`.
    """
    by = {log.robot: log for log in logs}
    lasers = [Body({robot: s.track}, {}, own_clock=robot in own_clocks) for robot, s in scanned.items()]
    held = {*scanned, *(robot for team in mapped if len(team.landmarks) for robot in team.robots)}
    loose = [log for log in logs if log.robot not in held]
    known = known or PlacePriors()
    layout = first_layout(logs, lasers, mapped, labels, smoothing, placing)
    layout = tied_by_known(layout, by, known, smoothing)
    walls = CommonWalls(scanned)
    if laser is not None:
        walls = common_walls(layout, scanned, laser, placing)
        layout = in_line(layout, walls)
        left = [log for log in loose if log.robot in layout.lost]
        if left and len(walls.parts):
            layout = _further(layout, lay_out(layout.bodies, left, by, labels, placing, smoothing))
    spread = {name: _variance(team.landmarks, k) for team in mapped for k, name in enumerate(team.landmarks.ids)}
    components: list[Smoothed] = []
    clocks = {robot: RobotClock(layout.clocks.get(robot, 0.0), CLOCK_FINE_STEP) for robot in layout.clocks}
    for body in layout.bodies:
        whole = body.on_team_time()
        team = _team(_with_more_landmarks(whole, by, labels, placing), spread, by, labels)
        mine = [by[robot] for robot in team.robots if robot in by]
        if not refine:
            components.append(smooth(team, [], labels, smoothing))
            continue
        for _ in range(PLACING_CLOCK_ROUNDS):
            graphs = {
                robot: _on_time(walls.scanned[robot].graph, clocks.get(robot))
                for robot in team.robots
                if robot in scanned
            }
            done = smooth(team, mine, labels, smoothing, calibration, graphs, walls.crossings, SMOOTHING_SOFTEN, known)
            wrong = {} if len(team.robots) < 2 else _late(done.map, own_clocks, by, labels, placing, clocks)
            if not wrong:
                break
            team = _with_clocks(team, wrong)
        components.append(done)
    fixed = [_with_fixes(log, (fixes or {}).get(log.robot), clocks.get(log.robot)) for log in logs]
    driven = [_by_wheels(log, by, smoothing) for log in fixed if log.robot in layout.lost and _drove_fixed(log)]
    if known or not refine:
        laid = LaidTeam(tuple(components), unused_fixes(fixed, FRAME_GIVEN if known else NOT_SMOOTHED))
    else:
        graphs = {robot: _on_time(scan.graph, clocks.get(robot)) for robot, scan in walls.scanned.items()}
        laid = laid_team([*components, *driven], fixed, labels, smoothing, calibration, graphs, walls.crossings)
        as_driven = set(map(id, driven))
        laid = replace(laid, components=tuple(s for s in laid.components if id(s) not in as_driven))
        placed = {r for s in laid.components for r in s.map.robots}
        layout = replace(layout, lost=tuple(r for r in layout.lost if r not in placed))
    made = laid.components if not refine else [_settled(s, held, by, labels, placing, known) for s in laid.components]
    layout = replace(layout, ties=(*layout.ties, *_ties_of_fixes([*components, *driven], laid.components)))
    return MixedMap(tuple(made), layout, _paths(made, walls, by), clocks, walls.merges, laid.findings)


def _with_fixes(log: LandmarkLog, of_laser: Fixes | None, clock: RobotClock | None) -> LandmarkLog:
    """The log with its fixes, else those beside its scans, on the team's clock."""
    if log.fixes is not None or of_laser is None:
        return log
    return replace(log, fixes=replace(of_laser, t=of_laser.t - (0.0 if clock is None else clock.ahead)))


def _drove_fixed(log: LandmarkLog) -> bool:
    """Whether its wheels and its fixes may tell where the robot was, whatever it saw."""
    return log.odometry is not None and log.fixes is not None


def _by_wheels(log: LandmarkLog, logs: Mapping[str, LandmarkLog], smoothing: SmoothingConfig) -> Smoothed:
    """The robot alone, as its wheels carried it."""
    nothing = LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))
    track = carried_by_wheels(log, logs, smoothing)
    return smooth(TeamMap((log.robot,), nothing, {log.robot: track}), [], {}, smoothing)


def _ties_of_fixes(before: Sequence[Smoothed], after: Sequence[Smoothed]) -> list[Tie]:
    """Which components became one."""
    out = []
    for whole in after:
        parts = [s.map.robots for s in before if set(s.map.robots) <= set(whole.map.robots)]
        out += [Tie(tuple(chain(*parts[:k])), parts[k], 0, 0, by="fixes") for k in range(1, len(parts))]
    return out


def _settled(
    done: Smoothed,
    held: Collection[str],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    placing: PlacingConfig,
    known: PlacePriors,
) -> Smoothed:
    """The component with the paths of robots that made no map, and have no wheels, cut to where sightings fix them."""
    loosely = [robot for robot in done.map.tracks if robot not in held and logs[robot].odometry is None]
    cut, notes = fixed_stretches(done.map, loosely, logs, labels, placing)
    where = done.georeference
    if where is not None:
        where = replace(
            where, tracks={r: _at_stamps_of(cut.tracks[r], w) for r, w in where.tracks.items() if r in cut.tracks}
        )
    return replace(done, map=cut, notes=(*done.notes, *notes, *known.contradicted(done.map)), georeference=where)


def _at_stamps_of(kept: Track, track: Track) -> Track:
    """The poses of `track` at the stamps that `kept` has left."""
    rows = np.isin(track.t, kept.t)
    return Track(track.t[rows], track.pose[rows], None if track.cov is None else track.cov[rows], track.frame)


def first_layout(
    logs: Sequence[LandmarkLog],
    lasers: Sequence[Body],
    mapped: Sequence[TeamMap],
    labels: Labels,
    smoothing: SmoothingConfig,
    placing: PlacingConfig,
) -> Layout:
    """What `lasers` and `mapped` made, and robots that made nothing, tied by what they saw of each other alone."""
    bodies = [*(_body(team) for team in mapped if len(team.landmarks)), *lasers]
    held = {robot for body in bodies for robot in body.robots}
    by = {log.robot: log for log in logs}
    return lay_out(bodies, [log for log in logs if log.robot not in held], by, labels, placing, smoothing)


def _further(before: Layout, after: Layout) -> Layout:
    """The later layout with what was told of the one before."""
    return replace(after, ties=(*before.ties, *after.ties), clocks={**before.clocks, **after.clocks})


def regained(
    maps: Sequence[TeamMap],
    logs: Sequence[LandmarkLog],
    labels: Labels,
    smoothing: SmoothingConfig,
    placing: PlacingConfig,
) -> tuple[tuple[TeamMap, ...], tuple[Finding, ...]]:
    """The maps, with robots in the largest whose own maps did not fit it, but whose sightings place them there.

    A filter that believed wrong sightings early is lost for good; its log is not. Where several maps are the largest,
    the one is taken in which most sightings agree. A copy of a placed robot's log places nobody. Also a finding for
    each robot that came back.
    """
    placed = {robot for team in maps for robot in team.robots}
    counted = {log.log_hash for log in logs if log.robot in placed}
    by = {log.robot: log for log in logs if log.robot in placed or log.log_hash not in counted}
    if not maps:
        return (), ()
    cfg = replace(placing, loose_share=REGAINED_SHARE, window=REGAINED_WINDOW)
    largest = [k for k, team in enumerate(maps) if len(team.robots) == len(maps[0].robots) and len(team.landmarks)]
    if not largest:  # nobody knows a landmark: who saw most of the others begins
        seen = [sum(len(all_seen(by[robot])) for robot in team.robots if robot in by) for team in maps]
        largest = [int(np.argmax(seen))]
    tried = [(k, *_with_the_lost(_body(maps[k]), by, labels, smoothing, cfg)) for k in largest]

    def agree(body: Body) -> int:
        return sum(agreeing_sightings(robot, body, by, labels, cfg)[0] for robot in body.robots if robot in by)

    k, body, back = tried[0] if len(tried) == 1 else max(tried, key=lambda option: agree(option[1]))
    if not back:
        return tuple(maps), ()
    spread = {name: _variance(maps[k].landmarks, i) for i, name in enumerate(maps[k].landmarks.ids)}
    rest = [team for j, team in enumerate(maps) if j != k and not set(team.robots) & set(back)]
    notes = tuple(Finding("placed-anew", robot, value={"value": n, "all": of}) for robot, (n, of) in back.items())
    return (_team(_with_more_landmarks(body, by, labels, cfg), spread, by, labels), *rest), notes


def _body(team: TeamMap) -> Body:
    return Body(dict(team.tracks), dict(zip(team.landmarks.ids, team.landmarks.mean, strict=True)))


def _with_the_lost(
    body: Body, logs: Mapping[str, LandmarkLog], labels: Labels, smoothing: SmoothingConfig, cfg: PlacingConfig
) -> tuple[Body, dict[str, tuple[int, int]]]:
    """The body with the robots that it can place, and with better tracks of its own that little agrees with.

    Also how many of the sightings of each agree, and of how many. One that places nobody is left as it is.
    """
    back: dict[str, tuple[int, int]] = {}
    for robot in sorted(body.robots, key=in_order):
        if robot not in logs or logs[robot].odometry is None or len(body.landmarks) < LEAST:
            continue
        agree, of = agreeing_sightings(robot, body, logs, labels, cfg)
        if agree >= LOST_SHARE * of:
            continue
        others = replace(body, tracks={name: track for name, track in body.tracks.items() if name != robot})
        anew = lay_out([others], [logs[robot]], logs, labels, cfg, smoothing).bodies[0]
        if robot in anew.tracks:
            now = agreeing_sightings(robot, replace(anew, anchors={}), logs, labels, cfg)
            if now[0] > PLACING_BETTER * agree:
                body, back[robot] = replace(anew, anchors={}, reach={}), now
    loose = [log for robot, log in logs.items() if robot not in body.tracks and log.odometry is not None]
    layout = lay_out([body], loose, logs, labels, cfg, smoothing)
    back.update({tie.b[0]: (tie.agree, tie.of) for tie in layout.ties})
    return layout.bodies[0], back


def _late(
    team: TeamMap,
    robots: Sequence[str],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
    clocks: dict[str, RobotClock],
) -> dict[str, float]:
    """How far [s] the clocks of `robots` are ahead, where the smoothed paths show it; `clocks` is updated."""
    wrong = {}
    for robot in robots:
        clock = clock_of(robot, team, logs, labels, cfg) if robot in team.tracks else None
        if clock is None:
            continue
        before = clocks.get(robot, RobotClock(0.0, 0.0)).ahead
        if abs(clock.ahead) > PLACING_CLOCK_SURE * clock.sd or (before and abs(clock.ahead) > clock.sd):
            wrong[robot] = clock.ahead
            clocks[robot] = RobotClock(before + clock.ahead, clock.sd)
        elif before:
            clocks[robot] = RobotClock(before, clock.sd)
    return wrong


def _with_clocks(team: TeamMap, ahead: Mapping[str, float]) -> TeamMap:
    """The team with the stamps of those robots moved back that are ahead."""
    tracks = {
        robot: replace(track, t=track.t - ahead[robot]) if robot in ahead else track
        for robot, track in team.tracks.items()
    }
    return replace(team, tracks=tracks)


def _on_time(graph: RobotGraph, clock: RobotClock | None) -> RobotGraph:
    return graph if clock is None else replace(graph, t=graph.t - clock.ahead)


def _variance(landmarks: LandmarkMap, k: int) -> float:
    return float(np.trace(landmarks.cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]) / 2)


def _with_more_landmarks(body: Body, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig) -> Body:
    """With the landmarks that no filter mapped, where bearings (or ranges) from places that are known meet."""
    seen: dict[str, list[MutualSightings]] = {}
    for robot in body.robots:
        table = all_seen(logs[robot])
        here, names = body.believed(robot, table.t) if len(table) else np.zeros(0, bool), labels.get(robot, {})
        for k, own in enumerate(table.ids):
            name = names.get(own, own)
            rows = np.flatnonzero((table.what == k) & here)
            if own in logs or name in body.landmarks or not len(rows):
                continue
            seen.setdefault(name, []).append(
                MutualSightings(
                    np.ones(len(rows), bool),
                    body.pose(robot, table.t[rows]).reshape(-1, 3),
                    np.zeros((len(rows), 2)),
                    table.range[rows],
                    table.bearing[rows],
                    table.t[rows],
                )
            )
    positions = {name: point_seen(MutualSightings.joined(parts), cfg) for name, parts in seen.items()}
    return replace(body, landmarks={**body.landmarks, **{name: p for name, p in positions.items() if p is not None}})


def _team(body: Body, variance: Mapping[str, float], logs: Mapping[str, LandmarkLog], labels: Labels) -> TeamMap:
    ids = tuple(sorted(body.landmarks, key=in_order))
    mean = np.array([body.landmarks[name] for name in ids]).reshape(-1, 2)
    cov = np.diag(np.repeat([variance.get(name, PLACING_UNSURE**2) for name in ids], 2)) if ids else np.zeros((0, 0))
    robots = tuple(sorted(body.robots, key=in_order))
    counts: dict[str, dict[str, int]] = {name: {} for name in ids}
    first: dict[str, float] = {}
    for robot in robots:
        table, names = all_seen(logs[robot]), labels.get(robot, {})
        for own, n in table.counts().items():
            if names.get(own, own) in counts:
                counts[names.get(own, own)][robot] = n
        for own, t in table.first().items():
            name = names.get(own, own)
            if name in counts:
                first[name] = min(t, first.get(name, t))
    return TeamMap(
        robots,
        LandmarkMap(ids, mean, cov),
        {robot: body.tracks[robot] for robot in robots},
        {name: tuple(seen) for name, seen in counts.items()},
        {name: sum(seen.values()) for name, seen in counts.items()},
        first_seen=first,
    )


def _paths(components: Sequence[Smoothed], walls: CommonWalls, logs: Mapping[str, LandmarkLog]) -> tuple[Path, ...]:
    """For every two laser robots of a component that no walls tie, through whose sightings they are connected."""
    out = []
    for component in components:
        robots = component.map.robots
        n = {(a, b): _between(logs[a], b) + _between(logs[b], a) for a in robots for b in robots if a != b}
        seen = {a: {name for name, by in component.map.members.items() if a in by} for a in robots}
        beside = {a: [b for b in robots if a != b and (n[a, b] >= LEAST or len(seen[a] & seen[b]) > 1)] for a in robots}
        lasers = [robot for robot in robots if robot in walls.scanned]
        for i, a in enumerate(lasers):
            for b in lasers[i + 1 :]:
                way = () if walls.together(a, b) else _way(a, b, beside)
                if len(way) > 1:
                    shared = tuple(len(seen[p] & seen[q]) for p, q in pairwise(way))
                    out.append(Path(way, tuple(n[p, q] for p, q in pairwise(way)), shared))
    return tuple(out)


def _between(log: LandmarkLog, other: str) -> int:
    return all_seen(log).counts().get(other, 0)


def _way(a: str, b: str, beside: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """The shortest path from a to b; empty where there is none."""
    before: dict[str, str | None] = {a: None}
    queue = deque([a])
    while queue:
        robot = queue.popleft()
        if robot == b:
            way = [b]
            while (previous := before[way[-1]]) is not None:
                way.append(previous)
            return tuple(reversed(way))
        for other in beside[robot]:
            if other not in before:
                before[other] = robot
                queue.append(other)
    return ()
