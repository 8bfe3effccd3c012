"""Laser maps laid where position fixes say: bent by as much as fixes are surer, joined where nothing seen ties them.

Every fix is one more factor on a keyframe of the pose graph. The map's own edges are those of its keyframes as the last
pass left them, so that a map bends where fixes pull, and nowhere else.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.findings import Finding
from ..core.fixes import Fixes, datum_of
from ..core.names import robot_name
from ..core.records import Track, frozen
from ..laser.laser_map import LaserMap
from ..laser.pose_graph import PoseGraph
from ..laser.robot_graph import RobotGraph
from ..ranges.fixes import FEWEST, SURE_TURN, Laid, Sights, lay, mirrored, registered, turn_sd
from ..ranges.network import Motions
from .merge_search import Start
from .woven_map import ClosureRow, Georeference, WovenMap, joint_grid, placed_track

FARTHEST = 50_000.0  # [m] from the datum: beyond, a plane is no map, and fixes are of another place
MOSTLY = 0.5  # share of wrong fixes from which nothing is believed
SILENT = 60.0  # [s] without a fix, from which it is told
EXPLAINED = 0.8  # of how far fixes lie from their middle: what a way must leave less of
WORSE = 2.0  # times what fixes say of their noise, from which it is told
START_XY, START_TURN = 0.5, 0.03  # [m], [rad] sd of a start that fixes tell, beside their own


class Sighted(NamedTuple):
    """One robot's fixes on its keyframes. rows: which keyframe each hangs on; arm: of the antenna from there."""

    robot: str
    fixes: Fixes
    rows: Int[np.ndarray, " k"]
    arm: Float[np.ndarray, "k 2"]
    z: Float[np.ndarray, "k 2"]


@dataclass(frozen=True, slots=True)
class FixedMaps:
    """components: with those joined that fixes tie; findings: of robots' fixes."""

    components: tuple[WovenMap, ...]
    findings: tuple[Finding, ...]


_Guess = tuple[WovenMap, np.ndarray, list[Sighted]]  # a component, (3,) where it lies in the world, its fixes


def starts_of(maps: Sequence[LaserMap]) -> dict[int, Start]:
    """Where robots start in the frame of the first, by place among them, as their fixes say; none without the first's.

    Only what both robots' fixes tell clearly: it is where a search for common places begins.
    """
    _, frame, seen = _world(maps)
    alone = {
        k: one
        for k, m in enumerate(maps)
        if m.robot in seen and seen[m.robot].fixes.frame == frame and (one := _alone(m, seen[m.robot])) is not None
    }
    if 0 not in alone:
        return {}
    out = {}
    for k, laid in alone.items():
        if k:
            A, B = se2.between_jacobians(alone[0].pose[0], laid.pose[0])
            P = A @ alone[0].covariances()[0] @ A.T + B @ laid.covariances()[0] @ B.T
            sd = np.hypot(np.sqrt(np.diag(P)), [START_XY, START_XY, START_TURN])
            out[k] = Start(np.asarray(se2.between(alone[0].pose[0], laid.pose[0])), sd)
    return out


def georeferenced(
    components: Sequence[WovenMap], maps: Sequence[LaserMap], resolution: float, unsure: float
) -> FixedMaps:
    """The components laid in one world by the fixes of their robots, those that fixes place as one map.

    unsure: covariances of the maps' own edges are told so many times as great.
    """
    by_robot = {m.robot: m for m in maps}
    datum, frame, seen = _world(maps)
    findings = [f for m in maps if m.fixes is not None for f in told_of_log(m.robot, m.fixes, _span(m), frame, seen)]
    laid: list[_Guess] = []
    left: list[WovenMap] = []
    for woven in components:
        mine = [seen[r] for r in woven.robots if r in seen]
        T, why = _first_guess(woven, mine) if mine else (None, [])
        findings += why
        if T is None:
            left.append(woven)
        else:
            laid.append((woven, T, mine))
    made, told = _laid_together(laid, datum, frame, by_robot, resolution, unsure)
    if not made:
        return FixedMaps(tuple(components), (*findings, *told))
    home = {r: w for w in (*made, *left) for r in w.robots}
    order = sorted({id(w): w for w in home.values()}.values(), key=lambda w: -len(w.robots))
    return FixedMaps(tuple(order), (*findings, *told))


