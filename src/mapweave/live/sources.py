"""Where a live robot's rows come from: a log played at any rate, a recording still written, a simulated team."""

import math
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event

from ..core.errors import DataError, ReaderError, UsageError
from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from ..core.names import in_order, robot_key, robot_name
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
from .landmark_stream import messages_of
from .laser_feed import ScanFeed
from .laser_stream import messages_of_laser
from .messages import Numbered
from .range_stream import messages_of_ranges, of_robot

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


def open_recording(path: Path, name: str, robot: str | None, fixes: str | None = None) -> LaserLog:
    """The laser log of one robot of the recording at `path`, as far as it is written; errors as of `open_source`."""
    number = re.search(r"(\d+)$", name)
    key = robot if robot is not None else None if number is None else str(int(number[1]))
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
MAGIC = b"\x89MCAP0\r\n"  # ends an MCAP file that was closed

Read = Callable[[Path], LaserLog]


class BagFeed(ScanFeed):
    """The scans of the recording at `path` so far, each once and when its odometry is there too.

    `ended` is set when `stop` is, or when the recording was closed and all of it is read; one that was cut off is
    waited for, which is said, as is what cannot be read yet. read: gives the robot's log of the file as it is.
    """

    def __init__(
        self, path: Path, read: Read, name: str, run: str, period: float, stop: Event, say: Callable[[str], None]
    ) -> None:
        super().__init__(name, run, period)
        self.ended = Event()
        self._path, self._read, self._stop, self._say = path, read, stop, say
        self._size, self._due, self._grown = -1, 0.0, time.monotonic()
        self._last, self._said = -math.inf, set[str]()

    def resume(self, kept: Sequence[Numbered]) -> None:
        super().resume(kept)
        self._last = self.resumed

    def take(self, timeout: float) -> list[Numbered]:
        if self._stop.wait(timeout):
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
        out = self._new(whole=closed)
        self._due = now + IDLE * (time.monotonic() - now)
        return out

    def close(self) -> list[Numbered]:
        """What is left, although later odometry may be missing, and that the drive has ended."""
        out = self._new(whole=True)
        return [*out, *super().close()]

    def _new(self, *, whole: bool) -> list[Numbered]:
        """Messages of the scans that are new; but for the `whole` those alone that odometry has passed."""
        if not self._path.exists() or not is_bag(self._path):
            self._once(f"waits for {self._path}, which is no recording yet")
            return []
        try:
            log = self._read(self._path)
        except (ReaderError, DataError) as error:
            self._once(f"waits: {error}")
            return []
        for found in log.findings:
            if found.code != "log-short":
                self._once(found.text)
        self._sweep = log.sweep
        until = math.inf if whole or log.odometry is None else float(log.odometry.t[-1])
        out: list[Numbered] = []
        for t, scan in zip(log.scan_t.tolist(), log.scans, strict=True):
            if self._last < t <= until:
                out += self._told(t, scan)
                self._last = t
        return out

    def _once(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._say(f"{self._name}: {words}")


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
