"""Segments: a trajectory is a chain of pieces in each of which every step is sure.

Between two of them it is not: a match was refused, few returns match where wheels say something else, wheels jump, or
the recording paused. Submaps never reach over such a border, its step is a weak prior, and places join what it parts.
"""

from bisect import insort
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from ..core import se2
from ..core.findings import Finding
from ..core.laser_log import LaserLog
from ..core.records import Track, frozen
from ..laser.log_warnings import set_to_zero, usual_drop
from ..laser.robot_graph import RobotGraph
from ..laser.scan_odometry import ScanInfo

SEGMENT_LEAST_SHARE = 0.5  # of the returns that match: fewer, and a match must lie where wheels put it
OFF_XY = 0.25  # [m] and
OFF_TURN = 0.2  # [rad] from where wheels put a match of few returns, at most
JUMP_XY = 1.0  # [m] and
JUMP_TURN = 1.0  # [rad] from where wheels put it, whatever matches
SPRING, FORCED = 0.3, 5.0  # [m] and [m/s2] beyond which scans alone tell of another speed at once
WEAK_XY = 1.0  # [m] and
WEAK_TURN = 0.5  # [rad] sd of a step over a border

LEARNED = 20  # scans from which on it is known how far apart they are
PAUSE, PAUSE_TIMES = 5.0, 8.0  # [s] between two scans, and times the usual: a pause
LEAP, LEAP_TIMES, SLOW = 1.0, 5.0, 0.2  # [m or rad], times the usual speed, at least [1/s]: wheels that were set anew
STILL, STILL_TURN = 0.2, 0.1  # [m], [rad]: a robot that moved less over a pause stood still
USUAL = 0.98  # of the steps between two scans are at most so long, and a robot that moved less went on as ever
FAST, FAST_TIMES = 0.5, 1.5  # [m or rad], times the usual: of more wheels do not lead on, they slipped
DRIVEN = 0.15  # of a step that wheels may err by where they lead on, over a gap or as views fade, there besides by
FADED_XY, FADED_TURN = 0.03, 0.02  # [m], [rad] and
FADED_TURN_PER_M, FADED_TURN_PER_RAD = 0.05, 0.1  # [rad] of the turn
WIDE = 0.5  # of a step over a border that it may err by, where that is more than the settings say,
ANY_TURN = 1.0  # [rad] and sd of its turn at most: of more a robot that faces the other way would be none to wonder at
SLIP, REFUSED, JUMP, SPRANG, GAP, FADED = "slip", "refused", "jump", "sprang", "gap", "faded"  # why a step is not sure,
CONTRADICTED = "contradicted"  # or turned out to be wrong
WHEELED = {GAP, FADED}  # where wheels lead on
WHY = {
    SLIP: "few returns match, and elsewhere than the wheels say",
    REFUSED: "too few returns match",
    JUMP: "scans and wheels tell motions far apart",
    FADED: "fewer and fewer returns match",
    SPRANG: "scans alone tell a motion that no robot makes from one scan to the next",
    CONTRADICTED: "places before and after it contradict what its scans tell",
}
MANY, PATCHY = 20, 0.02  # keyframes, and cuts among them from which on a trajectory is a patchwork
DISPUTED = 3.0  # sd by which places put a robot elsewhere over a gap or a cut than its wheels; over a cut besides by
DISPUTED_XY, DISPUTED_TURN = 0.5, 0.5  # [m] or [rad]: over few metres wheels that lead on are known to decimetres
CARRIED_BY = {"scene-jump", "scene-change", "wheels-leap", "wheels-set"}  # codes of what tells that it is elsewhere
STRETCHES = (10, 20, 40)  # steps of a trajectory that places may have bent,
BENT, BENT_SDS = 0.5, 5.5  # by more than this [m], and so many standard deviations of the steps together
SLID_FROM = 1.0  # [m] over one step that places contradict, from which it is told
SLID, SLID_HELD = 3.0, 20  # [m] that a robot may slide along a corridor, where so many places hold over it
LOOSE = 1.25  # [m] sd of a place seen from where the robot began, beyond which its map is not good,
LOOSE_ALL = 0.72  # and [m] root mean square over time by which its trajectory may err, as covariances say
SETTLED, SETTLED_CUTS = 5, 1  # keyframes after a robot was set down, of which at most so many are cut off, too
LONG = 3.0  # [m] of way from which on it matters that a piece shares no place with what came before


