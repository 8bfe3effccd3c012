"""What a map process has heard of a team: every message once, in order of its robot and number.

No network and no clock here: `now` [s] is an argument, from any steady clock.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from .landmark_stream import LandmarkRecord
from .laser_stream import LaserRecord, whole_log
from .messages import (
    Closed,
    Header,
    Message,
    Numbered,
    RefusedError,
    RobotState,
    Rows,
    Scans,
    Snapshot,
    Status,
    decode,
)
from .store import Store

Record = LandmarkRecord | LaserRecord

ANSWER = 200  # messages asked for at once
PATIENCE = 0.3  # [s] that a message may come late before it is asked for
AGAIN = 2.0  # [s] until an unanswered question is asked again
RATE_OVER = 5.0  # [s] that messages a second are counted over
JOINED = "robots, in the order of joining"
STATED = 64  # robots without a certificate may call themselves anything: beyond so many none is taken on


@dataclass(slots=True)
class Ledger:
    """What is known of one robot. held: numbers in the store beyond `next`, which is the first one missing.

    record: what the messages before `next` say; fault: why messages from there on are not used. asked: when what is
    missing was asked for last, `here` messages being here then; answered: whether that is answered to its end.
    """

    robot: str
    run: str
    next: int = 0
    last: int = -1
    held: set[int] = field(default_factory=set)
    record: Record | None = None
    status: Status | None = None
    snapshot: Snapshot | None = None
    there: bool = False
    fault: str = ""
    doubled: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    heard: deque[float] = field(default_factory=lambda: deque(maxlen=2000))
    gap_since: float | None = None
    asked: float | None = None
    here: int = 0
    answered: bool = False

    @property
    def complete(self) -> bool:
        """Whether its log ended and all of it is here (or the rest can't be used)."""
        return bool(self.fault) or (self.record is not None and self.record.closed)

    @property
    def count(self) -> int:
        """How many messages are here."""
        return self.next + len(self.held)

    @property
    def missing(self) -> int:
        """How many messages it is known to have told that are not here."""
        return self.last + 1 - self.count

    def rate(self, now: float) -> float:
        """Messages a second of late."""
        while self.heard and self.heard[0] < now - RATE_OVER:
            self.heard.popleft()
        return len(self.heard) / RATE_OVER


class Inbox:
    """The ledgers of a team and the store behind them. expected: the robots that may be heard (all when None)."""

    def __init__(self, store: Store, expected: Sequence[str] | None = None) -> None:
        self.ledgers: dict[str, Ledger] = {}
        self.refused: Counter[str] = Counter()
        self._there: set[str] = set()
        self.news: deque[str] = deque(maxlen=100)
        self._expected = None if expected is None else set(expected)
        self._store = store
        self._unsaved: list[tuple[str, int, bytes]] = []
        self._waiting: dict[tuple[str, int], bytes] = {}
        for robot in (store.about(JOINED) or "").split():  # in the order of joining: who came first keeps its place
            self._recall(robot)

    def _recall(self, robot: str) -> None:
        """The ledger as it was before this process began."""
        run = self._store.about(f"run of {robot}") or ""
        ledger = self.ledgers[robot] = Ledger(robot, run)
        numbers = self._store.numbers(robot)
        ledger.held, ledger.last = set(numbers), max(numbers, default=-1)
        self._advance(ledger)

    def offer(self, speaker: str, payload: bytes, now: float) -> None:
        """Take in a message under the key of `speaker`; what cannot be used is counted and told, never raised."""
        try:
            self._take(speaker, decode(payload), payload, now)
        except RefusedError as refused:
            self._count(speaker, refused)

    def _count(self, speaker: str, refused: RefusedError) -> None:
        known = self.ledgers.get(speaker)
        counts = self.refused if known is None else known.refused
        counts[refused.reason] += 1
        if counts[refused.reason] == 1:  # the first of its kind is told
            self.news.append(f"{speaker}: refused: {refused}")

    def _take(self, speaker: str, message: Message, payload: bytes, now: float) -> None:
        if not isinstance(message, Header | Rows | Scans | Closed | Status | Snapshot):
            raise RefusedError("malformed", f"a {type(message).__name__} from a robot")
        if message.robot != speaker:
            raise RefusedError("forged name", f"{message.robot!r} under the key of {speaker!r}")
        self._expect(speaker)
        ledger = self._ledger(speaker, message.run)
        match message:
            case Status():
                ledger.status = message
                ledger.last = max(ledger.last, message.last)
            case Snapshot():
                if ledger.snapshot is None or message.last >= ledger.snapshot.last:
                    ledger.snapshot = message
            case _:
                self._number(ledger, message, payload, now)
        self._note_gap(ledger, now)

    def _expect(self, robot: str) -> None:
        if self._expected is not None and robot not in self._expected:
            raise RefusedError("not expected", f"{robot} is not one of --robots")

    @staticmethod
    def _note_gap(ledger: Ledger, now: float) -> None:
        if ledger.gap_since is None and ledger.missing > 0:
            ledger.gap_since = now

    def _ledger(self, speaker: str, run: str) -> Ledger:
        """The ledger of this history, begun when it is the first of its robot."""
        ledger = self.ledgers.get(speaker)
        if ledger is None:
            if len(self.ledgers) >= STATED:
                raise RefusedError("too many robots", f"{STATED} are known")
            ledger = self.ledgers[speaker] = Ledger(speaker, run, there=speaker in self._there)
            self._store.set_about(f"run of {speaker}", run)
            self._store.set_about(JOINED, " ".join(self.ledgers))
            self.news.append(f"{speaker}: joined")
        if run != ledger.run:
            raise RefusedError("other history", "another robot has this name, or it began a new history")
        return ledger

    def _number(self, ledger: Ledger, message: Numbered, payload: bytes, now: float) -> None:
        ledger.heard.append(now)
        seq = message.seq
        if seq < ledger.next or seq in ledger.held:
            ledger.doubled += 1
            return
        if ledger.fault:
            raise RefusedError("after a fault", ledger.fault)
        ledger.last = max(ledger.last, seq)
        ledger.held.add(seq)
        self._waiting[ledger.robot, seq] = payload
        self._unsaved.append((ledger.robot, seq, payload))
        self._advance(ledger)

    def _advance(self, ledger: Ledger) -> None:
        """Work in what is next for as long as it is here."""
        while ledger.next in ledger.held and not ledger.fault:
            seq = ledger.next
            ledger.held.discard(seq)
            ledger.next = seq + 1
            payload = self._waiting.pop((ledger.robot, seq), None)
            if payload is None:
                payload = next((data for _, data in self._store.get(ledger.robot, seq, seq)), b"")
            try:
                self._work_in(ledger, payload)
            except RefusedError as refused:
                ledger.fault = f"message {seq}: {refused}"
                ledger.next = seq
                self.news.append(f"{ledger.robot}: nothing is used from message {seq} on: {refused}")
        if ledger.missing <= 0:
            ledger.gap_since = ledger.asked = None

    def _work_in(self, ledger: Ledger, payload: bytes) -> None:
        message = decode(payload)
        if isinstance(message, Header):
            self._expect_room_for(ledger, message)
            landmarks = message.sensor == "landmarks"
            ledger.record = LandmarkRecord.begin(message, keep=False) if landmarks else LaserRecord(message)
        elif ledger.record is None or not isinstance(message, Rows | Scans | Closed):
            raise RefusedError("malformed", f"a {type(message).__name__} in a history without a header")
        else:
            ledger.record.add(message)

    def _expect_room_for(self, ledger: Ledger, header: Header) -> None:
        """Raises RefusedError when this robot can't be beside those that are known."""
        for other in self.ledgers.values():
            known = None if other is ledger or other.record is None else other.record.header
            if known is None:
                continue
            if known.log_robot == header.log_robot:
                raise RefusedError("name taken", f"{other.robot} is {header.log_robot} already")
            if known.sensor != header.sensor:
                raise RefusedError("sensor", f"{header.sensor}, and {other.robot} has {known.sensor}")

    def presence(self, robot: str, *, there: bool) -> None:
        """Whether the robot is there now, known of it or not."""
        (self._there.add if there else self._there.discard)(robot)
        if robot in self.ledgers:
            self.ledgers[robot].there = there

    def hearsay(self, robots: Iterable[RobotState], now: float) -> None:
        """Another map process has these messages: what is missing here is asked for."""
        for state in robots:
            try:
                self._expect(state.robot)
                ledger = self._ledger(state.robot, state.run)
            except RefusedError:
                continue
            ledger.last = max(ledger.last, state.have - 1)
            self._note_gap(ledger, now)

    def save(self) -> None:
        """What came since the last time is on disk; raises DataError, forgetting nothing, when it can't be."""
        if self._unsaved:
            self._store.put(self._unsaved)
            self._unsaved = []

    def gaps(self, now: float) -> Iterator[tuple[str, int, int]]:
        """Robot, first and last number to ask for now; asked for again, `AGAIN` later, while they do not come."""
        for ledger in self.ledgers.values():
            if ledger.gap_since is None or ledger.fault or now < ledger.gap_since + PATIENCE:
                continue
            more = ledger.answered and ledger.count > ledger.here
            if ledger.asked is not None and not more and now < ledger.asked + AGAIN:
                continue
            ledger.asked, ledger.answered, ledger.here = now, False, ledger.count
            until = min([k - 1 for k in ledger.held if k > ledger.next], default=ledger.last)
            yield ledger.robot, ledger.next, min(until, ledger.next + ANSWER - 1)

    def answered(self, robot: str) -> None:
        """A question about `robot` was answered to its end: the next is asked at once if that has brought anything."""
        if robot in self.ledgers:
            self.ledgers[robot].answered = True

    def log(self, robot: str) -> LandmarkLog | LaserLog | None:
        """What `robot` told up to its first gap; None of one that told no header yet."""
        ledger = self.ledgers[robot]
        record = ledger.record
        if record is None:
            return None
        if isinstance(record, LandmarkRecord):
            rows = LandmarkRecord.begin(record.header)
            for message in self._messages(ledger):
                if isinstance(message, Rows):
                    rows.add(message)
            return rows.log
        again = LaserRecord(record.header)
        parts = (again.add(message) for message in self._messages(ledger) if isinstance(message, Scans))
        return whole_log(record.header, (part for part in parts if part is not None))

    def _messages(self, ledger: Ledger) -> Iterator[Message]:
        """The messages before `next`, from the store and from what it does not hold yet."""
        unsaved = {seq: payload for robot, seq, payload in self._unsaved if robot == ledger.robot}
        for first in range(0, ledger.next, ANSWER):
            last = min(first + ANSWER, ledger.next) - 1
            kept = dict(self._store.get(ledger.robot, first, last))
            yield from (decode(kept.get(seq) or unsaved[seq]) for seq in range(first, last + 1))
