"""A robot's process: it keeps its history, drives its estimator and tells the team, whether or not anybody listens."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from threading import Event
from typing import Protocol, runtime_checkable

from ..core.errors import DataError, UsageError
from .door import decode
from .messages import LARGEST, Correction, Header, MapState, Numbered, RefusedError, Snapshot, Status, Topics, encode
from .store import Store
from .transport import MOST_ANSWERS, SETTLE, Callback, Query, Sample, SampleKind, Session, answer, put, there_is

STATUS_EVERY = 0.5  # [s]
SNAPSHOT_PAUSES = 0.5, 2.0  # [s] from snapshot to snapshot at least, and at most
SNAPSHOT_RATE = 12_000.0  # [bytes / s] that snapshots take while the longest pause allows it
DISK_AGAIN = 1.0  # [s] until a full disk is tried again
TICK = 0.05  # [s] that a feed is waited for
UNHEARD = 5.0  # [s] until it is told that no map process was heard of
MOST_MAPS = 64  # map processes that are heard: names may be invented
OTHER_RUN = "it has another history under this name: --fresh there, or another name here"
GRACE = 1.0  # [s] after the last message, for a map process to be heard of

Say = Callable[[str], None]


def pause_after(size: int) -> float:
    """The time [s] after a snapshot of `size` bytes before a fresher one is told."""
    least, most = SNAPSHOT_PAUSES
    return min(max(size / SNAPSHOT_RATE, least), most)


Timed = Iterator[tuple[float, Numbered]]


@runtime_checkable
class Driving(Protocol):
    """An estimator that takes messages one by one."""

    t: float | None

    def add(self, message: Numbered) -> None: ...
    def status(self) -> tuple[tuple[float, ...], tuple[float, ...], int]: ...
    def snapshot(self) -> Snapshot | None: ...


@runtime_checkable
class Feed(Protocol):
    """Messages that come when they come. `resume` is told what a history holds; `close` gives the last messages."""

    def resume(self, kept: Sequence[Numbered]) -> None: ...
    def take(self, timeout: float) -> list[Numbered]: ...
    def close(self) -> list[Numbered]: ...


@dataclass(frozen=True, slots=True)
class Pace:
    """rate: seconds of the log in one of the clock; inf: as fast as it goes. The rest: see `RobotProcess.run`."""

    rate: float = 1.0
    linger: float = 30.0
    expected: bool = False


@dataclass(slots=True)
class Listeners:
    """Map processes that are there, and how many messages each has of this robot.

    unused: why one uses nothing, or nothing more, of it. part: of each map process's map in which this robot stands, 1
    the largest, 0 none; corrections: where its frame is in that.
    """

    there: set[str] = field(default_factory=set)
    have: dict[str, int] = field(default_factory=dict)
    unused: dict[str, str] = field(default_factory=dict)
    ever: bool = False
    part: dict[str, int] = field(default_factory=dict)
    corrections: dict[str, Correction] = field(default_factory=dict)

    @property
    def shared(self) -> tuple[int, Correction] | None:
        """The robot's part and where its frame is in that, as the first map process that is there has it."""
        for name in sorted(self.there):
            if (part := self.part.get(name, 0)) and (correction := self.corrections.get(name)) is not None:
                return part, correction
        return None

    def all_have(self, n: int) -> bool:
        """Whether everybody there has the first `n` messages; of those who went, when nobody is there."""
        names = tuple(self.there) or tuple(self.have)
        return bool(names) and all(self.have.get(name, 0) >= n for name in names)


