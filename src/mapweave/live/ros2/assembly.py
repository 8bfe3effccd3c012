"""Scans of one robot, each with its odometry and its place on the robot, from ROS messages as they come."""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from time import monotonic
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.findings import Finding
from ...core.records import Scan, Track, frozen
from ...io.assemble import LONGEST_SWEEP, RawScan, floats, is_sound, poses_at, scan_of
from ...io.fixes import SAME_STAMP, fix_row
from ...io.inertial import Inertial, Unit, imu_row, with_turns
from ...io.scan_checks import has_moved, is_frozen, is_habit, is_same_revolution
from ...io.transforms import NOWHERE, Transforms, frame, in_range, planar, rigid, rotation_matrix
from ..door import GREATEST, MOST_BEAMS, expect_steps
from ..fix_stream import UNTOLD
from ..laser_feed import FixRow, Row, Stamped, ToldUntil
from ..messages import RefusedError

PATIENCE = 2.0  # [s] of the robot's clock, and of ours, that a scan waits for odometry and for its frame
GAP = 1.0  # [s] without odometry: scans within are not placed by what is before and after
LEAP = 60.0  # [s] that a stamp may be ahead of the one before; more is believed when three in a row say so
SURE = 3
MOST_WAITING = 2000  # scans
OTHER_SWEEP = 0.25  # share by which scanners of one kind differ at most in the time of a scan
UNDECIDED = 2000  # transforms kept while it is open whether odometry comes from tf
WINDOW = 400  # scans that tell of a gyroscope's unit and bias
TURNED_EVERY = 1.0  # [s] of scans that are given their headings together
MOST_TURNS = 50_000  # messages of an IMU
POSES, BY_TF, NO_ODOMETRY = "poses", "tf", "none"


@dataclass(slots=True)
class Clock:
    """Stamps of one sensor, which only ascend."""

    what: str
    last: float | None = None
    _ahead: list[float] = field(default_factory=list)

    def take(self, t: float) -> None:
        """Raises RefusedError for a stamp that is not after the last, and for a leap that others do not confirm."""
        if t <= 0:
            raise RefusedError("stamp", f"{self.what} without a stamp")
        if self.last is not None and t <= self.last:
            raise RefusedError("clock", f"{self.what} {self.last - t:.3g} s before the last one: refused until past it")
        if self.last is not None and t > self.last + LEAP:
            goes_on = bool(self._ahead) and self._ahead[-1] < t <= self._ahead[-1] + LEAP
            self._ahead = [*self._ahead, t] if goes_on else [t]
            if len(self._ahead) < SURE:
                raise RefusedError("clock", f"{self.what} {t - self.last:.3g} s after the last one")
        self._ahead = []
        self.last = t


