"""A log of ranging radios as numbered messages of each of its robots, and these as one log again: the same, to the bit.

And the robot that is driving, which knows its odometry alone, and where a team of such robots stands by now.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.findings import finding_of, unused_of
from ..core.names import in_order
from ..core.records import Track
from ..ranges.estimate import PlacedPart, estimate
from ..ranges.network import NO_NUMBER, RangeLog, RangeNetwork, network_of, steps
from .door import decode, expect_span, expect_steps
from .fix_stream import FixRecord, cuts_of, fixes_of, packed, source_of
from .isolation import without_culprits
from .landmark_stream import indexed
from .messages import Closed, Header, LandmarkState, Message, Numbered, Radios, RefusedError, pack, told_by, unpack
from .store import Store
from .weaving import Placed

MOST_RANGES = 20_000  # in one message; a packet of more is split
UNKNOWN = np.diag([1e8, 1e8, np.pi**2])  # [m^2, rad^2] of a place that nothing tells


def of_robot(log: RangeLog, name: str) -> RangeLog:
    """What robot `name` of the log tells a team: its odometry, and the ranges that it measured or a beacon measured of
    it. The first of all robots tells beside those between beacons, and what reading the log has found.
    """
    robots = sorted(log.odometry, key=in_order)
    whose = [k for k, one in enumerate(log.names) if one == name]
    others = [k for k, one in enumerate(log.names) if one in log.odometry]
    first = name == robots[0]
    rows = np.isin(log.a, whose) | (np.isin(log.b, whose) & ~np.isin(log.a, others))
    rows |= first & ~np.isin(log.a, others) & ~np.isin(log.b, others)
    return replace(
        log,
        odometry={name: log.odometry[name]},
        a=log.a[rows],
        b=log.b[rows],
        t=log.t[rows],
        z=log.z[rows],
        antennas={name: log.antennas[name]} if name in log.antennas else {},
        fixes={name: log.fixes[name]} if name in log.fixes else {},
        dropped=log.dropped if first else {},
        unused=log.unused if first else (),
        findings=log.findings if first else (),
        others=tuple(one for one in robots if one != name),
    )


def of_team(logs: Sequence[RangeLog]) -> RangeLog:
    """The one log of what these robots tell, each of its own odometry."""
    logs = sorted(logs, key=lambda log: in_order(next(iter(log.odometry))))
    robots = [name for log in logs for name in log.odometry]
    names = tuple(dict.fromkeys([*robots, *sorted({name for log in logs for name in log.names}, key=in_order)]))
    place = {name: k for k, name in enumerate(names)}
    dropped: dict[str, int] = {}
    for log in logs:
        for reason, n in log.dropped.items():
            dropped[reason] = dropped.get(reason, 0) + n
    a, b = (
        np.concatenate([np.array([place[name] for name in log.names], np.int64)[end] for log, end in ends])
        for ends in ([(log, log.a) for log in logs], [(log, log.b) for log in logs])
    )
    return RangeLog(
        {name: track for log in logs for name, track in log.odometry.items()},
        names,
        a,
        b,
        np.concatenate([log.t for log in logs]),
        np.concatenate([log.z for log in logs]),
        antennas={name: at for log in logs for name, at in log.antennas.items()},
        fixes={name: fixes for log in logs for name, fixes in log.fixes.items()},
        dropped=dropped,
        source=", ".join(dict.fromkeys(log.source for log in logs)),
        log_hash=" ".join(dict.fromkeys(log.log_hash for log in logs)),
        unused=tuple(left for log in logs for left in log.unused),
        findings=tuple(found for log in logs for found in log.findings),
        others=tuple(dict.fromkeys(name for log in logs for name in log.others if name not in robots)),
    )


def messages_of_ranges(log: RangeLog, robot: str, run: str, period: float) -> Iterator[tuple[float, Numbered]]:
    """All messages of one robot's whole log and when each is complete [s], as of the other kinds."""
    ((name, track),) = log.odometry.items()
    order = told_of(log)
    bad = len(log.z) - len(order)
    dropped = {**log.dropped, NO_NUMBER: log.dropped.get(NO_NUMBER, 0) + bad} if bad else log.dropped
    a, b, t, z = log.a[order], log.b[order], log.t[order], log.z[order]
    own = a == log.names.index(name)
    begin = min([float(track.t[0]), *t[:1].tolist()])
    end = max([float(track.t[-1]), *t[-1:].tolist()])
    antenna = log.antennas.get(name)
    yield (
        begin,
        Header(
            robot=robot,
            run=run,
            sensor="ranges",
            log_robot=name,
            source=log.source,
            odometry=True,
            log_hash=log.log_hash,
            names=list(log.names),
            others=list(log.others),
            antenna=() if antenna is None else tuple(antenna.tolist()),
            fixes=source_of(log.fixes.get(name)),
            dropped=dict(dropped),
            findings=[found.row() for found in log.findings],
            unused=[left.row() for left in log.unused],
        ),
    )
    cuts = np.arange(begin + period, end, period)
    told = [[0, *np.searchsorted(stamps, cuts, side="right").tolist(), len(stamps)] for stamps in (track.t, t)]
    told.append(cuts_of(log.fixes.get(name), cuts))
    seq = 0
    for now, (c, d), (e, f), (g, h) in zip([*cuts.tolist(), end], *map(pairwise, told), strict=True):
        for k in range(e, max(f, e + 1), MOST_RANGES):
            rows, driven = slice(k, min(k + MOST_RANGES, f)), slice(c, d if k == e else c)
            fixes = packed(log.fixes.get(name), g, h if k == e else g)
            if rows.start < rows.stop or driven.start < driven.stop or fixes:
                seq += 1
                yield (
                    now,
                    Radios(
                        robot=robot,
                        run=run,
                        seq=seq,
                        track=pack(track.t[driven], *track.pose[driven].T),
                        told=pack(t[rows], z[rows]),
                        whom=b[rows].tolist(),
                        by=[] if own[rows].all() else a[rows].tolist(),
                        fixes=fixes,
                    ),
                )
    yield end, Closed(robot=robot, run=run, seq=seq + 1)


