"""The frames of a team tied to each other, one after the other, by what its robots saw of each other.

A frame is that of a `Body`: a piece of a team that holds together by itself.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.names import in_order
from ..core.records import Track
from ..laser.scan_odometry import blended
from .config import MOTION_NOISE_HOLD, PlacingConfig, SmoothingConfig, sharpened
from .relation import (
    PLACING_INLIER,
    PLACING_LEAST,
    PLACING_SHARE,
    MutualSightings,
    Relation,
    is_sure,
    relate,
    residuals,
)
from .robot_part import CommandedMotion, all_seen

TIE_MOMENT = 5.0  # [s] for which what is seen of one robot tells one place of it
WINDOW_REACH = 0.7  # of such a window, either way of its middle, in which the robot is where it says
REGAINED_SHARE = 0.3  # share of its sightings that must agree of a robot whose own map does not fit the others',
REGAINED_WINDOW = 6.0  # [s] over which its wheels are trusted,
LOST_SHARE = 0.6  # of a robot's sightings: its filter was lost where fewer agree with its track, and
PLACING_BETTER = 1.1  # times as many must agree with another
FIXED_WINDOW = 2.0  # [s] either way, in which sightings must fix a robot without wheels
PLACING_CLOCK = 3.0  # [s] largest offset of a clock that is looked for
CLOCK_STEP = 0.25  # [s] between two that are tried, which is halved
PLACING_CLOCK_STILL = 0.01  # [s] down to this
CLOCK_LEAD = 10.0  # cost by which an offset must be better than none
PLACING_CLOCK_SURE = 3.0  # standard deviations from which a fine offset is believed,
PLACING_CLOCK_ROUNDS = 3  # smoothing again after each,
CLOCK_FINE = 0.6  # [s] looked for either way then,
CLOCK_FINE_STEP = 0.1  # [s] between two that are tried then
CLOCK_SIGHTINGS = 20  # of the robot or by it, at least
CLOCK_TOGETHER = 3.0  # times the sd that independent sightings would give: a camera's errors last seconds
PLACING_LEVER = 2.0  # times as far as a tie may be off where robots meet, frames may be off where they begin
PLACING_NEAR = 0.5  # [m] by which two places of one loose robot may contradict its wheels, and
PLACING_NEAR_SHARE = 0.3  # as a share of what they drove, or [m/s] of a robot without
NEAR_DRIFT = 0.05  # [rad/s] that the same wheels may turn more than they say
SAME_XY = 0.05  # [m] and
SAME_THETA = 0.02  # [rad] sd of a tie by two tracks of one robot
ROOM_REACH = 0.5  # [s] of a known pose in which a robot sights those of landmarks mapped apart
PLACING_LEAP = 4.0  # standard deviations of its speed that a robot without odometry cannot have gone
PLACING_UNSURE = 1.0  # [m] sd of a landmark that bearings alone place, when the smoothing begins
PLACING_GUESSED = 3.0  # [rad^2] variance of a heading from which a pose is a guess between pieces of a map
WALLS_OFF = 3.0  # standard deviations of a tie by which walls may put a robot elsewhere and be believed

LONGER = (2.0, 4.0)  # times as long wheels are trusted, or a robot without is taken to stand, if sighted too rarely
Labels = Mapping[str, Mapping[str, str]]


Move = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]
UNMOVED: Move = (np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Body:
    """Robots and landmarks whose places to each other are known, in one frame.

    anchors: robot -> stamps [s] within `reach` [s] of which its track is believed; one that is not named is believed
    everywhere. clock: [s] by which the stamps of the tracks are ahead of the team's. moves: robot -> where the frame
    that its track began in lies by now, and the covariance of the ties that say so; one that is not named never moved.
    """

    tracks: Mapping[str, Track]
    landmarks: Mapping[str, Float[np.ndarray, "2"]]
    anchors: Mapping[str, Float[np.ndarray, " k"]] = field(default_factory=dict)
    reach: Mapping[str, float] = field(default_factory=dict)
    clock: float = 0.0
    own_clock: bool = False
    moves: Mapping[str, Move] = field(default_factory=dict)

    @property
    def robots(self) -> tuple[str, ...]:
        return tuple(self.tracks)

    def believed(self, robot: str, t: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
        """Whether the robot's track says where it was at the team's `t` [s]."""
        own = t + self.clock
        track = self.tracks[robot]
        if not len(track.t):
            return np.zeros(len(t), bool)
        inside = (own >= track.t[0]) & (own <= track.t[-1])
        if robot in self.anchors:
            at = self.anchors[robot]
            k = np.clip(np.searchsorted(at, t), 1, max(len(at) - 1, 1))
            near = np.minimum(np.abs(t - at[k - 1]), np.abs(t - at[np.minimum(k, len(at) - 1)]))
            inside &= near <= self.reach[robot]
        return np.asarray(inside)

    def pose(self, robot: str, t: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
        """Where the robot was at the team's `t` [s]."""
        track = self.tracks[robot]
        return se2.interpolate(t + self.clock, track.t, track.pose)

    def on_team_time(self) -> "Body":
        """The same with the stamps of the team's clock."""
        if not self.clock:
            return self
        tracks = {robot: replace(track, t=track.t - self.clock) for robot, track in self.tracks.items()}
        return replace(self, tracks=tracks, clock=0.0)

    def moved(self, T: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"] | None = None) -> "Body":
        """The same seen from a frame in which its own frame is at `T`, with covariance `cov` where that is known."""
        sure = np.zeros((3, 3)) if cov is None else cov
        moves = {}
        for robot in self.tracks:
            before, spread = self.moves.get(robot, UNMOVED)
            moves[robot] = np.asarray(se2.compose(T, before)), se2.composed_covariance(T, sure, before, spread)
        return replace(
            self,
            tracks={robot: moved_track(track, T) for robot, track in self.tracks.items()},
            landmarks={name: se2.act(T, p) for name, p in self.landmarks.items()},
            moves=moves,
        )

    def joined(self, other: "Body") -> "Body":
        """Both, which are in one frame; of a landmark in both, this one's place."""
        a, b = self.on_team_time(), other.on_team_time()
        return Body(
            {**b.tracks, **a.tracks},
            {**b.landmarks, **a.landmarks},
            {**b.anchors, **a.anchors},
            {**b.reach, **a.reach},
            moves={**b.moves, **a.moves},
        )


def moved_track(track: Track, T: Float[np.ndarray, "3"]) -> Track:
    """The track seen from a frame in which its own frame is at `T`; its covariance turned."""
    cov = None if track.cov is None else se2.turned_covariance(T[2], track.cov)
    return Track(track.t, se2.compose(T, track.pose), cov)


def mutual_sightings(a: Body, b: Body, logs: Mapping[str, LandmarkLog], labels: Labels) -> MutualSightings:
    """What robots of `a` saw of `b`, then what robots of `b` saw of `a`."""
    parts = [
        *(_of_robot(robot, a, b, logs[robot], labels, forward=True) for robot in a.robots if robot in logs),
        *(_of_robot(robot, b, a, logs[robot], labels, forward=False) for robot in b.robots if robot in logs),
    ]
    return MutualSightings.joined([p for part in parts for p in part])


def _of_robot(
    robot: str, own: Body, other: Body, log: LandmarkLog, labels: Labels, *, forward: bool
) -> list[MutualSightings]:
    table, names = all_seen(log), labels.get(robot, {})
    called = [names.get(name, name) for name in table.ids]
    wanted = [
        k
        for k, name in enumerate(table.ids)
        if name != robot and (name not in own.tracks if name in other.tracks else called[k] in other.landmarks)
    ]
    looked = np.flatnonzero(np.isin(table.what, wanted))  # poses of a track are most of the work
    looked = looked[own.believed(robot, table.t[looked])]
    if not len(looked):
        return []
    pose = np.zeros((len(table), 3))
    pose[looked] = own.pose(robot, table.t[looked])
    out = []
    for k in wanted:
        rows, name = looked[table.what[looked] == k], table.ids[k]
        if not len(rows):
            continue
        if name in other.tracks:
            rows = rows[other.believed(name, table.t[rows])]
            point = other.pose(name, table.t[rows])[:, :2]
        else:
            name, point = called[k], np.tile(other.landmarks[called[k]], (len(rows), 1))
        out.append(_mutual_sightings(table, rows, pose[rows], point, name, forward=forward))
    return out


def _mutual_sightings(
    table: SightingTable, rows: np.ndarray, pose: np.ndarray, point: np.ndarray, what: str, *, forward: bool
) -> MutualSightings:
    order = np.argsort(table.t[rows], kind="stable")
    rows = rows[order]
    return MutualSightings(
        np.full(len(rows), forward),
        pose[order].reshape(-1, 3),
        point[order].reshape(-1, 2),
        table.range[rows],
        table.bearing[rows],
        table.t[rows],
        np.full(len(rows), what),
    )


@dataclass(frozen=True, slots=True)
class Tie:
    """Two bodies became one. agree of `of` sightings said so; clock: [s] by which b's was found ahead.

    by: what said so: sightings, walls that both saw, where they are known to be, or position fixes.
    """

    a: tuple[str, ...]
    b: tuple[str, ...]
    agree: int
    of: int
    clock: float = 0.0
    by: Literal["sightings", "walls", "known", "fixes"] = "sightings"


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
    return int((e < PLACING_INLIER**2).sum()), len(z)


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
        alive[i] = a.joined(b.moved(relation.transform, relation.cov))
        del alive[j]
        candidates = {pair: tie for pair, tie in candidates.items() if not {i, j} & set(pair)}


def _tie(
    a: Body, b: Body, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> tuple[Relation, float] | None:
    """How b lies in a, and by how much the clock of the one that has its own is ahead; None when that is not sure."""
    shared = [robot for robot in a.robots if robot in b.tracks]
    if shared:
        return _by_same_robot(a.tracks[shared[0]], b.tracks[shared[0]]), 0.0
    swap = a.own_clock and not b.own_clock
    first, second = (b, a) if swap else (a, b)
    seen = mutual_sightings(first, second, logs, labels)
    best, clock = relate(seen, cfg), 0.0
    if second.own_clock:
        best, clock = _with_clock(first, second, logs, labels, cfg, best)
        seen = mutual_sightings(first, replace(second, clock=clock), logs, labels)
    if best is None or not is_sure(best, cfg) or hangs_on_one(seen, best, {*a.tracks, *b.tracks}, cfg):
        return None
    if swap:
        T = se2.inverse(best.transform)
        J = se2.inverse_jacobian(best.transform)
        best = replace(best, transform=T, cov=J @ best.cov @ J.T)
    return best, clock


def hangs_on_one(z: MutualSightings, relation: Relation, robots: Collection[str], cfg: PlacingConfig) -> bool:
    """Whether too few sightings agree but for those of one landmark, or of one robot at one moment.

    However often it was seen, one point that was mislabelled, or taken for another, makes sightings agree with any turn
    about it.
    """
    agree = np.square(residuals(z, relation.transform, cfg)).sum(axis=-1) < PLACING_INLIER**2
    moment = np.where(np.isin(z.what, sorted(robots)), z.t // TIE_MOMENT, 0.0)
    _, of = np.unique(np.rec.fromarrays([z.what, moment]), return_inverse=True)
    rest, agreeing = len(z) - np.bincount(of), agree.sum() - np.bincount(of, agree)
    return bool((agreeing < np.maximum(PLACING_LEAST, PLACING_SHARE * rest)).any())


def _with_clock(
    a: Body, b: Body, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig, plain: Relation | None
) -> tuple[Relation | None, float]:
    """The relation with the offset of b's clock that explains most, where it explains clearly more than none."""
    sharp = sharpened(cfg)

    def at(clock: float) -> Relation | None:
        relation = relate(mutual_sightings(a, replace(b, clock=clock), logs, labels), sharp)
        return None if relation is None or relation.of < 5 * PLACING_LEAST else relation

    def worth(relation: Relation | None) -> float:
        return np.inf if relation is None else relation.cost / relation.of

    steps = round(PLACING_CLOCK / CLOCK_STEP)
    tried = {k * CLOCK_STEP: at(k * CLOCK_STEP) for k in range(-steps, steps + 1)}
    best = min(tried, key=lambda clock: (worth(tried[clock]), abs(clock)))
    relation, none = tried[best], tried[0.0]
    if relation is None or (none is not None and (worth(none) - worth(relation)) * relation.of < CLOCK_LEAD):
        return plain, 0.0
    step = 0.5 * CLOCK_STEP
    while step > PLACING_CLOCK_STILL:
        near = {c: at(c) for c in (best - step, best, best + step)}
        best = min(near, key=lambda clock: (worth(near[clock]), abs(clock)))
        step = 0.5 * step
    return relate(mutual_sightings(a, replace(b, clock=best), logs, labels), cfg), float(best)


def _by_same_robot(a: Track, b: Track) -> Relation:
    """How two tracks of one robot lie: the motion that lays most short pieces of one on the other."""
    t = np.arange(max(a.t[0], b.t[0]), min(a.t[-1], b.t[-1]), 1.0)
    if len(t) < 3:
        return Relation(np.zeros(3), np.full((3, 3), np.inf), 0, 0, np.inf)
    p, q = se2.interpolate(t, a.t, a.pose), se2.interpolate(t, b.t, b.pose)
    T = se2.align(q[:, :2], p[:, :2])
    for _ in range(5):
        e = np.linalg.norm(se2.act(T, q[:, :2]) - p[:, :2], axis=1)
        T = se2.align(q[:, :2], p[:, :2], 1.0 / (1.0 + np.square(e / max(float(np.median(e)), 0.02))))
    return Relation(T, np.diag([SAME_XY**2, SAME_XY**2, SAME_THETA**2]), len(t), len(t), 0.0)


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
            for longer in LONGER if placed is None else ():
                wide = replace(cfg, window=longer * cfg.window, window_still=longer * cfg.window_still)
                placed = placed or _windows(group, log, wheel_track, logs, labels, wide)
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
    motion, known = CommandedMotion.of(log.odometry, MOTION_NOISE_HOLD), smoothing.calibration
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
    if len(windows.seen) < PLACING_LEAST or not len(windows.t) or windows.agree < cfg.loose_share * len(windows.seen):
        return None
    times, anchors = _agreeing(windows.t, windows.place, wheel_track, driven=driven)
    if not len(times):
        return None
    t = np.unique(np.concatenate([wheel_track.t, times]))
    base = se2.interpolate(t, wheel_track.t, wheel_track.pose)
    rows = np.searchsorted(t, times)
    pose = blended(base, rows, anchors) if driven else se2.interpolate(t, times, anchors)
    body = Body({robot: Track(t, pose)}, {}, {robot: times}, {robot: WINDOW_REACH * windows.length})
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
    t: Float[np.ndarray, " k"], place: Float[np.ndarray, "k 3"], wheel_track: Track, *, driven: bool
) -> tuple[Float[np.ndarray, " j"], Float[np.ndarray, "j 3"]]:
    """The places that follow from a neighbour as the wheels say, as far as that can be told."""
    if len(t) < 3:
        return t, place
    base = se2.interpolate(t, wheel_track.t, wheel_track.pose)
    said = se2.between(base[:-1], base[1:])
    miss = se2.between(se2.compose(place[:-1], said), place[1:])
    way = np.hypot(said[:, 0], said[:, 1]) if driven else np.diff(t)
    fits = np.hypot(miss[:, 0], miss[:, 1]) < PLACING_NEAR + PLACING_NEAR_SHARE * way
    if driven:
        fits &= np.abs(miss[:, 2]) < PLACING_NEAR + PLACING_NEAR_SHARE * np.abs(said[:, 2]) + NEAR_DRIFT * np.diff(t)
    keep = np.append(fits, False) | np.append(False, fits)
    return t[keep], place[keep]