class Assembly:
    """What one robot's messages make. `scan`, `odometry` and `transforms` change it; `ready` takes what is whole.

    wheels: where odometry comes from: "poses", "tf" or "none". sensor_pose: `T_robot_sensor`, where no transform
    tells it. sweep: [s] that a scan takes, as its driver states it. fix_frame: of position fixes; fixes_left: those
    that tell nothing, by reason. refused: messages not used, by reason; first_refusals: the first of each reason.
    """

    def __init__(self, wheels: str = POSES, sensor_pose: Sequence[float] | None = None) -> None:
        self.wheels = wheels
        self.refused: Counter[str] = Counter()
        self.first_refusals: dict[str, str] = {}
        self.odom_frame = self.base_frame = self.sensor_frame = self.fix_frame = ""
        self.fixes_left: Counter[str] = Counter()
        self.sweep = 0.0
        self.latest: Row | None = None
        self._given = None if sensor_pose is None else frozen(sensor_pose)
        self._tf = Transforms()
        self._places: dict[str, tuple[np.ndarray, bool]] = {}
        self._wheels_clock, self._fix_clock = Clock("odometry"), Clock("a position fix")
        self._fixes: list[FixRow] = []
        self._scanners: dict[str, Clock] = {}
        self._told_until: float | None = None  # [s] stamp of the last scan that was told
        # of each frame the first and the last of the scans with the ranges of the latest, and how many repeat the first
        self._before: dict[str, tuple[Scan, Scan, int]] = {}
        self._moved = self._again = 0  # scans of a robot that moved, and of those what repeats the one before
        self._waiting: deque[tuple[RawScan, str, float]] = deque()  # each with its frame, and when it came
        self._undecided: deque[tuple[float, tuple[float, float, float], tuple[str, str]]] = deque(maxlen=UNDECIDED)
        self._rows: list[Row] = []
        self._fresh: list[Row] = []
        self._light: bool | None = None
        self._sweeps: dict[str, float] = {}  # of each scanner, once it is stated
        self._told_sweep: float | None = None

    def resume(self, told: ToldUntil, *, sweep: float | None = None) -> None:
        """What was told already: only later scans, odometry and fixes are used.

        sweep: [s] that each scan took, of a robot with one scanner.
        """
        self._told_until, self._light = told.scan, told.light
        self._wheels_clock.last, self._fix_clock.last = told.odometry, told.fix
        self._told_sweep = None if told.scan is None else sweep

    def refuse(self, error: RefusedError) -> None:
        """Counted; the first of each reason is kept in words."""
        self.refused[error.reason] += 1
        self.first_refusals.setdefault(error.reason, str(error))

    def transforms(self, message: Any) -> None:
        """Of each edge the first transform, and whether it ever moved; odometry where that comes from tf."""
        for one in message.transforms:
            edge = frame(one.header.frame_id), frame(one.child_frame_id)
            pose = rigid(one.transform.translation, one.transform.rotation)
            if not (edge[0] and edge[1] and _sound(pose)):
                self.refuse(RefusedError("malformed", f"a transform from {edge[0]!r} to {edge[1]!r} that is none"))
                continue
            if edge not in self._tf.seen:
                self._tf.add(0.0, one)
                self._places.clear()
            elif len(self._tf.seen[edge]) == 1:
                self._tf.add(0.0, one)
                if not self._tf.moves(edge):
                    self._tf.seen[edge].pop()
            row = _stamp(one.header), planar(pose), edge
            if self.wheels == BY_TF and edge == self.odometry_edge:
                self._row(*row)
            elif self.wheels == POSES and not self._rows:
                self._undecided.append(row)

    def take_tf(self) -> None:
        """Odometry is the transform that is found for it, those that came already among them."""
        self.wheels = BY_TF
        edge = self.odometry_edge
        for row in self._undecided:
            if row[2] == edge:
                self._row(*row)
        self._undecided.clear()

    @property
    def odometry_edge(self) -> tuple[str, str] | None:
        """The transform that is the odometry, as far as frames tell; None while none is known."""
        return self._tf.odometry_edge(self.sensor_frame) if self.sensor_frame else None

    def odometry(self, message: Any) -> None:
        """One Odometry."""
        pose = rigid(message.pose.pose.position, message.pose.pose.orientation)
        if not _sound(pose):
            self.refuse(RefusedError("malformed", "odometry that is no pose"))
        elif self.wheels == POSES:
            self._row(
                _stamp(message.header), planar(pose), (frame(message.header.frame_id), frame(message.child_frame_id))
            )

    def fix(self, message: Any) -> None:
        """One position fix, of whatever type tells such."""
        t = _stamp(message.header)
        row = fix_row(t, message)
        if isinstance(row, str) or t == self._fix_clock.last:
            self.fixes_left[row if isinstance(row, str) else SAME_STAMP] += 1
            return
        try:
            self._fix_clock.take(t)
        except RefusedError as error:
            self.refuse(error)
            return
        self.fix_frame = self.fix_frame or frame(message.header.frame_id)
        self._fixes.append((*row[:4], *(row[4:] if np.isfinite(row[4:]).all() else (UNTOLD,) * 3)))

    def fixes(self) -> list[FixRow]:
        """Those since the last time."""
        out, self._fixes = self._fixes, []
        return out

    def up(self, name: str) -> Float[np.ndarray, "3"]:
        """Which way is up in a frame, as far as transforms tell: its own z, where they do not."""
        place = self._tf.rigid_pose(self.base_frame, name) if self.base_frame else None
        return np.asarray(rotation_matrix((place or NOWHERE)[1])[2])

    @property
    def antenna(self) -> tuple[float, ...]:
        """Where tf has the frame of fixes on the robot; its origin where it has not."""
        place = self._tf.rigid_pose(self.base_frame, self.fix_frame) if self.base_frame and self.fix_frame else None
        return (0.0, 0.0) if place is None else tuple(map(float, place[0][:2]))

    def _row(self, t: float, pose: tuple[float, float, float], edge: tuple[str, str]) -> None:
        try:
            if self.latest is not None and t > self.latest[0]:
                expect_steps(np.array([self.latest[0], t]), np.array([self.latest[1:3], pose[:2]]), "odometry")
            self._wheels_clock.take(t)
        except RefusedError as error:
            self.refuse(error)
            return
        self.odom_frame, self.base_frame = edge
        self.latest = (t, *pose)
        self._rows.append(self.latest)
        self._fresh.append(self.latest)

    def scan(self, message: Any, scanner: str = "") -> None:
        """One LaserScan of one of the robot's scanners."""
        try:
            raw = self._raw(message)
            self._expect_scanner(raw, scanner)
            self._take_stamp(raw.t, scanner)
            self.sweep = self.sweep or self._sweeps.get(scanner, 0.0)
        except RefusedError as error:
            self.refuse(error)
            return
        name = frame(message.header.frame_id)
        self.sensor_frame = self.sensor_frame or name
        after = next((k for k in range(len(self._waiting), 0, -1) if self._waiting[k - 1][0].t <= raw.t), 0)
        self._waiting.insert(after, (raw, name, monotonic()))
        if len(self._waiting) > MOST_WAITING:
            self._waiting.popleft()
            self.refuse(RefusedError("late", "scans that nothing placed"))

    def _expect_scanner(self, raw: RawScan, scanner: str) -> None:
        """Raises RefusedError for a scan that takes another time than those before: all are read with one."""
        stated = raw.sweep if 0.0 < raw.sweep < LONGEST_SWEEP else 0.0
        known = self._sweeps.get(scanner, self._told_sweep)
        if known is not None and abs(stated - known) > OTHER_SWEEP * max(stated, known):
            raise RefusedError(
                "scanner", f"a scan of {stated:.3g} s after such of {known:.3g} s: another scanner is another history"
            )
        if stated > 0.0:
            self._sweeps.setdefault(scanner, stated)

    def _take_stamp(self, t: float, scanner: str) -> None:
        """Raises RefusedError for one that is not after the scanner's last, and for one before what was told."""
        self._scanners.setdefault(scanner, Clock("a scan", self._told_until)).take(t)
        if self._told_until is not None and t < self._told_until:
            raise RefusedError(
                "late", f"a scan {self._told_until - t:.3g} s before one of another scanner that was told"
            )

    def _raw(self, message: Any) -> RawScan:
        """Raises RefusedError when its numbers do not make a scan."""
        ranges, light = floats(message.ranges), floats(message.intensities)
        n = len(ranges)
        if not 2 <= n <= MOST_BEAMS:
            raise RefusedError("malformed", f"a scan of {n} beams")
        step = float(message.angle_increment) or (float(message.angle_max) - float(message.angle_min)) / (n - 1)
        limit = float(message.range_max)
        raw = RawScan(
            _stamp(message.header),
            ranges,
            light if len(light) == n else None,
            float(message.angle_min),
            step,
            float(message.range_min),
            limit if limit > 0 else np.inf,
            sweep=float(message.time_increment) * (n - 1),
        )
        if not is_sound(raw) or np.isnan(raw.range_min) or GREATEST < limit < np.inf:
            raise RefusedError("malformed", "a scan whose angles or limits are none")
        return raw

    def ready(self, *, all_of_them: bool = False) -> tuple[list[Stamped], list[Row]]:
        """Scans that are placed now, in the order of their stamps, and odometry rows since the last time.

        all_of_them: none will follow, so that those still waiting are refused.
        """
        out: list[Stamped] = []
        while self._waiting:
            raw, name, came = self._waiting[0]
            placed = self._placed(raw, name)
            newest = max((clock.last or 0.0) for clock in self._scanners.values())
            late = all_of_them or (newest - raw.t > PATIENCE and monotonic() - came > PATIENCE)
            if not late and (isinstance(placed, RefusedError) or self._earlier_may_come(raw.t)):
                break
            self._waiting.popleft()
            if isinstance(placed, RefusedError):
                self.refuse(placed)
            elif placed is not None:
                self._told_until = raw.t
                if self._repeats(placed, name):
                    self.refuse(RefusedError("repeated", "a scan with the ranges of the one before, though it moved"))
                    continue
                out.append((raw.t, placed))
        self._forget()
        rows, self._fresh = self._fresh, []
        return out, rows

    def _repeats(self, scan: Scan, name: str) -> bool:
        """Whether the driver sends a revolution again, as it has done before, or the scanner hangs."""
        first, before, repeats = self._before.get(name, (scan, None, 0))
        again = before is not None and is_same_revolution(before, scan)
        first, repeats = (first, repeats + 1) if again else (scan, 0)
        self._before[name] = first, scan, repeats
        if before is None or not has_moved(before, scan):
            return False
        self._moved += 1
        self._again += again
        return again and (is_habit(self._again, self._moved) or is_frozen(first, scan, repeats))

    def _earlier_may_come(self, t: float) -> bool:
        """Whether a scanner has told nothing as late as `t` yet."""
        return any((clock.last or 0.0) < t for clock in self._scanners.values())

    def _placed(self, raw: RawScan, name: str) -> Scan | RefusedError | None:
        """The scan; what it lacks yet; None when it will always lack it, which is counted."""
        place = self._place(name)
        if place is None:
            base = self.base_frame or "the robot"
            return RefusedError("frame", f"a scan in {name!r}, which no transform places on {base!r}")
        mount, upside_down = place
        sign = -1.0 if upside_down else 1.0
        raw = replace(
            raw, angle_min=sign * raw.angle_min, angle_increment=sign * raw.angle_increment, T_robot_sensor=mount
        )
        if self.wheels == NO_ODOMETRY:
            return self._lit(raw)
        if not self._rows or self._rows[-1][0] < raw.t:
            return RefusedError("odometry", "a scan without odometry")
        after = next(k for k, row in enumerate(self._rows) if row[0] >= raw.t)
        near = self._rows[max(after - 1, 0) : after + 1]
        if near[-1][0] != raw.t and (len(near) < 2 or near[1][0] - near[0][0] > GAP):
            self.refuse(RefusedError("odometry", "a scan without odometry"))
            return None
        rows = np.array(near)
        pose = poses_at(np.array([raw.t]), Track(rows[:, 0], rows[:, 1:], frame="odom"))[0]
        scan = self._lit(raw)
        return None if scan is None else replace(scan, odometry=frozen(pose))

    def _lit(self, raw: RawScan) -> Scan | None:
        """With intensities where the first scan had some; None, counted, for one that lacks them then."""
        if self._light is None:
            self._light = raw.intensities is not None and len(np.unique(raw.intensities)) > 1
        if self._light and raw.intensities is None:
            self.refuse(RefusedError("light", "a scan without intensities, though those before had some"))
            return None
        return scan_of(raw if self._light else replace(raw, intensities=None))

    def _place(self, name: str) -> tuple[np.ndarray, bool] | None:
        """`T_robot_sensor` and whether it hangs upside down; None while it is not known."""
        if name not in self._places:
            base = self.base_frame
            if not base and self.wheels == NO_ODOMETRY:
                base = self._tf.chain(name)[-1]
            place = self._tf.sensor_pose(base, name) if base else None
            if place is None and self._given is not None and name == self.sensor_frame:
                place = self._given, False
            if place is None:
                return None
            self._places[name] = place
            self.base_frame = base
        return self._places[name]

    def _forget(self) -> None:
        """Rows that no waiting scan needs, but the last two."""
        first = self._waiting[0][0].t if self._waiting else self._rows[-1][0] if self._rows else 0.0
        keep = next((k for k, (_, b) in enumerate(pairwise(self._rows)) if b[0] >= first), max(len(self._rows) - 2, 0))
        del self._rows[:keep]