def world_of(
    held: Sequence[tuple[str, Fixes | None, tuple[float, float]]],
) -> tuple[Float[np.ndarray, "3"] | None, str, dict[str, Fixes]]:
    """The datum and the frame of the first robot with fixes, and each robot's fixes in it that can be of one map.

    held: of each robot its name, its fixes and when [s] it drove, from and to.
    """
    some = [fixes for _, fixes, _ in held if fixes is not None and len(fixes)]
    if not some:
        return None, "", {}
    datum, frame = datum_of(some[:1]), some[0].frame
    seen = {}
    for robot, fixes, span in held:
        if fixes is None or fixes.frame != frame:
            continue
        inside = fixes.within(*span)
        if len(inside) >= FEWEST and np.hypot(*np.median(inside.xy(datum), axis=0)) < FARTHEST:
            seen[robot] = inside
    return datum, frame, seen


def _span(m: LaserMap) -> tuple[float, float]:
    return float(m.track.t[0]), float(m.track.t[-1])


def _world(maps: Sequence[LaserMap]) -> tuple[Float[np.ndarray, "3"] | None, str, dict[str, Sighted]]:
    """`world_of` the maps, each fix on its keyframe."""
    woven = {m.robot: m for m in maps if m.graph is not None}
    datum, frame, seen = world_of([(robot, m.fixes, _span(m)) for robot, m in woven.items()])
    return datum, frame, {robot: _sighted(woven[robot], fixes, datum) for robot, fixes in seen.items()}


def _sighted(m: LaserMap, fixes: Fixes, datum: Float[np.ndarray, "3"] | None) -> Sighted:
    """Each fix from the keyframe nearest to it in time, or that such a pose hangs on."""
    graph = _graph(m)
    t = np.concatenate([graph.t, graph.revisits.t])
    order = np.argsort(t, kind="stable")
    host = np.concatenate([np.arange(len(graph)), graph.revisits.at])[order]
    step = np.concatenate([np.zeros((len(graph), 3)), graph.revisits.step])[order]
    nearest, way = from_nearest(t[order], m.track, fixes.t)
    arm = se2.act(se2.compose(step[nearest], way), np.broadcast_to(fixes.antenna, (len(fixes), 2)))
    return Sighted(m.robot, fixes, host[nearest], np.asarray(arm), fixes.xy(datum))


