"""A landmark log as numbered messages, and numbered messages as a landmark log: the same rows, to the bit.

And the robot that is driving: the estimator of `map`, one message at a time.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import EstimateError
from ..core.findings import finding_of, unused_of
from ..core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from ..core.records import Odometry
from ..core.run import Runner
from ..landmarks import ekf_slam
from ..landmarks.config import EkfSlamConfig
from ..landmarks.landmark_map import LocalMap, Submap
from ..landmarks.mapping import local_map, without_impossible
from .door import MOST_NAMES, decode, expect_span
from .fix_stream import FixRecord, cuts_of, fixes_of, packed, source_of
from .messages import Closed, Header, Message, Numbered, RefusedError, Rows, Snapshot, pack, pack_triangle, unpack
from .store import Store

WHEELS_LATE = 3.0  # [s] of its rows after which a robot that has told none of its wheels is taken to have none
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
            bearing_names=list(log.bearings.ids),
            dropped=dict(log.dropped),
            findings=[found.row() for found in log.findings],
            unused=[left.row() for left in log.unused],
            misread=pack(log.misread),
            fixes=source_of(log.fixes),
        ),
    )
    o, s, d = log.odometry, log.sightings, log.bearings
    cuts = np.arange(begin + period, end, period)
    tables = (np.zeros(0) if o is None else o.t, s.t, d.t)
    ends = [[0, *np.searchsorted(stamps, cuts, side="right").tolist(), len(stamps)] for stamps in tables]
    seq = 0
    fixed = pairwise(cuts_of(log.fixes, cuts))
    for t, *packet, fix in zip([*cuts.tolist(), end], *map(pairwise, ends), fixed, strict=True):
        left, fixes = packet, packed(log.fixes, *fix)
        while fixes or any(last > first for first, last in left):
            driven, seen, directed = (slice(first, min(first + MOST_SIGHTINGS, last)) for first, last in left)
            seq += 1
            yield (
                t,
                Rows(
                    robot=robot,
                    run=run,
                    seq=seq,
                    drive=b"" if o is None else pack(o.t[driven], o.v[driven], o.w[driven]),
                    seen=pack(s.t[seen], s.range[seen], s.bearing[seen]),
                    what=s.what[seen].tolist(),
                    bearings=pack(d.t[directed], d.bearing[directed]),
                    bearing_what=d.what[directed].tolist(),
                    fixes=fixes,
                ),
            )
            fixes = b""
            left = [(done.stop, last) for done, (_, last) in zip((driven, seen, directed), left, strict=True)]
    yield end, Closed(robot=robot, run=run, seq=seq + 1)


@dataclass(frozen=True, slots=True)
class Part:
    """The rows of one message. what, bearing_what: indices into the names known by then."""

    drive: Float[np.ndarray, "3 m"]
    seen: Float[np.ndarray, "3 n"]
    what: Int[np.ndarray, " n"]
    bearings: Float[np.ndarray, "2 k"]
    bearing_what: Int[np.ndarray, " k"]
    fixes: Float[np.ndarray, "7 f"]

    @property
    def end(self) -> float | None:
        """The last stamp [s] of its rows."""
        ends = [float(column[0, -1]) for column in (self.drive, self.seen, self.bearings) if column.shape[1]]
        return max(ends, default=None)


@dataclass(slots=True)
class LandmarkRecord:
    """What a robot has told so far, put together in the order of its numbers.

    keep: whether its rows are kept here, in `parts`; without, they are checked alone.
    """

    header: Header
    names: list[str]
    bearing_names: list[str]
    keep: bool = True
    parts: list[Part] = field(default_factory=list)
    closed: bool = False
    _driven: float = -np.inf
    _seen: float = -np.inf
    _directed: float = -np.inf
    _first: float = np.nan
    _named: set[str] = field(init=False)
    _bearing_named: set[str] = field(init=False)
    _fixes: FixRecord = field(init=False)

    def __post_init__(self) -> None:
        self._fixes = FixRecord(self.header.fixes)
        self._named, self._bearing_named = set(self.names), set(self.bearing_names)

    @classmethod
    def begin(cls, header: Header, *, keep: bool = True) -> "LandmarkRecord":
        if not header.log_robot.removeprefix("robot").isdecimal():
            raise RefusedError("malformed", f"expected robotK as the robot of a landmark log, found {header.log_robot}")
        return cls(header, list(header.names), list(header.bearing_names), keep)

    def add(self, message: Numbered) -> Part | None:
        """Its rows, put after all others; raises RefusedError when they can't be those of this robot."""
        if self.closed:
            raise RefusedError("malformed", "a message after the last one")
        if isinstance(message, Closed):
            self.closed = True
            return None
        if not isinstance(message, Rows):
            raise RefusedError("sensor", f"{type(message).__name__} from a robot that announced landmarks")
        drive, seen, bearings = unpack(message.drive, 3), unpack(message.seen, 3), unpack(message.bearings, 2)
        self._expect_later(drive[0], self._driven, "odometry")
        self._expect_later(seen[0], self._seen, "sightings")
        self._expect_later(bearings[0], self._directed, "bearings")
        if drive.shape[1] and not self.header.odometry:
            raise RefusedError("sensor", "odometry from a robot that announced none")
        first = self._first
        for table in (drive, seen, bearings):
            first = expect_span(first, table[0])
        what = indexed(self._named, message.names, message.what)
        bearing_what = indexed(self._bearing_named, message.bearing_names, message.bearing_what)
        for known, names, fresh in (
            (self._named, self.names, message.names),
            (self._bearing_named, self.bearing_names, message.bearing_names),
        ):
            known.update(fresh)
            names.extend(fresh)
        self._first = first
        self._driven = float(drive[0, -1]) if drive.shape[1] else self._driven
        self._seen = float(seen[0, -1]) if seen.shape[1] else self._seen
        self._directed = float(bearings[0, -1]) if bearings.shape[1] else self._directed
        part = Part(drive, seen, what, bearings, bearing_what, self._fixes.add(message.fixes))
        if self.keep:
            self.parts.append(part)
        return part

    @property
    def wheelless(self) -> bool:
        """Whether wheels were announced, and `WHEELS_LATE` of its rows are here without one of them."""
        silent = self.header.odometry and self._driven == -np.inf
        return silent and max(self._seen, self._directed) > self._first + WHEELS_LATE

    @staticmethod
    def _expect_later(t: Float[np.ndarray, " n"], before: float, what: str) -> None:
        if len(t) and not (t[0] >= before and (np.diff(t) >= 0).all()):
            raise RefusedError("malformed", f"{what} that step back in time")

    def log_of(self, part: Part) -> LandmarkLog:
        """The rows of one message as a log of their own."""
        return self._log([part])

    @property
    def log(self) -> LandmarkLog:
        """All rows so far."""
        return self._log(self.parts)

    def _log(self, parts: Sequence[Part]) -> LandmarkLog:
        h = self.header
        drive = np.concatenate([np.zeros((3, 0)), *(part.drive for part in parts)], axis=1)
        seen = np.concatenate([np.zeros((3, 0)), *(part.seen for part in parts)], axis=1)
        what = np.concatenate([np.zeros(0, np.int64), *(part.what for part in parts)])
        t, bearing = np.concatenate([np.zeros((2, 0)), *(part.bearings for part in parts)], axis=1)
        whom = np.concatenate([np.zeros(0, np.int64), *(part.bearing_what for part in parts)])
        directed = SightingTable(t, whom, np.full(len(t), np.nan), bearing, tuple(self.bearing_names))
        return LandmarkLog(
            h.log_robot,
            Odometry(drive[0].copy(), drive[1].copy(), drive[2].copy()) if h.odometry else None,
            SightingTable(seen[0], what, seen[1], seen[2], tuple(self.names)),
            h.dropped,
            tuple(map(finding_of, h.findings)),
            h.source,
            bearings=directed if self.bearing_names else NOTHING_SEEN,
            misread=unpack(h.misread, 1)[0],
            unused=tuple(map(unused_of, h.unused)),
            fixes=fixes_of(h.fixes, [part.fixes for part in parts]),
        )


