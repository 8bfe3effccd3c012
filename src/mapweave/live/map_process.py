"""A map process: it hears every robot, keeps what it heard, asks for what is missing and tells the shared map."""

import math
import sys
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from queue import Empty, Full, Queue
from threading import Event, Lock
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np

from ..core.errors import DataError, UsageError
from ..core.landmark_log import LandmarkLog
from ..core.names import robot_name
from ..landmarks.config import EkfSlamConfig
from ..mapping.config import LaserConfig
from .door import decode
from .inbox import Inbox, Ledger
from .isolation import beside, in_words, without_culprits
from .joined import Apart, Joined
from .landmark_stream import LandmarkRecord, mapped_again, rows_told
from .laser_team import Starts, WovenTeam, nobody
from .laser_weaver import LaserWeaver
from .messages import (
    LARGEST,
    LEVEL,
    MapState,
    Numbers,
    RefusedError,
    RobotState,
    Snapshot,
    Tile,
    Topics,
    count,
    encode,
    listed,
    square,
    triangle,
    unpack_triangle,
)
from .range_stream import RangedTeam, RangeRecord, ranged_again
from .shared_map import Fused, SharedMap, judged
from .store import Store
from .told import MOST_MAPS
from .transport import (
    MOST_ANSWERS,
    OWN,
    SETTLE,
    Callback,
    Locality,
    Query,
    Sample,
    SampleKind,
    Session,
    answer,
    ask,
    put,
    there_is,
)
from .weaving import Placed

if TYPE_CHECKING:
    from concurrent.futures import Future

    from ..fusion.online import OnlineFuser

KEPT = 8  # questions


@dataclass(slots=True)
class ClockOffset:
    """The other's clock minus ours [s]. An answer bounds it by half of the time that the question took."""

    _heard: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, asked: float, remote: float, answered: float) -> None:
        """`remote`: the other's clock; asked, answered: ours around it [s]. Raises ValueError for what is no time."""
        if not math.isfinite(remote):
            raise ValueError(remote)
        if answered >= asked:  # else our own clock was set back meanwhile
            self._heard.append((0.5 * (answered - asked), remote - 0.5 * (asked + answered)))

    @property
    def known(self) -> bool:
        return bool(self._heard)

    @property
    def best(self) -> tuple[float, float]:
        """The offset of the quickest answer of late and what it may be wrong by [s]; (0, inf) before any."""
        if not self._heard:
            return 0.0, math.inf
        error, offset = min(self._heard)
        return offset, error


MOST_BYTES = 64 << 20  # of all messages that wait
MOST_SPEAKERS = 256  # of whom any may wait
MOST_A_SECOND = 5_000  # messages of one speaker: a robot tells a few, and its history is asked for by the hundred
OTHERS = "others"  # who is let go beyond so many speakers
OVERHEAD = 200  # [bytes] that a message takes beside its own, so that empty ones are not free


@dataclass(slots=True)
class _Line:
    """Of one speaker: messages, their bytes, and how many came in the second that began at `since`."""

    messages: deque[bytes] = field(default_factory=deque)
    size: int = 0
    since: float = float("-inf")
    came: int = 0