def from_nearest(
    t: Float[np.ndarray, " n"], track: Track, at: Float[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Which of t [s], ascending, each of `at` [s] is nearest to, and the motion from there along `track`."""
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1) if len(t) > 1 else np.zeros(len(at), np.int64)
    nearest = np.where(np.abs(t[after - 1] - at) < np.abs(t[after] - at), after - 1, after)
    there, here = (se2.interpolate(when, track.t, track.pose) for when in (t[nearest], at))
    return nearest, np.asarray(se2.between(there, here))


def _alone(m: LaserMap, sighted: Sighted) -> Laid | None:
    """One robot's own map in the world."""
    graph = _graph(m)
    p = se2.act(graph.pose[sighted.rows], sighted.arm)
    if _vague(p, sighted.z) is not None:
        return None
    pose = se2.compose(registered(p, sighted.z)[0], graph.pose)
    laid = lay(pose, _motions(graph.graph(), graph.pose, 0, 1.0), sights_of([(sighted, 0)]))
    return None if laid is None or laid.far.mean() > MOSTLY else laid


def _vague(p: Float[np.ndarray, "k 2"], z: Float[np.ndarray, "k 2"]) -> float | None:
    """[rad] to which fixes tell the heading, where that is too little; all of it where they are not of this way."""
    off = float(np.median(np.hypot(*(se2.act(registered(p, z)[0], p) - z).T)))
    if off > EXPLAINED * float(np.median(np.hypot(*(z - np.median(z, axis=0)).T))):
        return np.pi
    turn = turn_sd(p, off)
    return turn if turn > SURE_TURN else None


def _first_guess(woven: WovenMap, seen: Sequence[Sighted]) -> tuple[Float[np.ndarray, "3"] | None, list[Finding]]:
    p = np.concatenate([_points(woven, s) for s in seen])
    return first_guess(seen[0].robot, p, np.concatenate([s.z for s in seen]))


def first_guess(
    robot: str, p: Float[np.ndarray, "k 2"], z: Float[np.ndarray, "k 2"]
) -> tuple[Float[np.ndarray, "3"] | None, list[Finding]]:
    """Where a map lies in the world, about, whose points p were fixed at z; None where that is not told.

    Then with the reason, told of `robot`.
    """
    T, off = registered(p, z)
    if len(p) > 2 * FEWEST and mirrored(p, z):
        return None, [Finding("fixes-mirrored", robot, value=off, action="they are not used")]
    if (turn := _vague(p, z)) is not None:
        return None, [Finding("fixes-vague", robot, value=float(np.degrees(turn)), action="they are not used")]
    return T, []


def _points(woven: WovenMap, s: Sighted) -> Float[np.ndarray, "k 2"]:
    pose = woven.graph.pose[woven.owner == woven.robots.index(s.robot)]
    return np.asarray(se2.act(pose[s.rows], s.arm))


def _motions(graph: PoseGraph, pose: Float[np.ndarray, "n 3"], at: int, unsure: float) -> Motions:
    """The edges of a graph whose nodes begin with number `at`, each as its ends stand at `pose` now."""
    z = se2.between(pose[graph.first], pose[graph.second])
    return Motions(graph.first + at, graph.second + at, z, unsure * np.linalg.inv(graph.information))


def sights_of(seen: Sequence[tuple[Sighted, int]]) -> Sights:
    """Fixes of several robots, whose keyframes begin with these numbers."""
    return Sights(
        np.concatenate([s.rows + at for s, at in seen]),
        np.concatenate([s.arm for s, _ in seen]),
        np.concatenate([s.z for s, _ in seen]),
        np.concatenate([s.fixes.cov for s, _ in seen]),
        np.concatenate([s.fixes.t for s, _ in seen]),
        np.concatenate([np.full(len(s.rows), k) for k, (s, _) in enumerate(seen)]),
    )


def _laid_together(
    laid: Sequence[_Guess],
    datum: Float[np.ndarray, "3"] | None,
    frame: str,
    maps: Mapping[str, LaserMap],
    resolution: float,
    unsure: float,
) -> tuple[list[WovenMap], list[Finding]]:
    """The components as one, in the frame of the lowest robot, and what is to be said of it."""
    if not laid:
        return [], []
    parts = [woven for woven, _, _ in laid]
    first = np.concatenate([[0], np.cumsum([len(w.graph) for w in parts])]).astype(np.int64)
    pose = np.concatenate([se2.compose(T, w.graph.pose) for w, T, _ in laid])
    edges = [_motions(w.graph, w.graph.pose, int(at), unsure) for w, at in zip(parts, first, strict=False)]
    motions = Motions(*(np.concatenate([getattr(e, name) for e in edges]) for name in Motions.__slots__))
    begin = {
        r: int(at) + int(np.argmax(w.owner == i))
        for w, at in zip(parts, first, strict=False)
        for i, r in enumerate(w.robots)
    }
    seen = [s for _, _, mine in laid for s in mine]
    found = lay(pose, motions, sights_of([(s, begin[s.robot]) for s in seen]))
    if found is None or found.far.mean() > MOSTLY:
        return [], [contradicted(seen[0].robot, found)]
    robots = [r for r in maps if r in begin]
    held = [np.arange(begin[r], begin[r] + len(_graph(maps[r]))) for r in robots]
    head = held[0][0]
    local = _graph(maps[robots[0]])
    placed = se2.compose(local.pose[0], se2.between(found.pose[head], found.pose))
    cov = se2.turned_covariance(local.pose[0, 2], found.relative(int(head))) + local.cov[0]
    T_world_map = np.asarray(se2.compose(found.pose[head], se2.inverse(local.pose[0])))
    rows = np.concatenate(held)
    number = np.empty(len(placed), np.int64)
    number[rows] = np.arange(len(rows))
    graphs = [_graph(maps[r]) for r in robots]
    each = [placed[h] for h in held]
    there = found.covariances()
    world = {r: placed_track(maps[r], found.pose[h], there[h]) for r, h in zip(robots, held, strict=True)}
    georeference = georeference_of(datum, frame, T_world_map, there[head], seen, found, world)
    lit = {w.feature for w in parts}
    feature = lit.pop() if len(lit) == 1 else "none"
    joint = PoseGraph(
        placed[rows],
        number[motions.first],
        number[motions.second],
        motions.z,
        unsure * np.linalg.inv(motions.cov),
    )
    woven = WovenMap(
        robots=tuple(robots),
        tracks={r: placed_track(maps[r], each[i], np.asarray(cov[held[i]])) for i, r in enumerate(robots)},
        grid=joint_grid(graphs, each, resolution, lit=feature != "none"),
        feature=feature,
        calibration=next((w.calibration for w in parts if robots[0] in w.robots), None) if feature != "none" else None,
        graph=joint,
        owner=np.repeat(np.arange(len(robots)), [len(g) for g in graphs]),
        t=np.concatenate([g.t for g in graphs]),
        closures=_moved([row for w in parts for row in w.closures], robots, graphs, each),
        georeference=georeference,
    )
    return [woven], _told_of_map(georeference, parts, robots[0], found, begin)


def contradicted(robot: str, found: Laid | None) -> Finding:
    """That fixes and what was seen do not tell of one drive."""
    share = 100.0 if found is None else 100.0 * float(found.far.mean())
    return Finding("fixes-contradict", robot, value=share, action="they are not used")


def georeference_of(
    datum: Float[np.ndarray, "3"] | None,
    frame: str,
    T_world_map: Float[np.ndarray, "3"],
    cov: Float[np.ndarray, "3 3"],
    seen: Sequence[Sighted],
    found: Laid,
    tracks: Mapping[str, Track],
) -> Georeference:
    """Where a map lies that fixes of `seen`, in that order, laid; tracks: in the world."""
    return Georeference(
        datum=datum,
        frame=frame,
        T_world_map=frozen(T_world_map),
        cov=frozen(cov),
        robots=tuple(s.robot for s in seen),
        topics=tuple(s.fixes.topic for s in seen),
        scale=frozen(found.receivers.scale),
        owner=frozen(np.concatenate([np.full(len(s.rows), k) for k, s in enumerate(seen)]), np.int64),
        t=frozen(np.concatenate([s.fixes.t for s in seen])),
        z=frozen(np.concatenate([s.z for s in seen])),
        residual=frozen(found.residual),
        used=frozen(~found.far, np.bool_),
        tracks=tracks,
    )


def _moved(
    rows: Sequence[ClosureRow],
    robots: Sequence[str],
    graphs: Sequence[RobotGraph],
    pose: Sequence[Float[np.ndarray, "_ 3"]],
) -> tuple[ClosureRow, ...]:
    """The closures where their keyframes stand now."""
    number = {r: k for k, r in enumerate(robots)}

    def at(robot: str, t: float) -> Float[np.ndarray, "2"]:
        k = number[robot]
        return np.asarray(pose[k][int(np.argmin(np.abs(graphs[k].t - t))), :2])

    return tuple(
        replace(c, at=np.stack([at(c.robot_a, c.stamp_a), at(c.robot_b, c.stamp_b)]))
        if {c.robot_a, c.robot_b} <= number.keys()
        else c
        for c in rows
    )


def told_of_log(robot: str, fixes: Fixes, span: tuple[float, float], frame: str, used: Container[str]) -> list[Finding]:
    """What is to be said of a robot's fixes before anything is made of them.

    span: when [s] it drove, from and to; frame: of the world; used: robots whose fixes can be of one map.
    """
    out = [Finding("fixes-dropped", robot, value={"n": n, "value": why}) for why, n in fixes.dropped.items()]
    silent = np.flatnonzero(np.diff(fixes.t) > SILENT)
    for k in silent.tolist():
        gap = (float(fixes.t[k]), float(fixes.t[k + 1]))
        out.append(Finding("fixes-silent", robot, gap, gap[1] - gap[0]))
    if robot in used:
        unknown = ~np.isfinite(fixes.cov).all(axis=(1, 2))
        return [*out, *([Finding("fixes-untold", robot, value=int(unknown.sum()))] if unknown.any() else [])]
    if fixes.frame != frame:
        why = f"they are told in {fixes.frame}, those of the first robot in {frame}"
    elif len(fixes.within(*span)) < FEWEST:
        why = f"fewer than {FEWEST} are of the time that it drove"
    else:
        why = f"they lie more than {FARTHEST / 1000:.0f} km from those of the first robot"
    return [*out, Finding("fixes-unused", robot, value=why)]


def _told_of_map(
    found: Georeference,
    parts: Sequence[WovenMap],
    first: str,
    laid: Laid,
    begin: Mapping[str, int],
) -> list[Finding]:
    cov = laid.covariances()
    return told_of_map(found, [w.robots for w in parts], first, {r: cov[k] for r, k in begin.items()})


def told_of_map(
    found: Georeference, parts: Sequence[Sequence[str]], first: str, cov: Mapping[str, Float[np.ndarray, "3 3"]]
) -> list[Finding]:
    """What is to be said of fixes once maps are laid by them.

    parts: the robots of each map that fixes alone tie to the others; first: the robot in whose frame they are one; cov:
    of where each robot's map lies in the world.
    """
    out = []
    for k, robot in enumerate(found.robots):
        mine = found.owner == k
        wrong = mine & ~found.used
        if wrong.any():
            off = float(np.hypot(*found.residual[wrong].T).max())
            values: dict[str, float | str] = {"far": int(wrong.sum()), "n": int(mine.sum()), "value": off}
            out.append(Finding("fixes-rejected", robot, value=values, action="they are left out"))
        if found.scale[k] > WORSE:
            out.append(Finding("fixes-worse", robot, value=float(found.scale[k])))
    for robots in parts:
        if first not in robots:
            P = cov[robots[0]]
            sd = {"value": float(np.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1])), "turn": float(np.degrees(P[2, 2] ** 0.5))}
            out += [Finding("placed-by-fixes", r, value={"other": robot_name(first), **sd}) for r in robots]
    return out


def _graph(m: LaserMap) -> RobotGraph:
    assert m.graph is not None  # noqa: S101  (only the graph method is woven)
    return m.graph
