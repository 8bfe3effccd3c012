"""What a finished laser log is warned of: clocks, wheels, jumps, places not found again, copies.

Stamps. A scanner's driver that stamps late, or a second computer whose clock is off, gives every scan the odometry of
another moment: straight on that does little, in turns it lays walls crooked. The turns that matching finds come later
than those of the wheels by the lag.

Wheels. Where the motion from scans and that from wheels differ for long, one of the two is wrong.

Turns. Where nothing but the scans tells of a wide turn from one to the next, it may have been another.

Slides. Where nothing but scans tells how far a robot drove, and walls do so no better than wheels would, nobody knows.

Jumps. Where the scene changes at once though the wheels hardly moved, the robot was carried, or logs were joined.

Places. A trajectory that says it passes by places seen before, where none of them is found again, is told.

Copies. Robots whose logs are copies of one drive hold the same returns, with other stamps or other scans left out:
noise never comes twice. Where noise was added they are in one place at one time.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.findings import Finding
from ..core.names import robot_name
from ..core.records import Scan, Track
from .keyframes import STEP_NOISE_BLUR
from .laser_map import ScanRecords
from .robot_graph import RobotGraph
from .scan_odometry import NARROW, STILL, field_of_view

LAG_GAIN = 0.75  # share of the difference without a lag that may remain with it, at most

LAG_MOST = 3.0  # [s] tried to either side,
LAG_STEP = 0.05  # [s] apart
LAG_TURN = 0.02  # [rad] from scan to scan, and more: what stands or drives straight tells nothing
LAG_TURNS = 40  # of them at least
LAG_CAPPED = 0.1  # [rad] more difference than this counts as this
LAG_PARTS = 8  # of the log, each asked by itself,
LAG_AGREE = 0.75  # share of them that must find the same lag
LAG_WITHIN = 0.1  # [s] of each other
LAG_LEAST = 0.2  # [s] of lag that is told
LAGS = LAG_STEP * np.arange(-round(LAG_MOST / LAG_STEP), round(LAG_MOST / LAG_STEP) + 1)
DRIFT_SPAN = 200.0  # [s] of the log that are asked by how much one clock is faster,
RATES = 0.0005 * np.arange(-120, 121)  # of which these are tried, and these lags [s] at its begin;
FIRST_LAGS = 0.1 * np.arange(-15, 16)
DRIFT_OWN = 1e-3  # [rad] from the wheels' turn at the same stamps: what is nearer was taken from them, tells nothing
DRIFT_GAIN = 0.85  # share of the difference by any constant lag that may remain, at most, and
DRIFT_WITHIN = 0.005  # of each other every second turn and the others must find the rate
DRIFT_LEAST = 0.005  # that is told

WHEEL_STRETCH = 2.0  # [m] driven, whose lengths are compared
WHEEL_SHARE = 0.2  # by which they differ
WHEEL_LONG = 8.0  # [m] on end, and
LONG_APART = 1.5  # [m] ahead in all: stamps that are mixed make stretches longer and shorter by turns
WHEEL_STAND = 2.0  # [m] that scans tell, on end, while wheels report no motion,
STAND_STEP = 0.5  # [m] from one place to the next
WHEEL_UNLIKE = 3.0  # times as far, or as little, as the wheels tell scans move in all
UNLIKE_WAY = 3.0  # [m] that scans tell, at least
WHEEL_LEAP = 2.0  # [m] from one scan to the next, or
LEAP_TURN = 1.0  # [rad] that it turns from one scan to the next: a leap, at
LEAP_SPEED = 5.0  # times the speed that no more
LEAP_OTHERS = 0.95  # of all steps than this share have
NEAR_ZERO = np.array([0.2, 0.2, 0.1])  # [m, m, rad] that the wheels tell at most of where they began

ALONE_WIDE = 0.6  # [rad] from one scan to the next that nothing but they tell: rooms alike pass for each other

SLIDE_SD = 0.02  # [m] of the step from keyframe to keyframe: walls tell it to 0.005, wheels would to 0.025
SLIDE_WAY = 2.0  # [m] of such steps in all: a few in a doorway do not matter,
SLIDE_SHARE = 0.5  # but where they are so much of the way, which scans then tell too short

JUMP_DROP = 0.4  # of the share of returns on known walls from one scan to the next, and
DROP_PER_M = 1.0  # so much more for a metre between the two and
DROP_PER_RAD = 0.3  # for a radian of turn: new places come into view
JUMP_LEAST_RETURNS = 30  # in either scan
JUMP_LATE = 50  # scans, after which the first of a scanner belongs to another drive

COPY_LEAST_RETURNS = 30  # of a keyframe that is compared,
COPY_SCANS = 5  # keyframes that are equal, at least, and
COPY_SHARE = 0.05  # of the keyframes of the robot that has fewer; or
ONE_PLACE = 0.15  # [m] within which the other is at the same time, as two robots cannot be, at
ONE_PLACE_SHARE = 0.9  # of the keyframes of that robot, which are
ONE_PLACE_LEAST = 20  # at least


def stamp_lag(t: Float[np.ndarray, " m"], heading: Float[np.ndarray, " m"], odometry: Track | None) -> float | None:
    """By how much [s] the stamps of scans lag behind those of odometry, ahead of them if negative; None where unsure.

    t, heading: of the scans as they were matched, headings unwrapped.
    """
    turns = _Turns.of(t, heading)
    if odometry is None or len(odometry.t) < 2 or turns is None:
        return None
    apart = turns.apart(odometry, LAGS[:, None])
    whole = apart.mean(axis=1)
    best = int(np.argmin(whole))
    own = LAGS[[int(np.argmin(part.mean(axis=1))) for part in np.array_split(apart, LAG_PARTS, axis=1)]]
    sure = np.mean(np.abs(own - LAGS[best]) <= LAG_WITHIN + 1e-9) >= LAG_AGREE
    return float(LAGS[best]) if sure and whole[best] <= LAG_GAIN * whole[len(LAGS) // 2] else None


def clock_drift(t: Float[np.ndarray, " m"], heading: Float[np.ndarray, " m"], odometry: Track | None) -> float | None:
    """The share by which the clock of the scans runs faster than that of the odometry, slower if negative.

    None where the turns of the first `DRIFT_SPAN` do not tell it. t, heading: of the scans as they were matched,
    headings unwrapped.
    """
    soon = t <= t[0] + DRIFT_SPAN
    turns = _Turns.of(t[soon], heading[soon])
    if odometry is None or len(odometry.t) < 2 or turns is None:
        return None
    by_lags = turns.apart(odometry, LAGS[:, None])
    own = by_lags[len(LAGS) // 2] > DRIFT_OWN
    if by_lags.mean(axis=1).min() <= LAG_TURN or own.sum() < LAG_TURNS // 2:
        return None
    lags, rates = (grid.ravel() for grid in np.meshgrid(FIRST_LAGS, RATES))
    apart = turns.apart(odometry, lags[:, None] + rates[:, None] * (turns.t - turns.t[0]))[:, own]
    best, odd, even = (int(np.argmin(some.mean(axis=1))) for some in (apart, apart[:, 1::2], apart[:, ::2]))
    sure = apart[best].mean() <= DRIFT_GAIN * by_lags[:, own].mean(axis=1).min()
    same = abs(rates[odd] - rates[even]) <= DRIFT_WITHIN
    faster = float(rates[best] / (1.0 - rates[best]))  # the rates are of what the scans' clock passed
    return faster if sure and same and abs(faster) >= DRIFT_LEAST else None


class _Turns(NamedTuple):
    """What scans that turn tell of clocks. t: (m,) [s] of all; turned: (n,) [rad] from one to the next, where
    `turning`, (m - 1,), says so.
    """

    t: Float[np.ndarray, " m"]
    turned: Float[np.ndarray, " n"]
    turning: Bool[np.ndarray, " k"]

    @classmethod
    def of(cls, t: Float[np.ndarray, " m"], heading: Float[np.ndarray, " m"]) -> "_Turns | None":
        """None where too few turn."""
        turned = np.diff(heading)
        turning = np.abs(turned) >= LAG_TURN
        return cls(t, turned[turning], turning) if turning.sum() >= LAG_TURNS else None

    def apart(self, odometry: Track, late: Float[np.ndarray, "k #m"]) -> Float[np.ndarray, "k n"]:
        """(k, n) [rad] from the turns of wheels whose stamps are `late` [s] behind, (k, m) or (k, 1)."""
        wheels = np.unwrap(odometry.pose[:, 2])
        by = np.array([np.diff(np.interp(self.t - one, odometry.t, wheels))[self.turning] for one in late])
        return np.asarray(np.minimum(np.abs(self.turned - by), LAG_CAPPED))


def lag_found(lag: float | None, drift: float | None, robot: str) -> tuple[Finding, ...]:
    """A finding for a drift, or else for a lag that matters."""
    if drift is not None:
        told = {"value": 100 * abs(drift), "way": "faster" if drift > 0 else "slower"}
        return (Finding("clock-drift", robot, value=told),)
    if lag is None or abs(lag) < LAG_LEAST - 1e-9:
        return ()
    return (Finding("stamp-lag", robot, value={"value": abs(lag), "way": "after" if lag > 0 else "before"}),)


def wheels_disagree(track: Track, dead: Track | None, robot: str, factor: float = 1.0) -> tuple[Finding, ...]:
    """A finding where the motion from scans and the motion from wheels differ for long.

    dead: dead reckoning at the stamps of `track`; factor: of its ways, which is told already. Both are cut where the
    wheels have driven `cfg.stretch` on; stretches that differ in length by a share of `cfg.share` add up while they
    follow each other, and must differ by `cfg.long_apart` in all.
    """
    if dead is None or len(dead.t) != len(track.t) or len(track.t) < 2:
        return ()
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dead.pose[:, :2], axis=0).T))])
    cuts = np.searchsorted(driven, np.arange(0.0, driven[-1], WHEEL_STRETCH))
    wheels = factor * np.hypot(*np.diff(dead.pose[cuts, :2], axis=0).T)
    scans = np.hypot(*np.diff(track.pose[cuts, :2], axis=0).T)
    far = np.abs(scans - wheels) > WHEEL_SHARE * np.maximum(wheels, 0.5 * WHEEL_STRETCH)
    most, run, end = 0, 0, 0
    for k, differs in enumerate(far.tolist()):
        run = run + 1 if differs else 0
        if run > most:
            most, end = run, k + 1
    if most * WHEEL_STRETCH < WHEEL_LONG:
        return ()
    part = slice(end - most, end)
    ahead = [se2.between(p[cuts[:-1]], p[cuts[1:]])[part, 0].sum() for p in (track.pose, dead.pose)]
    if abs(ahead[0] - factor * ahead[1]) < LONG_APART:
        return ()
    first, last = track.t[cuts[end - most]], track.t[cuts[end]]
    told = {"scans": float(scans[part].sum()), "wheels": float(wheels[part].sum())}
    return (Finding("wheels-disagree", robot, (float(first), float(last)), told),)


def wheels_stand(track: Track, dead: Track | None, robot: str) -> tuple[Finding, ...]:
    """A finding where the wheels report no motion at all while the scans tell of one: the first such stretch.

    dead: dead reckoning at the stamps of `track`. The motion from scans counts in steps of `cfg.stand_step`, so that
    how poses of a robot that stands jump about is none.
    """
    if dead is None or len(dead.t) != len(track.t) or len(track.t) < 2:
        return ()
    stood = (np.abs(np.diff(dead.pose, axis=0)) <= STILL).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stood.astype(np.int8), [0]])))
    whole, stretches = 0.0, []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        way, at = 0.0, track.pose[first, :2]
        for place in track.pose[first + 1 : last + 1, :2]:
            if (d := float(np.hypot(*(place - at)))) >= STAND_STEP:
                way, at = way + d, place
        if way >= WHEEL_STAND:
            whole += way
            stretches.append((float(track.t[first]), float(track.t[last])))
    if not stretches:
        return ()
    return (Finding("wheels-stand", robot, stretches[0], {"way": whole, "times": len(stretches)}),)


def turns_alone(records: ScanRecords, scans: Sequence[Scan], robot: str) -> tuple[Finding, ...]:
    """A finding where scans alone, without wheels and without a gyroscope, tell of wide turns: the first such."""
    alone = np.array([scan.odometry is None and scan.heading is None for scan in scans], bool)
    turned = np.abs(se2.wrap_angle(np.diff(records.pose[:, 2])))
    wide = np.flatnonzero(alone[1:] & (turned > ALONE_WIDE))
    if not len(wide):
        return ()
    span = (float(records.t[wide[0]]), float(records.t[wide[0] + 1]))
    return (Finding("turns-alone", robot, span, {"times": len(wide), "most": float(np.degrees(turned[wide].max()))}),)


def slides_alone(graph: RobotGraph, scans: Sequence[Scan], robot: str) -> tuple[Finding, ...]:
    """A finding where scans alone, without wheels and without light, tell the way, and walls tell little along it.

    The way counts as the scans tell it, which is short: a robot may seem to stand.
    """
    if graph.q is not None or not all(scan.odometry is None for scan in scans):
        return ()
    sd = np.sqrt(np.linalg.eigvalsh(np.linalg.inv(graph.step_information)[:, :2, :2])[:, 1])
    loose = np.flatnonzero((sd > SLIDE_SD) & np.array([not why for why in graph.border[1:]], bool))
    way = float(np.hypot(*graph.step[loose, :2].T).sum())
    whole = float(np.hypot(*graph.step[:, :2].T).sum())
    if way >= SLIDE_WAY or way > SLIDE_SHARE * whole:
        return (Finding("slides-alone", robot, (float(graph.t[loose[0]]), float(graph.t[loose[-1] + 1])), way),)
    along, across = np.linalg.eigvalsh(graph.normals.T @ graph.normals)
    if graph.path[-1] >= SLIDE_WAY or along > STEP_NOISE_BLUR * (along + across):
        return ()
    return (Finding("slides-alone", robot, None, way),)


def wheels_unlike(track: Track, dead: Track | None, robot: str) -> tuple[Finding, ...]:
    """A finding where the ways of scans and wheels are many times as long as each other, as in other units.

    dead: dead reckoning at the stamps of `track`. Both ways count in steps of `cfg.stand_step` of the trajectory.
    """
    if dead is None or len(dead.t) != len(track.t):
        return ()
    at, scans, wheels = 0, 0.0, 0.0
    for k in range(1, len(track.t)):
        if (d := float(np.hypot(*(track.pose[k, :2] - track.pose[at, :2])))) >= STAND_STEP:
            scans, wheels = scans + d, wheels + float(np.hypot(*(dead.pose[k, :2] - dead.pose[at, :2])))
            at = k
    if scans < UNLIKE_WAY or wheels <= STILL or 1 / WHEEL_UNLIKE <= scans / wheels <= WHEEL_UNLIKE:
        return ()
    return (Finding("wheels-unlike", robot, value=scans / wheels),)


def set_to_zero(before: Float[np.ndarray, "*n 3"], after: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Whether wheels that were elsewhere tell of where they began: a robot that turns about stays where it is."""
    there = [(np.abs(pose) <= NEAR_ZERO).all(axis=-1) for pose in (before, after)]
    return np.asarray(there[1] & ~there[0])