def border_covariance(step: Float[np.ndarray, "3"], why: str = "") -> Float[np.ndarray, "3 3"]:
    """Of a step over a border, over x, y, theta. why: there is one; wheels lead on over a gap and as views fade."""
    way = float(np.hypot(step[0], step[1]))
    if why == FADED:
        turn = FADED_TURN + FADED_TURN_PER_M * way + FADED_TURN_PER_RAD * abs(float(step[2]))
        return np.diag(np.square([FADED_XY + DRIVEN * way] * 2 + [turn]))
    if why == GAP:
        return np.diag(np.square([max(0.5 * WEAK_XY, DRIVEN * way)] * 2 + [0.5 * WEAK_TURN]))
    xy = max(WEAK_XY, WIDE * way)
    return np.diag(np.square([xy, xy, min(max(WEAK_TURN, WIDE * abs(float(step[2]))), ANY_TURN)]))


class _Learned:
    """What is usual of numbers that are seen: a quantile of the first ones of each. `see` changes it."""

    def __init__(self, numbers: int, quantile: float) -> None:
        self._seen: list[list[float]] = [[] for _ in range(numbers)]  # each in ascending order
        self._quantile, self.usual = quantile, np.zeros(numbers)

    def __len__(self) -> int:
        return len(self._seen[0])

    def see(self, row: Sequence[float]) -> None:
        """One of each more, unless there are enough."""
        if len(self) >= 10 * LEARNED:
            return
        for seen, x in zip(self._seen, row, strict=True):
            insort(seen, float(x))
        at = self._quantile * (len(self) - 1)
        k, part = int(at), at % 1.0
        self.usual = np.array([s[k] + part * (s[min(k + 1, len(s) - 1)] - s[k]) for s in self._seen])