class RobotProcess:
    """One robot of a team. wall: the robot's own wall clock [s]."""

    def __init__(
        self,
        name: str,
        session: Session,
        topics: Topics,
        store: Store,
        say: Say,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self.name, self.last = name, -1
        self.listeners = Listeners()
        self._session, self._topics, self._store, self._say, self._wall = session, topics, store, say, wall
        self._unsaved: list[tuple[str, int, bytes]] = []
        self._full_until = 0.0
        self._snapshot_due = float("-inf")
        self._unheard_told = self._large_told = False
        self._declared: list[object] = []

    def join(self) -> None:
        """Others hear of this robot from now on; raises UsageError when one of its name is there."""
        if self._store.damage:
            self._say(f"{self.name}: {self._store.damage}")
        time.sleep(SETTLE)
        if there_is(self._session, self._topics.alive(self.name)):
            raise UsageError(f"--name {self.name}: a robot of that name is in team {self._topics.team} already")
        t, s = self._topics, self._session
        callback = Callback
        self._declared = [
            s.declare_queryable(t.history(self.name), callback(self._answer)),
            s.declare_queryable(t.clock(self.name), callback(self._tell_time)),
            s.declare_subscriber(t.map_state(), callback(self._hear_map)),
            s.declare_subscriber(t.correction(self.name), callback(self._hear_correction)),
            s.liveliness().declare_subscriber(t.map_alive(), callback(self._map_there), history=True),
            s.liveliness().declare_token(t.alive(self.name)),
        ]

    def run(self, messages: Timed, driving: Driving, pace: Pace, stop: Event) -> int:
        """All of `messages`, each at its time; how many there are now.

        Those in the store already are taken from there and not told again. After the last one the process stays until
        every map process there has all of them, but at most `pace.linger` [s]; where nobody was ever heard of it goes
        at once, unless others are `expected`, be the network gone just now.
        """
        rest = self._again(messages, driving)
        begin_t, begin = None, time.monotonic()
        told_status = float("-inf")
        fresh = False
        due: tuple[float, Numbered] | None = next(rest, None)
        while not stop.is_set() and (due is not None or self._unsaved):
            batch: list[Numbered] = []
            now = time.monotonic()
            while due is not None and len(batch) < MOST_ANSWERS:
                begin_t = due[0] if begin_t is None else begin_t
                if begin + (due[0] - begin_t) / pace.rate > now:
                    break
                batch.append(due[1])
                due = next(rest, None)
            self._tell(batch)
            for message in batch:
                driving.add(message)
            fresh |= bool(batch)
            now = time.monotonic()
            if now >= told_status + STATUS_EVERY:
                told_status = now
                self._tell_status(driving, finished=False)
            if self._tell_snapshot(driving, fresh=fresh):
                fresh = False
            if pace.expected and now > begin + UNHEARD:
                self._tell_unheard()
            if due is not None and begin_t is not None:
                wait = min(begin + (due[0] - begin_t) / pace.rate, told_status + STATUS_EVERY) - time.monotonic()
                stop.wait(max(wait, 0.0))
            elif self._unsaved:
                stop.wait(DISK_AGAIN)
        finished = due is None and not self._unsaved
        self._snapshot_due = float("-inf")
        self._tell_snapshot(driving, fresh=True)
        self._linger(driving, pace, stop, finished=finished)
        return self.last + 1

    def follow(
        self, feed: Feed, begin: Callable[[Header], Driving], pace: Pace, stop: Event, shown: Callable[[Driving], None]
    ) -> int:
        """All that `feed` gives until `stop`, which ends the drive; how many messages there are now.

        begin: the estimator of a header; shown: called with it after all that came was worked in. Then as `run`, but
        the process stays although `stop` is set.
        """
        driving = self._resumed(feed, begin)
        told_status = float("-inf")
        while not stop.is_set():
            driving = self._worked(feed.take(TICK), driving, begin)
            now = time.monotonic()
            if driving is not None and now >= told_status + STATUS_EVERY:
                told_status = now
                self._tell_status(driving, finished=False)
            if driving is not None:
                shown(driving)
        driving = self._worked(feed.close(), driving, begin)
        if driving is None:
            return 0
        if self._unsaved:  # a full disk gets one more try
            self._full_until = 0.0
            self._tell([])
        self._linger(driving, pace, Event(), finished=not self._unsaved)
        return self.last + 1

    def _resumed(self, feed: Feed, begin: Callable[[Header], Driving]) -> Driving | None:
        """The estimator after all that the store holds, and `feed` told of it."""
        kept = [decode(payload) for _, payload in self._store.get(self.name, 0, 1 << 60)]
        history = [message for message in kept if isinstance(message, Numbered)]
        lost = next((k for k, message in enumerate(history) if message.seq != k), None)
        if lost is not None:
            gone = f"messages from {lost} to {history[lost].seq - 1} are lost, and nobody drives that way again"
            raise DataError(f"{self._store.path}: {gone}; --fresh begins a new history")
        try:
            feed.resume(history)
        except RefusedError as error:
            raise UsageError(f"{self._store.path}: {error}") from None
        driving = None
        for message in history:
            driving = begin(message) if driving is None and isinstance(message, Header) else driving
            assert driving is not None  # noqa: S101  (a history begins with its header)
            driving.add(message)
            self.last = message.seq
        if history:
            self._say(f"{self.name}: goes on after {len(history)} messages of its history")
        return driving

    def _worked(
        self, batch: Sequence[Numbered], driving: Driving | None, begin: Callable[[Header], Driving]
    ) -> Driving | None:
        """`batch` kept, told and driven through."""
        self._tell(batch)
        for message in batch:
            driving = begin(message) if driving is None and isinstance(message, Header) else driving
            assert driving is not None  # noqa: S101  (a header comes first)
            driving.add(message)
        return driving

    def _again(self, messages: Timed, driving: Driving) -> Timed:
        """What the store holds, worked in anew; what is left of `messages`."""
        kept = dict(self._store.get(self.name, 0, 1 << 60))
        for seq in range(max(kept, default=-1) + 1):
            _, message = next(messages, (0.0, None))
            if message is None or encode(message) != kept.get(seq, encode(message)):
                raise UsageError(f"{self._store.path}: holds the history of another log; --fresh begins a new one")
            self._unsaved += [] if seq in kept else [(self.name, seq, encode(message))]  # its disk has lost it
            self.last = seq
            driving.add(message)
        if kept:
            self._say(f"{self.name}: goes on after {self.last + 1} messages of its history")
        return messages

    def _tell(self, batch: Sequence[Numbered]) -> None:
        """On disk first, then to the team: what was told is never lost."""
        self._unsaved += [(self.name, message.seq, encode(message)) for message in batch]
        now = time.monotonic()
        if not self._unsaved or now < self._full_until:
            return
        try:
            self._store.put(self._unsaved)
        except DataError as error:
            if self._full_until == 0.0:
                self._say(f"{self.name}: {error}: driving on, telling nothing until it can be kept")
            self._full_until = now + DISK_AGAIN
            return
        self._full_until = 0.0
        sent, self._unsaved = self._unsaved, []
        self.last = max(self.last, sent[-1][1])
        for _, _, payload in sent:
            put(self._session, self._topics.log(self.name), payload)

    def _tell_status(self, driving: Driving, *, finished: bool) -> None:
        pose, cov, landmarks = driving.status()
        header = self._header
        status = Status(
            robot=self.name,
            run=header[0],
            sensor=header[1],
            last=max(self.last, 0),
            clock=self._wall(),
            t=driving.t or 0.0,
            pose=pose,
            cov=cov,
            landmarks=landmarks,
            finished=finished,
        )
        put(self._session, self._topics.status(self.name), encode(status))

    @property
    def _header(self) -> tuple[str, str]:
        """Run and sensor of this robot."""
        return self._store.about("run") or "", self._store.about("sensor") or ""

    def _tell_unheard(self) -> None:
        """Once, when no map process was heard of so far."""
        if not (self.listeners.ever or self._unheard_told):
            self._unheard_told = True
            self._say(f"{self.name}: no map process is heard of yet: driving on, who comes later gets all of it")

    def _tell_snapshot(self, driving: Driving, *, fresh: bool) -> bool:
        """The map as it stands is told, when it is time; whether it was.

        fresh: whether it is another than the one told last, which is told again for who comes late.
        """
        now = time.monotonic()
        least, most = SNAPSHOT_PAUSES
        if driving.t is None or now < self._snapshot_due + (0.0 if fresh else most - least):
            return False
        snapshot = driving.snapshot()
        payload = b"" if snapshot is None else encode(snapshot)
        if 0 < len(payload) <= LARGEST:
            put(self._session, self._topics.snapshot(self.name), payload)
        elif payload and not self._large_told:
            self._large_told = True
            self._say(f"{self.name}: its map is more than a message holds: the shared map holds it at the end alone")
        self._snapshot_due = now + pause_after(len(payload))
        return True

    def _linger(self, driving: Driving, pace: Pace, stop: Event, *, finished: bool) -> None:
        """Answers until nobody needs it any more; a status now and then."""
        begin = time.monotonic()
        last_status = float("-inf")
        while not stop.is_set():
            now = time.monotonic()
            nobody = not (self.listeners.there or self.listeners.ever or pace.expected)
            if now > begin + pace.linger or (nobody and now > begin + GRACE):
                return
            if self.listeners.all_have(self.last + 1):
                return
            if pace.expected and now > begin + UNHEARD:
                self._tell_unheard()
            if now >= last_status + STATUS_EVERY:
                last_status = now
                self._tell_status(driving, finished=finished)
            self._tell_snapshot(driving, fresh=False)
            stop.wait(0.1)

    def _answer(self, query: Query) -> None:
        """The numbered messages that are asked for, as they were told."""
        with query:
            answer(query, self._topics.history(self.name), partial(self._store.get, self.name))

    def _tell_time(self, query: Query) -> None:
        with query:
            query.reply(self._topics.clock(self.name), repr(self._wall()))

    def _hear_map(self, sample: Sample) -> None:
        if (
            len(self.listeners.have) >= MOST_MAPS
            and self._topics.map_of(str(sample.key_expr)) not in self.listeners.have
        ):
            return
        try:
            state = decode(sample.payload.to_bytes())
        except RefusedError:
            return
        if isinstance(state, MapState) and state.map == self._topics.map_of(str(sample.key_expr)):
            mine = next((robot for robot in state.robots if robot.robot == self.name), None)
            why = state.unused.get(self.name, "")
            if mine is not None and mine.run != self._header[0]:
                mine, why = None, OTHER_RUN
            self._note_unused(state.map, why)
            self.listeners.have[state.map] = 0 if mine is None else mine.have
            self.listeners.part[state.map] = 0 if mine is None else mine.component
            self.listeners.ever = True  # a liveliness token may be long in coming over a slow link

    def _note_unused(self, named: str, why: str) -> None:
        """Whether, and why, this map process uses nothing more of the robot; told when it changes."""
        if why and self.listeners.unused.get(named) != why:
            self._say(f"{self.name}: not used by map process {named}: {why}")
        if why:
            self.listeners.unused[named] = why
        else:
            self.listeners.unused.pop(named, None)

    def _hear_correction(self, sample: Sample) -> None:
        try:
            message = decode(sample.payload.to_bytes())
        except RefusedError:
            return
        named = self._topics.map_of(str(sample.key_expr))
        known = named in self.listeners.have or len(self.listeners.corrections) < MOST_MAPS
        if isinstance(message, Correction) and (message.robot, message.map) == (self.name, named) and known:
            self.listeners.corrections[named] = message

    def _map_there(self, sample: Sample) -> None:
        name = self._topics.map_of(str(sample.key_expr))
        if sample.kind == SampleKind.PUT:
            self.listeners.ever = True
            if len(self.listeners.there) < MOST_MAPS:
                self.listeners.there.add(name)
        else:
            self.listeners.there.discard(name)
