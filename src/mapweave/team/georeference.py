"""Teams laid where position fixes say: one more factor a fix in the problem of the whole team, which then lies in a
world, bent by as much as fixes are surer than what was seen, and joined where nothing seen ties it.

Teams of landmarks, mixed teams, and those that ranges place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.fixes import Fixes
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..core.records import Track, frozen
from ..landmarks.landmark_map import LandmarkMap
from ..laser.robot_graph import RobotGraph
from ..mapping.georeference import (
    MOSTLY,
    Sighted,
    contradicted,
    first_guess,
    from_nearest,
    georeference_of,
    sights_of,
    told_of_log,
    told_of_map,
    world_of,
)
from ..mapping.woven_map import Georeference
from ..ranges.estimate import PlacedPart, RangeEstimate, laid_as_fixes_fit, laid_parts
from ..ranges.fixes import FEWEST, Laid, Sights, lay_among, registered
from ..ranges.network import RangeNetwork
from ..solve import Factor
from .config import SMOOTHING_SOFTEN, SmoothingConfig
from .covariance import FLOOR, TeamCovariance, covariance_of_body, covariance_of_shape, weakened
from .factors import InterRobotEdge
from .problem import TeamProblem, team_problem
from .relative_frame import Labels, moved_track
from .robot_part import PARAMETERS, RobotPart
from .smooth import BARE_RANGE_SCALE, Calibration, Smoothed, assumed, calibration_of, dense_track, of_ranges_alone
from .team_map import TeamMap, in_first_frame

FRAME_GIVEN = "--start and --survey say where the map lies"
NOT_SMOOTHED = "maps that are not smoothed (--no-refine) are not laid by them"
JUDGED = 3  # landmarks of one name in two maps, from which fusing them was refused for what they say


@dataclass(frozen=True, slots=True)
class LaidTeam:
    """components: with those joined that fixes tie, the largest first; findings: of robots' fixes."""

    components: tuple[Smoothed, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class _Guess:
    """A component, and where it lies in the world, about: `T_world_map`."""

    smoothed: Smoothed
    T: Float[np.ndarray, "3"]


def unused_fixes(logs: Sequence[LandmarkLog], why: str) -> tuple[Finding, ...]:
    """That nothing is made of the fixes of `logs`, and why."""
    return tuple(Finding("fixes-unused", log.robot, value=why) for log in logs if log.fixes is not None)


def laid_team(
    components: Sequence[Smoothed],
    logs: Sequence[LandmarkLog],
    labels: Labels,
    cfg: SmoothingConfig,
    calibration: Mapping[str, Calibration] | None = None,
    scans: Mapping[str, RobotGraph] | None = None,
    crossings: Sequence[InterRobotEdge] = (),
) -> LaidTeam:
    """The components laid in one world by the fixes in the logs of their robots, those that fixes place as one map.

    All as `smooth` had it, stamps on the clock of the components' tracks. Two maps that share `JUDGED` landmarks or
    more, and were not joined by them, stay two, in one world. Covariances of landmarks and poses are told in the frame
    that the landmarks as a body are, and in the world in `georeference`.
    """
    by = {log.robot: log for log in logs}
    tracks = {r: track for s in components for r, track in s.map.tracks.items() if len(track.t)}
    gaps = {r: spans for s in components for r, spans in s.map.left_out.items()}
    told = {r: f for r in sorted(by, key=in_order) if (f := by[r].fixes) is not None}
    if not told:
        return LaidTeam(tuple(components), ())
    span = {r: (float(tracks[r].t[0]), float(tracks[r].t[-1])) if r in tracks else (0.0, 0.0) for r in told}
    datum, frame, seen = world_of([(r, f, span[r]) for r, f in told.items() if r in tracks])
    findings = [found for r in told if r in tracks for found in told_of_log(r, told[r], span[r], frame, seen)]
    findings += unused_fixes([by[r] for r in told if r not in tracks], "nothing else tells where it was")
    seen = {r: f.select(_driven(f.t, by[r], gaps.get(r, ()))) for r, f in seen.items()}
    seen = {r: f for r, f in seen.items() if len(f) >= FEWEST and (len(by[r]) or r in (scans or {}))}
    guesses, out = [], list[Smoothed]()
    for s in components:
        mine = sorted((r for r in s.map.robots if r in seen), key=in_order)
        T = None
        if mine and s.refused and set(s.used) - {"scan"}:
            findings += unused_fixes([by[r] for r in mine], f"its map could not be smoothed: {s.refused}")
        elif mine:
            p = [se2.act(se2.interpolate(seen[r].t, tracks[r].t, tracks[r].pose), seen[r].antenna) for r in mine]
            T, why = first_guess(mine[0], np.concatenate(p), np.concatenate([seen[r].xy(datum) for r in mine]))
            findings += why
        if T is None:
            out.append(s)
        else:
            guesses.append(_Guess(s, T))
    for group in _groups(guesses):
        laid, why = _laid(group, by, seen, datum, frame, labels, cfg, calibration or {}, scans or {}, crossings)
        out += [g.smoothed for g in group] if laid is None else [laid]
        findings += why
    return LaidTeam(tuple(sorted(out, key=lambda s: -len(s.map.robots))), tuple(findings))


def _driven(
    t: Float[np.ndarray, " k"], log: LandmarkLog, gaps: Sequence[tuple[float, float]]
) -> Bool[np.ndarray, " k"]:
    """At which of t [s] something tells where the robot was: not in `gaps`, nor where it was carried elsewhere."""
    out = np.ones(len(t), bool)
    for begin, end in gaps:
        out &= (t <= begin) | (t >= end)
    if log.cuts:
        spans = [stretch.span for stretch in log.stretches() if len(stretch)]
        out &= np.any([(t >= begin) & (t <= end) for begin, end in spans], axis=0)
    return out


def _groups(guesses: Sequence[_Guess]) -> list[list[_Guess]]:
    """Maps that become one, the largest first: those of which landmarks do not say that they are none."""
    groups: list[list[_Guess]] = []
    for guess in sorted(guesses, key=lambda g: -len(g.smoothed.map.robots)):
        ids = set(guess.smoothed.map.landmarks.ids)
        for group in groups:
            if len(ids & {name for g in group for name in g.smoothed.map.landmarks.ids}) < JUDGED:
                group.append(guess)
                break
        else:
            groups.append([guess])
    return groups


def _in_world(group: Sequence[_Guess]) -> TeamMap:
    """The maps as one, each where it lies in the world, about; a landmark of several where the first has it."""
    ids: list[str] = []
    mean, cov = [np.zeros((0, 2))], [np.zeros((0, 0))]
    for g in group:
        m = g.smoothed.map.landmarks
        new = m.select([name for name in m.ids if name not in ids]).moved(g.T, m.frame)
        ids += new.ids
        mean.append(new.mean)
        cov.append(new.cov)
    maps = [g.smoothed.map for g in group]
    seen_by = {n: {r for m in maps for r in m.members.get(n, ())} for n in ids}
    first = {n: [m.first_seen[n] for m in maps if n in m.first_seen] for n in ids}
    return TeamMap(
        robots=tuple(sorted((r for m in maps for r in m.robots), key=in_order)),
        landmarks=LandmarkMap(tuple(ids), np.concatenate(mean), sla.block_diag(*cov), maps[0].landmarks.frame),
        tracks={r: moved_track(track, g.T) for g in group for r, track in g.smoothed.map.tracks.items()},
        members={n: tuple(sorted(robots, key=in_order)) for n, robots in seen_by.items()},
        sightings={n: sum(m.sightings.get(n, 0) for m in maps) for n in ids},
        left_out={r: spans for m in maps for r, spans in m.left_out.items()},
        first_seen={n: min(t) for n, t in first.items() if t},
    )


def _laid(
    group: Sequence[_Guess],
    logs: Mapping[str, LandmarkLog],
    seen: Mapping[str, Fixes],
    datum: Float[np.ndarray, "3"] | None,
    frame: str,
    labels: Labels,
    cfg: SmoothingConfig,
    calibration: Mapping[str, Calibration],
    scans: Mapping[str, RobotGraph],
    crossings: Sequence[InterRobotEdge],
) -> tuple[Smoothed | None, list[Finding]]:
    """The maps of `group` as one that fixes lay, and what is to be said of it; None where they do not."""
    start = _in_world(group)
    chosen = [logs[r] for r in start.robots if r in logs and len(start.tracks[r].t) and (len(logs[r]) or r in scans)]
    cfg = assumed(chosen, cfg, scans)
    if of_ranges_alone(chosen, scans):
        cfg = replace(cfg, calibration=replace(cfg.calibration, range_scale=BARE_RANGE_SCALE))
    held = {r: graph for r, graph in scans.items() if r in start.tracks}
    made = team_problem(chosen, start.landmarks, start.tracks, labels, calibration, cfg, held, crossings)
    inflation = {r: by for g in group for r, by in g.smoothed.inflation.items()}
    x = _with_calibration(made, group)
    terms = _sized(weakened(made, x, inflation), group)
    sighted = [_sighted(part, seen[part.robot], datum) for part in made.parts if part.robot in seen]
    rows = np.concatenate([s.rows for s in sighted])
    team = replace(made, problem=replace(made.problem, x0=x, terms=terms)).held_at(3 * rows)
    shared = sum(len(g.smoothed.map.landmarks) for g in group) > len(start.landmarks)
    before = [team.softened(width).factors for width in SMOOTHING_SOFTEN] if shared else ()
    n = team.landmark_start // 3
    sights = sights_of([(s, 0) for s in sighted])
    found = lay_among(x, n, team.factors, sights, team.problem.fixed, team.ordered, before)
    if found is None or found.far.mean() > MOSTLY:
        return None, [contradicted(sighted[0].robot, found)]
    return _finished(group, start, team, found, sighted, datum, frame, inflation)


def _with_calibration(made: TeamProblem, group: Sequence[_Guess]) -> Float[np.ndarray, " n"]:
    """Where the problem begins: with the calibrations that were found, as with the poses."""
    x = made.problem.x0.copy()
    known = {r: values for g in group for r, values in g.smoothed.calibration.items()}
    for part in made.parts:
        for name, (value, _) in known.get(part.robot, {}).items():
            x[part.parameters + PARAMETERS.index(name)] = value
    return x


def _sized(terms: Sequence[Factor], group: Sequence[_Guess]) -> list[Factor]:
    """The factors, with the size of a map that ranges alone tell as sure as it is; of several maps it says nothing."""
    m = group[0].smoothed.map.landmarks
    away = (m.mean - m.mean.mean(axis=0)).ravel() if len(m) else np.zeros(0)
    square = float(away @ away)
    if len(group) > 1 or not square:
        return [term for term in terms if term.name != "size"]
    sd = float(np.sqrt(away @ m.cov @ away)) / square
    return [replace(term, sqrt_info=np.array([[1.0 / sd]])) if term.name == "size" else term for term in terms]


def _sighted(part: RobotPart, fixes: Fixes, datum: Float[np.ndarray, "3"] | None) -> Sighted:
    """Each fix from the instant nearest to it in time."""
    k, step = part.instants.from_nearest(fixes.t)
    arm = se2.act(step, np.broadcast_to(fixes.antenna, (len(fixes), 2)))
    return Sighted(part.robot, fixes, part.start // 3 + k, np.asarray(arm), fixes.xy(datum))


def _finished(
    group: Sequence[_Guess],
    start: TeamMap,
    team: TeamProblem,
    found: Laid,
    sighted: Sequence[Sighted],
    datum: Float[np.ndarray, "3"] | None,
    frame: str,
    inflation: Mapping[str, float],
) -> tuple[Smoothed, list[Finding]]:
    x, there = found.solution.x, found.covariances() + FLOOR
    nodes = {p.robot: p.start // 3 + np.arange(len(p.instants.t)) for p in team.parts}
    landmarks, poses = covariance_of_shape(team, found.solution)
    if len(team.landmarks) < 2:  # no body: seen from the first pose, which is the frame
        seen_from = found.relative(int(nodes[team.parts[0].robot][0]))
        turn = found.pose[nodes[team.parts[0].robot][0], 2]
        poses = [se2.turned_covariance(turn, seen_from[at]) + FLOOR for at in nodes.values()]
    world = {p.robot: dense_track(p, x, there[nodes[p.robot]]) for p in team.parts}
    ours = {p.robot: dense_track(p, x, P) for p, P in zip(team.parts, poses, strict=True)}
    mean = x[team.landmark_columns].reshape(-1, 2)
    laid = replace(
        start,
        landmarks=LandmarkMap(team.landmarks, mean, landmarks, start.landmarks.frame),
        tracks={**start.tracks, **ours},
    )
    first = there[nodes[team.parts[0].robot][0]]
    frame_cov = (
        covariance_of_body(team, found.solution, team.landmarks, np.zeros(2))
        if len(team.landmarks) > 1
        else _told_at(first, -found.pose[nodes[team.parts[0].robot][0], :2])
    )
    georeference = georeference_of(datum, frame, se2.IDENTITY, frame_cov, sighted, found, world)
    parameters = np.concatenate([part.parameters + np.arange(len(PARAMETERS)) for part in team.parts])
    deviations = np.sqrt(found.solution.blocks(parameters[:, None])[:, 0, 0])
    cov = TeamCovariance(landmarks, tuple(poses), tuple(deviations.reshape(len(team.parts), -1)), ())
    parts = [g.smoothed for g in group]
    sure: dict[str, np.ndarray] = {}
    for s in parts:
        names = [name for name in s.map.landmarks.ids if name in team.landmarks]
        body = mean[[name in names for name in team.landmarks]]
        alone = next((there[nodes[r][0]] for r in s.map.robots if r in nodes), first)
        at = covariance_of_body(team, found.solution, names, body.mean(axis=0)) if len(names) > 1 else alone
        sure |= dict.fromkeys(s.map.robots, at)
    head = min((r for r in laid.robots if len(laid.tracks[r].t)), key=in_order)
    told = told_of_map(georeference, [s.map.robots for s in parts], head, sure)
    used: dict[str, int] = {"fixes": int(georeference.used.sum())}
    for s in parts:
        used = {name: used.get(name, 0) + s.used.get(name, 0) for name in {**s.used, **used}}
    smoothed = Smoothed(
        map=laid,
        calibration=calibration_of(team, found.solution, cov),
        inflation=dict(inflation),
        used=used,
        poses=len(found.pose),
        iterations=sum(s.iterations for s in parts) + found.solution.iterations,
        status=str(found.solution.status),
        prior=parts[0].prior,
        notes=tuple(dict.fromkeys(note for s in parts for note in s.notes)),
        cost=found.solution.cost,
        clocks={r: clock for s in parts for r, clock in s.clocks.items()},
        georeference=georeference,
    )
    return seen_from_first(smoothed), told


def seen_from_first(s: Smoothed) -> Smoothed:
    """The component in the frame of the first pose of its lowest robot, and where that lies in the world."""
    moved, g = in_first_frame(s.map), s.georeference
    if g is None or moved is s.map:
        return replace(s, map=moved)
    at = s.map.tracks[min((r for r, track in s.map.tracks.items() if len(track.t)), key=in_order)].pose[0]
    T = se2.compose(g.T_world_map, at)
    cov = _told_at(g.cov, T[:2] - g.T_world_map[:2])
    return replace(s, map=moved, georeference=replace(g, T_world_map=frozen(T), cov=frozen(cov)))


def _told_at(cov: Float[np.ndarray, "3 3"], d: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3 3"]:
    """The covariance of a body's place and turn, told of its point `d` from where it is told of."""
    J = np.array([[1.0, 0.0, -d[1]], [0.0, 1.0, d[0]], [0.0, 0.0, 1.0]])
    return np.asarray(J @ cov @ J.T)


@dataclass(frozen=True, slots=True)
class LaidRanges:
    """estimate: with the parts that fixes lay as one; georeference: of that part, whose poses are in the world;
    findings: of robots' fixes.
    """

    estimate: RangeEstimate
    georeference: Georeference | None
    findings: tuple[Finding, ...]


def laid_ranges(
    net: RangeNetwork, found: RangeEstimate, odometry: Mapping[str, Track], fixes: Mapping[str, Fixes]
) -> LaidRanges:
    """What ranges place laid in one world by the robots' fixes; those of `net` drove along `odometry`.

    Of ways in which a part may lie that ranges fit alike, those that its fixes fit.
    """
    told = {r: fixes[r] for r in net.robots if r in fixes}
    if len(net.priors.node):
        return LaidRanges(found, None, tuple(Finding("fixes-unused", r, value=FRAME_GIVEN) for r in told))
    span = {r: (float(odometry[r].t[0]), float(odometry[r].t[-1])) for r in told}
    datum, frame, seen = world_of([(r, f, span[r]) for r, f in told.items()])
    findings = [finding for r, f in told.items() for finding in told_of_log(r, f, span[r], frame, seen)]
    sighted = {r: _on_nodes(net, r, odometry[r], f, datum) for r, f in seen.items()}
    parts, poses, others, used = list[PlacedPart](), list[np.ndarray](), list[tuple[int, np.ndarray]](), list[Sighted]()
    for part in found.parts:
        mine = [sighted[r] for r in _robots(net, part) if r in sighted]
        if not mine:
            continue
        sights = sights_of([(s, 0) for s in mine])
        there = [
            np.asarray(se2.compose(registered(_seen(net, part, way, sights), sights.z)[0], way))
            for way in (part.pose, *part.mirrored)
        ]
        fit = there if len(there) == 1 else laid_as_fixes_fit(net, found, part, there, sights) or there[:1]
        T, vague = first_guess(mine[0].robot, _seen(net, part, fit[0], sights), sights.z)
        findings += vague
        if T is not None:
            others += [(len(parts), way) for way in fit[1:]]
            parts.append(part)
            poses.append(fit[0])
            used += mine
    if not parts:
        return LaidRanges(found, None, tuple(findings))
    laid = laid_parts(net, found, parts, poses, sights_of([(s, 0) for s in used]), others)
    if laid is None or laid.laid.far.mean() > MOSTLY:
        why = contradicted(used[0].robot, None if laid is None else laid.laid)
        return LaidRanges(found, None, (*findings, why))
    every, whole, how, _ = laid
    georeference, sure = _world_of_ranges(net, whole, how, used, datum, frame)
    told_of = told_of_map(georeference, [_robots(net, part) for part in parts], _robots(net, whole)[0], sure)
    return LaidRanges(every, georeference, (*findings, *told_of))


def _robots(net: RangeNetwork, part: PlacedPart) -> list[str]:
    """In their order."""
    return [net.robots[k] for k in np.unique(net.owner[part.nodes]).tolist() if k < len(net.robots)]


def _on_nodes(
    net: RangeNetwork, robot: str, track: Track, fixes: Fixes, datum: Float[np.ndarray, "3"] | None
) -> Sighted:
    """Each fix from the robot's node nearest to it in time."""
    nodes = np.flatnonzero(net.owner == net.robots.index(robot))
    k, way = from_nearest(net.t[nodes], track, fixes.t)
    arm = se2.act(way, np.broadcast_to(fixes.antenna, (len(fixes), 2)))
    return Sighted(robot, fixes, nodes[k], np.asarray(arm), fixes.xy(datum))


def _seen(
    net: RangeNetwork, part: PlacedPart, pose: Float[np.ndarray, "m 3"], sights: Sights
) -> Float[np.ndarray, "k 2"]:
    """Where the antennas are when the nodes of `part` stand at `pose`."""
    every = np.full((len(net.owner), 3), np.nan)
    every[part.nodes] = pose
    return sights.at(every)


def _world_of_ranges(
    net: RangeNetwork,
    part: PlacedPart,
    laid: Laid,
    sighted: Sequence[Sighted],
    datum: Float[np.ndarray, "3"] | None,
    frame: str,
) -> tuple[Georeference, dict[str, Float[np.ndarray, "3 3"]]]:
    """Where the part lies, seen from its lowest robot's first pose, and how sure each robot's first pose is there."""
    pose, cov = np.full((len(net.owner), 3), np.nan), np.full((len(net.owner), 3, 3), np.nan)
    pose[part.nodes], cov[part.nodes] = part.pose, laid.covariances() + FLOOR
    robots = _robots(net, part)
    tracks = {r: net.track(net.robots.index(r), pose, cov, "world") for r in robots}
    assert part.frame_cov is not None  # noqa: S101  (a part that fixes lay has one)
    T = tracks[robots[0]].pose[0]
    g = georeference_of(datum, frame, T, _told_at(part.frame_cov, T[:2]), sighted, laid, tracks)
    return g, {r: cov[part.nodes[np.argmax(net.owner[part.nodes] == net.robots.index(r))]] for r in robots}
