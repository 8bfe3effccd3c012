"""What scans are asked while they are read: which returns are no walls, and whether they tell the wheels' motion.

No walls are the robot's own body, the hands of who carries it off, and a greatest range that stands for nothing seen.
Matched as walls they hold the robot in its place: what it carries along never moves against it, nor does what carries
it, and a ring of greatest ranges stands round it wherever it is.

A scanner mounted turned, and ranges or odometry in other units, show in the motion. A wall point seen again at the same
bearing lies nearer by the distance driven along the wall's normal, whatever the wall. So over moments of straight
driving the changes along the normals tell the motion as the scanner saw it: a factor and a direction against the
wheels' (the linear form of point-to-line matching, [Censi08]). No map is needed.

Stamps that cannot be are mended: all equal, rounded so that several rows share one, or going back. Rows stand in a file
in the order in which they were written, which is all that is left where stamps tell nothing. Ranges in another unit
than metres show by their size, and in which one by how they change as wheels drive.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding, turned_scanner
from ..core.laser_log import LEAST_RETURNS
from ..core.records import Scan, frozen

FALSE_RETURN_NEAR = 1.0  # [m] from the scanner: returns as near may be of the robot itself
FALSE_RETURN_SAME = 0.03  # [m] about its middle a beam's range stays there,
FALSE_RETURN_SHARE = 0.9  # in so many of the places looked at,
FALSE_RETURN_BESIDE = 0.3  # or in so many of them for a beam beside such a one: edges flicker
FALSE_RETURN_APART = 0.25  # [m] or [rad] from one place that is looked at to the next
FALSE_RETURN_PLACES = 20  # that are looked at, at least,
FALSE_RETURN_MOST_PLACES = 200  # and at most
FALSE_RETURN_TURNED = 6.0  # [rad] in all from place to place: driving straight, walls stay where they are, too
HELD_NEAR = 0.2  # [m] from the scanner, nearer than which hands and arms are of whoever carries the robot:
HELD_SHARE = 0.25  # of its beams at least, and on no one side of it, as a wall is,
HELD_REACH = 0.4  # [m] up to which they are left out then: arms are farther than hands;
HELD_MOST = 0.5  # but in no more of its scans: a robot that is always so is in a narrow place

FALSE_RETURN_SCANS = 20  # scans that are looked at for equal ranges, at least, and
EQUAL_SHARE = (0.02, 0.9)  # of their returns that have exactly the greatest range of all,
FALSE_RETURN_TIMES = 20.0  # as many as have any one range
FALSE_RETURN_BELOW = 0.1  # of it beneath, on average

SCAN_AGREEMENT_PAIRS = 400  # scans compared with a later one, at most
SCAN_AGREEMENT_AHEAD = 20  # scans, within which the later one is looked for
SCAN_AGREEMENT_WAY = (0.1, 0.6)  # [m] by the wheels between the two,
SCAN_AGREEMENT_TURN = 0.06  # [rad] and by how much at most they turn
SCAN_AGREEMENT_SLOPE = 0.25  # of the range, by which a beam's neighbours may differ in range to lie on one wall
SCAN_AGREEMENT_SIDE = 0.018  # [rad] to either side of a beam, whose returns tell how its wall lies
SCAN_AGREEMENT_NEAR = 0.6  # [m] along the normal, from which a change is of another wall
SCAN_AGREEMENT_LEAST_PAIRS = 40  # of scans that must speak
SCAN_AGREEMENT_SURE = 6.0  # standard deviations
SCAN_AGREEMENT_TURNED = 0.2  # [rad] from which a mounting is told,
SCAN_AGREEMENT_SEEN = 0.6  # where so much of the motion is seen: what slides along walls lowers it
SCAN_AGREEMENT_SCALE = (0.45, 1.4)  # outside which a factor is told,
SCAN_AGREEMENT_ACROSS = 0.35  # if walls across the motion make up so much of all: in corridors no motion is seen

REPEAT_STILL = 1e-6  # [m] and [rad] between scans, up to which wheels report no motion
REPEAT_SHARE = (0.1, 0.8)  # of the scans while it moves, that repeat the one before where that is a driver's habit
FROZEN_SCANS = 3  # that repeat one, at least: copies now and then come alone,
FROZEN = 0.2  # [m] or [rad] that a robot drives while scans repeat one, from which its scanner stands still in time
REPEAT = "scan that repeats the one before while the robot drives"

OWN = "return of the robot itself"
HELD = "return of what closed round the scanner for a while"
GREATEST = "greatest range, which stands for no return"


def without_false_returns(scans: Sequence[Scan]) -> tuple[list[Scan], Counter[str]]:
    """The scans without such returns, and how many of each kind were left out. Needs `Scan.odometry` for its own."""
    out, count = list(scans), Counter[str]()
    held = [closed_round(scan) for scan in scans]
    if sum(near is not None for near in held) < HELD_MOST * len(scans):
        for k, near in enumerate(held):
            if near is not None:
                count[HELD] += int(near.sum())
                out[k] = _without(scans[k], near)
    for rows in _alike(scans):
        if len(rows) < FALSE_RETURN_SCANS:
            continue
        group = [out[k] for k in rows]
        far = stands_for_nothing(np.concatenate([scan.ranges[scan.hit] for scan in group]))
        depth = own_body(group)
        for k in rows:
            scan = out[k]
            greatest, own = scan.hit & (scan.ranges >= far), scan.hit & (scan.ranges <= depth)
            if greatest.any() or own.any():
                count.update({GREATEST: int(greatest.sum()), OWN: int((own & ~greatest).sum())})
                out[k] = _without(scan, greatest | own)
    return out, +count


def closed_round(scan: Scan) -> Bool[np.ndarray, " n"] | None:
    """Which returns are of something that stands close round the scanner, on no one side; None where nothing does."""
    near = scan.hit & (scan.ranges < HELD_NEAR)
    if not near.any() or near.mean() < HELD_SHARE:
        return None
    way = np.sort(np.mod(scan.angles()[near], 2 * np.pi))
    on_no_side = np.diff(way, append=way[0] + 2 * np.pi).max() < np.pi
    return scan.hit & (scan.ranges < HELD_REACH) if on_no_side else None


def repeated(scans: Sequence[Scan]) -> Bool[np.ndarray, " m"]:
    """Which of the scans have the very ranges of the one before by the same scanner although the robot moved.

    Drivers that ask their scanner oftener than it turns send a revolution twice; the second comes with the stamp of a
    moment in which nothing was seen. Where few do it is no habit: they count if the robot drove on all the while, past
    a scanner that hung. None where so many do that nothing else is there. Without wheels those that come alone count:
    what stands is seen alike for longer.
    """
    out = np.zeros(len(scans), dtype=bool)
    for rows in rows_by_scanner([(scan.T_robot_sensor.tobytes(), "") for scan in scans]):
        group = [scans[k] for k in rows]
        same = np.array([False, *(is_same_revolution(a, b) for a, b in pairwise(group)), False])
        if any(scan.odometry is None for scan in group):
            moved = ~same[1:-1] | ~(same[:-2] | same[2:])
        else:
            moved = np.array([has_moved(a, b) for a, b in pairwise(group)], dtype=bool)
        again = same[1:-1] & moved
        if is_habit(int(again.sum()), int(moved.sum())):
            out[rows[1:]] = again
        elif again.sum() < REPEAT_SHARE[1] * moved.sum():
            out[rows[1:]] = again & _frozen(group, same[1:-1])
    return out


def _frozen(scans: Sequence[Scan], same: Bool[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Which of the scans after the first are of a run that repeats one while wheels drive away from there."""
    out = np.zeros(len(same), dtype=bool)
    begins = np.flatnonzero(same & ~np.append(False, same[:-1]))
    ends = np.flatnonzero(same & ~np.append(same[1:], False)) + 1
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        out[first:last] = is_frozen(scans[first], scans[last], last - first)
    return out


