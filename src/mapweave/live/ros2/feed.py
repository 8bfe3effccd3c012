"""One robot of a ROS graph as a live source: found by its tokens, heard through its topics, told as messages."""

import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from queue import Empty, Full, Queue
from typing import Any

from msgspec import structs

from ...io.bag_robots import FIXES
from ...io.fixes import NAVSAT, frame_of
from ...io.inertial import IMU
from ..laser_feed import Packets, Row, Stamped, log_robot, told_until
from ..messages import Closed, FixSource, Header, Numbered, RefusedError
from ..transport import Callback, HistoryConfig, Sample, SampleKind, Session, declare_advanced_subscriber
from .assembly import BY_TF, NO_ODOMETRY, POSES, Assembly, Gyroscope
from .wire import (
    BRIDGE,
    NO_HASH,
    NODE,
    ODOMETRY,
    PUBLISHER,
    SCAN,
    SUBSCRIPTION,
    TF,
    Attachment,
    Entity,
    Qos,
    Topic,
    decode,
    every_token,
    type_hash,
)

Place = tuple[str, ...]  # namespaces, the outermost first


@dataclass(frozen=True, slots=True)
class RosRobot:
    """One robot of a graph. name: its namespace without slashes around, empty where there is none.

    tf, tf_static: topics of transforms, its own before those of all; scanners: its other scans; beside: other odometry,
    which is not heard; fixes: topics that tell where it is, of which one may be heard; imu: that tell its turns, of
    which one is heard where it has no odometry.
    """

    name: str
    scan: Topic
    odometry: Topic | None
    tf: tuple[Topic, ...]
    scanners: tuple[Topic, ...] = ()
    beside: tuple[str, ...] = ()
    fixes: tuple[Topic, ...] = ()
    imu: tuple[Topic, ...] = ()

    @property
    def called(self) -> str:
        return self.name or "the robot without a namespace"

    @property
    def topics(self) -> tuple[Topic, ...]:
        return (self.scan, *([self.odometry] if self.odometry else []), *self.tf)


@dataclass(slots=True)
class Graph:
    """The tokens that are held now. refused: by their reason and what was told of it."""

    entities: dict[str, Entity] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)

    def put(self, token: str) -> None:
        try:
            self.entities[token] = Entity.read(token)
        except RefusedError as error:
            self.refused.setdefault(token, str(error))

    def drop(self, token: str) -> None:
        self.entities.pop(token, None)

    def published(self, kind: str) -> list[Topic]:
        """Topics of a type that somebody publishes with a hash that we can read, each once, in the order of names.

        Another hash is another definition of the message: it is told in `refused`. What comes by rmw_zenoh too is not
        heard through the bridge.
        """
        topics: dict[str, Topic] = {}
        for token, entity in sorted(self.entities.items(), key=lambda one: (one[0].startswith("@/"), one[0])):
            topic = entity.topic
            if entity.kind != PUBLISHER or topic is None or topic.kind != kind:
                continue
            if topic.type_hash in {type_hash(kind), NO_HASH}:
                topics.setdefault(topic.name, topic)
            else:
                refusal = (
                    f"hash: {topic.name} is {kind} of another definition, {topic.type_hash}; ours {type_hash(kind)}"
                )
                self.refused.setdefault(token, refusal)
        return [topics[name] for name in sorted(topics)]

    def publishers_of(self, name: str, but: str) -> list[str]:
        """Nodes that publish the topic `name` in sessions other than `but`."""
        mine = (e for e in self.entities.values() if e.kind == PUBLISHER and e.topic and e.topic.name == name)
        return sorted({f"{e.namespace.rstrip('/')}/{e.node}" for e in mine if e.session != but})

    def robots(self) -> list[RosRobot]:
        """Every robot that publishes scans, in the order of names."""
        scans, odometry, tf = self.published(SCAN), self.published(ODOMETRY), self.published(TF)
        fixes, imu = self.fixes(), self.published(IMU)
        homes: dict[str, list[Topic]] = {}
        for topic in scans:
            homes.setdefault("/".join(_home(_place(topic), [_place(t) for t in (*odometry, *tf)])), []).append(topic)
        return [self._robot(name, homes, odometry, tf, fixes, imu) for name in sorted(homes)]

    def fixes(self) -> list[Topic]:
        """All topics that tell positions."""
        return [topic for kind in FIXES for topic in self.published(kind)]

    @staticmethod
    def _robot(
        name: str,
        homes: dict[str, list[Topic]],
        odometry: Sequence[Topic],
        tf: Sequence[Topic],
        fixes: Sequence[Topic],
        imu: Sequence[Topic],
    ) -> RosRobot:
        place: Place = tuple(name.split("/")) if name else ()
        others = [tuple(h.split("/")) for h in homes if h and h != name]

        def mine_of(topics: Sequence[Topic]) -> list[Topic]:
            free = [t for t in topics if not any(_within(_place(t), other) for other in others)]
            return free if len(homes) == 1 else [t for t in free if _within(_place(t), place)]

        mine = [t for t in mine_of(odometry) if _within(_place(t), place)] or mine_of(odometry)
        scan, *more = _best(homes[name], "scan")
        wheels = _best(mine, "odom")
        own = [t for t in tf if place and _within(_place(t), place)]
        shared = [t for t in tf if not _place(t)]
        beside = tuple(t.name for t in wheels[1:])
        told, turns = tuple(mine_of(fixes)), tuple(_best(mine_of(imu), "imu"))
        return RosRobot(name, scan, wheels[0] if wheels else None, (*own, *shared), tuple(more), beside, told, turns)