class Borders:
    """Which of the scans of one robot, as they come, begin a new segment. `seen` changes it."""

    def __init__(self) -> None:
        self._t = np.nan
        self._apart = _Learned(1, 0.5)
        self._wheels: np.ndarray | None = None
        self._speed = _Learned(2, 0.95)
        self._leapt = False
        self._steps = _Learned(2, USUAL)
        self._share, self._why = np.nan, ""  # of the latest scan: of its returns those that match, and what came of it
        self._velocity = np.zeros((2, 2))  # [m/s] on the robot, over the last step and the last that was sure

    def leapt(self, t: float, wheels: Float[np.ndarray, "3"] | None) -> bool:
        """Whether the pose that wheels tell was set anew since the scan before, one at `t` [s] having come."""
        before, self._wheels = self._wheels, wheels
        if wheels is None or before is None or not self._apart:
            return False
        step = se2.between(before, wheels)
        moved = np.array([np.hypot(step[0], step[1]), abs(step[2])])
        speed = moved / max(t - self._t, float(self._apart.usual[0]))
        far = len(self._apart) >= LEARNED and bool((moved > LEAP).any())
        if far:
            fast = speed > LEAP_TIMES * np.maximum(self._speed.usual, SLOW)
            far = bool(((moved > LEAP) & fast).any() and (fast[0] or set_to_zero(before, wheels)))
        if not far or self._leapt:  # one after the other, they are a robot's way
            self._speed.see(speed.tolist())
        self._leapt = far
        return far

    def seen(
        self, t: float, info: ScanInfo, step: Float[np.ndarray, "3"], *, wheels: bool, wide: float = 2.0 * np.pi
    ) -> str:
        """Why the step to the scan at `t` [s] is not sure, empty where it is.

        step: as scan odometry has it; wide: [rad] of the sector that is seen. Wheels lead on where views fade that were
        sure: of one that changes at once, and of those after one of which scans and wheels did not tell one motion,
        they may know nothing, nor where they tell more than robots move between two scans.
        """
        apart, self._t = t - self._t, t
        pause = len(self._apart) >= LEARNED and apart > max(PAUSE, PAUSE_TIMES * float(self._apart.usual[0]))
        why, last = self._unsure(apart, info, step, wheels=wheels, pause=pause), self._share
        self._share = np.nan if info.decision == "first" else info.matches / max(info.beams, 1)
        told = se2.compose(step, se2.inverse(info.innovation)) if info.decision == "matched" else step
        sudden = bool(last - self._share >= usual_drop(told, wide))
        if why in {REFUSED, SLIP} and wheels and not (pause or sudden) and self._why in {"", *WHEELED}:
            way = np.array([np.hypot(told[0], told[1]), abs(told[2])])
            fast = bool((way > np.maximum(FAST, FAST_TIMES * self._steps.usual)).any())
            why = why if fast else FADED
        self._why = why
        return why

    def _unsure(self, apart: float, info: ScanInfo, step: Float[np.ndarray, "3"], *, wheels: bool, pause: bool) -> str:
        """Why the step to a scan `apart` [s] after the last is not sure, whatever wheels are worth."""
        if np.isfinite(apart) and not pause:
            self._apart.see([apart])
        size = np.array([np.hypot(step[0], step[1]), abs(step[2])])
        moved = (size > [STILL, STILL_TURN]).any()
        if not pause:
            self._steps.see(size.tolist())
        if info.decision in {"first", "empty", "unseen"}:
            return ""
        if info.decision != "matched":
            return REFUSED
        if pause and moved and not (wheels and self._went_on(info, size)):
            return GAP
        if wheels:
            return self._contradicted(info)
        return SPRANG if self._sprang(step, apart) else ""

    def _sprang(self, step: Float[np.ndarray, "3"], apart: float) -> bool:
        """Whether a step `apart` [s] after the one before has a speed that no robot comes to in that time."""
        dt = np.nanmax([apart, *self._apart.usual[: len(self._apart)]])
        if not dt > 0.0:
            return False
        off = np.hypot(*(step[:2] - dt * self._velocity).T)
        sprang = bool((off > max(SPRING, FORCED * dt**2)).all())
        self._velocity[: 1 if sprang else 2] = step[:2] / dt
        return sprang

    def _went_on(self, info: ScanInfo, size: Float[np.ndarray, "2"]) -> bool:
        """Whether a pause hid nothing: as little way as between any two scans, and the match is where wheels say."""
        usual = bool((size <= self._steps.usual).all())
        off = np.abs([np.hypot(*info.innovation[:2]), se2.wrap_angle(info.innovation[2])])
        return usual and info.matches >= SEGMENT_LEAST_SHARE * info.beams and bool((off <= [OFF_XY, OFF_TURN]).all())

    def _contradicted(self, info: ScanInfo) -> str:
        """Why a match is not believed that lies elsewhere than wheels put it."""
        off, turned = float(np.hypot(*info.innovation[:2])), abs(float(se2.wrap_angle(info.innovation[2])))
        if off > JUMP_XY or turned > JUMP_TURN:
            return JUMP
        few = info.matches < SEGMENT_LEAST_SHARE * info.beams
        return SLIP if few and (off > OFF_XY or turned > OFF_TURN) else ""


def pieces_of(graph: RobotGraph) -> list[Int[np.ndarray, " k"]]:
    """The keyframes of one robot in pieces that no closure joins, in the order of their first keyframes.

    A piece of less than `LONG` [m] of way goes with the one before it, or where there is none with the next.
    """
    cuts, piece = _pieces(graph)
    way = np.bincount(piece, _ways(graph, cuts))
    of, before = piece.copy(), -1
    for k in range(len(of)):
        of[k] = before = piece[k] if way[piece[k]] >= LONG or before < 0 else before
    if way[of[0]] < LONG and (long := np.flatnonzero(way[of] >= LONG)).size:
        of[of == of[0]] = of[long[0]]
    whose = np.repeat(of, np.diff([0, *cuts, len(graph)]))
    return [np.flatnonzero(whose == p) for p in dict.fromkeys(whose.tolist())]