def told_of(log: RangeLog) -> Int[np.ndarray, " k"]:
    """The ranges that are told, in order of time: all but those that are no numbers."""
    order = np.flatnonzero((np.isfinite(log.z) & (log.z > 0)) | (log.a == log.b))
    return np.asarray(order[np.argsort(log.t[order], kind="stable")])


@dataclass(frozen=True, slots=True)
class RadioPart:
    """The rows of one message: track of t, x, y, theta; told: t and range; a, b: ends, as an index into all names."""

    track: Float[np.ndarray, "4 m"]
    told: Float[np.ndarray, "2 k"]
    a: np.ndarray
    b: np.ndarray
    fixes: Float[np.ndarray, "7 f"]


@dataclass(slots=True)
class RangeRecord:
    """How far a ranging robot's messages came, in the order of its numbers; their rows are not kept here."""

    header: Header
    closed: bool = False
    _driven: float = -np.inf
    _ranged: float = -np.inf
    _first: float = np.nan
    _at: tuple[float, ...] | None = None  # t, x, y of the last row of odometry
    _names: set[str] = field(init=False)
    _mine: int = field(init=False)
    _others: list[int] = field(init=False)
    _anew: Header | None = None
    _fixes: FixRecord = field(init=False)

    def __post_init__(self) -> None:
        self._fixes = FixRecord(self.header.fixes)
        self._names = set(self.header.names)
        if self.header.log_robot not in self._names or not self.header.odometry:
            raise RefusedError("malformed", "a ranging robot without its own name or odometry")
        self._mine = self.header.names.index(self.header.log_robot)
        self._others = [k for k, name in enumerate(self.header.names) if name in self.header.others]

    def add(self, message: Numbered) -> RadioPart | None:
        """Its rows; raises RefusedError when they can't be those of this robot."""
        if self.closed:
            raise RefusedError("malformed", "a message after the last one")
        if isinstance(message, Radios):
            return self._rows(message)
        if isinstance(message, Header):
            if (message.sensor, message.log_robot) != (self.header.sensor, self.header.log_robot):
                raise RefusedError("malformed", "a header of another log")
            self._anew = message
        elif isinstance(message, Closed):
            if self._anew is not None and self._anew.names != self.header.names:
                raise RefusedError("malformed", "a header whose names are not those that ranges were told by")
            self.closed, self.header = True, self._anew or self.header
        else:
            raise RefusedError("sensor", f"{type(message).__name__} from a robot that announced ranges")
        return None

    def _rows(self, message: Radios) -> RadioPart:
        if self._anew is not None:
            fresh = RangeRecord(self._anew)
            for name in self.__slots__:
                setattr(self, name, getattr(fresh, name))
        track, told = unpack(message.track, 4), unpack(message.told, 2)
        if not (np.diff(np.concatenate([[self._driven], track[0]])) > 0).all():
            raise RefusedError("malformed", "odometry that steps back in time")
        if not (np.diff(np.concatenate([[self._ranged], told[0]])) >= 0).all():
            raise RefusedError("malformed", "ranges that step back in time")
        whom, by = (indexed(self._names, [], ends) for ends in (message.whom, message.by))
        by = by if len(by) else np.full(len(whom), self._mine)
        if (np.isin(by, self._others) | ((by != self._mine) & np.isin(whom, self._others))).any():
            raise RefusedError("malformed", "ranges that other robots tell")
        first = expect_span(expect_span(self._first, track[0]), told[0])
        rows = np.array([*([] if self._at is None else [self._at]), *track[:3].T.tolist()]).reshape(-1, 3)
        expect_steps(rows[:, 0], rows[:, 1:], "odometry")
        self._first, self._at = first, tuple(rows[-1].tolist()) if len(rows) else None
        self._driven = float(track[0, -1]) if track.shape[1] else self._driven
        self._ranged = float(told[0, -1]) if told.shape[1] else self._ranged
        return RadioPart(track, told, by, whom, self._fixes.add(message.fixes))


