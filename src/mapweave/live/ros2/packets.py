"""Placed scans as the numbered messages of a history, packed by the robot's clock."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from ..columns import pack
from ..laser_stream import MOST_BYTES, beams_of
from ..messages import Closed, Header, Numbered, ScanBeams, Scans
from .assembly import Placed, Row


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
    _bytes: int = 0

    def add(self, placed: Sequence[Placed], rows: Sequence[Row]) -> list[Numbered]:
        """Whole messages now that these came."""
        out: list[Numbered] = []
        if self.header.odometry:
            self._rows += rows
        for t, scan in placed:
            if self._until is not None and t >= self._until:
                out += self._flush()
                self._until = None
            beams = beams_of(t, scan)
            size = len(beams.ranges) + len(beams.light or b"") + len(beams.hit)
            if self._bytes + size > MOST_BYTES:
                out += self._flush()
            self._scans.append(beams)
            self._bytes += size
            self._until = t + self.period if self._until is None else self._until
        return out

    def close(self) -> list[Numbered]:
        """The rest, and that it is the end."""
        out = self._flush()
        self.last += 1
        return [*out, Closed(robot=self.header.robot, run=self.header.run, seq=self.last)]

    def _flush(self) -> list[Numbered]:
        """The scans that wait, and odometry up to the last of them: what is later comes with later scans."""
        if not self._scans:
            return []
        self.last += 1
        end = bisect_right(self._rows, self._scans[-1].t, key=itemgetter(0))
        rows, self._rows = self._rows[:end], self._rows[end:]
        scans, self._scans, self._bytes = self._scans, [], 0
        track = pack(*zip(*rows, strict=True)) if rows else b""
        return [Scans(robot=self.header.robot, run=self.header.run, seq=self.last, track=track, scans=scans)]