class Intake:
    """A line for each speaker; one message of each in turn. Any thread may use it.

    let_go: how many of a speaker's messages were, for they came too fast or too many waited: those of whom most
    wait, the oldest first. What is numbered is asked for later.
    """

    def __init__(self, most: int = MOST_BYTES, clock: Callable[[], float] = monotonic) -> None:
        self.let_go: Counter[str] = Counter()
        self.size = 0
        self._most, self._clock = most, clock
        self._lines: OrderedDict[str, _Line] = OrderedDict()
        self._lock = Lock()

    def put(self, speaker: str, payload: bytes) -> None:
        """The message waits, unless its speaker is too fast."""
        with self._lock:
            line = self._lines.get(speaker)
            if line is None:
                if len(self._lines) >= MOST_SPEAKERS and not self._forget_idle():
                    self.let_go[OTHERS] += 1
                    return
                line = self._lines[speaker] = _Line()
            now = self._clock()
            if now >= line.since + 1.0:
                line.since, line.came = now, 0
            line.came += 1
            if line.came > MOST_A_SECOND:
                self.let_go[speaker] += 1
                return
            line.messages.append(payload)
            line.size += len(payload) + OVERHEAD
            self.size += len(payload) + OVERHEAD
            while self.size > self._most:
                longest = max(self._lines, key=lambda name: self._lines[name].size)
                self._pop(self._lines[longest])
                self.let_go[longest] += 1

    def take(self) -> tuple[str, bytes] | None:
        """The oldest message of the speaker whose turn it is; None when none waits."""
        with self._lock:
            for name in list(self._lines):
                self._lines.move_to_end(name)
                if self._lines[name].messages:
                    return name, self._pop(self._lines[name])
            return None

    def __len__(self) -> int:
        with self._lock:
            return sum(len(line.messages) for line in self._lines.values())

    def _pop(self, line: _Line) -> bytes:
        payload = line.messages.popleft()
        line.size -= len(payload) + OVERHEAD
        self.size -= len(payload) + OVERHEAD
        return payload

    def _forget_idle(self) -> bool:
        """A speaker of whom nothing waits gives its place; whether there was one."""
        idle = next((name for name, line in self._lines.items() if not line.messages), None)
        if idle is not None:
            del self._lines[idle]
        return idle is not None


MOST_OTHER = 2_000  # tokens and clocks not worked in yet: all of them are told again
WORKED = 0.2  # [s] that messages are worked in before other things have their turn
TICK = 0.05  # [s]
SWITCH = 0.0005  # [s] between threads: who follows robots comes back from each kernel to one who searches
STATE_EVERY = 1.0  # [s], and as soon as landmark robots are fused
CLOCK_EVERY = 5.0  # [s]
FUSED = 0.25  # of the time between two solutions of laser robots: how often landmark robots are fused at most
JOINING_REST = 3.0  # the time without joining laser robots and landmark robots, in that it took
JUDGING_REST = 3.0  # the time without judging landmark maps anew, in that it took
FUSING_REST = 0.25  # the time without fusing is at least so many times what fusing took
BEHIND = 10  # messages of a robot that are missing, or not worked in: beyond, it catches up
TELL_CLOCK = 1.0  # [s] that a clock is off before it is told

REST = 5.0  # [s] before a thread that died is started again
MOST_FINDINGS = 100  # told: what goes wrong as often goes wrong on

Say = Callable[[str], None]
Joins = Callable[[Apart, Sequence[LandmarkLog]], Joined]
Step = TypeVar("Step")


def _joined(joins: Joins, store: Store, heard: Mapping[str, int], apart: Apart) -> Joined:
    """What `joins` makes of the rows of these robots, robot -> its first number missing; of those it can be made of."""
    logs = {}
    for name, end in heard.items():
        log = rows_told(decode(payload) for _, payload in store.get(name, 0, end - 1))
        if log is not None and len(log):
            logs[name] = log
    joined, _, failed = without_culprits(list(logs), lambda some: joins(apart, [logs[name] for name in some]))
    why = [f"{name}: not laid beside laser robots: {error}" for name, error in failed.items()]
    return replace(joined or Joined(), decisions=[*(joined or Joined()).decisions, *why])


@dataclass(slots=True)
class _Heard:
    """What callbacks leave for the process's own thread."""

    messages: Intake = field(default_factory=Intake)
    other: Queue[Callable[[], object]] = field(default_factory=lambda: Queue(MOST_OTHER))
    _states: dict[str, bytes] = field(default_factory=dict)  # the newest of each map process
    _lock: Any = field(default_factory=Lock)

    def put_state(self, name: str, payload: bytes) -> None:
        """What a map process says takes the place of what it said before; beyond `MOST_MAPS` it is let go."""
        with self._lock:
            if name in self._states or len(self._states) < MOST_MAPS:
                self._states[name] = payload

    def taken_states(self) -> list[tuple[str, bytes]]:
        with self._lock:
            taken, self._states = self._states, {}
            return list(taken.items())

    def do(self, what: Callable[[], object]) -> None:
        """`what` is done in its turn; beyond `MOST_OTHER` it is let go, and comes again."""
        with suppress(Full):
            self.other.put_nowait(what)