def wheels_leap(
    t: Float[np.ndarray, " m"], scans: Sequence[Scan], robot: str, *, segments: bool = False
) -> tuple[Finding, ...]:
    """A finding where the pose that wheels tell leaps from one scan to the next: the widest such leap.

    segments: the map goes on by the scans there, or in another segment.
    """
    if len(scans) < 2 or scans[0].odometry is None:
        return ()
    poses = np.array([scan.odometry for scan in scans], dtype=float)
    step, dt = se2.between(poses[:-1], poses[1:]), np.maximum(np.diff(t), 1e-9)
    way, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
    fast = [size / dt > LEAP_SPEED * np.quantile(size / dt, LEAP_OTHERS) for size in (way, turn)]
    moved = (way > NEAR_ZERO[0]) & fast[0]
    turned = (turn >= LEAP_TURN) & fast[1] & (moved | set_to_zero(poses[:-1], poses[1:]))
    leaps = ((way >= WHEEL_LEAP) & fast[0]) | turned
    if not leaps.any():
        return ()
    k = int(np.argmax(np.where(leaps, way / WHEEL_LEAP + turn / LEAP_TURN, 0.0)))
    told = {"value": float(way[k]), "degrees": float(np.degrees(turn[k])), "times": int(leaps.sum())}
    span = (float(t[k]), float(t[k + 1]))
    if segments:
        return (Finding("wheels-set", robot, span, told, "the map goes on by the scans"),)
    return (Finding("wheels-leap", robot, span, told, "the map goes on by the wheels"),)


