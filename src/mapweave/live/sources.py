"""Where a live robot's rows come from: a log played at any rate, a recording still written, a simulated team."""

import hashlib
import math
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event

import numpy as np
from jaxtyping import Float
from msgspec import structs

from ..core import se2
from ..core.errors import DataError, ReaderError, UsageError
from ..core.fixes import Fixes
from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from ..core.names import in_order, robot_key, robot_name
from ..core.records import Scan, Track, frozen
from ..io.landmark_logs import is_landmark_log, read_landmark_logs
from ..io.laser_logs import LaserSource, is_bag, is_laser_log, read_laser, robots_of
from ..io.mixed_logs import is_mixed, read_mixed_landmarks, sorted_logs
from ..io.mrclam import write_mrclam
from ..io.range_bags import is_range_bag, read_range_bag
from ..io.unknown import not_known
from ..ranges.network import RangeLog
from ..sim.landmarks import TeamWorld, simulate_team
from ..sim.laser import drive
from ..sim.laser_worlds import OfficeConfig, office_route, office_world
from .fix_stream import fix_columns, source_of
from .landmark_stream import messages_of
from .laser_feed import Packets, ScanFeed
from .laser_stream import LaserRecord, messages_of_laser
from .messages import Header, Numbered, Radios
from .range_stream import messages_of_ranges, of_robot, ranges_told, told_of

LiveLog = LandmarkLog | LaserLog | RangeLog
LANDMARKS, OFFICE = "sim:landmarks", "sim:office"
SIMULATED = 5  # robots in the simulated team among landmarks
ROUTES = 1000  # the seed of robot K's route through the office of seed S is K + 1000 S


def open_source(
    source: str,
    name: str,
    robot: str | None,
    seed: int = 0,
    *,
    radios: Mapping[str, str] | None = None,
    fixes: str | None = None,
) -> LiveLog:
    """The log of one robot of `source`, as a reader gives it; raises UsageError when it is none or lacks the robot.

    robot: which one of those in the log; when None the one that `name` ends with the number of, or the only one.
    radios, fixes: as of `read_range_bag`; raises UsageError where there can be none.
    """
    path = Path(source)
    _expect_recording(path, radios, fixes)
    number = re.search(r"(\d+)$", name)
    key = robot if robot is not None else None if number is None else str(int(number[1]))
    if source == OFFICE:
        return _office(_whole(key, name), seed)
    if source == LANDMARKS:
        with tempfile.TemporaryDirectory() as folder:
            write_mrclam(Path(folder), simulate_team(TeamWorld(robots=SIMULATED), seed))
            logs = [replace(log, source=f"{LANDMARKS}-{seed}") for log in read_landmark_logs(Path(folder))]
        return _chosen(logs, key, name, source, asked=robot is not None)
    if source.startswith("sim:"):
        raise UsageError(f"--source {source}: expected {LANDMARKS} or {OFFICE}")
    if not path.exists():
        raise UsageError(f"--source {source}: no such file or folder")
    if is_mixed([path]):
        return _of_mixed(path, key, name, source, asked=robot is not None)
    if is_landmark_log(path):
        return _chosen(list(read_landmark_logs(path)), key, name, source, asked=robot is not None)
    if is_range_bag(path):
        return _ranging(read_range_bag(path, radios, fixes), key, name, asked=robot is not None)
    if is_laser_log(path):
        return _laser(path, LaserSource(fixes=fixes), key, name, asked=robot is not None)
    raise UsageError(f"--source {not_known(path)}")


def _expect_recording(path: Path, radios: Mapping[str, str] | None, fixes: str | None) -> None:
    """Raises UsageError for options of recordings where `path` is none."""
    recording = (radios or fixes is not None) and path.exists() and not is_mixed([path]) and is_bag(path)
    if radios and not (recording and is_range_bag(path)):
        raise UsageError(f"--radios: only for recordings of ranges, found {path}")
    if fixes is not None and not recording:
        raise UsageError(f"--fixes: only for recordings, found {path}")