def held_over(graph: RobotGraph, t: float) -> bool:
    """Whether places hold what was driven before `t` [s] and most of what was driven from then on together."""
    k = int(np.searchsorted(graph.t, t))
    if not 0 < k < len(graph):
        return True
    cuts, piece = _pieces(graph, k)
    before = cuts.index(k) + 1  # segments
    held = np.isin(piece[before:], piece[:before])
    way = _ways(graph, cuts)[before:]
    return bool(way[held].sum() >= 0.5 * way.sum())


def set_down(graph: RobotGraph, t: float) -> bool:
    """Whether a robot in another scene at `t` [s] at once may be in another place, which nothing ties to the rest.

    There it sees walls; one whose next scans match as little as the first drove on, and sees little of anything.
    """
    k = int(np.searchsorted(graph.t, t))
    later = graph.border[k + 1 : k + 1 + SETTLED]
    return not held_over(graph, t) and sum(bool(why) for why in later) <= SETTLED_CUTS


def _ways(graph: RobotGraph, cuts: Sequence[int]) -> Float[np.ndarray, " s"]:
    """The way [m] of each segment, of which all but the first begin with the keyframes `cuts`."""
    first, last = np.array([0, *cuts]), np.array([*(k - 1 for k in cuts), len(graph) - 1])
    return np.asarray(graph.path[last] - graph.path[first])


def _pieces(graph: RobotGraph, beside: int = 0) -> tuple[list[int], Int[np.ndarray, " s"]]:
    """The keyframes that segments but the first begin with, and which piece each of the s segments is of.

    beside: a keyframe that a segment is said to begin with, too.
    """
    cuts = [k for k, why in enumerate(graph.border) if k and (why or k == beside)]
    held = [c for c in graph.closures if c.accepted]
    segment = np.searchsorted(np.array(cuts, dtype=np.int64), np.arange(len(graph)), side="right")
    ends = np.array([(segment[c.first], segment[c.second]) for c in held], dtype=np.int64).reshape(-1, 2)
    n = len(cuts) + 1
    links = sp.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    return cuts, np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def segment_findings(graph: RobotGraph) -> tuple[Finding, ...]:
    """Where the trajectory was cut and why, and which pieces share no place with anything before them."""
    cuts, joined = _pieces(graph)
    way, found = _ways(graph, cuts), []
    if len(graph) >= MANY and len(cuts) > PATCHY * len(graph):
        found.append(Finding("track-patchy", graph.robot, None, {"cuts": len(cuts), "keyframes": len(graph)}))
    for piece, k in enumerate(cuts, start=1):
        why, span = graph.border[k], (float(graph.t[k - 1]), float(graph.t[k]))
        if why == GAP:
            found.append(Finding("scan-gap", graph.robot, span, span[1] - span[0]))
            e = se2.between(graph.step[k - 1], se2.between(graph.pose[k - 1], graph.pose[k]))
            if e @ graph.step_information[k - 1] @ e > DISPUTED**2:
                found.append(Finding("gap-disputed", graph.robot, span, float(np.hypot(e[0], e[1])), "places decide"))
        else:
            found.append(Finding("track-cut", graph.robot, span, WHY[why]))
        if k in graph.unclear:
            found.append(Finding("place-unclear", graph.robot, span, action="the place that fits best is taken"))
        last = cuts[piece] - 1 if piece < len(cuts) else len(graph) - 1
        if min(way[piece], way[:piece].max()) >= LONG and joined[piece] not in joined[:piece]:
            found.append(Finding("segment-apart", graph.robot, (span[1], float(graph.t[last])), float(way[piece])))
    return tuple(found)


def cuts_disputed(graph: RobotGraph, told: Sequence[Finding]) -> tuple[Finding, ...]:
    """Where places put a robot far from where its wheels do over a cut, and it saw nothing of having been carried.

    told: what is told of its scenes and wheels: where a scene changes at once the robot was carried, and where wheels
    leap they tell nothing.
    """
    seen = [f for f in told if f.code in CARRIED_BY and f.span is not None]
    if any(isinstance(f.value, Mapping) and f.value["times"] != 1 for f in seen):
        return ()  # of which the first alone is told with its time
    found = []
    for cuts in _loose_cuts(graph):
        each, together = [off for k in cuts if (off := _off_over(graph, [k])) is not None], _off_over(graph, cuts)
        for (first, last), e in each or ([] if together is None else [together]):
            span = (float(graph.t[first]), float(graph.t[last]))
            if not any(f.span is not None and span[0] <= f.span[1] and f.span[0] <= span[1] for f in seen):
                found.append(Finding("cut-disputed", graph.robot, span, float(np.hypot(e[0], e[1])), "places decide"))
    return tuple(found)