def chosen(robots: Sequence[RosRobot], name: str, pattern: str | None) -> RosRobot | None:
    """The only robot whose namespace fits `pattern`; without one that of `name`, or the only one; None while there

    is none. Raises RefusedError, listing them, where several could be meant.
    """
    if pattern is not None:
        fit = [r for r in robots if fnmatchcase(r.name, pattern.strip("/"))]
    else:
        fit = [r for r in robots if r.name == name] or list(robots)
    if len(fit) > 1:
        there = ", ".join(r.name or "one without a namespace" for r in fit)
        raise RefusedError("pattern", f"--pattern: which robot is {name}? There are {there}")
    return fit[0] if fit else None


def chosen_fixes(graph: Graph, robot: RosRobot, asked: str | None) -> Topic | None:
    """The topic of fixes that is heard of `robot`: a satellite receiver's, or the one `asked` for by name, as of `map`.

    Raises RefusedError for a name of none.
    """
    if asked is None:
        return next(iter(_best([t for t in robot.fixes if t.kind == NAVSAT], "fix")), None)
    wanted = [word.strip().strip("/") for word in asked.split(",") if word.strip() and word.strip() != "none"]
    there = {topic.name.strip("/"): topic for topic in graph.fixes()}
    for word in wanted:
        if word not in there:
            held = ", ".join(f"{t.name} ({t.kind})" for t in there.values()) or "none"
            raise RefusedError("fixes", f"--fixes: no topic {word!r} that tells positions; there are {held}")
    return next((there[word] for word in wanted if there[word] in robot.fixes), None)


def _place(topic: Topic) -> Place:
    return tuple(topic.name.strip("/").split("/")[:-1])


def _within(place: Place, home: Place) -> bool:
    return place[: len(home)] == home


def _home(place: Place, others: Iterable[Place]) -> Place:
    """The deepest namespace around a scan topic that holds odometry or transforms too; its own where none does."""
    about = list(others)
    return next((place[:n] for n in range(len(place), 0, -1) if any(_within(o, place[:n]) for o in about)), place)


def _best(topics: Iterable[Topic], word: str) -> list[Topic]:
    """Those whose last part is `word` first, then those nearest to the root."""
    return sorted(topics, key=lambda t: (t.name.rsplit("/", 1)[-1] != word, len(_place(t)), t.name))


WAITING = 5000  # messages not worked in yet: beyond, they are let go and counted
MOST_PUBLISHERS = 10_000
SETTLE = 1.0  # [s] after the first robot is seen, for others to be seen too
BEGIN = 3.0  # [s] after the first scan, for odometry by tf where nobody publishes Odometry
SILENCE = 5.0  # [s] without a scan until it is told

Say = Callable[[str], None]
Heard = tuple[Topic, bytes, bytes | None]