def jumps(records: ScanRecords, scans: Sequence[Scan], robot: str) -> tuple[Finding, ...]:
    """A finding for the first scan that shows little of what the one before it saw, and how many more there are."""
    if len(scans) < 3 or scans[0].odometry is None:
        return ()
    wheels = np.array([scan.odometry for scan in scans], dtype=float)
    share = records.matches / np.maximum(records.beams, 1)
    before, after = _one_to_the_next(scans, JUMP_LATE)
    step = se2.between(wheels[before], wheels[after])
    way = np.hypot(step[:, 0], step[:, 1])
    enough = np.minimum(records.beams[before], records.beams[after]) >= JUMP_LEAST_RETURNS
    enough &= np.array([records.decision[k] != "unseen" for k in after], dtype=bool)
    wide = np.array([field_of_view(scan).wide for scan in scans])[after]
    gone = np.flatnonzero(enough & (before > 0) & (share[before] - share[after] >= usual_drop(step, wide)))
    if not len(gone):
        return ()
    row = gone[np.argmin(after[gone])]
    k, last = int(after[row]), int(before[row])
    found = {
        "now": 100 * float(share[k]),
        "before": 100 * float(share[last]),
        "way": float(way[row]),
        "times": len(gone),
    }
    at = float(records.t[k])
    return (Finding("scene-jump", robot, (at, at), found, "the map goes on by the wheels"),)


