"""Scans that come one by one, from a program or a ROS graph, as the numbered messages of a robot."""

import math
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from queue import Empty, Queue
from threading import Event
from typing import Any, NamedTuple

from msgspec import structs

from ..core.errors import DataError
from ..core.names import robot_name
from ..core.records import Scan
from .laser_stream import MOST_BYTES, beams_of
from .messages import Closed, Header, Numbered, RefusedError, ScanBeams, Scans, pack, unpack

Row = tuple[float, float, float, float]  # t [s], x, y [m], theta [rad]
FixRow = Sequence[float]  # t [s], three of the place, variances as of `fix_columns`
Stamped = tuple[float, Scan]
WAITING = 1000  # scans: who hands in more waits


@dataclass(slots=True)
class Packets:
    """Messages after number `last` of a history. period: seconds of scans in one.

    `add` and `close` change it and give what is complete.
    """

    header: Header
    period: float
    last: int = 0
    _until: float | None = None
    _scans: list[ScanBeams] = field(default_factory=list)
    _rows: list[Row] = field(default_factory=list)
    _fixes: list[FixRow] = field(default_factory=list)
    _bytes: int = 0

    def add(self, placed: Sequence[Stamped], rows: Sequence[Row], fixes: Sequence[FixRow] = ()) -> list[Numbered]:
        """Whole messages now that these came."""
        out: list[Numbered] = []
        if self.header.odometry:
            self._rows += rows
        if self.header.fixes is not None:
            self._fixes += fixes
        for t, scan in placed:
            if self._until is not None and t >= self._until:
                out += self._flush(self._scans[-1].t)
                self._until = None
            beams = beams_of(t, scan)
            size = len(beams.ranges) + len(beams.light or b"") + len(beams.hit)
            if self._scans and self._bytes + size > MOST_BYTES:
                out += self._flush(self._scans[-1].t)
            self._scans.append(beams)
            self._bytes += size
            self._until = t + self.period if self._until is None else self._until
        return out

    def close(self) -> list[Numbered]:
        """The rest, and that it is the end."""
        out = self.rest()
        self.last += 1
        return [*out, Closed(robot=self.header.robot, run=self.header.run, seq=self.last)]

    def rest(self) -> list[Numbered]:
        """All that waits."""
        return self._flush(math.inf)

    def amended(self, header: Header) -> list[Numbered]:
        """All that waits, and the header once more, where it is another by now than it was told."""
        out = self.rest()
        if header != self.header:
            self.last += 1
            out.append(structs.replace(header, seq=self.last))
        return out

    def _flush(self, until: float) -> list[Numbered]:
        """The scans that wait, odometry and fixes up to `until` [s]: what is later comes with later scans."""
        (rows, self._rows), (fixes, self._fixes) = _cut(self._rows, until), _cut(self._fixes, until)
        scans, self._scans, self._bytes = self._scans, [], 0
        if not (scans or rows or fixes):
            return []
        self.last += 1
        track, places = _columns(rows), _columns(fixes)
        h = self.header
        return [Scans(robot=h.robot, run=h.run, seq=self.last, track=track, scans=scans, fixes=places)]


def _cut(rows: list[Any], until: float) -> tuple[list[Any], list[Any]]:
    """Those up to `until` [s], and those after it."""
    end = bisect_right(rows, until, key=itemgetter(0))
    return rows[:end], rows[end:]


def _columns(rows: Sequence[Sequence[float]]) -> bytes:
    return pack(*zip(*rows, strict=True)) if rows else b""


class ToldUntil(NamedTuple):
    """Stamps [s] of the last scan, odometry and fix of a history, and whether its scans have light; None of none."""

    scan: float | None = None
    odometry: float | None = None
    fix: float | None = None
    light: bool | None = None


def told_until(kept: Sequence[Numbered]) -> ToldUntil:
    """Until when a history goes."""
    told = ToldUntil()
    for message in kept:
        if isinstance(message, Scans):
            scans, track, fixes = message.scans, unpack(message.track, 4)[0], unpack(message.fixes, 7)[0]
            told = ToldUntil(
                scans[-1].t if scans else told.scan,
                float(track[-1]) if len(track) else told.odometry,
                float(fixes[-1]) if len(fixes) else told.fix,
                scans[0].light is not None if scans and told.light is None else told.light,
            )
    return told


def log_robot(name: str) -> str:
    """What a robot is called in the log of its drive: by the number that its name ends with."""
    number = re.search(r"(\d+)$", name)
    return robot_name("1" if number is None else str(int(number[1])))


class ScanFeed:
    """Scans that a program hands in with `put`, from any thread; the rest is asked by the robot's process.

    period: [s] of scans in one message. resumed: stamp [s] up to which scans are in the history already.
    """

    def __init__(self, name: str, run: str, period: float) -> None:
        self.resumed = float("-inf")
        self._name, self._run, self._period = name, run, period
        self._waiting: Queue[Stamped] = Queue(WAITING)
        self._packets: Packets | None = None
        self._driven = float("-inf")  # [s] stamp of the last odometry
        self._sweep = 0.0  # [s] that a scan takes
        self._known = Event()  # what the history holds

    def put(self, t: float, scan: Scan) -> None:
        """One scan; waits while too many do, and until it is known what the history holds."""
        self._known.wait()
        if t <= self.resumed:
            raise DataError(f"scan at {t} s: the history of {self._name} goes on after {self.resumed!r} s")
        self._waiting.put((t, scan))

    def resume(self, kept: Sequence[Numbered]) -> None:
        try:
            if kept and (isinstance(kept[-1], Closed) or not isinstance(kept[0], Header)):
                raise RefusedError("history", "this drive has ended; a fresh history begins a new one")
            if kept and isinstance(kept[0], Header):
                self._packets = Packets(kept[0], self._period, kept[-1].seq)
                told = told_until(kept)
                self.resumed = self.resumed if told.scan is None else told.scan
                self._driven = self._driven if told.odometry is None else told.odometry
        finally:
            self._known.set()

    def take(self, timeout: float) -> list[Numbered]:
        out: list[Numbered] = []
        try:
            out += self._told(*self._waiting.get(timeout=timeout))
            while True:
                out += self._told(*self._waiting.get_nowait())
        except Empty:
            return out

    def close(self) -> list[Numbered]:
        out = self.take(0.001)
        return out if self._packets is None else [*out, *self._packets.close()]

    def _told(self, t: float, scan: Scan) -> list[Numbered]:
        begin = self._packets is None
        if self._packets is None:
            self._packets = Packets(self._header(scan), self._period)
        rows = [] if scan.odometry is None or t <= self._driven else [(t, *scan.odometry.tolist())]
        self._driven = max(self._driven, t)
        return [*([self._packets.header] if begin else []), *self._packets.add([(t, scan)], rows)]

    def _header(self, scan: Scan) -> Header:
        return Header(
            robot=self._name,
            run=self._run,
            sensor="laser",
            log_robot=log_robot(self._name),
            source="scans as they came",
            odometry=scan.odometry is not None,
            odometry_from="none" if scan.odometry is None else "poses",
            log_hash=self._run,
            sweep=self._sweep,
        )