def is_frozen(first: Scan, last: Scan, repeats: int) -> bool:
    """Whether a scanner hung: the `repeats` scans up to `last` are `first` again, and the robot drove on."""
    return repeats >= FROZEN_SCANS and moved_by(first, last) > FROZEN


def is_same_revolution(a: Scan, b: Scan) -> bool:
    """Whether noise would have told two scans apart: all ranges are the same, and they are not one and the same."""
    same = np.array_equal(a.ranges, b.ranges) and np.array_equal(a.hit, b.hit)
    return same and len(np.unique(a.ranges[a.hit])) >= LEAST_RETURNS


def has_moved(a: Scan, b: Scan) -> bool:
    """Whether wheels tell of a motion between two scans."""
    return moved_by(a, b) > REPEAT_STILL


def moved_by(a: Scan, b: Scan) -> float:
    """How far wheels drove or turned between two scans [m] or [rad], whichever is more; 0 without wheels."""
    if a.odometry is None or b.odometry is None:
        return 0.0
    return float(np.abs(se2.between(a.odometry, b.odometry)).max())


def is_habit(repeats: int, moved: int) -> bool:
    """Whether a driver sends revolutions again: so many of the scans of a robot that moves repeat the one before."""
    return moved >= FALSE_RETURN_SCANS and REPEAT_SHARE[0] * moved <= repeats <= REPEAT_SHARE[1] * moved