def usual_drop(step: Float[np.ndarray, "*n 3"], wide: Float[np.ndarray, " *n"] | float) -> Float[np.ndarray, " *n"]:
    """By how much the share of returns on known walls may drop from one scan to the next, whose scene is the same one.

    step: between them, as wheels tell; wide: sector of the scanner [rad].
    """
    wide = np.maximum(wide, 1e-3)
    per_rad = np.where(wide < NARROW, 1.0 / wide, DROP_PER_RAD)  # a narrow view turns away sooner,
    drop = JUMP_DROP * np.maximum(1.0, NARROW / wide)  # and past a door jamb it is all another room
    return np.asarray(drop + DROP_PER_M * np.hypot(step[..., 0], step[..., 1]) + per_rad * np.abs(step[..., 2]))


def _one_to_the_next(scans: Sequence[Scan], late: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Each scan after the one before it of the same scanner: before and after.

    The first scan of a scanner that joins late follows the last of any: scanners of one robot begin together.
    """
    latest: dict[bytes, int] = {}
    pairs = []
    for k, scan in enumerate(scans):
        mount = scan.T_robot_sensor.tobytes()
        if mount in latest or k >= late:
            pairs.append((latest.get(mount, k - 1), k))
        latest[mount] = k
    before, after = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return before, after


def copies_found(graphs: Sequence[RobotGraph], maps: Sequence[Mapping[str, Track]] = ()) -> list[Finding]:
    """A finding for each pair of robots of which keyframes have the same returns, to the last digit, or places.

    maps: of each map, its robots' trajectories: two of them that are in one place all the time are one, whatever noise
    was added to its log. Stamps count from the same clock, or from where either log begins.
    """
    seen = [_keyframes(graph) for graph in graphs]
    out = []
    for a, b in combinations(range(len(graphs)), 2):
        equal, fewer = len(seen[a] & seen[b]), min(len(seen[a]), len(seen[b]))
        copied = equal >= max(COPY_SCANS, COPY_SHARE * fewer)
        if not copied:
            short, long = sorted((graphs[a], graphs[b]), key=len)
            together = (m for m in maps if {short.robot, long.robot} <= m.keys())
            equal = max((_in_one_place(short, m[short.robot], m[long.robot]) for m in together), default=0)
            fewer = len(short)
            copied = equal >= max(ONE_PLACE_LEAST, ONE_PLACE_SHARE * fewer)
        if copied:
            other = robot_name(graphs[a].robot)
            out.append(Finding("logs-alike", graphs[b].robot, value={"other": other, "same": equal, "all": fewer}))
    return out


def _in_one_place(graph: RobotGraph, one: Track, other: Track) -> int:
    """At how many keyframes, whose robot's trajectory is `one`, the `other` robot is where this one is."""
    at, most = se2.interpolate(graph.t, one.t, one.pose), 0
    for lag in (0.0, other.t[0] - one.t[0]):
        t = graph.t + lag
        there = (t >= other.t[0]) & (t <= other.t[-1])
        off = se2.interpolate(t[there], other.t, other.pose)[:, :2] - at[there, :2]
        most = max(most, int((np.hypot(off[:, 0], off[:, 1]) < ONE_PLACE).sum()))
    return most


def _keyframes(graph: RobotGraph) -> set[bytes]:
    """The returns of each keyframe, each told from all others."""
    pairs = zip(graph.start[:-1].tolist(), graph.start[1:].tolist(), strict=True)
    return {graph.points[i:j].tobytes() for i, j in pairs if j - i >= COPY_LEAST_RETURNS}