class MapProcess:
    """One of any number of map processes of a team. wall: its wall clock [s].

    at_the_door: counts of what the transport refused.
    """

    def __init__(
        self,
        name: str,
        session: Session,
        topics: Topics,
        store: Store,
        inbox: Inbox,
        say: Say,
        wall: Callable[[], float] = time.time,
        at_the_door: Mapping[str, int] | None = None,
    ) -> None:
        self._door = {} if at_the_door is None else at_the_door
        self.name, self.inbox, self.shared = name, inbox, SharedMap(name=name)
        self.laser = LaserConfig()
        self.starts: Starts = nobody
        self._weaver: LaserWeaver | None = None
        self._woven: WovenTeam | None = None
        self.ekf = EkfSlamConfig()
        self._remembered: set[str] = set()
        self._remembering: tuple[str, Future[Snapshot | None]] | None = None
        self._ended = False
        self._fusing: tuple[float, Future[Fused]] | None = None  # since when [s]
        self._judging: tuple[float, Future[OnlineFuser]] | None = None  # since when [s]
        self._judge_due = self._fuse_due = self._hearsay_due = self._join_due = float("-inf")
        self.joins: Joins | None = None
        self._joining: tuple[float, Future[Joined]] | None = None  # since when [s]
        self._joined_of: object = None
        self._ranging: tuple[float, Future[RangedTeam]] | None = None  # since when [s]
        self._range_due = float("-inf")
        self._ranged_of: dict[str, int] = {}
        self.clocks: dict[str, ClockOffset] = {}
        self.findings: dict[str, None] = {}
        self._anew: dict[str, int] = {}  # how often each robot's history was put right, as the weaver knows it
        self._begin_again = float("-inf")  # [s] when a thread that died may be started
        self._session, self._topics, self._store, self._say, self._wall = session, topics, store, say, wall
        self._heard = _Heard()
        self._declared: list[object] = []
        self._disk_told = False
        self._clocks_told: set[str] = set()

    def join(self) -> None:
        """From now on robots are heard; raises UsageError when a map process of this name is there."""
        t, s, callback = self._topics, self._session, Callback
        time.sleep(SETTLE)
        if there_is(s, t.map_alive(self.name)):
            raise UsageError(f"--name {self.name}: a map process of that name is in team {t.team} already")
        hear = callback(self._hear)
        remote = Locality.REMOTE
        self._declared = [
            *(s.declare_subscriber(key, hear) for key in (t.log(), t.status(), t.snapshot())),
            s.declare_subscriber(t.map_state(), callback(self._hear_map), allowed_origin=remote),
            s.declare_queryable(t.history(), callback(self._answer), allowed_origin=remote),
            s.declare_queryable(t.tiles(self.name), callback(self._answer_tiles)),
            s.liveliness().declare_subscriber(t.alive(), callback(self._robot_there), history=True),
            s.liveliness().declare_token(t.map_alive(self.name)),
        ]

    def run(self, stop: Event, every: float, until: Callable[[Inbox], bool]) -> None:
        """Until `stop`, or until `until` holds; where there is news the graph of laser robots is solved every `every`
        [s], and landmark robots are fused as they come, `FUSED` of that apart.
        """
        before = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        try:
            self._hear_until(stop, every, until)
        finally:
            sys.setswitchinterval(before)
            self._ended = True
            if self._weaver is not None:
                self._weaver.stop()

    def finding(self, text: str) -> None:
        """What went wrong here is told at once, on the page and with the result; each once."""
        if text not in self.findings and len(self.findings) < MOST_FINDINGS:
            self.findings[text] = None
            self._say(text)

    def _safely(self, what: str, do: Callable[[], Step]) -> Step | None:
        """What `do` gives; None where it failed, which is told: the process goes on with what comes."""
        try:
            return do()
        except Exception as error:  # noqa: BLE001  (no message may end the process)
            self.finding(f"{what} failed: {in_words(error)}")
            return None

    def _hear_until(self, stop: Event, every: float, until: Callable[[Inbox], bool]) -> None:
        state = clock = float("-inf")
        while not stop.is_set():
            now = time.monotonic()
            self._safely("working messages in", lambda: self._work_in(now))  # noqa: B023  (called at once)
            self._safely("asking for messages", lambda: self._ask(now))  # noqa: B023
            self._safely("weaving", lambda: self._weave(every))
            self._safely("mapping a robot that is gone", self._remember)
            self._safely("judging landmark maps", self._judge)
            if self._safely("fusing", lambda: self._fuse(every)):
                state = float("-inf")
            self._safely("joining lasers and landmarks", lambda: self._join(every))
            self._safely("placing robots by ranges", lambda: self._range(every))
            if now >= clock + CLOCK_EVERY:
                clock = now
                self._safely("asking for clocks", self._ask_clocks)
            if now >= state + STATE_EVERY:
                state = now
                self._safely("telling the map", self.tell_state)
                if not len(self._heard.messages) and until(self.inbox):
                    return
            if not len(self._heard.messages):
                stop.wait(TICK)

    def _work_in(self, now: float) -> None:
        for _ in range(1000):
            try:
                do = self._heard.other.get_nowait()
            except Empty:
                break
            self._safely("working in what was heard", do)
        end = time.monotonic() + WORKED
        while time.monotonic() < end and (waiting := self._heard.messages.take()) is not None:
            self.inbox.offer(*waiting, now)
        if now >= self._hearsay_due:
            self._hearsay_due = now + STATE_EVERY
            for name, payload in self._heard.taken_states():
                self._hearsay(name, payload)
        try:
            self.inbox.save()
            self._disk_told = False
        except DataError as error:
            if not self._disk_told:
                self._say(f"{error}: what comes is kept in memory until it can be written")
            self._disk_told = True
        while self.inbox.news:
            self._say(self.inbox.news.popleft())

    def _ask(self, now: float) -> None:
        for robot, first, last in list(self.inbox.gaps(now)):
            ask(
                self._session,
                self._topics.history(robot),
                f"first={first};last={last}",
                lambda payload, robot=robot: self._heard.messages.put(robot, payload),  # type: ignore[misc]
                lambda robot=robot: self._heard.do(lambda: self.inbox.answered(robot)),  # type: ignore[misc]
            )
        for robot, first, last in list(self.inbox.doubts(now)):
            self._ask_itself(robot, first, last)

    def _ask_itself(self, robot: str, first: int, last: int) -> None:
        """The robot's own word on these messages, which no other process gives."""
        answers: list[bytes] = []

        def take(payload: bytes) -> None:
            if len(answers) < MOST_ANSWERS:
                answers.append(payload)

        def end() -> None:
            self._heard.do(lambda: self.inbox.decide(robot, answers, time.monotonic()))

        ask(self._session, self._topics.history(robot), f"first={first};last={last};{OWN}=1", take, end)

    def _fuse(self, every: float) -> bool:
        """Snapshots are fused in a thread of their own; whether landmark robots stand anew, which is told."""
        if self._fusing is None:
            fusing = self.shared.fusing(self.inbox.ledgers.values()) if time.monotonic() >= self._fuse_due else None
            if fusing is not None:
                self._fusing = time.monotonic(), beside(fusing.run)
            return False
        begin, fused = self._fusing
        if not fused.done():
            return False
        self._fusing = None
        now = time.monotonic()
        self._fuse_due = max(begin + FUSED * every, now + FUSING_REST * (now - begin))
        self._tell(self.shared.take_fused(fused.result()))
        return True

    def _judge(self) -> None:
        """All landmark maps are judged anew where that is due, beside fusing them as they come."""
        now = time.monotonic()
        if self._judging is not None:
            begin, fuser = self._judging
            if fuser.done() and self._fusing is None:
                self._judging = None
                self._judge_due = now + JUDGING_REST * (now - begin)
                self.shared.take_judged(fuser.result())
        elif self.shared.fuser.due and now >= self._judge_due:
            self._judging = now, beside(partial(judged, self.shared.fuser))

    def _join(self, every: float) -> None:
        """What laser robots and landmark robots made apart is tied by what they saw of each other, beside."""
        now = time.monotonic()
        if self._joining is not None:
            begin, joined = self._joining
            if joined.done():
                self._joining = None
                self._join_due = now + max(every, JOINING_REST * (now - begin))
                self._tell(self.shared.take_joined(joined.result().after(self.shared.joined)))
                if self._weaver is not None:
                    self._weaver.tie(self.shared.joined)
            return
        ledgers = {n: x for n, x in self.inbox.ledgers.items() if isinstance(x.record, LandmarkRecord) and x.sure > 1}
        if self.joins is None or self._woven is None or not ledgers or now < self._join_due:
            return
        fresh = self._woven.number, {name: ledger.sure for name, ledger in ledgers.items()}
        if fresh == self._joined_of:
            return
        self._joined_of = fresh
        work = partial(_joined, self.joins, self._store, fresh[1], self._mixed(self._woven))
        self._joining = now, beside(work)

    def _range(self, every: float) -> None:
        """Robots that range are placed by all they have told, beside."""
        now = time.monotonic()
        if self._ranging is not None:
            begin, found = self._ranging
            if found.done():
                self._ranging = None
                self._range_due = now + max(every, JOINING_REST * (now - begin))
                self._tell(self.shared.take_ranged(found.result()))
            return
        heard = {n: x.sure for n, x in self.inbox.ledgers.items() if isinstance(x.record, RangeRecord) and x.sure > 1}
        if not heard or heard == self._ranged_of or now < self._range_due:
            return
        self._ranged_of = heard
        self._ranging = now, beside(partial(ranged_again, self._store, heard))

    def _mixed(self, woven: WovenTeam) -> Apart:
        """What is known of a mixed team, by the names in its logs."""
        called, told = {}, {}
        for name, ledger in self.inbox.ledgers.items():
            if ledger.record is None:
                continue
            robot = robot_name(ledger.record.header.log_robot)
            called[robot] = name
            if ledger.status is not None:
                told[robot] = ledger.status.t, np.array(ledger.status.pose)
        return Apart({robot: woven.ways[name] for robot, name in called.items() if name in woven.ways}, told, called)

    def _tell(self, tiles: Sequence[Tile]) -> None:
        """Everybody hears of squares that changed, and every robot where its frame is."""
        for tile in tiles:
            put(self._session, self._topics.tile(self.name, tile), encode(tile))
        self._tell_corrections()

    def _remember(self) -> None:
        """A landmark robot that is gone, and never told this process a snapshot, is mapped from what it told, once."""
        if self._remembering is None:
            for name, ledger in self.inbox.ledgers.items():
                silent = isinstance(ledger.record, LandmarkRecord) and ledger.snapshot is None and not ledger.there
                if silent and ledger.next > 1 and ledger.missing <= 0 and name not in self._remembered:
                    self._remembered.add(name)
                    again = partial(mapped_again, self._store, name, ledger.next, self.ekf, lambda: self._ended)
                    self._remembering = name, beside(again)
                    return
        elif self._remembering[1].done():
            name, future = self._remembering
            self._remembering, ledger = None, self.inbox.ledgers[name]
            ledger.snapshot = ledger.snapshot or future.result()

    def _tell_corrections(self) -> None:
        for robot, placed in self.shared.placed.items():
            correction = placed.correction(self.name, robot)
            put(self._session, self._topics.correction(robot, self.name), encode(correction))

    def _weave(self, every: float) -> None:
        """Laser robots are followed in a thread of their own; what it has woven anew is told."""
        heard = {
            name: ledger.next
            for name, ledger in self.inbox.ledgers.items()
            if ledger.record is not None and ledger.record.header.sensor == "laser"
        }
        if not heard:
            return
        if self.shared.meet(list(heard)):
            self._tell_corrections()
        weaver = self._living_weaver(every)
        if weaver is None:
            return
        for name, ledger in self.inbox.ledgers.items():
            if ledger.anew != self._anew.get(name, 0):
                self._anew[name] = ledger.anew
                weaver.begin_again(name)
        weaver.hear(heard)
        for why in weaver.failed[:]:
            self.finding(f"not woven: {why}")
        if weaver.newest is None or weaver.newest is self._woven:
            return
        self._woven = weaver.newest
        for name, why in self._woven.lost.items():
            self.finding(f"{name}: left out of the map while robots drive: {why}")
        self._tell(self.shared.take(self._woven))

    def _living_weaver(self, every: float) -> LaserWeaver | None:
        """The thread that follows laser robots; None for a moment after one has died."""
        if self._weaver is not None and self._weaver.died:
            self.finding(f"the thread that follows laser robots died and begins anew: {self._weaver.died}")
            self._weaver.stop()
            self._weaver, self._begin_again = None, time.monotonic() + REST
        if self._weaver is None:
            if time.monotonic() < self._begin_again:
                return None
            self.shared.resolution = self.laser.resolution
            self._weaver = LaserWeaver(self._store, self.laser, every, self.starts)
            self._weaver.tie(self.shared.joined)
            self._weaver.start()
        return self._weaver

    def _ask_clocks(self) -> None:
        for robot, ledger in self.inbox.ledgers.items():
            if not ledger.there:
                continue
            asked = self._wall()

            def take(payload: bytes, robot: str = robot, asked: float = asked) -> None:
                answered = self._wall()
                self._heard.do(lambda: self._clock(robot, asked, payload, answered))

            ask(self._session, self._topics.clock(robot), "", take, lambda: None, timeout=CLOCK_EVERY)

    def _clock(self, robot: str, asked: float, payload: bytes, answered: float) -> None:
        try:
            heard = self.clocks.get(robot) or ClockOffset()
            heard.add(asked, float(payload), answered)
        except ValueError:
            self.inbox.refused["malformed"] += 1
            return
        if not heard.known:
            return
        self.clocks[robot] = heard
        off, error = heard.best
        if abs(off) - error > TELL_CLOCK and robot not in self._clocks_told:
            self._clocks_told.add(robot)
            ahead = "ahead" if off > 0 else "behind"
            self._say(f"{robot}: its clock is {abs(off):.1f} s {ahead} (within {error:.2f} s)")

    def state(self) -> MapState:
        """The shared map as it stands."""
        refused = {**self.inbox.refused, **self._door}
        if let_go := self._heard.messages.let_go.total():
            refused["let go, asked for later"] = let_go
        now = time.monotonic()
        return MapState(
            map=self.name,
            clock=self._wall(),
            fused=self.shared.fused,
            robots=[self._robot(ledger, now) for _, ledger in sorted(self.inbox.ledgers.items())],
            landmarks=self.shared.landmarks,
            decisions=[*self.findings, *self.inbox.not_used(), *self.inbox.wheelless(), *self.shared.decisions],
            refused=refused,
            unused=self.inbox.unused(),
        )

    def _robot(self, ledger: Ledger, now: float) -> RobotState:
        header = None if ledger.record is None else ledger.record.header
        offset, error = self.clocks[ledger.robot].best if ledger.robot in self.clocks else (None, None)
        placed, status = self.shared.placed.get(ledger.robot), ledger.status
        pose: Numbers = ()
        cov: Numbers = ()
        here = None if status is None else (status.pose, square(status.cov))
        if status is None and ledger.snapshot is not None:
            here = ledger.snapshot.pose, unpack_triangle(ledger.snapshot.cov, 3 + 2 * len(ledger.snapshot.ids))[:3, :3]
        if placed is not None and here is not None:
            carried = placed.carry(np.array(here[0]), here[1])
            pose, cov = listed(carried[0]), triangle(carried[1])
        return RobotState(
            robot=ledger.robot,
            run=ledger.run,
            log_robot="" if header is None else header.log_robot,
            sensor="" if header is None else header.sensor,
            there=ledger.there,
            finished=ledger.complete,
            have=ledger.next,
            last=ledger.last,
            rate=ledger.rate(now),
            pose=pose,
            cov=cov,
            frame=() if placed is None else listed(placed.frame),
            component=0 if placed is None else placed.component,
            landmarks=0 if status is None else status.landmarks,
            offset=offset,
            offset_error=error,
            refused=dict(ledger.refused),
            doubled=ledger.doubled,
            doing=self._doing(ledger, placed),
        )

    def _doing(self, ledger: Ledger, placed: Placed | None) -> str:
        """What the robot is up to as far as is known here, in a word or two."""
        woven = self._woven
        worked = ledger.next if woven is None else woven.worked.get(ledger.robot, ledger.next)
        lost = ledger.fault or (woven is not None and ledger.robot in woven.lost)
        parts = [p.component for p in self.shared.placed.values()]
        first = (
            ("is lost", lost),
            ("has finished", ledger.complete),
            ("is gone", not ledger.there),
            ("compiles", self._weaver is not None and woven is None),
            ("waits", placed is None),
            ("catches up", ledger.missing > BEHIND or ledger.next - worked > BEHIND),
            ("stands alone", placed is not None and len(parts) > 1 and parts.count(placed.component) == 1),
        )
        return next((word for word, so in first if so), "drives")

    def tell_state(self) -> None:
        """Everybody hears how the map stands, who is there and what it has."""
        state = self.state()
        payload = encode(state)
        if len(payload) > LARGEST:
            self.finding(
                f"{len(state.landmarks)} landmarks and what is decided are more than a message holds: not told"
            )
            payload = encode(msgspec.structs.replace(state, landmarks=[], decisions=list(self.findings)))
        put(self._session, self._topics.map_state(self.name), payload)

    def summary(self) -> list[str]:
        """A line a robot: what was heard and what was refused."""
        out = []
        for name, ledger in sorted(self.inbox.ledgers.items()):
            line = f"{name}: {ledger.next} messages"
            if ledger.missing > 0 or ledger.held:
                line += f", {max(ledger.missing, 0)} missing: used up to the first gap"
            if ledger.fault:
                line += f"; from there on refused: {ledger.fault}"
            out.append(line + (f"; refused: {count(ledger.refused)}" if ledger.refused else ""))
        others = {**self.inbox.refused, **self._door}
        return out + ([f"refused from others: {count(others)}"] if others else [])

    def _answer_tiles(self, query: Query) -> None:
        """The whole map as it is, or a level of it, for those who come late."""
        with query:
            level = query.parameters.get(LEVEL)
            for key in tuple(self.shared.tiles):
                if level not in {None, str(key[1])}:
                    continue
                payload = encode(self.shared.tile(key))
                query.reply(query.key_expr, payload)

    def _hear(self, sample: Sample) -> None:
        speaker = self._topics.robot_of(str(sample.key_expr))
        if len(sample.payload) > LARGEST:  # not even copied
            self._heard.do(lambda: self.inbox.refuse(speaker, "oversized", f"{len(sample.payload)} bytes"))
        else:
            self._heard.messages.put(speaker, sample.payload.to_bytes())

    def _hear_map(self, sample: Sample) -> None:
        """Another map process may know robots that have left."""
        if len(sample.payload) <= LARGEST:
            self._heard.put_state(self._topics.map_of(str(sample.key_expr)), sample.payload.to_bytes())

    def _hearsay(self, name: str, payload: bytes) -> None:
        try:
            state = decode(payload)
        except RefusedError:
            return
        if isinstance(state, MapState) and state.map == name:
            self.inbox.hearsay(state.robots, time.monotonic())

    def _robot_there(self, sample: Sample) -> None:
        robot, there = self._topics.robot_of(str(sample.key_expr)), sample.kind == SampleKind.PUT
        self._heard.do(lambda: self._there(robot, there=there))

    def _there(self, robot: str, *, there: bool) -> None:
        ledger = self.inbox.ledgers.get(robot)
        if ledger is not None and ledger.there != there:
            self._say(f"{robot}: {'is there' if there else 'is gone'}")
        self.inbox.presence(robot, there=there)

    def _answer(self, query: Query) -> None:
        """The past of any robot that is kept here, for those who come late."""
        with query:
            robot = self._topics.robot_of(str(query.key_expr))
            if query.parameters.get(OWN):  # the robot's own word is asked for
                return
            if robot == "*":
                query.reply_err(b"expected the name of a robot")
                return
            answer(query, str(query.key_expr), partial(self._store.get, robot))
