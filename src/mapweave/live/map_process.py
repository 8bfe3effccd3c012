"""A map process: it hears every robot, keeps what it heard, asks for what is missing and tells the shared map."""

import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, Full, Queue
from threading import Event

import numpy as np
import zenoh

from ..core.errors import DataError, UsageError
from ..landmarks.config import EkfSlamConfig
from ..laser.config import LaserConfig
from .clocks import ClockOffset
from .columns import listed, square, triangle, unpack_triangle
from .inbox import Inbox, Ledger
from .landmark_robot import mapped_again
from .landmark_stream import LandmarkRecord
from .laser_team import Starts, WovenTeam, nobody
from .laser_weaver import LaserWeaver
from .messages import LARGEST, MapState, Numbers, RefusedError, RobotState, Snapshot, count, decode, encode
from .shared_map import Fused, SharedMap
from .store import Store
from .topics import Topics
from .transport import SETTLE, answer, ask, put, there_is

WAITING = 20_000  # messages not worked in yet: beyond, they are let go and asked for later
TICK = 0.05  # [s]
SWITCH = 0.0005  # [s] between threads: who follows robots comes back from each kernel to one who searches
STATE_EVERY = 1.0  # [s], and as soon as landmark robots are fused
CLOCK_EVERY = 5.0  # [s]
FUSED = 0.25  # of the time between two solutions of laser robots: how often landmark robots are fused at most
FUSING_REST = 0.25  # the time without fusing is at least so many times what fusing took
TELL_CLOCK = 1.0  # [s] that a clock is off before it is told

Say = Callable[[str], None]


@dataclass(slots=True)
class _Heard:
    """What callbacks leave for the process's own thread."""

    messages: Queue[tuple[str, bytes]] = field(default_factory=lambda: Queue(WAITING))
    let_go: int = 0
    other: Queue[Callable[[], object]] = field(default_factory=Queue)

    def message(self, speaker: str, payload: bytes) -> None:
        try:
            self.messages.put_nowait((speaker, payload))
        except Full:
            self.let_go += 1