def stands_for_nothing(ranges: Float[np.ndarray, " n"]) -> float:
    """The greatest of `ranges` where far more returns have exactly it than any other range near it, else infinite."""
    if not len(ranges):
        return np.inf
    top = float(ranges.max())
    equal = int((ranges == top).sum())
    below = ranges[(ranges < top) & (ranges >= (1.0 - FALSE_RETURN_BELOW) * top)]
    usual = len(below) / max(1, len(np.unique(below)))
    least, most = EQUAL_SHARE
    few = equal < max(least * len(ranges), FALSE_RETURN_TIMES * usual) or equal > most * len(ranges)
    return np.inf if few else top


def own_body(scans: Sequence[Scan]) -> Float[np.ndarray, " n"]:
    """Up to which range [m] each beam sees the robot itself; minus infinity for beams that see past it.

    scans: of one scanner with the same beams. A beam sees the robot where its range is near and stays the same
    wherever the robot stands and turns.
    """
    none = np.full(len(scans[0].ranges), -np.inf)
    rows = _places(scans)
    if len(rows) < FALSE_RETURN_PLACES:
        return none
    heading = np.array([scans[k].odometry[2] for k in rows])  # type: ignore[index]
    if np.abs(se2.wrap_angle(np.diff(heading))).sum() < FALSE_RETURN_TURNED:
        return none
    rows = rows[:: max(1, len(rows) // FALSE_RETURN_MOST_PLACES)]
    ranges, hit = np.array([scans[k].ranges for k in rows]), np.array([scans[k].hit for k in rows])
    middle = np.median(np.where(hit, ranges, np.inf), axis=0)
    stays = (hit & (np.abs(ranges - np.where(middle < np.inf, middle, -1.0)) <= FALSE_RETURN_SAME)).mean(axis=0)
    own = (middle <= FALSE_RETURN_NEAR) & (stays >= FALSE_RETURN_SHARE)
    beside = (middle <= FALSE_RETURN_NEAR) & (stays >= FALSE_RETURN_BESIDE) & (np.roll(own, 1) | np.roll(own, -1))
    return np.asarray(np.where(own | beside, middle + 2 * FALSE_RETURN_SAME, -np.inf))


def _alike(scans: Sequence[Scan]) -> Iterator[list[int]]:
    """The scans of each scanner that have ranges, by how their beams lie."""
    groups: dict[tuple[bytes, int, float, float], list[int]] = {}
    for k, scan in enumerate(scans):
        if len(scan.ranges):
            beams = scan.T_robot_sensor.tobytes(), len(scan.ranges), scan.angle_min, scan.angle_increment
            groups.setdefault(beams, []).append(k)
    return iter(groups.values())


def _places(scans: Sequence[Scan]) -> list[int]:
    """Scans from one place to the next by the wheels; none without odometry."""
    if any(scan.odometry is None for scan in scans):
        return []
    poses = np.array([scan.odometry for scan in scans], dtype=float).tolist()
    out, last = [0], poses[0]
    for k, pose in enumerate(poses):
        if max(abs(pose[0] - last[0]), abs(pose[1] - last[1]), abs(pose[2] - last[2])) >= FALSE_RETURN_APART:
            out.append(k)
            last = pose
    return out


def _without(scan: Scan, gone: Bool[np.ndarray, " n"]) -> Scan:
    hit = scan.hit & ~gone
    light = None if scan.intensities is None else frozen(np.where(hit, scan.intensities, 0.0))
    return replace(
        scan, ranges=frozen(np.where(hit, scan.ranges, scan.range_max)), hit=frozen(hit, np.bool_), intensities=light
    )


@dataclass(frozen=True, slots=True)
class ScanAgreement:
    """scale: of the scans' motion over the wheels'; direction: of it in the wheels' [rad], left positive; sds of both.

    across: the share of the walls seen that stands across the motion; pairs: of scans.
    """

    scale: float
    direction: float
    scale_sd: float
    direction_sd: float
    across: float
    pairs: int

    def finding(self, robot: str) -> Finding | None:
        """What contradicts; None where nothing clearly does."""
        if self.pairs < SCAN_AGREEMENT_LEAST_PAIRS:
            return None
        low, high = SCAN_AGREEMENT_SCALE
        if self.scale < low and self.across > SCAN_AGREEMENT_ACROSS:
            return Finding("wheels-unlike", robot, value=self.scale)
        if self.scale >= SCAN_AGREEMENT_SEEN and abs(self.direction) > max(
            SCAN_AGREEMENT_TURNED, SCAN_AGREEMENT_SURE * self.direction_sd
        ):
            return turned_scanner(robot, self.direction, self.direction_sd)
        if self.scale - SCAN_AGREEMENT_SURE * self.scale_sd > high:
            return Finding("wheels-unlike", robot, value=self.scale)
        return None


def scan_agreement(scans: Sequence[Scan]) -> ScanAgreement | None:
    """The motion that scans tell beside the wheels'; None where no two can be compared. Needs `Scan.odometry`."""
    rows, values, speaking = [np.zeros((0, 2))], [np.zeros(0)], 0
    for a, b, step in _straight(scans):
        changes = _changes(a, b, step)
        if changes is not None:
            rows.append(changes[0])
            values.append(changes[1])
            speaking += 1
    A, y = np.concatenate(rows), np.concatenate(values)
    if speaking < 2:
        return None
    x, cov = _robust(A, y)
    scale = float(np.hypot(*x))
    if scale == 0.0:
        return None
    along, across = x / scale, np.array([-x[1], x[0]]) / scale**2
    return ScanAgreement(
        scale,
        float(np.arctan2(x[1], x[0])),
        float(np.sqrt(along @ cov @ along)),
        float(np.sqrt(across @ cov @ across)),
        float((A[:, 0] ** 2).sum() / (A**2).sum()),
        speaking,
    )


def _straight(scans: Sequence[Scan]) -> list[tuple[Scan, Scan, Float[np.ndarray, "3"]]]:
    """(scan, a later one, the wheels' motion between them) where the robot drove on without turning."""
    poses = np.array([scan.odometry for scan in scans], dtype=float)
    out: list[tuple[Scan, Scan, Float[np.ndarray, 3]]] = []
    for k in range(0, len(scans) - 1, max(1, len(scans) // SCAN_AGREEMENT_PAIRS)):
        step = se2.between(poses[[k]], poses[k + 1 : k + 1 + SCAN_AGREEMENT_AHEAD])
        way = np.hypot(step[:, 0], step[:, 1])
        good = np.flatnonzero(
            (way >= SCAN_AGREEMENT_WAY[0])
            & (way <= SCAN_AGREEMENT_WAY[1])
            & (np.abs(step[:, 2]) <= SCAN_AGREEMENT_TURN)
        )
        if len(good):
            out.append((scans[k], scans[k + 1 + int(good[0])], step[good[0]]))
    return out


def _changes(
    a: Scan, b: Scan, step: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]] | None:
    """Normals times the wheels' motion and times it turned left, and how much nearer each wall came; None where few."""
    n = len(a.ranges)
    if len(b.ranges) != n or n < 3:
        return None
    angle = a.angles()
    at = (angle - step[2] - b.angle_min) / b.angle_increment
    low = np.clip(np.floor(at).astype(np.intp), 0, n - 2)
    part = at - low
    seen = (part >= 0) & (part <= 1) & b.hit[low] & b.hit[low + 1] & _flat(b)[low]
    later = (1 - part) * b.ranges[low] + part * b.ranges[low + 1]
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    p = a.ranges[:, None] * direction
    side = max(1, round(SCAN_AGREEMENT_SIDE / max(abs(a.angle_increment), 1e-6)))
    if n <= 2 * side:
        return None
    tangent = np.zeros_like(p)
    weight = np.arange(side, -side - 1, -1.0)
    tangent[side:-side] = np.stack([np.convolve(column, weight, "valid") for column in p.T], axis=-1)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    size = np.hypot(*normal.T)
    whole = np.convolve(_flat(a), np.ones(2 * side), "valid") > 2 * side - 0.5
    flat = np.zeros(n, bool)
    flat[side:-side] = whole[: n - 2 * side]
    good = seen & a.hit & flat & (size > 0)
    if good.sum() < 20:
        return None
    normal = normal[good] / size[good, None]
    nearer = -np.sum(normal * (later[good] - a.ranges[good])[:, None] * direction[good], axis=1)
    _, _, yaw = a.T_robot_sensor
    ahead = se2.rotation(-float(yaw)) @ step[:2]
    rows = np.stack([normal @ ahead, normal @ np.array([-ahead[1], ahead[0]])], axis=-1)
    kept = np.abs(nearer) < SCAN_AGREEMENT_NEAR
    return rows[kept], nearer[kept]


def _flat(scan: Scan) -> Bool[np.ndarray, " n"]:
    """Whether a beam and the next hit one wall."""
    r = scan.ranges
    next_one = np.append(r[1:], np.inf)
    both = scan.hit & np.append(scan.hit[1:], False)
    return np.asarray(both & (np.abs(next_one - r) < SCAN_AGREEMENT_SLOPE * np.minimum(r, next_one)))


def _robust(A: Float[np.ndarray, "n 2"], y: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """The x of least absolute errors y - A x, by reweighted least squares, and its covariance."""
    weight = np.ones(len(y))
    H = np.eye(2)
    for _ in range(30):
        H = A.T @ (weight[:, None] * A) + 1e-9 * np.eye(2)
        x = np.linalg.solve(H, A.T @ (weight * y))
        error = np.abs(y - A @ x)
        weight = 1.0 / np.maximum(error, 0.005)
    noise = float(np.mean(weight * error**2))
    return x, noise * np.linalg.inv(H)


def range_difference(a: Scan, b: Scan, shift: int) -> float | None:
    """The mean range difference [m] of beam i of `b` and beam i + shift of `a`, each capped at half a metre."""
    n = len(a.ranges)
    low, high = max(0, -shift), min(n, n - shift)
    both = a.hit[low + shift : high + shift] & b.hit[low:high]
    if both.sum() < 20:
        return None
    d = np.abs(a.ranges[low + shift : high + shift] - b.ranges[low:high])[both]
    return float(np.minimum(d, 0.5).mean())


FAR = 25.0  # [m] that half the returns of few scanners in use exceed,
FARTHEST = 90.0  # [m] and of none
ABOUT = 1.7  # times a unit's factor by which ranges may change with the way, or as little
SHARE = 0.8  # of the ranges ahead that become shorter by less: some see walls along the way
ENOUGH = 20  # scans, and
MOST_SCANS = 200  # that are looked at
PILE = 0.1  # share of values at the very top that stands for no return
AHEAD = 0.35  # [rad] to either side of where the wheels lead
WAY, TURN = (0.1, 1.0), 0.1  # [m] and [rad] by the wheels from one scan to the next looked at: straight on
WAYS = 5  # that must tell
UNITS = {"centimetres": 100.0, "millimetres": 1000.0, "inches": 39.37}  # of which a metre holds so many


@runtime_checkable
class Ranged(Protocol):
    """A scan as a file has it."""

    @property
    def ranges(self) -> np.ndarray: ...
    @property
    def angle_min(self) -> float: ...
    @property
    def angle_increment(self) -> float: ...
    @property
    def T_robot_sensor(self) -> np.ndarray: ...
    @property
    def kept(self) -> bool: ...


def unit_of_ranges(scans: Sequence[Ranged], wheels: Sequence[np.ndarray | None]) -> str | None:
    """In words, in which unit ranges are that are not in metres; None where they may be. wheels: pose at each scan."""
    held = [scan for scan in scans if scan.kept and len(scan.ranges)]
    if len(held) < ENOUGH:
        return None
    some = held[:: max(1, len(held) // MOST_SCANS)]
    seen = np.concatenate([scan.ranges for scan in some])
    seen = seen[np.isfinite(seen) & (seen > 0) & (seen < 1e9)]
    if not len(seen):
        return None
    top = seen >= 0.99 * seen.max()
    seen = seen[~top] if PILE <= top.mean() < 1.0 else seen
    middle = float(np.median(seen))
    if middle <= FAR:
        return None
    ratio = _ratio(scans, wheels)
    told = f"half of the ranges exceed {middle:.4g}"
    if ratio is not None:
        off = {unit: max(ratio / factor, factor / ratio) for unit, factor in UNITS.items()}
        unit = min(off, key=lambda unit: off[unit])
        if off[unit] <= ABOUT:
            return f"the ranges are in {unit}: {told}, and they change by {ratio:.3g} times the way of the wheels"
    return f"the ranges are in centimetres or millimetres: {told}" if middle > FARTHEST else None


def wheels_in_inches(scans: Sequence[Ranged], wheels: Sequence[np.ndarray | None]) -> bool:
    """Whether ranges ahead change by the way of the wheels only where that counts as inches, not metres."""
    inches = np.array([1.0, 1.0, UNITS["inches"]]) / UNITS["inches"]
    ratio = _ratio(scans, [None if pose is None else pose * inches for pose in wheels])
    return ratio is not None and 1 / ABOUT < ratio < ABOUT


def _ratio(scans: Sequence[Ranged], wheels: Sequence[np.ndarray | None]) -> float | None:
    """By how many times the wheels' way the ranges ahead become shorter, in the median; None where too little tells."""
    places: list[tuple[Ranged, np.ndarray]] = []
    for scan, pose in zip(scans, wheels, strict=True):
        if pose is not None and (not places or np.hypot(*(pose - places[-1][1])[:2]) >= WAY[0]):
            places.append((scan, pose))
    ways = [way for (a, p), (b, q) in pairwise(places) if (way := _nearer(a, p, b, q)) is not None]
    ratio = float(np.median(ways)) if len(ways) >= WAYS else 0.0
    return ratio if ratio > 0 else None


def _nearer(a: Ranged, p: np.ndarray, b: Ranged, q: np.ndarray) -> float | None:
    """By how much the ranges ahead became shorter from one scan at `p` to the next at `q`, over the way."""
    if len(a.ranges) != len(b.ranges):
        return None
    step = q - p
    way = float(np.hypot(step[0], step[1]))
    if way > WAY[1] or abs(step[2]) > TURN:
        return None
    lead = float(np.arctan2(step[1], step[0]) - p[2] - a.T_robot_sensor[2])
    off = se2.wrap_angle(a.angle_min + a.angle_increment * np.arange(len(a.ranges)) - lead)
    change = _change(a.ranges, b.ranges, off)
    return None if change is None else change / way


def _change(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], off: Float[np.ndarray, " n"]) -> float | None:
    with np.errstate(invalid="ignore"):
        both = (np.abs(off) <= AHEAD) & np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)
        nearer = a[both] - b[both]
    return float(np.quantile(nearer, SHARE)) if both.sum() >= 3 else None


SAME = 0.3  # share of rows that bear the stamp of the one before, from which stamps are equal or rounded
ALIKE = 0.9  # share of rows of one stamp, of more it tells no time
ENOUGH_ROWS = 20  # rows, of fewer nobody can say that their stamps are rounded
LATE = 20  # rows by which one may be late and is sorted in
A_FEW = 3  # rows after which stamps go on, at most, where some bear none
AGAIN = 0.1  # by which a leap forward may differ from the one back that it takes back
USUAL = 1.0  # [s] from row to row, where neither the log nor its other rows tell


class Mended(NamedTuple):
    """t: (n,) [s] ascending in the file's order. what: "equal", "rounded" or "back"; rows: how many it is so of."""

    t: Float[np.ndarray, " n"]
    what: str
    rows: int


def mended_stamps(
    t: Float[np.ndarray, " n"], other: Bool[np.ndarray, " n"], step: float | None = None
) -> Mended | None:
    """Stamps in the file's order, None where those of the rows are right, or are right once sorted.

    other: whether a row says something else than the row before; step: [s] from row to row as the log states it.
    """
    if len(t) < 3:
        return None
    d = np.diff(t)
    same = (d == 0) & other[1:]
    stamps, count = np.unique(t, return_counts=True)
    most = float(stamps[count.argmax()])
    if count.max() == len(t) or (len(t) >= ENOUGH_ROWS and count.max() > ALIKE * len(t)):
        return Mended(most + _usual(d[:0], step) * np.arange(len(t)), "equal", int(same.sum())) if same.any() else None
    if np.abs(np.argsort(t, kind="stable") - np.arange(len(t))).max() > LATE:
        back = d < 0
        return Mended(
            t[0] + np.concatenate([[0.0], np.cumsum(_forward(np.where(same, _usual(d, step), d), step))]),
            "back",
            int(back.sum()),
        )
    if len(t) < ENOUGH_ROWS or same.mean() < SAME:
        return None
    return Mended(_spread(np.maximum.accumulate(t), step), "rounded", int(same.sum()))


def stampless(t: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Rows that bear no time, between others that do: a few, far behind those before, and no clock goes on in them.

    A second logger's rows between those of a first may be far behind, and their stamps go on.
    """
    latest = np.append(t[0], np.maximum.accumulate(t)[:-1])
    settled = np.append(np.full(min(LATE, len(t)), t[0]), latest[:-LATE])  # a row just before may be early
    soon = np.lib.stride_tricks.sliding_window_view(np.append(t[1:], np.full(A_FEW, np.inf)), A_FEW).max(axis=1)
    alone = (t < latest) & (soon >= settled)
    others, before = t[~alone], np.cumsum(~alone)[alone]
    alone[alone] = t[alone] < others[np.maximum(before - LATE, 0)]
    goes_on = np.diff(t[alone]) > 0
    return alone if 2 * goes_on.sum() <= len(goes_on) else np.zeros(len(t), bool)


def _usual(d: Float[np.ndarray, " m"], step: float | None) -> float:
    """[s] from row to row: as stated, or the median of those that go forward."""
    if step is not None and np.isfinite(step) and step > 0:
        return step
    return float(np.median(d[d > 0])) if (d > 0).any() else USUAL


def _forward(d: Float[np.ndarray, " m"], step: float | None) -> Float[np.ndarray, " m"]:
    """The steps, those back, and leaps forward that take one of them back, replaced by the usual one."""
    usual = _usual(d, step)
    out = np.array(d)
    for k in np.flatnonzero(d < 0).tolist():
        out[k] = usual
        near = slice(max(0, k - LATE), k + LATE)
        leaps = (d[near] > 10 * usual) & (np.abs(d[near] + d[k]) <= AGAIN * -d[k])
        out[near][leaps] = usual
    return out


def _spread(t: Float[np.ndarray, " n"], step: float | None) -> Float[np.ndarray, " n"]:
    """Rows of one stamp spread evenly until the next; those of the last as far apart as rows usually are."""
    first = np.flatnonzero(np.append(True, t[1:] > t[:-1]))
    count = np.diff(np.append(first, len(t)))
    gap = np.diff(t[first])
    usual = step if step is not None and step > 0 else float(np.median(gap / count[:-1]))
    each = np.append(np.minimum(gap / count[:-1], usual * 1.5), usual)
    inside = np.arange(len(t)) - np.repeat(first, count)
    return np.asarray(t + inside * np.repeat(each, count))


def rows_by_scanner(keys: Sequence[tuple[bytes, str]]) -> list[list[int]]:
    """The rows of each scanner and logger, in the file's order: clocks and order are theirs."""
    groups: dict[tuple[bytes, str], list[int]] = {}
    for k, key in enumerate(keys):
        groups.setdefault(key, []).append(k)
    return list(groups.values())