class Gyroscope:
    """Headings of a robot without odometry: the turns of its IMU, as the reader of recordings finds them in scans.

    Of its unit and its bias the last scans tell. `turned` gives scans their headings, a second's at a time; a scan
    that came before scans had shown the unit has none.
    """

    def __init__(self, topic: str) -> None:
        self.frame = ""
        self.findings = list[Finding]()
        self._topic, self._unit, self._clock = topic, Unit(), Clock("a turn")
        self._rows: deque[tuple[float, ...]] = deque(maxlen=MOST_TURNS)
        self._waiting: list[Stamped] = []
        self._told: list[Stamped] = []  # the last ones
        self._due = -np.inf

    def add(self, message: Any) -> None:
        """One Imu; raises RefusedError for a stamp that cannot be."""
        row = imu_row(_stamp(message.header), message)
        self._clock.take(row[0])
        self.frame = self.frame or frame(message.header.frame_id)
        self._rows.append(row)

    def turned(self, placed: Sequence[Stamped], up: Float[np.ndarray, "3"], *, all_of_them: bool) -> list[Stamped]:
        """Scans whose turns are known by now, or will not be. up: in the unit's frame."""
        self._waiting += placed
        if not self._waiting or not (all_of_them or self._waiting[-1][0] > self._due):
            return []
        until = max(self._rows[-1][0] if self._rows else -np.inf, self._waiting[-1][0] - PATIENCE)
        out = [one for one in self._waiting if all_of_them or one[0] <= until]
        self._waiting = self._waiting[len(out) :]
        self._due = out[-1][0] + TURNED_EVERY if out else self._due
        told, out = self._told, self._headed(out, up) if out else out
        self._told = [*told, *out][-WINDOW:]
        while self._rows and self._told and self._rows[0][0] < self._told[0][0] - TURNED_EVERY:
            self._rows.popleft()
        return out

    def _headed(self, fresh: list[Stamped], up: Float[np.ndarray, "3"]) -> list[Stamped]:
        every = [*self._told, *fresh]
        t, scans = np.array([t for t, _ in every]), [scan for _, scan in every]
        rows = floats(list(self._rows)).reshape(-1, 7)
        found = with_turns(Inertial(self._topic, rows, up), "", t, scans, None, self._unit)
        self._unit = found.unit
        if found.unused or found.unit.scale is None:
            return fresh
        self.findings = [f for f in found.findings if f.code.startswith("imu-")]
        last = scans[len(self._told) - 1].heading if self._told else None
        here = found.scans[len(self._told) - 1].heading
        turn = 0.0 if last is None or here is None else last - here
        headed = [s.heading for s in found.scans[len(self._told) :]]
        return [
            (at, replace(scan, heading=None if heading is None else heading + turn))
            for (at, scan), heading in zip(fresh, headed, strict=True)
        ]


def _sound(pose: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]) -> bool:
    turn = pose[1]
    return in_range(pose) and abs(float(turn @ turn) - 1.0) < 0.1


def _stamp(header: Any) -> float:
    return float((header.stamp.sec * 10**9 + header.stamp.nanosec) / 1e9)
