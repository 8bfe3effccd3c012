"""From rows as a format gives them to a `LaserLog`: order, doubles, no-returns and intensities mended and counted.

Where the scene turns against the odometry, the beam angles have the wrong sign, which is told.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import DataError, ReaderError
from ..core.findings import Finding, Unused, Value
from ..core.fixes import Fixes
from ..core.laser_log import LEAST_RETURNS, LaserLog
from ..core.records import Scan, Track, expect_seconds, frozen
from .files import TextLog
from .inertial import IMU, Inertial, with_turns
from .scan_checks import (
    ENOUGH_ROWS,
    REPEAT,
    Mended,
    mended_stamps,
    range_difference,
    repeated,
    rows_by_scanner,
    scan_agreement,
    stampless,
    unit_of_ranges,
    wheels_in_inches,
    without_false_returns,
)

PAIRS = 400  # scan pairs looked at, at most
VOTES = 10  # pairs that must speak before anything is said
SHARE = 0.75  # of them against the odometry
FAST, FASTEST = 2.0, 25.0  # [m/s] at the median of the moments in which a robot drives: in inches may be, none is


def looks_mirrored(scans: Sequence[Scan]) -> bool:
    """True when consecutive scans agree clearly better under the turn opposite to the odometry's.

    Pairs with a turn of 0.05 to 0.6 rad and little travel are compared beam by beam; needs `Scan.odometry`.
    """
    votes = [vote for a, b in _turns(scans) if (vote := _vote(*a, b)) != 0]
    return len(votes) >= VOTES and votes.count(-1) > SHARE * len(votes)


def _turns(scans: Sequence[Scan]) -> list[tuple[tuple[Scan, float], Scan]]:
    """((scan, turn until the next), next) of the pairs worth asking, spread over the log."""
    poses = np.array([scan.odometry for scan in scans], dtype=float)
    step = se2.between(poses[:-1], poses[1:])
    turn, travel = step[:, 2], np.hypot(step[:, 0], step[:, 1])
    good = np.flatnonzero((np.abs(turn) > 0.05) & (np.abs(turn) < 0.6) & (travel < 0.3))
    good = good[:: max(1, len(good) // PAIRS)]
    return [((scans[k], float(turn[k])), scans[k + 1]) for k in good.tolist()]


def _speed(scans: Sequence[Scan], t: Float[np.ndarray, " n"]) -> float:
    """The median speed [m/s] that the wheels tell of moments in which the robot drives; 0 where it never does."""
    poses = np.array([scan.odometry for scan in scans], dtype=float)
    step = se2.between(poses[:-1], poses[1:])
    way, dt = np.hypot(step[:, 0], step[:, 1]), np.diff(t)
    drives = (way > 0) & (dt > 0)
    return float(np.median(way[drives] / dt[drives])) if drives.any() else 0.0


def _vote(a: Scan, turn: float, b: Scan) -> int:
    """1: the beams turn with the odometry, -1: against it, 0: cannot say."""
    shift = round(turn / a.angle_increment)
    n = len(a.ranges)
    if len(b.ranges) != n or abs(shift) < 2 or abs(shift) > n // 2:
        return 0
    right, wrong = range_difference(a, b, shift), range_difference(a, b, -shift)
    if right is None or wrong is None or max(right, wrong) < 1.2 * min(right, wrong):
        return 0
    return 1 if right < wrong else -1


LARGEST, LATEST = 1e9, 1e15  # [m or rad], [s]: what is more was never measured
CLOSEST, WIDEST = 1e-6, 4 * np.pi  # [rad] from beam to beam, and of all beams: what is less, or more, no scanner has
LONGEST_SWEEP = 10.0  # [s] of a scan: what takes longer is no scan
UNSOUND = "scan with a stamp, pose or angle that none can have"
UNTIMED = "odometry row whose time is not known"
FEW = 0.05  # share of scans without intensities that are dropped rather than all intensities


@dataclass(frozen=True, slots=True)
class RawScan:
    """A scan as the file has it: ranges may be NaN, infinite, zero or beyond the limits, which count as no return.

    kept: whether the ranges are here at all; of a scan without them nothing is told. sweep: [s] from its first beam to
    its last, 0 where the format does not say.
    """

    t: float
    ranges: np.ndarray
    intensities: np.ndarray | None
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    T_robot_sensor: Float[np.ndarray, "3"] = field(default_factory=lambda: se2.IDENTITY)
    host: str = ""
    odometry: Float[np.ndarray, "3"] | None = None
    kept: bool = True
    sweep: float = 0.0


@dataclass(slots=True)
class RawLog:
    """What a format reader has gathered; `finish` makes the `LaserLog`. scan_time: [s] from scan to scan, if stated."""

    robot: str
    source: str
    log_hash: str
    scans: list[RawScan] = field(default_factory=list)
    odometry: list[tuple[float, float, float, float]] = field(default_factory=list)
    odometry_from: str = "none"
    scan_time: float | None = None
    inertial: Inertial | None = None
    fixes: Fixes | None = None
    dropped: Counter = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)
    unused: list[Unused] = field(default_factory=list)

    def find(self, code: str, value: Value = None, action: str = "") -> None:
        """Add a finding of this robot."""
        self.findings.append(Finding(code, self.robot, None, value, action))

    def read_rows(self, log: TextLog, rows: Sequence[tuple[int, list[str]]], take: Callable[[list[str]], None]) -> None:
        """Gives `take` the words of each row of `log`. A last one cut short, which it refuses, is dropped and counted.

        Raises ReaderError, naming the line, where `take` raises ValueError or IndexError.
        """
        for number, words in rows:
            try:
                take(words)
            except (ValueError, IndexError) as error:
                if number == rows[-1][0] and (log.truncated or not log.complete):
                    self.dropped["last line cut short"] += 1
                    break
                raise ReaderError(log.path, str(error), number) from None
        if log.truncated:
            self.find("log-short", f"{log.path.name}: {log.truncated}", "what was readable is used")

    def finish(
        self, *, mirrored: bool = False, sensor_pose: Sequence[float] | None = None, used: bool = False
    ) -> LaserLog:
        """The log; `mirrored` turns the sense of all beam angles, `sensor_pose` replaces every `T_robot_sensor`.

        used: the scans went into a map already, as they are: false returns are told, not left out. Raises DataError
        when there is no scan at all.
        """
        expect_seconds(np.array([raw.t for raw in self.scans if np.isfinite(raw.t)]), self.source)
        good = [raw for raw in self.scans if is_sound(raw) and abs(raw.t) < LATEST]
        if len(good) < len(self.scans):
            self.dropped[UNSOUND] += len(self.scans) - len(good)
            self.scans = good
        if not self.scans:
            why = "".join(f"; left out, {n} times: {what}" for what, n in self.dropped.items())
            raise DataError(f"{self.source}: no laser scan in it{why and ' can be used'}{why}")
        self._mend_stamps()
        if not self.odometry:
            self.odometry = [odometry_row(raw.t, raw.odometry) for raw in self.scans if raw.odometry is not None]
        odometry = self._odometry()
        scans = self._in_order()
        scans = self._with_intensities(scans)
        self._tell_beams(scans)
        log_scans = self._with_odometry(
            [scan_of(raw, mirrored=mirrored, sensor_pose=sensor_pose) for raw in scans], scans, odometry
        )
        if (unit := unit_of_ranges(scans, [scan.odometry for scan in log_scans])) is not None:
            raise DataError(f"{self.source}: {unit}: expected metres")
        t = np.array([raw.t for raw in scans])
        if log_scans[0].odometry is not None and self._too_fast(scans, log_scans, t):
            log_scans, odometry = [replace(scan, odometry=None) for scan in log_scans], None
        if self.inertial is not None:
            log_scans, odometry = self._with_turns(self.inertial, t, log_scans, odometry)
        if not used and (again := repeated(log_scans)).any():
            self.dropped[REPEAT] += int(again.sum())
            t, log_scans = t[~again], [log_scans[k] for k in np.flatnonzero(~again).tolist()]
        log_scans = self._without_false_returns(log_scans, used=used)
        if log_scans[0].odometry is None:
            self.odometry_from = "none"
            self.find("no-odometry")
        elif looks_mirrored(log_scans):
            self.find("beams-mirrored")
        else:
            agreement = scan_agreement(log_scans)
            found = None if agreement is None else agreement.finding(self.robot)
            self.findings += [] if found is None else [found]
        return LaserLog(
            self.robot,
            self.source,
            t,
            tuple(log_scans),
            odometry,
            self.odometry_from,
            dict(self.dropped),
            tuple(self.findings),
            self.log_hash,
            sweep=_sweep(scans),
            unused=tuple(self.unused),
            fixes=self.fixes,
        )

    def _with_turns(
        self, told: Inertial, t: np.ndarray, scans: list[Scan], odometry: Track | None
    ) -> tuple[list[Scan], Track | None]:
        """The scans and the odometry with the turns of an IMU, where these are the better ones."""
        turned = with_turns(told, self.robot, t, scans, odometry)
        self.findings += turned.findings
        if turned.unused:
            self.unused.append(Unused(self.source, told.topic, IMU, len(told.rows), turned.unused))
        if odometry is None or turned.odometry is None:
            return turned.scans, None
        poses = poses_at(t, turned.odometry)
        return [replace(s, odometry=frozen(p)) for s, p in zip(turned.scans, poses, strict=True)], turned.odometry

    def _without_false_returns(self, scans: list[Scan], *, used: bool) -> list[Scan]:
        kept, left = without_false_returns(scans)
        if used:
            for what, n in left.items():
                self.find("false-returns", {"value": n, "what": what})
            return scans
        self.dropped.update(left)
        return kept

    def _too_fast(self, raw: Sequence[RawScan], scans: Sequence[Scan], t: Float[np.ndarray, " n"]) -> bool:
        """Whether no robot drives as the wheels tell, which is a finding then."""
        speed = _speed(scans, t)
        inches = speed > FAST and wheels_in_inches(raw, [scan.odometry for scan in scans])
        if inches or speed > FASTEST:
            unit = ", in inches beside the ranges," if inches else ""
            self.find("wheels-fast", speed, f"the odometry{unit} is not used")
        return inches or speed > FASTEST

    def _mend_stamps(self) -> None:
        """Scans whose stamps cannot be get new ones, in the file's order; odometry rows too, or they are left out."""
        mended = self._mended_scans()
        own = all(raw.odometry is not None for raw in self.scans)
        rows = np.array(self.odometry, dtype=float).reshape(-1, 4)
        good = (np.abs(rows) < np.array([LATEST, *[LARGEST] * 3])).all(axis=1)
        moves = np.append(False, (np.diff(rows[:, 1:], axis=0) != 0).any(axis=1))
        wrong = mended_stamps(rows[good, 0], moves[good])
        self._tell_stamps("scans", mended, len(self.scans))
        unknown = any(m.what == "equal" for m in mended)  # nothing says which of the rows belong to a scan
        if wrong is not None and wrong.what == "back" and not mended:
            if (without := stampless(rows[good, 0])).any():
                self.dropped[UNTIMED] += int(without.sum())
                self.odometry = [self.odometry[k] for k in np.flatnonzero(good)[~without].tolist()]
            return  # several loggers' rows in one file, as often: sorted
        if not len(rows) or (wrong is None and not unknown):
            return
        unknown |= wrong is not None and wrong.what == "equal"
        if unknown or wrong is None:
            self.dropped[UNTIMED] += len(rows)
            self.odometry = []
            if not own:
                self.find("wheels-untimed", len(rows), "they are not used")
            return
        self._tell_stamps("odometry", [wrong], len(rows))
        self.odometry = [(t, x, y, a) for t, (_, x, y, a) in zip(wrong.t.tolist(), rows[good].tolist(), strict=True)]

    def _mended_scans(self) -> list[Mended]:
        out = []
        scans = self.scans
        for rows in rows_by_scanner([(raw.T_robot_sensor.tobytes(), raw.host) for raw in scans]):
            t = np.array([scans[k].t for k in rows])
            other = np.array([True, *(_differ(scans[a], scans[b]) for a, b in pairwise(rows))])
            mended = mended_stamps(t, other, self.scan_time)
            if mended is not None:
                out.append(mended)
                for k, stamp in zip(rows, mended.t.tolist(), strict=True):
                    scans[k] = replace(scans[k], t=stamp)
        return out

    def _tell_stamps(self, what: str, mended: Sequence[Mended], rows: int) -> None:
        count = {kind: sum(m.rows for m in mended if m.what == kind) for kind in ("equal", "rounded", "back")}
        order = "they are taken in the file's order"
        if count["equal"]:
            self.find("stamps-equal", {"what": what, "value": count["equal"], "all": rows}, order)
        if count["rounded"]:
            self.find("stamps-rounded", {"what": what, "value": count["rounded"], "all": rows}, f"{order}, evenly")
        if count["back"]:
            self.find("stamps-back", {"what": what, "value": count["back"]}, order)

    def _odometry(self) -> Track | None:
        rows = np.array(self.odometry, dtype=float).reshape(-1, 4)
        good = (np.abs(rows) < np.array([LATEST, *[LARGEST] * 3])).all(axis=1)
        if not good.all():
            self.dropped["odometry row that is not finite"] += int((~good).sum())
            rows = rows[good]
        if not len(rows):
            return None
        if (back := int((np.diff(rows[:, 0]) < 0).sum())) > 0:
            self.find("stamps-back", {"what": "odometry", "value": back}, "sorted by stamp")
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
        last = np.append(rows[1:, 0] != rows[:-1, 0], True)
        if not last.all():
            self.dropped["odometry row whose stamp comes again"] += int((~last).sum())
        return Track(rows[last, 0], rows[last, 1:], frame="odom")

    def _in_order(self) -> list[RawScan]:
        scans = list(self.scans)
        back = sum(b.t < a.t for a, b in pairwise(scans))
        if back:
            self.find("stamps-back", {"what": "scans", "value": back}, "sorted by stamp")
            scans.sort(key=lambda raw: raw.t)
        out: list[RawScan] = []
        for raw in scans:
            if _doubles(raw, out):
                self.dropped["scan doubled"] += 1
            else:
                out.append(raw)
        return out

    def _with_intensities(self, scans: list[RawScan]) -> list[RawScan]:
        have = [raw.intensities is not None and len(raw.intensities) == len(raw.ranges) for raw in scans]
        without = have.count(False)
        other = sum(bool(raw.intensities is not None and len(raw.intensities)) for raw in scans) - have.count(True)
        if other and without > FEW * len(scans):
            self.find("light-unused", f"{other} of {len(scans)} scans hold another number of them than of ranges")
            return [replace(raw, intensities=None) for raw in scans]
        if without == len(scans):
            return [replace(raw, intensities=None) for raw in scans]
        if without > FEW * len(scans):
            self.find("light-unused", f"{without} of {len(scans)} scans have none")
            return [replace(raw, intensities=None) for raw in scans]
        if without:
            self.dropped["scan without intensities"] += without
            scans = [raw for raw, kept in zip(scans, have, strict=True) if kept]
        values = [_received(raw) for raw in scans]
        low = min((float(v.min()) for v in values if len(v)), default=0.0)
        high = max((float(v.max()) for v in values if len(v)), default=0.0)
        if low == high:
            self.find("light-unused", f"all intensities are {low:g}")
            return [replace(raw, intensities=None) for raw in scans]
        return scans

    def _tell_beams(self, scans: list[RawScan]) -> None:
        every, scans = len(scans), [raw for raw in scans if raw.kept]
        counts = Counter(len(raw.ranges) for raw in scans)
        if len(counts) > 1:
            listing = ", ".join(f"{n} beams in {k} scans" for n, k in counts.most_common())
            self.find("beams-change", listing)
        returns = [int(_hit(raw).sum()) for raw in scans]
        empty = returns.count(0)
        if empty == every:
            self.find("scans-blind", every)
        elif empty:
            self.find("scans-empty", {"value": empty, "all": every}, "odometry carries over them")
        if every > empty and every >= ENOUGH_ROWS and max(returns) < LEAST_RETURNS:
            self.find("scans-sparse", {"value": every, "least": LEAST_RETURNS})
        if nan := sum(int(np.isnan(raw.ranges).sum()) for raw in scans):
            self.find("ranges-nan", nan)

    def _with_odometry(self, log_scans: list[Scan], scans: list[RawScan], odometry: Track | None) -> list[Scan]:
        own = [raw.odometry for raw in scans]
        if odometry is None or all(pose is not None for pose in own):
            if any(pose is None for pose in own):
                return [replace(scan, odometry=None) for scan in log_scans]
            return [replace(scan, odometry=frozen(pose)) for scan, pose in zip(log_scans, own, strict=True)]
        outside = sum(not odometry.t[0] - 0.5 <= raw.t <= odometry.t[-1] + 0.5 for raw in scans)
        if outside:
            self.find("odometry-short", {"value": outside, "all": len(scans)}, "its nearest pose is taken")
        poses = poses_at(np.array([raw.t for raw in scans]), odometry)
        return [replace(scan, odometry=frozen(pose)) for scan, pose in zip(log_scans, poses, strict=True)]