def _loose_cuts(graph: RobotGraph) -> list[list[int]]:
    """The cuts, gaps aside, in runs between which no place was recognised: there both motions are free to share it."""
    runs: list[list[int]] = []
    held = np.array([k for c in graph.closures if c.accepted for k in (c.first, c.second)], dtype=np.int64)
    for k, why in enumerate(graph.border):
        if not k or why in {"", GAP}:
            continue
        free = (
            bool(runs) and not ((held >= runs[-1][-1]) & (held < k)).any() and GAP not in graph.border[runs[-1][-1] : k]
        )
        runs = [*runs[:-1], [*runs[-1], k]] if free else [*runs, [k]]
    return runs


def _off_over(graph: RobotGraph, cuts: Sequence[int]) -> tuple[tuple[int, int], Float[np.ndarray, "3"]] | None:
    """Between which keyframes the cuts lie, and by how much places put the robot elsewhere there than its wheels do.

    None where wheels may err by as much.
    """
    first, last = cuts[0] - 1, cuts[-1]
    way, cov = np.zeros(3), np.zeros((3, 3))  # the way from each keyframe to the last, as wheels and scans tell it
    for k in range(last, first, -1):
        if k in cuts:
            border = border_covariance(graph.step[k - 1], graph.border[k])
            cov += border + np.diag([1.0, 1.0, 0.0]) * border[2, 2] * float(way[:2] @ way[:2])  # a turn swings the rest
        way = se2.compose(graph.step[k - 1], way)
    e = se2.between(way, se2.between(graph.pose[first], graph.pose[last]))
    far = np.hypot(e[0], e[1]) > DISPUTED_XY or abs(e[2]) > DISPUTED_TURN
    return ((first, last), e) if far and e @ np.linalg.solve(cov, e) > DISPUTED**2 else None


def way_bent(graph: RobotGraph) -> tuple[Finding, ...]:
    """Findings where places bend the trajectory far beyond what its steps may err by, as places that look alike do.

    Of all stretches of as many steps as `STRETCHES` tells that which is bent most, against the covariance that its
    steps have together; over a border nothing is known, so that nothing can be bent. Where a score of places hold what
    came before to what came after, a robot slid by metres, as along a corridor, and they have mended it; where such a
    slide was laid upon one step, scans beside it may be as far off.
    """
    e = se2.between(graph.step, se2.between(graph.pose[:-1], graph.pose[1:]))[:, :2]
    slid = np.hypot(e[:, 0], e[:, 1]) * [why == CONTRADICTED for why in graph.border[1:]]
    found = [
        Finding("way-slid", graph.robot, (float(graph.t[k]), float(graph.t[k + 1])), float(slid[k]))
        for k in np.flatnonzero(slid > SLID_FROM).tolist()
    ]
    e[[bool(why) for why in graph.border[1:]]] = 0.0
    off = np.concatenate([np.zeros((1, 2)), np.cumsum(e, axis=0)])
    cov = np.concatenate([np.zeros((1, 2, 2)), np.cumsum(np.linalg.inv(graph.step_information)[:, :2, :2], axis=0)])
    worst = (0.0, 0.0, 0, 0)
    for steps in STRETCHES:
        if steps > len(e):
            break
        bent = off[steps:] - off[:-steps]
        sds = np.sqrt(np.einsum("ki,kij,kj->k", bent, np.linalg.inv(cov[steps:] - cov[:-steps]), bent))
        far = np.hypot(bent[:, 0], bent[:, 1])
        k = int(np.argmax(np.where(far > BENT, sds, 0.0)))
        worst = max(worst, (float(sds[k]) if far[k] > BENT else 0.0, float(far[k]), k, k + steps))
    first, last = worst[2], worst[3]
    if worst[0] <= BENT_SDS or (worst[1] <= SLID and _places_over(graph, first, last) >= SLID_HELD):
        return tuple(found)
    value = {"value": worst[1], "way": float(graph.path[last] - graph.path[first]), "sd": worst[0]}
    return (*found, Finding("way-bent", graph.robot, (float(graph.t[first]), float(graph.t[last])), value))