def rows_told(messages: Iterable[Message]) -> LandmarkLog | None:
    """The log that a robot's messages make, from its header on; None without one."""
    record: LandmarkRecord | None = None
    for message in messages:
        if isinstance(message, Header):
            record = LandmarkRecord.begin(message)
        elif isinstance(message, Rows) and record is not None:
            record.add(message)
    return None if record is None else record.log


def indexed(known: set[str], fresh: list[str], what: list[int]) -> Int[np.ndarray, " n"]:
    """The indices in a message whose names come after those known; raises RefusedError when they can't be.

    It costs what the message holds, however many are known.
    """
    n, index = len(known) + len(fresh), np.array(what, dtype=np.int64)
    if n > MOST_NAMES:
        raise RefusedError("oversized", f"{n} names, at most {MOST_NAMES}")
    if not known.isdisjoint(fresh) or len(set(fresh)) < len(fresh):
        raise RefusedError("malformed", "a name that is known already")
    if (index >= n).any():
        raise RefusedError("malformed", f"an index of {int(index.max())} among {n} names")
    return index


WANDERING_EVERY = 32  # messages: a robot without odometry is mapped anew from its first row
WANDERING_FIRST = frozenset({4, 8, 16})  # messages after which it is, before


class LandmarkRobot:
    """The estimate of one robot after the messages so far; with its log's end it is the one that a whole log gives."""

    def __init__(self, header: Header, cfg: EkfSlamConfig) -> None:
        self.record = LandmarkRecord.begin(header)
        self.t: float | None = None
        self.last = 0
        self._cfg = cfg
        self._driven = False  # whether a row of its wheels is there
        self._wandering = not (cfg.odometry and header.odometry)
        self._submap: Submap | None = None
        self._counts: dict[str, int] = {}
        self._runner = Runner(ekf_slam, self._cfg, 0)

    def add(self, message: Numbered) -> None:
        """The estimate with the rows of `message`."""
        self.last = message.seq
        if isinstance(message, Header):  # it was begun with it
            return
        part = self.record.add(message)
        if part is None or part.end is None:
            return
        self.t = part.end if self.t is None else max(self.t, part.end)
        log = without_impossible(self.record.log_of(part))
        for name, n in log.sightings.counts().items():
            self._counts[name] = self._counts.get(name, 0) + n
        self._driven |= log.odometry is not None
        announced = self._cfg.odometry and self.record.header.odometry
        if not announced or (self.record.wheelless and not self._driven):
            if not self._wandering or message.seq % WANDERING_EVERY == 0 or message.seq in WANDERING_FIRST:
                self._map_anew()
            self._wandering = True
            return
        if self._wandering:  # its wheels were late
            self._wandering = False
            self._runner = Runner(ekf_slam, self._cfg, 0)
            log = without_impossible(self.record.log)
        for event in log.events():
            self._runner.push(event)
            self._submap = None

    def _map_anew(self) -> None:
        log = self.record.log
        mapped = local_map(log, self._cfg, 0) if len(log.sightings) else None
        self._submap = mapped.submap if mapped is not None and mapped.submap.ids else None

    @property
    def submap(self) -> Submap:
        """Pose and landmarks in `local_k`; raises EstimateError when the estimate left finite numbers."""
        if self._submap is None:
            robot = self.record.header.log_robot
            state = self._runner.states.get(robot) or ekf_slam.initial(robot, self._cfg)
            if not np.isfinite(state.x).all():
                raise EstimateError(f"{robot}: EKF-SLAM left finite numbers")
            self._submap = state.submap
        return self._submap

    def status(self) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        """`T_local_robot`, the upper triangle of its covariance, how many landmarks there are."""
        m = self.submap
        return tuple(m.pose.tolist()), tuple(m.cov[:3, :3][np.triu_indices(3)].tolist()), len(m.ids)

    def snapshot(self) -> Snapshot:
        """What a map process fuses while the robot drives on."""
        m, h = self.submap, self.record.header
        return Snapshot(
            robot=h.robot,
            run=h.run,
            last=self.last,
            t=self.t or 0.0,
            pose=tuple(m.pose.tolist()),
            ids=list(m.ids),
            mean=pack(*m.mean.T),
            cov=pack_triangle(m.cov),
            counts=[self._counts.get(name, 0) for name in m.ids],
        )


def mapped_again(store: Store, robot: str, end: int, cfg: EkfSlamConfig, ended: Callable[[], bool]) -> Snapshot | None:
    """What `robot` would have told after its messages before `end`, which are in the store.

    None when they make no map, or when it is `ended` meanwhile.
    """
    record: LandmarkRecord | None = None
    try:
        for _, payload in store.get(robot, 0, end - 1):
            message = decode(payload)
            if ended():
                return None
            if isinstance(message, Header):
                record = LandmarkRecord.begin(message)
            elif record is not None and isinstance(message, Numbered):
                record.add(message)
        return None if record is None else _told(record, end - 1, local_map(record.log, cfg))
    except Exception:  # noqa: BLE001  (whatever it told, it makes no map)
        return None


def _told(record: LandmarkRecord, last: int, m: LocalMap) -> Snapshot:
    return Snapshot(
        robot=record.header.robot,
        run=record.header.run,
        last=last,
        t=record.log.span[1],
        pose=tuple(m.submap.pose.tolist()),
        ids=list(m.submap.ids),
        mean=pack(*m.submap.mean.T),
        cov=pack_triangle(m.submap.cov),
        counts=[m.sightings.get(name, 0) for name in m.submap.ids],
    )