def ranges_told(messages: Iterable[Message]) -> RangeLog | None:
    """The log that a ranging robot's messages make, from its header on; None without one, or without odometry."""
    told = told_by(messages, RangeRecord)
    if told is None or not any(part.track.shape[1] for part in told[1]):
        return None
    h, parts = told
    track = np.concatenate([part.track for part in parts], axis=1)
    t, z = np.concatenate([part.told for part in parts], axis=1)
    fixes = fixes_of(h.fixes, [part.fixes for part in parts])
    return RangeLog(
        {h.log_robot: Track(track[0], np.ascontiguousarray(track[1:].T), frame="odom")},
        tuple(h.names),
        np.concatenate([part.a for part in parts]),
        np.concatenate([part.b for part in parts]),
        t,
        z,
        antennas={h.log_robot: np.array(h.antenna)} if h.antenna else {},
        fixes={} if fixes is None else {h.log_robot: fixes},
        dropped=dict(h.dropped),
        source=h.source,
        log_hash=h.log_hash,
        unused=tuple(map(unused_of, h.unused)),
        findings=tuple(map(finding_of, h.findings)),
        others=tuple(h.others),
    )


class RangeRobot:
    """What one ranging robot knows after the messages so far: where its odometry has it, and how it may err."""

    def __init__(self, header: Header) -> None:
        self.record = RangeRecord(header)
        self.t: float | None = None
        self._pose, self._cov = np.zeros(3), np.zeros((3, 3))
        self._row: np.ndarray | None = None
        self._told = False  # whether what comes is told once more

    def add(self, message: Numbered) -> None:
        """The estimate with the rows of `message`."""
        self._told |= isinstance(message, Header) and message.seq > 0
        if isinstance(message, Header) or self._told:  # it was begun with it; what is told anew it has seen
            return
        part = self.record.add(message)
        if part is None or not part.track.shape[1]:
            return
        rows = part.track.T if self._row is None else np.vstack([self._row, part.track.T])
        self._row = rows[-1]
        for step, variance in zip(*steps(rows[:, 1:], rows[:, 0]), strict=True):
            self._cov = se2.composed_covariance(self._pose, self._cov, step, np.diag(variance))
            self._pose = np.asarray(se2.compose(self._pose, step))
        self._pose, self.t = self._row[1:], float(self._row[0])

    def status(self) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        """`T_odom_robot`, the upper triangle of its covariance since the first row, how many it may range to."""
        numbers = tuple(self._cov[np.triu_indices(3)].tolist())
        return tuple(self._pose.tolist()), numbers, len(self.record.header.names) - 1

    def snapshot(self) -> None:
        """A robot makes no map of ranges alone."""