class MapProcess:
    """One of any number of map processes of a team. wall: its wall clock [s].

    at_the_door: counts of what the transport refused.
    """

    def __init__(
        self,
        name: str,
        session: zenoh.Session,
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
        self._beside = ThreadPoolExecutor(2, thread_name_prefix="beside")  # one that fuses, one that remembers
        self._remembered: set[str] = set()
        self._remembering: tuple[str, Future[Snapshot | None]] | None = None
        self._ended = False
        self._fusing: tuple[float, Future[Fused]] | None = None  # since when [s]
        self._fuse_due = float("-inf")
        self.clocks: dict[str, ClockOffset] = {}
        self._session, self._topics, self._store, self._say, self._wall = session, topics, store, say, wall
        self._heard = _Heard()
        self._declared: list[object] = []
        self._disk_told = False
        self._clocks_told: set[str] = set()

    def join(self) -> None:
        """From now on robots are heard; raises UsageError when a map process of this name is there."""
        t, s, callback = self._topics, self._session, zenoh.handlers.Callback
        time.sleep(SETTLE)
        if there_is(s, t.map_alive(self.name)):
            raise UsageError(f"--name {self.name}: a map process of that name is in team {t.team} already")
        hear = callback(self._hear)
        remote = zenoh.Locality.REMOTE
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
            self._beside.shutdown(cancel_futures=True)
            if self._weaver is not None:
                self._weaver.stop()

    def _hear_until(self, stop: Event, every: float, until: Callable[[Inbox], bool]) -> None:
        state = clock = float("-inf")
        while not stop.is_set():
            now = time.monotonic()
            self._work_in(now)
            self._ask(now)
            self._weave(every)
            self._remember()
            if self._fuse(every):
                state = float("-inf")
            if now >= clock + CLOCK_EVERY:
                clock = now
                self._ask_clocks()
            if now >= state + STATE_EVERY:
                state = now
                self.tell_state()
                if not self._heard.messages.qsize() and until(self.inbox):
                    return
            if not self._heard.messages.qsize():
                stop.wait(TICK)

    def _work_in(self, now: float) -> None:
        for _ in range(1000):
            try:
                self._heard.other.get_nowait()()
            except Empty:
                break
        for _ in range(5000):
            try:
                speaker, payload = self._heard.messages.get_nowait()
            except Empty:
                break
            self.inbox.offer(speaker, payload, now)
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
                lambda payload, robot=robot: self._heard.message(robot, payload),  # type: ignore[misc]
                lambda robot=robot: self._heard.other.put(lambda: self.inbox.answered(robot)),  # type: ignore[misc]
            )

    def _fuse(self, every: float) -> bool:
        """Snapshots are fused in a thread of their own; whether landmark robots stand anew, which is told."""
        if self._fusing is None:
            fusing = self.shared.fusing(self.inbox.ledgers.values()) if time.monotonic() >= self._fuse_due else None
            if fusing is not None:
                self._fusing = time.monotonic(), self._beside.submit(fusing.run)
            return False
        begin, fused = self._fusing
        if not fused.done():
            return False
        self._fusing = None
        now = time.monotonic()
        self._fuse_due = max(begin + FUSED * every, now + FUSING_REST * (now - begin))
        self.shared.take_fused(fused.result())
        self._tell_corrections()
        return True

    def _remember(self) -> None:
        """A landmark robot that is gone, and never told this process a snapshot, is mapped from what it told, once."""
        if self._remembering is None:
            for name, ledger in self.inbox.ledgers.items():
                silent = isinstance(ledger.record, LandmarkRecord) and ledger.snapshot is None and not ledger.there
                if silent and ledger.next > 1 and ledger.missing <= 0 and name not in self._remembered:
                    self._remembered.add(name)
                    again = partial(mapped_again, self._store, name, ledger.next, self.ekf, lambda: self._ended)
                    self._remembering = name, self._beside.submit(again)
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
        if self._weaver is None:
            self.shared.resolution = self.laser.resolution
            self._weaver = LaserWeaver(self._store, self.laser, every, self.starts)
            self._weaver.start()
        self._weaver.hear(heard)
        if self._weaver.failed:
            self.shared.decisions = [f"not woven: {self._weaver.failed}"]
        if self._weaver.newest is None or self._weaver.newest is self._woven:
            return
        self._woven = self._weaver.newest
        for tile in self.shared.take(self._woven):
            put(self._session, self._topics.tile(self.name, tile), encode(tile))
        self._tell_corrections()

    def _ask_clocks(self) -> None:
        for robot, ledger in self.inbox.ledgers.items():
            if not ledger.there:
                continue
            asked = self._wall()

            def take(payload: bytes, robot: str = robot, asked: float = asked) -> None:
                answered = self._wall()
                self._heard.other.put(lambda: self._clock(robot, asked, payload, answered))

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
        if self._heard.let_go:
            refused["let go, asked for later"] = self._heard.let_go
        now = time.monotonic()
        return MapState(
            map=self.name,
            clock=self._wall(),
            fused=self.shared.fused,
            robots=[self._robot(ledger, now) for _, ledger in sorted(self.inbox.ledgers.items())],
            landmarks=self.shared.landmarks,
            decisions=self.shared.decisions,
            refused=refused,
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
        )

    def tell_state(self) -> None:
        """Everybody hears how the map stands, who is there and what it has."""
        payload = encode(self.state())
        if len(payload) <= LARGEST:
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

    def _answer_tiles(self, query: zenoh.Query) -> None:
        """The whole map as it is, for views that come late."""
        with query:
            for key in tuple(self.shared.tiles):
                payload = encode(self.shared.tile(key))
                query.reply(query.key_expr, payload)

    def _hear(self, sample: zenoh.Sample) -> None:
        self._heard.message(self._topics.robot_of(str(sample.key_expr)), sample.payload.to_bytes())

    def _hear_map(self, sample: zenoh.Sample) -> None:
        """Another map process may know robots that have left."""
        try:
            state = decode(sample.payload.to_bytes())
        except RefusedError:
            return
        if isinstance(state, MapState):
            self._heard.other.put(lambda: self.inbox.hearsay(state.robots, time.monotonic()))

    def _robot_there(self, sample: zenoh.Sample) -> None:
        robot, there = self._topics.robot_of(str(sample.key_expr)), sample.kind == zenoh.SampleKind.PUT
        self._heard.other.put(lambda: self._there(robot, there=there))

    def _there(self, robot: str, *, there: bool) -> None:
        ledger = self.inbox.ledgers.get(robot)
        if ledger is not None and ledger.there != there:
            self._say(f"{robot}: {'is there' if there else 'is gone'}")
        self.inbox.presence(robot, there=there)

    def _answer(self, query: zenoh.Query) -> None:
        """The past of any robot that is kept here, for those who come late."""
        with query:
            robot = self._topics.robot_of(str(query.key_expr))
            if robot == "*":
                query.reply_err(b"expected the name of a robot")
                return
            answer(query, str(query.key_expr), partial(self._store.get, robot))
