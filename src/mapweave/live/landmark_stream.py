"""A landmark log as numbered messages, and numbered messages as a landmark log: the same rows, to the bit."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from ..core.findings import finding_of
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry
from .columns import pack, unpack
from .door import MOST_NAMES, expect_span
from .messages import Closed, Header, Numbered, RefusedError, Rows

MOST_SIGHTINGS = 20_000  # in one message; packets of a log are split beyond


def messages_of(log: LandmarkLog, robot: str, run: str, period: float) -> Iterator[tuple[float, Numbered]]:
    """All messages of a whole log and when each is complete [s]: the rows of every `period` [s], header and end.

    How rows are packed depends on the log and `period` alone, so that a robot started again goes on where it was.
    """
    begin, end = log.span
    yield (
        begin,
        Header(
            robot=robot,
            run=run,
            sensor="landmarks",
            log_robot=log.robot,
            source=log.source,
            odometry=log.odometry is not None,
            names=list(log.sightings.ids),
            dropped=dict(log.dropped),
            findings=[found.row() for found in log.findings],
            misread=pack(log.misread),
        ),
    )
    o, s = log.odometry, log.sightings
    cuts = np.arange(begin + period, end, period)
    driven = [0] if o is None else [0, *np.searchsorted(o.t, cuts, side="right").tolist(), len(o.t)]
    seen = [0, *np.searchsorted(s.t, cuts, side="right").tolist(), len(s)]
    driven = driven if o is not None else [0] * len(seen)
    seq = 0
    for t, (a, b), (c, d) in zip([*cuts.tolist(), end], pairwise(driven), pairwise(seen), strict=True):
        while b > a or d > c:
            most, rows = min(a + MOST_SIGHTINGS, b), min(c + MOST_SIGHTINGS, d)
            seq += 1
            drive = pack(o.t[a:most], o.v[a:most], o.w[a:most]) if o is not None and most > a else b""
            columns = (s.t[c:rows], s.range[c:rows], s.bearing[c:rows])
            what = s.what[c:rows].tolist()
            yield t, Rows(robot=robot, run=run, seq=seq, drive=drive, seen=pack(*columns), what=what)
            a, c = most, rows  # noqa: PLW2901  (what is left of this packet)
    yield end, Closed(robot=robot, run=run, seq=seq + 1)


@dataclass(frozen=True, slots=True)
class Part:
    """The rows of one message. what: index into the names known by then; t: (n,) [s]."""

    drive: Float[np.ndarray, "3 m"]
    seen: Float[np.ndarray, "3 n"]
    what: Int[np.ndarray, " n"]

    @property
    def end(self) -> float | None:
        """The last stamp [s] of its rows."""
        ends = [float(column[0, -1]) for column in (self.drive, self.seen) if column.shape[1]]
        return max(ends, default=None)


@dataclass(slots=True)
class LandmarkRecord:
    """What a robot has told so far, put together in the order of its numbers.

    keep: whether its rows are kept here, in `parts`; without, they are checked alone.
    """

    header: Header
    names: list[str]
    keep: bool = True
    parts: list[Part] = field(default_factory=list)
    closed: bool = False
    _driven: float = -np.inf
    _seen: float = -np.inf
    _first: float = np.nan

    @classmethod
    def begin(cls, header: Header, *, keep: bool = True) -> "LandmarkRecord":
        if not header.log_robot.removeprefix("robot").isdecimal():
            raise RefusedError("malformed", f"expected robotK as the robot of a landmark log, found {header.log_robot}")
        return cls(header, list(header.names), keep)

    def add(self, message: Numbered) -> Part | None:
        """Its rows, put after all others; raises RefusedError when they can't be those of this robot."""
        if self.closed:
            raise RefusedError("malformed", "a message after the last one")
        if isinstance(message, Closed):
            self.closed = True
            return None
        if not isinstance(message, Rows):
            raise RefusedError("sensor", f"{type(message).__name__} from a robot that announced landmarks")
        drive, seen = unpack(message.drive, 3), unpack(message.seen, 3)
        self._expect_later(drive[0], self._driven, "odometry")
        self._expect_later(seen[0], self._seen, "sightings")
        if drive.shape[1] and not self.header.odometry:
            raise RefusedError("sensor", "odometry from a robot that announced none")
        first = expect_span(expect_span(self._first, drive[0]), seen[0])
        names = [*self.names, *message.names]
        if len(names) > MOST_NAMES:
            raise RefusedError("oversized", f"{len(names)} names, at most {MOST_NAMES}")
        if len(set(names)) < len(names):
            raise RefusedError("malformed", "a name that is known already")
        what = np.array(message.what, dtype=np.int64)
        if (what >= len(names)).any():
            raise RefusedError("malformed", f"an index of {int(what.max())} among {len(names)} names")
        self.names, self._first = names, first
        self._driven = float(drive[0, -1]) if drive.shape[1] else self._driven
        self._seen = float(seen[0, -1]) if seen.shape[1] else self._seen
        part = Part(drive, seen, what)
        if self.keep:
            self.parts.append(part)
        return part

    @staticmethod
    def _expect_later(t: Float[np.ndarray, " n"], before: float, what: str) -> None:
        if len(t) and not (t[0] >= before and (np.diff(t) >= 0).all()):
            raise RefusedError("malformed", f"{what} that step back in time")

    def log_of(self, part: Part) -> LandmarkLog:
        """The rows of one message as a log of their own."""
        return self._log(part.drive, part.seen, part.what)

    @property
    def log(self) -> LandmarkLog:
        """All rows so far."""
        drive = np.concatenate([np.zeros((3, 0)), *(part.drive for part in self.parts)], axis=1)
        seen = np.concatenate([np.zeros((3, 0)), *(part.seen for part in self.parts)], axis=1)
        what = np.concatenate([np.zeros(0, np.int64), *(part.what for part in self.parts)])
        return self._log(drive, seen, what)

    def _log(
        self, drive: Float[np.ndarray, "3 m"], seen: Float[np.ndarray, "3 n"], what: Int[np.ndarray, " n"]
    ) -> LandmarkLog:
        h = self.header
        return LandmarkLog(
            h.log_robot,
            Odometry(drive[0].copy(), drive[1].copy(), drive[2].copy()) if h.odometry else None,
            SightingTable(seen[0], what, seen[1], seen[2], tuple(self.names)),
            h.dropped,
            tuple(map(finding_of, h.findings)),
            h.source,
            misread=unpack(h.misread, 1)[0],
        )
