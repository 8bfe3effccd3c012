"""A laser log as numbered messages, and numbered messages as a laser log: the same scans, to the bit."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..core.findings import finding_of, unused_of
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track, frozen
from .door import expect_span, expect_steps
from .fix_stream import FixRecord, cuts_of, fixes_of, joined_fixes, packed, source_of
from .messages import (
    LARGEST,
    Closed,
    Header,
    Message,
    Numbered,
    RefusedError,
    ScanBeams,
    Scans,
    pack,
    squeeze,
    stretch,
    told_by,
    unpack,
)

MOST_AT_ONCE = 200_000  # beams of the scans in one message; a packet of more is split
MOST_BYTES = LARGEST // 2  # of the scans in one message; a packet of more is split


def messages_of_laser(log: LaserLog, robot: str, run: str, period: float) -> Iterator[tuple[float, Numbered]]:
    """All messages of a whole log and when each is complete [s]: what came in every `period` [s], header and end."""
    o = log.odometry
    stamps = [log.scan_t] if o is None else [log.scan_t, o.t]
    begin, end = min(float(t[0]) for t in stamps if len(t)), max(float(t[-1]) for t in stamps if len(t))
    yield begin, header_of(log, robot, run)
    cuts = np.arange(begin + period, end, period)
    seen = [0, *np.searchsorted(log.scan_t, cuts, side="right").tolist(), len(log.scans)]
    driven = [0] * len(seen) if o is None else [0, *np.searchsorted(o.t, cuts, side="right").tolist(), len(o.t)]
    seq, fixed = 0, cuts_of(log.fixes, cuts)
    for t, (a, b), (c, d), (e, f) in zip([*cuts.tolist(), end], *map(pairwise, (seen, driven, fixed)), strict=True):
        fixes = packed(log.fixes, e, f)
        track = pack(o.t[c:d], *o.pose[c:d].T) if o is not None and d > c else b""
        batch: list[ScanBeams] = []
        size = told = 0
        for k in range(a, b):
            beams = beams_of(float(log.scan_t[k]), log.scans[k])
            size += len(beams.ranges) + len(beams.light or b"") + len(beams.hit)
            batch.append(beams)
            told += beams.n
            if size > MOST_BYTES or told > MOST_AT_ONCE:
                seq += 1
                yield t, Scans(robot=robot, run=run, seq=seq, track=track, scans=batch, fixes=fixes)
                track, fixes, batch, size, told = b"", b"", [], 0, 0
        if batch or track or fixes:
            seq += 1
            yield t, Scans(robot=robot, run=run, seq=seq, track=track, scans=batch, fixes=fixes)
    yield end, Closed(robot=robot, run=run, seq=seq + 1)


def header_of(log: LaserLog, robot: str, run: str) -> Header:
    """What of a log is no row."""
    return Header(
        robot=robot,
        run=run,
        sensor="laser",
        log_robot=log.robot,
        source=log.source,
        odometry=log.odometry is not None,
        odometry_from=log.odometry_from,
        log_hash=log.log_hash,
        dropped=dict(log.dropped),
        findings=[found.row() for found in log.findings],
        unused=[left.row() for left in log.unused],
        sweep=log.sweep,
        fixes=source_of(log.fixes),
    )


def beams_of(t: float, scan: Scan) -> ScanBeams:
    """One scan, packed; see `squeeze` for ranges and light."""
    return ScanBeams(
        t=t,
        n=len(scan.ranges),
        ranges=squeeze(scan.ranges),
        hit=np.packbits(scan.hit).tobytes(),
        light=None if scan.intensities is None else squeeze(scan.intensities),
        angle_min=float(scan.angle_min),
        angle_increment=float(scan.angle_increment),
        range_max=float(scan.range_max),
        mount=tuple(scan.T_robot_sensor.tolist()),
        host=scan.host,
        odometry=None if scan.odometry is None else tuple(scan.odometry.tolist()),
        heading=scan.heading,
    )


def scan_of(beams: ScanBeams) -> Scan:
    """The scan of beams that came in by the door."""
    n = beams.n
    hit = np.unpackbits(np.frombuffer(beams.hit, np.uint8))
    return Scan(
        stretch(beams.ranges, n),
        frozen(hit[:n], dtype=bool),
        None if beams.light is None else stretch(beams.light, n),
        beams.angle_min,
        beams.angle_increment,
        beams.range_max,
        frozen(beams.mount),
        beams.host,
        None if beams.odometry is None else frozen(beams.odometry),
        beams.heading,
    )


@dataclass(slots=True)
class LaserRecord:
    """How far a laser robot's messages came, in the order of its numbers; their scans are not kept here.

    scans: how many came; t, driven: [s] stamps of the last scan and the last row of odometry; first: of the first of
    both. Where a log is told anew all that is of what came since.
    """

    header: Header
    scans: int = 0
    t: float = -np.inf
    driven: float = -np.inf
    first: float = np.nan
    closed: bool = False
    _light: bool | None = None
    _row: tuple[float, ...] | None = None  # t, x, y of the last row of odometry
    _at: tuple[float, ...] | None = None  # the same of the last scan
    _anew: Header | None = None
    _fixes: FixRecord = field(init=False)

    def __post_init__(self) -> None:
        self._fixes = FixRecord(self.header.fixes)

    def add(self, message: Numbered) -> LaserLog | None:
        """Its scans and odometry as a log of their own; raises RefusedError when they can't be this robot's."""
        if self.closed:
            raise RefusedError("malformed", "a message after the last one")
        if isinstance(message, Header):
            if (message.sensor, message.log_robot) != (self.header.sensor, self.header.log_robot):
                raise RefusedError("malformed", "a header of another log")
            self._anew = message
            return None
        if isinstance(message, Closed):
            self.closed, self.header = True, self._anew or self.header
            return None
        if not isinstance(message, Scans):
            raise RefusedError("sensor", f"{type(message).__name__} from a robot that announced a laser")
        if self._anew is not None:
            self._begin_anew(self._anew)
        track = unpack(message.track, 4)
        scans = [scan_of(beams) for beams in message.scans]
        stamps = [beams.t for beams in message.scans]
        self._expect(stamps, scans, track)
        self._expect_possible(stamps, scans, track)
        if stamps:
            self.t = stamps[-1]
            self._light = scans[0].intensities is not None
        if track.shape[1]:
            self.driven = float(track[0, -1])
        self.scans += len(scans)
        fixes = fixes_of(self.header.fixes, [self._fixes.add(message.fixes)])
        return replace(_log(self.header, stamps, scans, track), fixes=fixes)

    def _begin_anew(self, header: Header) -> None:
        fresh = LaserRecord(header)
        for name in self.__slots__:
            setattr(self, name, getattr(fresh, name))

    def _expect(self, stamps: list[float], scans: list[Scan], track: Float[np.ndarray, "4 n"]) -> None:
        if any(later < earlier for earlier, later in pairwise([self.t, *stamps])):
            raise RefusedError("malformed", "scans that step back in time")
        if not (np.diff(np.concatenate([[self.driven], track[0]])) > 0).all():
            raise RefusedError("malformed", "odometry that steps back in time")
        if track.shape[1] and not self.header.odometry:
            raise RefusedError("sensor", "odometry from a robot that announced none")
        light = self._light
        for scan in scans:
            light = scan.intensities is not None if light is None else light
            if (scan.intensities is not None) != light:
                raise RefusedError("sensor", "light in some scans and not in others")
            if (scan.odometry is None) == self.header.odometry:
                raise RefusedError("sensor", "scans whose odometry is not what was announced")

    def _expect_possible(self, stamps: list[float], scans: list[Scan], track: Float[np.ndarray, "4 n"]) -> None:
        """Raises RefusedError when it is more than a drive can be; remembers where odometry has come to."""
        first = expect_span(expect_span(self.first, track[0]), stamps)
        told = [
            (t, *scan.odometry[:2].tolist()) for t, scan in zip(stamps, scans, strict=True) if scan.odometry is not None
        ]
        row, at = _gone_on(self._row, track[:3].T.tolist()), _gone_on(self._at, told)
        self.first, self._row, self._at = first, row, at


def _gone_on(before: tuple[float, ...] | None, rows: Sequence[Sequence[float]]) -> tuple[float, ...] | None:
    """The last of `rows` of t, x, y, which go on from `before`; RefusedError when they step farther than robots do."""
    every = np.array([*([] if before is None else [before]), *rows]).reshape(-1, 3)
    expect_steps(every[:, 0], every[:, 1:], "odometry")
    return tuple(every[-1].tolist()) if len(every) else None


def scans_told(messages: Iterable[Message]) -> LaserLog | None:
    """The log that a laser robot's messages make, from its header on; None without one."""
    told = told_by(messages, LaserRecord)
    return None if told is None else whole_log(*told)


def whole_log(header: Header, parts: Iterable[LaserLog]) -> LaserLog:
    """The log of a robot from what its messages said, in their order."""
    stamps: list[float] = []
    scans: list[Scan] = []
    rows = [np.zeros((4, 0))]
    fixes = []
    for part in parts:
        stamps += part.scan_t.tolist()
        scans += part.scans
        if part.odometry is not None:
            rows.append(np.vstack([part.odometry.t, part.odometry.pose.T]))
        fixes += [] if part.fixes is None else [part.fixes]
    return replace(_log(header, stamps, scans, np.concatenate(rows, axis=1)), fixes=joined_fixes(header.fixes, fixes))


def _log(h: Header, stamps: list[float], scans: list[Scan], rows: Float[np.ndarray, "4 n"]) -> LaserLog:
    return LaserLog(
        h.log_robot,
        h.source,
        np.array(stamps),
        tuple(scans),
        Track(rows[0], rows[1:].T, frame="odom") if h.odometry else None,
        h.odometry_from,
        dict(h.dropped),
        tuple(map(finding_of, h.findings)),
        h.log_hash,
        sweep=h.sweep,
        unused=tuple(map(unused_of, h.unused)),
    )