def poses_at(t: Float[np.ndarray, " m"], track: Track) -> Float[np.ndarray, "m 3"]:
    """The track at `t`, interpolated; where a stamp of the track is hit its own pose, to the bit; ends held."""
    poses = se2.interpolate(t, track.t, track.pose)
    at = np.clip(np.searchsorted(track.t, t), 0, len(track.t) - 1)
    exact = track.t[at] == t
    poses[exact] = track.pose[at[exact]]
    return poses


def median_pose(poses: Iterable[Float[np.ndarray, "3"]]) -> tuple[Float[np.ndarray, "3"], float]:
    """The middle of many nearly equal poses and the largest deviation of nine in ten of them [m or rad]."""
    P = np.array(list(poses))
    mid = np.median(P, axis=0)
    mid[2] = P[0, 2] + np.median(se2.wrap_angle(P[:, 2] - P[0, 2]))
    off = P - mid
    off[:, 2] = se2.wrap_angle(off[:, 2])
    mid[2] = se2.wrap_angle(mid[2])
    return mid, float(np.quantile(np.abs(off).max(axis=1), 0.9))


def odometry_row(t: float, pose: Float[np.ndarray, "3"]) -> tuple[float, float, float, float]:
    return t, float(pose[0]), float(pose[1]), float(pose[2])