@dataclass(frozen=True, slots=True)
class RangedTeam:
    """Where a team stands by ranges, the part of most robots number 1: robot, by the log's name -> its frame."""

    placed: Mapping[str, Placed] = field(default_factory=dict)
    beacons: Sequence[LandmarkState] = ()
    decisions: Sequence[str] = ()


def ranged(logs: Sequence[RangeLog]) -> RangedTeam:
    """Where the robots of these logs stand after what they have told, each part in the frame of its first robot."""
    log = of_team(logs)
    net = network_of(log)
    if not len(net.ranges):
        return RangedTeam(decisions=["no range can be used yet"])
    found = estimate(net)
    placed: dict[str, Placed] = {}
    beacons: list[LandmarkState] = []
    for number, part in enumerate(found.parts, 1):
        home = se2.inverse(part.pose[int(np.argmin(net.is_beacon[part.nodes]))])
        placed |= _placed(net, part, home, number, log)
        beacons += _beacons(net, part, home, number)
    n, twofold = len(found.parts), [k for k, part in enumerate(found.parts, 1) if part.mirrored]
    said = [f"{n} parts that no ranges tie"] if n > 1 else []
    return RangedTeam(placed, beacons, [*said, *(f"part {k} may lie otherwise too: ranges fit both" for k in twofold)])


def ranged_again(store: Store, heard: Mapping[str, int]) -> RangedTeam:
    """Where those stand, by the team's names, whose messages are in the store: robot -> its first number missing.

    Of those that it can be told of; why not of others is said in its decisions.
    """
    logs = {}
    for name, end in heard.items():
        log = ranges_told(decode(payload) for _, payload in store.get(name, 0, end - 1))
        if log is not None:
            logs[name] = log
    called = {robot: name for name, log in logs.items() for robot in log.odometry}
    found, _, failed = without_culprits(list(logs), lambda some: ranged([logs[name] for name in some]))
    found = found or RangedTeam()
    why = [f"{name}: not placed by ranges: {error}" for name, error in failed.items()]
    placed = {called[robot]: place for robot, place in found.placed.items()}
    return replace(found, placed=placed, decisions=[*found.decisions, *why])


def _placed(
    net: RangeNetwork, part: PlacedPart, home: Float[np.ndarray, "3"], number: int, log: RangeLog
) -> dict[str, Placed]:
    """Where the odometry of each robot of a part stands, by the last of its poses; home: of the map in the part."""
    out = {}
    for k in np.unique(net.owner[part.nodes[~net.is_beacon[part.nodes]]]).tolist():
        last = int(np.flatnonzero(net.owner[part.nodes] == k)[-1])
        here = np.asarray(se2.compose(home, part.pose[last]))
        track = log.odometry[net.robots[k]]
        there = track.pose[int(np.searchsorted(track.t, net.t[part.nodes[last]]))]
        frame = np.asarray(se2.compose(here, se2.inverse(there)))
        cov = se2.turned_covariance(float(home[2]), part.cov[last])
        lever = np.linalg.inv(se2.compose_jacobians(frame, there)[0])
        whole = lever @ np.where(np.isfinite(cov), cov, UNKNOWN) @ lever.T
        out[net.robots[k]] = Placed(number, frame, 0.5 * (whole + whole.T), 1.0, own=False)
    return out


def _beacons(net: RangeNetwork, part: PlacedPart, home: Float[np.ndarray, "3"], number: int) -> list[LandmarkState]:
    out, R = [], se2.rotation(float(home[2]))
    for k, at in enumerate(np.flatnonzero(net.is_beacon[part.nodes]).tolist()):
        block = part.beacon_cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        P = R @ np.where(np.isfinite(block), block, UNKNOWN[:2, :2]) @ R.T
        x, y = se2.act(home, part.pose[at, :2]).tolist()
        cov = (float(P[0, 0]), float(P[0, 1]), float(P[1, 1]))
        out.append(LandmarkState(id=net.everybody[net.owner[part.nodes[at]]], x=x, y=y, cov=cov, component=number))
    return out
