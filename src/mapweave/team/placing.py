"""A mixed team laid out in common frames: bodies tied by what they saw of each other, surest first; then loose robots.

A loose robot has no map of its own: wheels alone, or nothing. It is placed window by window, in each as far as its
wheels are good, and its track is bent through the places found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order
from ..core.records import Track
from ..laser.scan_odometry import blended
from .commanded_motion import CommandedMotion
from .config import SmoothingConfig
from .relative_frame import (
    Body,
    Labels,
    MutualSightings,
    PlacingConfig,
    Relation,
    is_sure,
    mutual_sightings,
    relate,
    residuals,
    sharpened,
)

LONGER = (2.0, 4.0)  # times as long a robot without wheels may be taken to stand, where it is sighted too rarely


@dataclass(frozen=True, slots=True)
class Tie:
    """Two bodies became one. agree of `of` sightings said so; clock: [s] by which b's was found ahead.

    by: what said so: sightings, walls that both saw, or where they are known to be.
    """

    a: tuple[str, ...]
    b: tuple[str, ...]
    agree: int
    of: int
    clock: float = 0.0
    by: Literal["sightings", "walls", "known"] = "sightings"


@dataclass(frozen=True, slots=True)
class Layout:
    """bodies: what is connected, the largest first, by the team's clock; ties: in the order they were made.

    lost: robots that nothing places; clocks: robot -> [s] its log's clock was found ahead.
    """

    bodies: tuple[Body, ...]
    ties: tuple[Tie, ...]
    lost: tuple[str, ...]
    clocks: Mapping[str, float] = field(default_factory=dict)


def lay_out(
    bodies: Sequence[Body],
    loose: Sequence[LandmarkLog],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
    smoothing: SmoothingConfig,
) -> Layout:
    """Frames and tracks of everybody that can be placed; the same whatever the order of the robots."""
    groups = sorted(bodies, key=_first_robot)
    waiting = sorted(loose, key=lambda log: in_order(log.robot))
    ties: list[Tie] = []
    clocks: dict[str, float] = {}
    while True:
        groups = _merged(groups, logs, labels, cfg, ties, clocks)
        placed = _placed_next(groups, waiting, logs, labels, cfg, smoothing)
        if placed is None:
            break
        k, log, body, agree, of = placed
        ties.append(Tie(groups[k].robots, (log.robot,), agree, of))
        groups[k] = groups[k].on_team_time().joined(body)
        waiting = [other for other in waiting if other.robot != log.robot]
    groups.sort(key=lambda body: (-len(body.robots), _first_robot(body)))
    return Layout(tuple(groups), tuple(ties), tuple(log.robot for log in waiting), clocks)


def _first_robot(body: Body) -> tuple[tuple[tuple[int, int, str], ...], str]:
    return in_order(min(body.robots, key=in_order, default=""))


def agreeing_sightings(
    robot: str, body: Body, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> tuple[int, int]:
    """How many sightings by a robot of the body, and of it, agree with its track there, and of how many."""
    own = Body({robot: body.tracks[robot]}, {})
    rest = replace(body, tracks={name: track for name, track in body.tracks.items() if name != robot})
    z = mutual_sightings(rest, own, logs, labels)
    e = np.square(residuals(z, np.zeros(3), cfg)).sum(axis=-1) if len(z) else np.zeros(0)
    return int((e < cfg.inlier**2).sum()), len(z)


def _merged(
    groups: list[Body],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
    ties: list[Tie],
    clocks: dict[str, float],
) -> list[Body]:
    """The groups after every tie that is sure, the surest first."""
    candidates: dict[tuple[int, int], tuple[Relation, float] | None] = {}
    alive = dict(enumerate(groups))
    while True:
        for i, a in alive.items():
            for j, b in alive.items():
                if i < j and (i, j) not in candidates:
                    candidates[i, j] = _tie(a, b, logs, labels, cfg)
        sure = [(tie[0].spread, pair) for pair, tie in candidates.items() if tie is not None]
        if not sure:
            return list(alive.values())
        i, j = min(sure)[1]
        relation, clock = candidates[i, j]  # type: ignore[misc]
        a, b = alive[i], alive[j]
        if b.own_clock:
            b = replace(b, clock=clock, own_clock=False)
            clocks.update({robot: clock for robot in b.robots if clock})
        elif clock:
            a = replace(a, clock=clock, own_clock=False)
            clocks.update(dict.fromkeys(a.robots, clock))
        ties.append(Tie(a.robots, b.robots, relation.agree, relation.of, clock))
        alive[i] = a.joined(b.moved(relation.transform))
        del alive[j]
        candidates = {pair: tie for pair, tie in candidates.items() if not {i, j} & set(pair)}


def _tie(
    a: Body, b: Body, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> tuple[Relation, float] | None:
    """How b lies in a, and by how much the clock of the one that has its own is ahead; None when that is not sure."""
    shared = [robot for robot in a.robots if robot in b.tracks]
    if shared:
        return _by_same_robot(a.tracks[shared[0]], b.tracks[shared[0]], cfg), 0.0
    swap = a.own_clock and not b.own_clock
    first, second = (b, a) if swap else (a, b)
    seen = mutual_sightings(first, second, logs, labels)
    best, clock = relate(seen, cfg), 0.0
    if second.own_clock:
        best, clock = _with_clock(first, second, logs, labels, cfg, best)
    if best is None or not is_sure(best, cfg):
        return None
    if swap:
        T = se2.inverse(best.transform)
        J = se2.inverse_jacobian(best.transform)
        best = replace(best, transform=T, cov=J @ best.cov @ J.T)
    return best, clock


def _with_clock(
    a: Body, b: Body, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig, plain: Relation | None
) -> tuple[Relation | None, float]:
    """The relation with the offset of b's clock that explains most, where it explains clearly more than none."""
    sharp = sharpened(cfg)

    def at(clock: float) -> Relation | None:
        relation = relate(mutual_sightings(a, replace(b, clock=clock), logs, labels), sharp)
        return None if relation is None or relation.of < 5 * cfg.least else relation

    def worth(relation: Relation | None) -> float:
        return np.inf if relation is None else relation.cost / relation.of

    steps = round(cfg.clock / cfg.clock_step)
    tried = {k * cfg.clock_step: at(k * cfg.clock_step) for k in range(-steps, steps + 1)}
    best = min(tried, key=lambda clock: (worth(tried[clock]), abs(clock)))
    relation, none = tried[best], tried[0.0]
    if relation is None or (none is not None and (worth(none) - worth(relation)) * relation.of < cfg.clock_lead):
        return plain, 0.0
    step = 0.5 * cfg.clock_step
    while step > cfg.clock_still:
        near = {c: at(c) for c in (best - step, best, best + step)}
        best = min(near, key=lambda clock: (worth(near[clock]), abs(clock)))
        step = 0.5 * step
    return relate(mutual_sightings(a, replace(b, clock=best), logs, labels), cfg), float(best)