@dataclass(frozen=True, slots=True)
class Chosen:
    """What the feed is asked for. pattern: of the robot's namespace; period: [s] of scans in one message.

    all_scanners: the scans of all that the robot has, not of the first alone; fixes: as of `map`.
    """

    name: str
    run: str
    period: float = 1.0
    domain: int = 0
    pattern: str | None = None
    sensor_pose: tuple[float, float, float] | None = None
    all_scanners: bool = False
    fixes: str | None = None


@dataclass(slots=True)
class Member:
    """What this process is in the ROS graph: a node, and its next entity's number."""

    session: Session
    domain: int
    namespace: str
    node: str
    entities: int = 0
    held: list[object] = field(default_factory=list)

    def declare(self, kind: str, topic: Topic | None = None) -> Entity:
        """Others see it from now on."""
        who = str(self.session.info.zid())
        entity = Entity(self.domain, who, 0, self.entities, kind, self.namespace, self.node, topic)
        self.entities += 1
        self.held.append(self.session.liveliness().declare_token(entity.token()))
        return entity


class RosFeed:
    """The messages of one robot. `take` and `close` are called from one thread; callbacks only fill a queue.

    robot: which one it is, None before it was seen; assembly: what its messages make; graph: who else is there.
    """

    def __init__(self, session: Session, asked: Chosen, say: Say) -> None:
        self.asked, self.graph = asked, Graph()
        self.robot: RosRobot | None = None
        self._fixes: Topic | None = None
        self._gyroscope: Gyroscope | None = None
        self.member: Member | None = None
        self.assembly = Assembly(sensor_pose=asked.sensor_pose)
        self.lost: Counter[str] = Counter()
        self._session, self._say = session, say
        self._tokens: Queue[tuple[str, bool]] = Queue()
        self._heard: Queue[Heard] = Queue(WAITING)
        self._let_go = 0
        self._said: set[str] = set()
        self._packets: Packets | None = None
        self._new = True  # no scan was told yet
        self._seen = self._first = self._last = 0.0
        self._sequences: dict[bytes, int] = {}
        self._declared: list[object] = []
        self._declared += [
            session.liveliness().declare_subscriber(key, Callback(self._token), history=True)
            for key in every_token(asked.domain)
        ]

    def resume(self, kept: Sequence[Numbered]) -> None:
        """Goes on after a history. Raises RefusedError when that has ended."""
        if not kept:
            return
        header, last = kept[0], kept[-1]
        if isinstance(last, Closed) or (isinstance(last, Header) and last.seq):
            raise RefusedError("history", "this drive has ended; --fresh begins a new one")
        assert isinstance(header, Header)  # noqa: S101  (number 0 of every history)
        self._packets, self._new = Packets(header, self.asked.period, last.seq), False
        self.assembly.wheels = header.odometry_from
        self.assembly.resume(told_until(kept), sweep=None if self.asked.all_scanners else header.sweep)

    def take(self, timeout: float) -> list[Numbered]:
        """Messages that are whole now; waits for something to come for `timeout` [s] at most."""
        self._work_in(timeout)
        if self.robot is None:
            self._choose()
        self._tell()
        return self._whole(*self.assembly.ready()) if self._begun() else []

    def close(self) -> list[Numbered]:
        """What was heard and is not told yet, and the end of the history; nothing where none was begun."""
        for one in self._declared:
            one.undeclare()  # type: ignore[attr-defined]
        self._work_in(0.0)
        if not self._begun(now=True):
            return []
        assert self._packets is not None  # noqa: S101  (begun)
        out = self._whole(*self.assembly.ready(all_of_them=True), end=True)
        self._tell()
        return [] if self._new else [*out, *self._packets.amended(self._known()), *self._packets.close()]

    @property
    def header(self) -> Header | None:
        return None if self._packets is None else self._packets.header

    def summary(self) -> str:
        """What was refused, in words; empty when nothing was."""
        counts = self.assembly.refused + self.lost
        return ", ".join(f"{n} {reason}" for reason, n in sorted(counts.items()))

    def _begun(self, *, now: bool = False) -> bool:
        """Whether there is a header: once it is known where odometry comes from."""
        a = self.assembly
        if self._packets is not None or self.robot is None:
            return self._packets is not None
        if not a.sensor_frame:
            return False
        self._first = self._first or time.monotonic()
        if self.robot.odometry is None and a.wheels == POSES:
            if a.odometry_edge is not None:
                a.take_tf()
            elif now or time.monotonic() > self._first + BEGIN:
                a.wheels = NO_ODOMETRY
                self._say(f"{self.asked.name}: {self.robot.called} tells no odometry: poses come from scans alone")
            else:
                return False
        self._packets = Packets(self._header(self.robot), self.asked.period)
        return True

    def _header(self, robot: RosRobot) -> Header:
        wheels = self.assembly.wheels
        return Header(
            robot=self.asked.name,
            run=self.asked.run,
            sensor="laser",
            log_robot=log_robot(self.asked.name),
            source=f"ros2:{robot.scan.name}",
            odometry=wheels != NO_ODOMETRY,
            odometry_from=wheels,
            log_hash=self.asked.run,
            sweep=self.assembly.sweep,
            fixes=self._fix_source(),
        )

    def _fix_source(self) -> FixSource | None:
        """What of its fixes is known by now."""
        a, topic = self.assembly, self._fixes
        if topic is None:
            return None
        antenna = a.antenna if topic.kind == NAVSAT else (0.0, 0.0)
        frame = frame_of(topic.kind, a.fix_frame)
        return FixSource(frame=frame, topic=topic.name, antenna=antenna, dropped=dict(a.fixes_left))

    def _known(self) -> Header:
        """The header, with what of fixes and turns was known only when some had come."""
        assert self._packets is not None  # noqa: S101  (begun)
        header, source = self._packets.header, self._fix_source()
        if header.fixes is not None and source is not None and (self.assembly.fix_frame or self.assembly.fixes_left):
            header = structs.replace(header, fixes=source)
        if self._gyroscope is not None and self._gyroscope.findings:
            found = [replace(one, robot=header.log_robot).row() for one in self._gyroscope.findings]
            header = structs.replace(header, findings=found)
        return header

    def _whole(self, placed: list[Stamped], rows: list[Row], *, end: bool = False) -> list[Numbered]:
        """Messages that are complete now; the header comes before the first scan."""
        assert self._packets is not None  # noqa: S101  (begun)
        if self._gyroscope is not None and self.assembly.wheels == NO_ODOMETRY:
            placed = self._gyroscope.turned(placed, self.assembly.up(self._gyroscope.frame), all_of_them=end)
        new = bool(placed) and self._new
        self._new = self._new and not new
        return [*([self._packets.header] if new else []), *self._packets.add(placed, rows, self.assembly.fixes())]

    def _work_in(self, timeout: float) -> None:
        """Everything that came."""
        while not self._tokens.empty():
            token, there = self._tokens.get_nowait()
            (self.graph.put if there else self.graph.drop)(token)
        end = time.monotonic() + timeout
        waited = False
        while True:
            try:
                heard = self._heard.get(timeout=max(0.0, end - time.monotonic()) if not waited else 0.0)
            except Empty:
                return
            waited = True
            self._hear(*heard)

    def _hear(self, topic: Topic, payload: bytes, attachment: bytes | None) -> None:
        try:
            if not self._is_new(topic, attachment):
                return
            message = decode(payload, topic.kind)
        except RefusedError as error:
            self.assembly.refuse(error)
            return
        if topic.kind == SCAN:
            self._last = time.monotonic()
            self.assembly.scan(message, topic.name)
        elif topic.kind == ODOMETRY:
            self.assembly.odometry(message)
        elif topic.kind in FIXES:
            self.assembly.fix(message)
        elif topic.kind == IMU:
            self._turn(message)
        else:
            self.assembly.transforms(message)

    def _turn(self, message: Any) -> None:
        try:
            if self._gyroscope is not None and self.assembly.wheels != BY_TF:
                self._gyroscope.add(message)
        except RefusedError as error:
            self.assembly.refuse(error)

    def _is_new(self, topic: Topic, attachment: bytes | None) -> bool:
        """Whether this is the next message of its publisher, or a later one; what is between them was lost.

        The bridge tells neither.
        """
        if topic.bridged:
            return True
        if attachment is None:
            raise RefusedError("attachment", f"a message on {topic.name} without one")
        header = Attachment.decode(attachment)
        before = self._sequences.get(header.gid)
        if before is not None and header.sequence <= before:
            self.lost["doubled"] += 1
            return False
        if before is not None and header.sequence > before + 1:
            self.lost["lost"] += header.sequence - before - 1
        if len(self._sequences) > MOST_PUBLISHERS:
            self._sequences.clear()
        self._sequences[header.gid] = header.sequence
        return True

    def _choose(self) -> None:
        """Hears the robot once it is seen and others had time to be."""
        robots = self.graph.robots()
        now = time.monotonic()
        if not robots:
            return
        self._seen = self._seen or now
        if now < self._seen + SETTLE:
            return
        choice = chosen(robots, self.asked.name, self.asked.pattern)
        if choice is None:
            there = ", ".join(robot.name or "one without a namespace" for robot in robots)
            self._once(f"no robot fits {self.asked.pattern!r} yet; there are {there}")
            return
        self._fixes = chosen_fixes(self.graph, choice, self.asked.fixes)
        if self.asked.fixes not in {None, "none"} and self._fixes is None:
            self._once(f"--fixes {self.asked.fixes}: of another robot, or it is not told of which: not heard")
        self.robot = choice
        wheels = choice.odometry.name if choice.odometry else "tf, if that tells any"
        imu = choice.imu[:1] if choice.odometry is None else ()
        self._gyroscope = Gyroscope(imu[0].name) if imu else None
        scanners = choice.scanners if self.asked.all_scanners else ()
        left = [*([] if scanners else [t.name for t in choice.scanners]), *choice.beside]
        beside = f"; not heard: {', '.join(left)}" if left else ""
        self.member = Member(self._session, self.asked.domain, f"/{choice.name}", node_name(self.asked.name))
        if not choice.scan.bridged:
            self.member.declare(NODE)
        self._last = now
        self._heard_topics((*choice.topics, *scanners, *([self._fixes] if self._fixes else []), *imu))
        scans = " and ".join(topic.name for topic in (choice.scan, *scanners))
        through = f" through {BRIDGE}" if choice.scan.bridged else ""
        fixes = f", position fixes from {self._fixes.name}" if self._fixes else ""
        turns = f", turns of {imu[0].name} without it" if imu else ""
        self._once(f"hears {scans}{through}, odometry from {wheels}{turns}{fixes}{beside}")

    def _heard_topics(self, topics: Sequence[Topic]) -> None:
        assert self.member is not None  # noqa: S101  (chosen)
        for topic in topics:
            latched = topic.qos.transient_local
            reliable = topic.qos.reliable if topic.kind in {IMU, *FIXES} else topic.kind != SCAN
            qos = Qos(reliable, latched, 100 if topic.kind == TF else 10)
            self.member.declare(SUBSCRIPTION, replace(topic, qos=qos))
            self._declared.append(
                declare_advanced_subscriber(
                    self._session,
                    topic.key(self.asked.domain),
                    Callback(partial(self._sample, topic)),
                    history=HistoryConfig(detect_late_publishers=True, max_samples=100) if latched else None,
                    subscriber_detection=latched,
                )
            )

    def _tell(self) -> None:
        """A line of each kind of thing that went wrong, once; that the robot is gone or silent, and is back."""
        for refusal in (*self.graph.refused.values(), *self.assembly.first_refusals.values()):
            self._once(f"refused: {refusal}")
        if self._let_go:
            self.lost["too many at once"] += self._let_go
            self._let_go = 0
            self._once("messages come faster than they are worked in: some are let go")
        if self.robot is None:
            return
        now = time.monotonic()
        if now > self._last + SILENCE:
            self._once(f"no scan for {SILENCE:g} s on {self.robot.scan.name}")
        else:
            self._said.discard(f"no scan for {SILENCE:g} s on {self.robot.scan.name}")

    def _once(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._say(f"{self.asked.name}: {words}")

    def _token(self, sample: Sample) -> None:
        self._tokens.put((str(sample.key_expr), sample.kind == SampleKind.PUT))

    def _sample(self, topic: Topic, sample: Sample) -> None:
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        try:
            self._heard.put_nowait((topic, sample.payload.to_bytes(), attachment))
        except Full:
            self._let_go += 1


def node_name(name: str) -> str:
    """`name` as the name of a ROS node, which holds letters, digits and underscores."""
    return "mapweave_" + re.sub(r"\W", "_", name, flags=re.ASCII)