def _sweep(scans: Sequence[RawScan]) -> float:
    """[s] that a scan takes from its first beam to its last, the median; 0 where most do not say so, or no time."""
    told = [raw.sweep for raw in scans if 0.0 < raw.sweep < LONGEST_SWEEP]
    return float(np.median(told)) if 2 * len(told) > len(scans) else 0.0


def _differ(a: RawScan, b: RawScan) -> bool:
    return not np.array_equal(a.ranges, b.ranges, equal_nan=True)


def _doubles(raw: RawScan, before: list[RawScan]) -> bool:
    for other in reversed(before):
        if other.t != raw.t:
            return False
        if np.array_equal(other.T_robot_sensor, raw.T_robot_sensor):
            return True
    return False


@np.errstate(invalid="ignore")
def floats(values: Any) -> np.ndarray:
    """As 64-bit numbers, whatever kind of NaN is among them."""
    return np.asarray(values, dtype=float)


def is_sound(raw: RawScan) -> bool:
    """Whether poses and angles of a scan are numbers that a robot can have, and its stamp is one, of whatever unit."""
    poses = [raw.T_robot_sensor] if raw.odometry is None else [raw.T_robot_sensor, raw.odometry]
    numbers = np.concatenate([[raw.angle_min, raw.angle_increment], *poses])
    if not (np.isfinite(raw.t) and (np.abs(numbers) < LARGEST).all() and not np.isnan(raw.range_max)):
        return False
    step, n = abs(raw.angle_increment), len(raw.ranges)
    return n < 2 or bool(step >= CLOSEST and step * (n - 1) <= WIDEST)


def _hit(raw: RawScan) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        r = raw.ranges
        return np.asarray((r > 0) & (r < LARGEST) & (r >= raw.range_min) & (r < raw.range_max))


def _received(raw: RawScan) -> np.ndarray:
    assert raw.intensities is not None  # noqa: S101  (checked by the caller)
    values = raw.intensities[_hit(raw)]
    return np.asarray(values[np.isfinite(values)])


def scan_of(raw: RawScan, *, mirrored: bool = False, sensor_pose: Sequence[float] | None = None) -> Scan:
    """The record of `raw` without its odometry; options as of `RawLog.finish`."""
    hit = _hit(raw)
    sign = -1.0 if mirrored else 1.0
    light = None
    if raw.intensities is not None:
        light = np.where(hit & np.isfinite(raw.intensities), np.maximum(raw.intensities, 0.0), 0.0)
    return Scan(
        frozen(np.where(hit, raw.ranges, min(raw.range_max, LARGEST))),
        frozen(hit, dtype=bool),
        None if light is None else frozen(light),
        sign * raw.angle_min,
        sign * raw.angle_increment,
        raw.range_max,
        frozen(raw.T_robot_sensor if sensor_pose is None else np.asarray(sensor_pose, float)),
        raw.host,
    )