def _by_same_robot(a: Track, b: Track, cfg: PlacingConfig) -> Relation:
    """How two tracks of one robot lie: the motion that lays most short pieces of one on the other."""
    t = np.arange(max(a.t[0], b.t[0]), min(a.t[-1], b.t[-1]), 1.0)
    if len(t) < 3:
        return Relation(np.zeros(3), np.full((3, 3), np.inf), 0, 0, np.inf)
    p, q = se2.interpolate(t, a.t, a.pose), se2.interpolate(t, b.t, b.pose)
    T = se2.align(q[:, :2], p[:, :2])
    for _ in range(5):
        e = np.linalg.norm(se2.act(T, q[:, :2]) - p[:, :2], axis=1)
        T = se2.align(q[:, :2], p[:, :2], 1.0 / (1.0 + np.square(e / max(float(np.median(e)), 0.02))))
    return Relation(T, np.diag([cfg.same_xy**2, cfg.same_xy**2, cfg.same_theta**2]), len(t), len(t), 0.0)


def _placed_next(
    groups: Sequence[Body],
    waiting: Sequence[LandmarkLog],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
    smoothing: SmoothingConfig,
) -> tuple[int, LandmarkLog, Body, int, int] | None:
    """The loose robot that most windows place, in which group, and its track there."""
    best: tuple[int, int, LandmarkLog, Body, int, int] | None = None
    for log in waiting:
        wheel_track = carried_by_wheels(log, logs, smoothing)
        if not len(wheel_track.t):
            continue
        for k, group in enumerate(groups):
            placed = _windows(group, log, wheel_track, logs, labels, cfg)
            for longer in LONGER if placed is None and log.odometry is None else ():
                still = replace(cfg, window_still=longer * cfg.window_still)
                placed = placed or _windows(group, log, wheel_track, logs, labels, still)
            if placed is not None and (best is None or len(placed[0].anchors[log.robot]) > best[0]):
                best = (len(placed[0].anchors[log.robot]), k, log, *placed)
    return None if best is None else best[1:]