def _places_over(graph: RobotGraph, first: int, last: int) -> int:
    """The places that hold what was before the middle half of a stretch to what was after it."""
    ends = [(c.first, c.second) for c in graph.closures if c.accepted]
    edge = (last - first) / 4
    return sum(min(pair) <= first + edge and max(pair) >= last - edge for pair in ends)


def way_loose(graph: RobotGraph) -> tuple[Finding, ...]:
    """A finding where the covariances say that the trajectory may be off by more than a map is good for.

    A piece that nothing ties to where the robot began has no place that could be sure, and `segment-apart` tells it.
    """
    cuts, piece = _pieces(graph)
    tied = np.repeat(np.asarray(piece) == piece[0], np.diff([0, *cuts, len(graph)]))
    sd = np.where(tied, np.sqrt(np.linalg.eigvalsh(graph.cov[:, :2, :2])[:, 1]), 0.0)
    all_loose = off_over_time(graph.t[tied], graph.cov[tied]) > LOOSE_ALL
    loose = np.flatnonzero(sd > (LOOSE_ALL if all_loose else LOOSE))
    if not len(loose):
        return ()
    span = (float(graph.t[loose[0]]), float(graph.t[loose[-1]]))
    return (Finding("way-loose", graph.robot, span, float(sd.max())),)


def off_over_time(t: Float[np.ndarray, " n"], cov: Float[np.ndarray, "n 3 3"]) -> float:
    """[m] root mean square over time by which places err, as their covariances say, wherever the stamps stand."""
    half = 0.5 * np.diff(t)
    weights = np.append(half, 0.0) + np.append(0.0, half)
    return float(np.sqrt(np.average(cov[:, 0, 0] + cov[:, 1, 1], weights=weights))) if weights.any() else 0.0


def still_apart(findings: Sequence[Finding], graph: RobotGraph, held: Sequence[int]) -> tuple[Finding, ...]:
    """The findings but for segments said to be apart that others tie: those of the pieces `held`, by `pieces_of`."""
    pieces = pieces_of(graph)
    tied = {float(t) for k in held for t in graph.t[pieces[k]]}
    return tuple(f for f in findings if f.code != "segment-apart" or f.span is None or f.span[0] not in tied)


def bridged(log: LaserLog, graph: RobotGraph, track: Track, dead: Track) -> tuple[LaserLog, Track]:
    """The log, and its dead reckoning, whose wheels tell over every border what the map does: set-backs are no motion.

    track, dead: the map's trajectory and the wheels' at the same stamps, those of all scans among them.
    """
    cuts = [k for k, why in enumerate(graph.border) if why and k]
    step = se2.between(dead.pose[:-1], dead.pose[1:])
    over = np.zeros(len(step), dtype=bool)
    for k in cuts:
        over |= (track.t[1:] > graph.t[k - 1]) & (track.t[1:] <= graph.t[k])
    step[over] = se2.between(track.pose[:-1], track.pose[1:])[over]
    pose = np.tile(np.asarray(dead.pose[0], dtype=float), (len(dead.t), 1))
    pose[1:, 2] += np.cumsum(step[:, 2])
    c, s = np.cos(pose[:-1, 2]), np.sin(pose[:-1, 2])
    pose[1:, 0] += np.cumsum(c * step[:, 0] - s * step[:, 1])
    pose[1:, 1] += np.cumsum(s * step[:, 0] + c * step[:, 1])
    wheels = Track(dead.t, pose, frame=dead.frame)
    rows = np.searchsorted(dead.t, log.scan_t).tolist()
    scans = tuple(replace(scan, odometry=frozen(pose[row])) for scan, row in zip(log.scans, rows, strict=True))
    return replace(log, odometry=wheels, scans=scans), wheels
