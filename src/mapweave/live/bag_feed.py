"""A recording that another program is still writing, as the scans of a robot that drives now."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event

from ..core.errors import DataError, ReaderError
from ..core.laser_log import LaserLog
from ..io.laser_logs import is_bag
from .laser_feed import ScanFeed
from .messages import Numbered

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