def messages(log: LiveLog, robot: str, run: str, period: float) -> Iterator[tuple[float, Numbered]]:
    """What a robot with this log tells, and when [s] of the log's clock."""
    if isinstance(log, LaserLog):
        return messages_of_laser(log, robot, run, period)
    if isinstance(log, RangeLog):
        return messages_of_ranges(log, robot, run, period)
    return messages_of(log, robot, run, period)


def open_recording(
    path: Path, name: str, robot: str | None, fixes: str | None = None, radios: Mapping[str, str] | None = None
) -> LaserLog | RangeLog:
    """The log of one robot of the recording at `path`, as far as it is written; errors as of `open_source`."""
    number = re.search(r"(\d+)$", name)
    key = robot if robot is not None else None if number is None else str(int(number[1]))
    if is_range_bag(path, growing=True):
        return _ranging(read_range_bag(path, radios, fixes), key, name, asked=robot is not None)
    if radios:
        raise UsageError(f"--radios: only for recordings of ranges, found {path}")
    return _laser(path, LaserSource(fixes=fixes), key, name, asked=robot is not None)


def _laser(path: Path, source: LaserSource, key: str | None, name: str, *, asked: bool) -> LaserLog:
    """The only robot of a laser log, or the one of that name or number in it; the team calls it by `name`'s number."""
    there = robots_of(path, source)
    called = there[0]
    if len(there) > 1:
        names = [str(word) for word in there]
        if key in names:
            called = key
        elif key is not None and key.isdecimal() and 0 < int(key) <= len(names):
            called = names[int(key) - 1]
        else:
            raise UsageError(f"--robot: which robot is {name}? {path} holds {', '.join(names)}")
    elif asked and key != "1":
        raise UsageError(f"--robot {key}: {path} holds one robot: leave --robot away")
    number = re.search(r"(\d+)$", name)
    return read_laser(path, robot_name("1" if number is None else str(int(number[1]))), replace(source, name=called))


def _ranging(log: RangeLog, key: str | None, name: str, *, asked: bool) -> RangeLog:
    """What one robot of a recording of ranging radios tells: the one of that name, or the one of that number."""
    robots = sorted(log.odometry, key=in_order)
    there = [one for one in robots if key in {one, robot_key(one)}] or [
        one for one in robots if key is not None and key.isdecimal() and re.search(rf"(?<!\d)0*{int(key)}$", one)
    ]
    if not there and not asked and len(robots) == 1:
        there = robots
    if len(there) != 1:
        raise UsageError(f"--robot: which robot is {name}? {log.source} holds {', '.join(map(robot_key, robots))}")
    return of_robot(log, there[0])


def _of_mixed(path: Path, key: str | None, name: str, source: str, *, asked: bool) -> LandmarkLog | LaserLog:
    """The log of one robot of a mixed team's folder, as `map` reads it there; a robot tells of one sensor alone."""
    found = sorted_logs([path], LaserSource())
    logs = {log.robot: log for log in read_mixed_landmarks(found)}
    log = _chosen(list(logs.values()), key, name, source, asked=asked)
    laser = found.lasers.get(log.robot)
    if laser is None:
        return log
    if len(log):
        what = "a laser log and rows of wheels or sightings"
        raise UsageError(
            f"--source {source}: robot {robot_key(log.robot)} has {what}; a live robot has one sensor: give "
            f"{laser.path.name} alone, or a folder without it; `map` takes both"
        )
    return read_laser(laser.path, log.robot, laser.source)


def _office(k: int, seed: int) -> LaserLog:
    """Robot k's round through the office of `seed`, by a way of its own."""
    cfg, own = OfficeConfig(), k + ROUTES * seed
    simulated = drive(office_world(cfg, seed), office_route(cfg, own), cfg.drive, own)
    return replace(simulated.log, robot=robot_name(str(k)), source=f"{OFFICE}-{seed}-{k}")