def carried_by_wheels(log: LandmarkLog, logs: Mapping[str, LandmarkLog], smoothing: SmoothingConfig) -> Track:
    """Where wheels say the robot went, at every stamp that matters; without wheels it stands at the origin."""
    seen = [
        table.t[table.what == table.ids.index(log.robot)]
        for other in logs.values()
        for table in (other.sightings, other.bearings)
        if log.robot in table.ids
    ]
    stamps = [log.sightings.t, log.bearings.t, *seen]
    if log.odometry is None:
        t = np.unique(np.concatenate(stamps))
        return Track(t, np.zeros((len(t), 3)))
    t = np.unique(np.concatenate([log.odometry.t, *stamps]))
    motion, known = CommandedMotion.of(log.odometry, smoothing.motion.hold), smoothing.calibration
    return Track(t, motion.at(t, known.speed_scale, known.turn_scale, known.lag)[0])


@dataclass(frozen=True, slots=True)
class Windows:
    """A loose robot placed window by window. t: (k,) [s]; place: (k, 3) in the group's frame; seen: all there was."""

    t: Float[np.ndarray, " k"]
    place: Float[np.ndarray, "k 3"]
    agree: int
    seen: MutualSightings
    length: float


def placed_windows(
    group: Body,
    log: LandmarkLog,
    wheel_track: Track,
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
) -> Windows:
    """Where sightings place the robot in the group, each window on its own; those that are not sure are left out."""
    seen = mutual_sightings(group, Body({log.robot: wheel_track}, {}), logs, labels)
    seen = seen.select(np.argsort(seen.t, kind="stable"))
    length = cfg.window_still if log.odometry is None else cfg.window
    number = ((seen.t - seen.t[:1]) // length).astype(int)
    at, place, agree = [], [], 0
    for k in np.unique(number).tolist():
        part = seen.select(number == k)
        relation = relate(part, cfg)
        if relation is None or not is_sure(relation, cfg):
            continue
        middle = float(np.median(part.t))
        there = se2.interpolate(np.array([middle]), wheel_track.t, wheel_track.pose)[0]
        at.append(middle)
        place.append(se2.compose(relation.transform, there))
        agree += relation.agree
    return Windows(np.array(at), np.array(place).reshape(-1, 3), agree, seen, length)


def _windows(
    group: Body,
    log: LandmarkLog,
    wheel_track: Track,
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
) -> tuple[Body, int, int] | None:
    """The robot's track in the group's frame, bent through every window that places it; how many sightings agree."""
    robot, driven = log.robot, log.odometry is not None
    windows = placed_windows(group, log, wheel_track, logs, labels, cfg)
    if len(windows.seen) < cfg.least or not len(windows.t) or windows.agree < cfg.loose_share * len(windows.seen):
        return None
    times, anchors = _agreeing(windows.t, windows.place, wheel_track, cfg, driven=driven)
    if not len(times):
        return None
    t = np.unique(np.concatenate([wheel_track.t, times]))
    base = se2.interpolate(t, wheel_track.t, wheel_track.pose)
    rows = np.searchsorted(t, times)
    pose = blended(base, rows, anchors) if driven else se2.interpolate(t, times, anchors)
    body = Body({robot: Track(t, pose)}, {}, {robot: times}, {robot: cfg.window_reach * windows.length})
    return body, windows.agree, len(windows.seen)


def placed_alone(
    group: Body,
    log: LandmarkLog,
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
    smoothing: SmoothingConfig,
) -> Track | None:
    """The trajectory of `log`'s robot, not in the group, where its sightings place it there; None where they do not."""
    wheel_track = carried_by_wheels(log, logs, smoothing)
    inside = (wheel_track.t >= log.span[0]) & (wheel_track.t <= log.span[1])
    wheel_track = Track(wheel_track.t[inside], wheel_track.pose[inside])
    placed = _windows(group, log, wheel_track, logs, labels, cfg)
    return None if placed is None else placed[0].tracks[log.robot]


def _agreeing(
    t: Float[np.ndarray, " k"], place: Float[np.ndarray, "k 3"], wheel_track: Track, cfg: PlacingConfig, *, driven: bool
) -> tuple[Float[np.ndarray, " j"], Float[np.ndarray, "j 3"]]:
    """The places that follow from a neighbour as the wheels say, as far as that can be told."""
    if len(t) < 3:
        return t, place
    base = se2.interpolate(t, wheel_track.t, wheel_track.pose)
    said = se2.between(base[:-1], base[1:])
    miss = se2.between(se2.compose(place[:-1], said), place[1:])
    way = np.hypot(said[:, 0], said[:, 1]) if driven else np.diff(t)
    fits = np.hypot(miss[:, 0], miss[:, 1]) < cfg.near + cfg.near_share * way
    if driven:
        fits &= np.abs(miss[:, 2]) < cfg.near + cfg.near_share * np.abs(said[:, 2]) + cfg.near_drift * np.diff(t)
    keep = np.append(fits, False) | np.append(False, fits)
    return t[keep], place[keep]