def _whole(key: str | None, name: str) -> int:
    if key is None or not key.isdecimal():
        raise UsageError(f"--robot: which robot is {name}? Expected a number")
    return int(key)


def _chosen(logs: list[LandmarkLog], key: str | None, name: str, source: str, *, asked: bool) -> LandmarkLog:
    by = {log.robot: log for log in logs}
    robots = sorted(by, key=in_order)
    if key is not None and robot_name(key) in by:
        return by[robot_name(key)]
    there = ", ".join(map(robot_key, robots))
    if asked:
        raise UsageError(f"--robot {key}: {source} holds robots {there}")
    if len(robots) == 1:
        return by[robots[0]]
    raise UsageError(f"--robot: which robot is {name}? {source} holds {there}")


IDLE = 4.0  # times what a reading took pass before the next: it is read from its beginning
QUIET = 30.0  # [s] without growth after which that is said
RANGED = 0.5  # [s] by which stamps of ranges may be earlier than what was recorded before them
HEADED = 2.0  # [s] of the log that a scan waits for its heading at most
MAGIC = b"\x89MCAP0\r\n"  # ends an MCAP file that was closed

Read = Callable[[Path], LaserLog | RangeLog]


class BagFeed(ScanFeed):
    """What the recording at `path` holds so far, each scan, or range, once and when its odometry is there too.

    `ended` is set when `stop` is, or when the recording was closed and all of it is read; one that was cut off is
    waited for, which is said, as is what cannot be read yet. What shows in the whole of a log alone is told at the end:
    the log's header once more, and where it reads otherwise than it was told, all of it. read: gives the robot's log of
    the file as it is.
    """

    def __init__(
        self, path: Path, read: Read, name: str, run: str, period: float, stop: Event, say: Callable[[str], None]
    ) -> None:
        super().__init__(name, run, period)
        self.ended = Event()
        self._path, self._read, self._stop, self._say = path, read, stop, say
        self._size, self._due, self._grown = -1, 0.0, time.monotonic()
        self._last, self._said = -math.inf, set[str]()
        self._digest, self._behind, self._anew = LogDigest(), _Behind(), False

    def resume(self, kept: Sequence[Numbered]) -> None:
        super().resume(kept)
        self._last = self.resumed
        again = next((k for k, message in enumerate(kept) if k and isinstance(message, Header)), None)
        self._anew = again is not None  # it was ended before all of it was told once more
        header = kept[0] if kept and again is None else None
        if isinstance(header, Header) and header.sensor == "ranges":
            log = ranges_told(kept)
            if log is not None:
                self._digest.add_ranges(log)
                self._behind = self._behind.after_ranges(log)
        elif isinstance(header, Header):
            record = LaserRecord(header)
            for part in map(record.add, kept[1:]):
                if part is not None:
                    self._digest.add(part)
                    self._behind = self._behind.after(part)

    def take(self, timeout: float) -> list[Numbered]:
        if self._stop.wait(timeout) or self._anew:
            self.ended.set()
            return []
        now = time.monotonic()
        if now < self._due:
            return []
        size, closed = _size(self._path), _closed(self._path)
        if size == self._size:
            if closed:
                self.ended.set()
            elif now > self._grown + QUIET:
                self._once(f"{self._path} has not grown for {QUIET:.0f} s and was not closed: it is waited for")
            return []
        self._size, self._grown = size, now
        if closed:
            self.ended.set()
            return []
        log = self._logged()
        out = [] if log is None else self._new(log, _whole_until(log))
        self._due = now + IDLE * (time.monotonic() - now)
        return out

    def close(self) -> list[Numbered]:
        """What is left, although later odometry may be missing, what is known now alone, and that the drive has ended.

        Raises ReaderError, DataError or UsageError for a recording that was closed and cannot be read, or lacks the
        robot.
        """
        log = self._logged(closed=_closed(self._path))
        if log is None:
            return super().close()
        out = [] if self._anew else self._new(log, math.inf)
        if self._packets is None:
            return out
        header, begun, whole = self._header_of(log), self._packets.header, LogDigest()
        if header.sensor != begun.sensor:
            self._once(f"holds {header.sensor} where it held {begun.sensor}: what it holds now is not told")
            return [*out, *self._packets.close()]
        if isinstance(log, RangeLog):
            whole.add_ranges(log)
        else:
            whole.add(log)
        if not self._anew and whole.parts == self._digest.parts and header.names == begun.names:
            return [*out, *self._packets.amended(header), *self._packets.close()]
        out += self._packets.rest()
        first = self._packets.last + 1
        again = messages(log, self._name, self._run, self._period)
        return [*out, *(structs.replace(message, seq=first + message.seq) for _, message in again)]

    def _header_of(self, log: LaserLog | RangeLog) -> Header:
        header = next(messages(log, self._name, self._run, self._period))[1]
        assert isinstance(header, Header)  # noqa: S101  (the first of every log)
        return header

    def _logged(self, *, closed: bool = False) -> LaserLog | RangeLog | None:
        """The log so far, None of none yet, which is said; raises what is wrong with one that is `closed`."""
        if not self._path.exists() or not is_bag(self._path):
            self._once(f"waits for {self._path}, which is no recording yet")
            return None
        try:
            log = self._read(self._path)
        except (ReaderError, DataError, UsageError) as error:  # a robot, a radio or a topic may come later
            if closed:
                raise
            self._once(f"waits: {error}")
            return None
        for found in log.findings:
            if found.code != "log-short":
                self._once(found.text)
        return log

    def _new(self, log: LaserLog | RangeLog, until: float) -> list[Numbered]:
        """Messages of what is new up to `until` [s], as it goes on from what was told."""
        header = self._header_of(log) if self._packets is None else self._packets.header
        if isinstance(log, RangeLog):
            return self._new_ranges(log, header, until)
        part = self._behind.going_on(log, header, self._last, until)
        if part is None:
            self._once("reads otherwise than it did: what follows is told when it is closed")
            return []
        begin = self._packets is None and len(part.scans)
        if not begin and self._packets is None:
            return []
        self._packets = self._packets or Packets(header, self._period)
        self._digest.add(part)
        self._behind = self._behind.after(part)
        self._last = float(part.scan_t[-1]) if len(part.scans) else self._last
        o = part.odometry
        rows = [] if o is None else list(zip(o.t.tolist(), *o.pose.T.tolist(), strict=True))
        fixes = () if part.fixes is None else fix_columns(part.fixes).T.tolist()
        placed = list(zip(part.scan_t.tolist(), part.scans, strict=True))
        return [*([header] if begin else []), *self._packets.add(placed, rows, fixes)]

    def _new_ranges(self, log: RangeLog, header: Header, until: float) -> list[Numbered]:
        part = None if header.sensor != "ranges" else self._behind.ranges(log, header, until)
        if part is None:
            return []
        out: list[Numbered] = [] if self._packets is not None else [header]
        self._packets = self._packets or Packets(header, self._period)
        self._digest.add_ranges(part)
        self._behind = self._behind.after_ranges(part)
        for _, message in messages_of_ranges(part, self._name, self._run, self._period):
            if isinstance(message, Radios):
                self._packets.last += 1
                out.append(structs.replace(message, seq=self._packets.last))
        return out

    def _once(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._say(f"{self._name}: {words}")


def _whole_until(log: LaserLog | RangeLog) -> float:
    """Until when [s] what a recording that grows holds has all it will have: odometry, or headings that come late."""
    if isinstance(log, RangeLog):
        return log.span[1] - RANGED
    if log.odometry is not None:
        return float(log.odometry.t[-1])
    headed = [t for t, scan in zip(log.scan_t.tolist(), log.scans, strict=True) if scan.heading is not None]
    return max(headed[-1], float(log.scan_t[-1]) - HEADED) if headed else math.inf


class LogDigest:
    """A digest of scans or ranges, of odometry and fixes, in whatever parts they come. `add` changes it."""

    def __init__(self) -> None:
        self._all = tuple(hashlib.sha256() for _ in range(3))

    def add(self, log: LaserLog) -> None:
        scans, rows, fixes = self._all
        for t, s in zip(log.scan_t.tolist(), log.scans, strict=True):
            scans.update(repr((t, s.angle_min, s.angle_increment, s.range_max, s.host, s.heading)).encode())
            for column in (s.ranges, s.hit, s.intensities, s.T_robot_sensor, s.odometry):
                scans.update(b"none" if column is None else column.tobytes())
        if log.odometry is not None:
            rows.update(np.column_stack([log.odometry.t, log.odometry.pose]).tobytes())
        if log.fixes is not None:
            fixes.update(np.ascontiguousarray(fix_columns(log.fixes).T).tobytes())

    def add_ranges(self, log: RangeLog) -> None:
        """The same of what a robot tells that ranges."""
        ranges, rows, fixes = self._all
        (track,) = log.odometry.values()
        told = told_of(log)
        ends = ([log.names[k] for k in end[told].tolist()] for end in (log.a, log.b))
        for row in sorted(zip(log.t[told].tolist(), log.z[told].tolist(), *ends, strict=True)):
            ranges.update(repr(row).encode())
        rows.update(np.column_stack([track.t, track.pose]).tobytes())
        for found in log.fixes.values():
            fixes.update(np.ascontiguousarray(fix_columns(found).T).tobytes())

    @property
    def parts(self) -> tuple[str, ...]:
        return tuple(digest.hexdigest() for digest in self._all)


@dataclass(frozen=True, slots=True)
class _Behind:
    """What was told last: t [s] and `T_odom_robot`, t [s] and heading by a gyroscope, t [s] of a fix and of a range;
    lit: whether scans have light, None of none yet.
    """

    row: tuple[float, Float[np.ndarray, "3"]] | None = None
    turned: tuple[float, float] | None = None
    fixed: float = -math.inf
    lit: bool | None = None
    ranged: float = -math.inf

    def after_ranges(self, part: RangeLog) -> "_Behind":
        """The same after a part of what a robot tells that ranges."""
        (track,), fixes, t = part.odometry.values(), [f for f in part.fixes.values() if len(f)], part.t[told_of(part)]
        return replace(
            self,
            row=(float(track.t[-1]), track.pose[-1]),
            fixed=float(fixes[0].t[-1]) if fixes else self.fixed,
            ranged=float(t[-1]) if len(t) else self.ranged,
        )

    def ranges(self, log: RangeLog, header: Header, until: float) -> RangeLog | None:
        """What the log holds after what was told up to `until` [s], by the header's names; None without odometry."""
        ((name, track),) = log.odometry.items()
        rows = (track.t > (-math.inf if self.row is None else self.row[0])) & (track.t <= until)
        place = {known: k for k, known in enumerate(header.names)}
        index = np.array([place.get(one, -1) for one in log.names], np.int64)
        told = (log.t > self.ranged) & (log.t <= until) & (index[log.a] >= 0) & (index[log.b] >= 0)
        fixes = self._fixes(log.fixes.get(name), header, until)
        if name != header.log_robot or not rows.any():
            return None
        return replace(
            log,
            names=tuple(header.names),
            odometry={name: Track(track.t[rows], track.pose[rows], frame=track.frame)},
            a=index[log.a[told]],
            b=index[log.b[told]],
            t=log.t[told],
            z=log.z[told],
            fixes={} if fixes is None else {name: fixes},
        )

    def _fixes(self, fixes: Fixes | None, header: Header, until: float) -> Fixes | None:
        """Those that are new up to `until` [s], if they are of what was announced."""
        announced = header.fixes
        if fixes is None or announced is None:
            return None
        same = source_of(replace(fixes, dropped=announced.dropped)) == announced
        return fixes.select((fixes.t > self.fixed) & (fixes.t <= until)) if same else None

    def after(self, part: LaserLog) -> "_Behind":
        """The same after a part of the log."""
        o, f = part.odometry, part.fixes
        turned = [
            (t, s.heading) for t, s in zip(part.scan_t.tolist(), part.scans, strict=True) if s.heading is not None
        ]
        return replace(
            self,
            row=self.row if o is None else (float(o.t[-1]), o.pose[-1]),
            turned=turned[-1] if turned else self.turned,
            fixed=self.fixed if f is None or not len(f) else float(f.t[-1]),
            lit=part.has_intensity if part.scans else self.lit,
        )

    def going_on(self, log: LaserLog, header: Header, last: float, until: float) -> LaserLog | None:
        """What the log holds after what was told, scans after `last` [s], up to `until` [s]; None where it has not what
        was announced.

        Odometry and headings are of a gyroscope's bias that every reading finds anew: they go on from the last told.
        """
        if (header.odometry and log.odometry is None) or (self.lit and not log.has_intensity):
            return None
        keep = (log.scan_t > last) & (log.scan_t <= until)
        scans = [self._seen(log.scans[k], header) for k in np.flatnonzero(keep).tolist()]
        odometry, turn = log.odometry if header.odometry else None, self._turn(log)
        if odometry is not None:
            T = self._shift(odometry)
            rows = (odometry.t > (-math.inf if self.row is None else self.row[0])) & (odometry.t <= until)
            odometry = Track(odometry.t[rows], _moved(T, odometry.pose[rows]), frame=odometry.frame)
            scans = [s if s.odometry is None else replace(s, odometry=frozen(_moved(T, s.odometry))) for s in scans]
        if turn:
            scans = [s if s.heading is None else replace(s, heading=s.heading + turn) for s in scans]
        fixes = self._fixes(log.fixes, header, until)
        return replace(log, scan_t=log.scan_t[keep], scans=tuple(scans), odometry=odometry, fixes=fixes)

    def _seen(self, scan: Scan, header: Header) -> Scan:
        """The scan without what those before had none of."""
        odometry = scan.odometry if header.odometry else None
        return replace(scan, odometry=odometry, intensities=None if self.lit is False else scan.intensities)

    def _shift(self, odometry: Track) -> Float[np.ndarray, "3"] | None:
        """By what odometry is told elsewhere than it was; None where it is not."""
        if self.row is None:
            return None
        at = int(np.searchsorted(odometry.t, self.row[0]))
        if at == len(odometry.t) or odometry.t[at] != self.row[0] or (odometry.pose[at] == self.row[1]).all():
            return None
        return np.asarray(se2.compose(self.row[1], se2.inverse(odometry.pose[at])))

    def _turn(self, log: LaserLog) -> float:
        """By what headings are told otherwise than they were."""
        t, heading = self.turned or (math.nan, 0.0)
        there = (s.heading for k, s in zip(log.scan_t.tolist(), log.scans, strict=True) if k == t)
        now = next((found for found in there if found is not None), heading)
        return heading - now


def _moved(T: Float[np.ndarray, "3"] | None, poses: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    return poses if T is None else np.asarray(se2.compose(T, poses))


def _parts(path: Path) -> list[Path]:
    try:
        return sorted(path.iterdir()) if path.is_dir() else [path]
    except OSError:
        return []


def _size(path: Path) -> int:
    """Bytes of the recording, a database's journal too; -1 where there is none yet."""
    beside = [] if path.is_dir() else [path.with_name(f"{path.name}-wal")]
    there = [part for part in (*_parts(path), *beside) if part.is_file()]
    return sum(part.stat().st_size for part in there) if there else -1


def _closed(path: Path) -> bool:
    """Whether who wrote the recording has closed it: a folder with its metadata, an MCAP file with its end."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    try:
        with path.open("rb") as file:
            start, size = file.read(len(MAGIC)), file.seek(0, 2)
            if size < 2 * len(MAGIC) or start != MAGIC:
                return False
            file.seek(size - len(MAGIC))
            return file.read() == MAGIC
    except OSError:
        return False
