"""What a map process has heard of a team: every message once, in order of its robot and number.

Messages under a robot's key may be others' than the robot's, where no certificates keep them out. Two of one number
that differ are in doubt, and so is a history (`run`) until the robot itself, asked for it, has told the same: it alone
decides, and until then neither of two is used. No network and no clock here: `now` [s] is an argument, from any steady
clock.
"""

import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from ..core.names import robot_name
from ..ranges.network import RangeLog
from .door import decode, envelope_of
from .isolation import in_words
from .landmark_stream import WHEELS_LATE, LandmarkRecord, rows_told
from .laser_stream import LaserRecord, scans_told
from .messages import (
    Closed,
    Header,
    Message,
    Numbered,
    Radios,
    RefusedError,
    RobotState,
    Rows,
    Scans,
    Snapshot,
    Status,
    is_name,
)
from .range_stream import RangeRecord, ranges_told
from .store import Store

Record = LandmarkRecord | LaserRecord | RangeRecord

ANSWER = 200  # messages asked for at once
PATIENCE = 0.3  # [s] that a message may come late before it is asked for
AGAIN = 2.0  # [s] until an unanswered question is asked again
RATE_OVER = 5.0  # [s] that messages a second are counted over
JOINED = "robots, in the order of joining"
STATED = 64  # robots without a certificate may call themselves anything: beyond so many none is taken on
AHEAD = 20_000  # numbers beyond the first one missing that are kept: what is farther ahead is asked for in its turn
DECIDED_AT_ONCE = 100  # messages of its own history that a robot is asked for at once
IN_VAIN = 3  # questions without an answer of use until the robot itself is asked what is wrong with its message
MOST_UNSAVED = 256 << 20  # [bytes] that a full disk may leave in memory
MOST_THERE = 1_000  # names of robots that are there, heard of or not
MOST_REASONS = 50  # that messages of one speaker are refused for
OTHER = "other history", "another robot has this name, or it began a new history"
NOT_EXPECTED = "not expected"
TURNED_AWAY = {NOT_EXPECTED, "too many robots"}  # reasons for which a robot is not heard at all
MOST_WHY = 500  # letters of why a robot is not used: its own words may be in it
WHEELLESS = f"it announced wheels, and told no row of them in {WHEELS_LATE:g} s: it is mapped without"
RIVALS = "?"  # after a robot's name, which has none in it: what was told in its name beside what is used


@dataclass(slots=True)
class Ledger:
    """What is known of one robot. held: numbers in the store beyond `next`, which is the first one missing.

    top: the highest number here. record: what the messages before `next` say; fault: why messages from there on are not
    used. asked: when what is missing was asked for last, `here` messages being here then; answered: whether that is
    answered to its end; in_vain: how often in a row nothing of use came. own: whether the robot itself has told that
    this is its run; rivals: other runs that were told in its name; suspect: whether others have spoken in its name, so
    that all it told is in doubt; doubt: first and last such number, None when there is none; settled: numbers of which
    the robot itself has told its own; own_asked: when it was asked last, so many times. anew: how often its history was
    put right, all that was made of it being void.
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
    in_vain: int = 0
    top: int = -1
    own: bool = False
    rivals: set[str] = field(default_factory=set)
    doubt: tuple[int, int] | None = None
    suspect: bool = False
    settled: set[int] = field(default_factory=set)
    own_asked: tuple[float, int] = (float("-inf"), 0)
    anew: int = 0

    @property
    def complete(self) -> bool:
        """Whether its log ended and all of it is here (or the rest can't be used)."""
        closed = bool(self.fault) or (self.record is not None and self.record.closed)
        return closed and self.sure == self.next and not (self.fault and self.doubted)

    @property
    def doubted(self) -> bool:
        """Whether the next message may be another's than the robot's."""
        return self.doubt is not None and self.doubt[0] <= self.next

    @property
    def sure(self) -> int:
        """Messages before this number are used: all that are here without a gap and in no doubt."""
        return self.next if self.doubt is None else min(self.next, self.doubt[0])

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
        self._turned_away: dict[str, RefusedError] = {}
        self._there: set[str] = set()
        self.news: deque[str] = deque(maxlen=100)
        self._expected = None if expected is None else set(expected)
        self._store = store
        self._unsaved: dict[tuple[str, int], bytes] = {}
        self._unsaved_size = 0
        told = sorted(name for name in store.robots() if not name.endswith(RIVALS))
        for robot in dict.fromkeys([*(store.about(JOINED) or "").split(), *told]):  # who came first keeps its place
            self._recall(robot)

    def _recall(self, robot: str) -> None:
        """The ledger as it was before this process began."""
        numbers = self._store.numbers(robot)
        first = envelope_of(self._payload(robot, numbers[0])) if numbers else None  # a word may be lost with its disk
        run = (self._store.about(f"run of {robot}") or "") if first is None else first.run
        ledger = self.ledgers[robot] = Ledger(robot, run)
        ledger.held, ledger.last = set(numbers), max(numbers, default=-1)
        ledger.top, ledger.own = ledger.last, self._store.about(f"own run of {robot}") == run
        ledger.suspect = self._store.about(f"suspect {robot}") is not None
        if ledger.suspect:
            ledger.doubt = 0, ledger.top
        self._advance(ledger)

    def offer(self, speaker: str, payload: bytes, now: float) -> None:
        """Take in a message under the key of `speaker`; what cannot be used is counted and told, never raised."""
        try:
            self._expect(speaker)  # before it costs to read what it says
            if speaker not in self.ledgers:
                self._make_room()
            self._take(speaker, decode(payload), payload, now)
        except RefusedError as refused:
            self._count(speaker, refused)
        except Exception as error:  # noqa: BLE001  (no message may end the process; the door is to be mended)
            self._count(speaker, RefusedError("failed", in_words(error)))

    def refuse(self, speaker: str, reason: str, detail: str) -> None:
        """A message that was not even read is counted and told as others are."""
        self._count(speaker, RefusedError(reason, detail))

    def _count(self, speaker: str, refused: RefusedError) -> None:
        known = self.ledgers.get(speaker)
        counts = self.refused if known is None else known.refused
        if refused.reason in TURNED_AWAY and len(self._turned_away) < STATED and is_name(speaker):
            self._turned_away[speaker] = refused
        if len(counts) > MOST_REASONS and refused.reason not in counts:
            return
        counts[refused.reason] += 1
        if counts[refused.reason] == 1:  # the first of its kind is told
            self.news.append(f"{speaker}: refused: {refused}")

    def _take(self, speaker: str, message: Message, payload: bytes, now: float) -> None:
        if not isinstance(message, Header | Rows | Scans | Radios | Closed | Status | Snapshot):
            raise RefusedError("malformed", f"a {type(message).__name__} from a robot")
        if message.robot != speaker:
            raise RefusedError("forged name", f"{message.robot!r} under the key of {speaker!r}")
        ledger = self._ledger(speaker, message.run)
        match message:
            case Status():
                ledger.status = message
                ledger.last = max(ledger.top, message.last)
            case Snapshot():
                before = ledger.snapshot  # one of messages that are not here is nobody's word on which is newer
                if before is None or message.last >= before.last or before.last >= ledger.next:
                    ledger.snapshot = message
            case _:
                self._number(ledger, message, payload, now)
        self._note_gap(ledger, now)

    def _expect(self, robot: str) -> None:
        if self._expected is not None and robot not in self._expected:
            raise RefusedError(NOT_EXPECTED, f"{robot} is not one of --robots")

    @staticmethod
    def _note_gap(ledger: Ledger, now: float) -> None:
        if ledger.gap_since is None and ledger.missing > 0:
            ledger.gap_since = now

    def _ledger(self, speaker: str, run: str) -> Ledger:
        """The ledger of this history, begun when it is the first of its robot."""
        ledger = self.ledgers.get(speaker)
        if ledger is None:
            self._make_room()
            ledger = self.ledgers[speaker] = Ledger(speaker, run, there=speaker in self._there)
            self._store.set_about(f"run of {speaker}", run)
            self._store.set_about(JOINED, " ".join(self.ledgers))
            self.news.append(f"{speaker}: joined")
        if run != ledger.run:
            if not ledger.own and len(ledger.rivals) < STATED:
                ledger.rivals.add(run)
            raise RefusedError(*OTHER)
        return ledger

    def _make_room(self) -> None:
        """Who was only spoken of gives its place to who comes; raises RefusedError when there is nobody.

        Robots that are expected by name have a place each.
        """
        if self._expected is not None or len(self.ledgers) < STATED:
            return
        for name, ledger in self.ledgers.items():
            if not (ledger.there or ledger.own or ledger.count):
                del self.ledgers[name]
                return
        raise RefusedError(
            "too many robots",
            f"{STATED} are taken on unnamed: --robots NAME,NAME,.. of the map process takes on all it names",
        )

    def _number(self, ledger: Ledger, message: Numbered, payload: bytes, now: float) -> None:
        ledger.heard.append(now)
        seq = message.seq
        if seq < ledger.next or seq in ledger.held or (ledger.fault and seq == ledger.next):
            if self._payload(ledger.robot, seq) == payload:
                ledger.doubled += 1
            else:
                self._contradict(ledger, seq, payload)
            return
        if ledger.fault:
            raise RefusedError("after a fault", ledger.fault)
        if seq > ledger.next + AHEAD:
            raise RefusedError("far ahead", f"{seq} before {ledger.next}: asked for in its turn")
        if self._unsaved_size + len(payload) > MOST_UNSAVED:
            raise RefusedError("no room", "what the disk does not take: asked for later")
        ledger.last, ledger.top = max(ledger.last, seq), max(ledger.top, seq)
        ledger.held.add(seq)
        self._unsaved[ledger.robot, seq] = payload
        self._unsaved_size += len(payload)
        if ledger.suspect and seq not in ledger.settled:
            self._doubt(ledger, seq)
        self._advance(ledger, message)

    def _payload(self, robot: str, seq: int) -> bytes:
        """The message that is here; empty when the disk has lost it."""
        kept = self._unsaved.get((robot, seq))
        return kept if kept is not None else next((data for _, data in self._store.get(robot, seq, seq)), b"")

    def _contradict(self, ledger: Ledger, seq: int, payload: bytes) -> None:
        """Another message of a number that is here: both are kept, and neither is used before the robot decides."""
        if seq in ledger.settled:
            raise RefusedError("not its own", f"another message {seq} than the robot's history holds")
        if ledger.doubt is None:
            told = f"message {seq} was told in two ways: neither is used until the robot itself decides"
            self.news.append(f"{ledger.robot}: {told}")
        if not ledger.suspect:
            ledger.suspect = True
            self._store.set_about(f"suspect {ledger.robot}", "yes")
            self._doubt(ledger, next(k for k in range(seq + 1) if k not in ledger.settled))
            self._doubt(ledger, max(ledger.top, seq))
        self._doubt(ledger, seq)
        ledger.refused["told in two ways"] += 1
        self._store.put([(ledger.robot + RIVALS, seq, payload)])

    @staticmethod
    def _doubt(ledger: Ledger, seq: int) -> None:
        first, last = ledger.doubt or (seq, seq)
        ledger.doubt = min(first, seq), max(last, seq)

    def _advance(self, ledger: Ledger, fresh: Numbered | None = None) -> None:
        """Work in what is next for as long as it is here and in no doubt; `fresh`: the one that came just now."""
        while ledger.next in ledger.held and not ledger.fault and not ledger.doubted:
            seq = ledger.next
            ledger.held.discard(seq)
            ledger.next = seq + 1
            try:
                self._work_in(ledger, fresh if fresh is not None and fresh.seq == seq else None, seq)
            except Exception as error:  # noqa: BLE001  (it costs this robot's part alone)
                refused = in_words(error)
                ledger.fault = f"message {seq}: {refused}"
                ledger.next = seq
                self.news.append(f"{ledger.robot}: nothing is used from message {seq} on: {refused}")
        if ledger.missing <= 0:
            ledger.gap_since = ledger.asked = None

    def _work_in(self, ledger: Ledger, fresh: Numbered | None, seq: int) -> None:
        message = decode(self._payload(ledger.robot, seq)) if fresh is None else fresh
        if isinstance(message, Header) and seq == 0:
            self._expect_room_for(ledger, message)
            ledger.record = _begun(message)
        elif ledger.record is None or not isinstance(message, Numbered):
            raise RefusedError("malformed", f"a {type(message).__name__} in a history without a header")
        else:
            before = _wheelless(ledger)
            ledger.record.add(message)
            if _wheelless(ledger) and not before:
                self.news.append(f"{ledger.robot}: {WHEELLESS}")

    def _expect_room_for(self, ledger: Ledger, header: Header) -> None:
        """Raises RefusedError when this robot can't be beside those that are known and have as good a claim.

        One that has told itself what its history is has a better claim than one that others may have spoken for, and
        to a name in the log one whose own name ends with that number.
        """
        for other in list(self.ledgers.values()):
            known = None if other is ledger or other.record is None else other.record.header
            if known is None or known.log_robot != header.log_robot:
                continue
            mine, its = (ledger.own, _is_of(ledger.robot, header)), (other.own, _is_of(other.robot, known))
            refused = RefusedError("name taken", f"{other.robot} is {header.log_robot} already")
            aside = RefusedError("name taken", f"{ledger.robot} is {header.log_robot}")
            if mine <= its:
                raise refused
            self._set_aside(other, f"message 0: {aside}")

    def _set_aside(self, ledger: Ledger, why: str) -> None:
        """Nothing of this robot is used: its place is another's."""
        ledger.anew += 1
        ledger.record, ledger.fault, ledger.next = None, why, 0
        self.news.append(f"{ledger.robot}: nothing is used from message 0 on: {why}")

    def _reconsider(self) -> None:
        """Robots for whom there was no room have it now, if those who had it are others than they were."""
        for ledger in list(self.ledgers.values()):
            if ledger.fault and ledger.next == 0 and ledger.record is None:
                ledger.fault = ""
                unsaved = {seq for robot, seq in self._unsaved if robot == ledger.robot}
                ledger.held = {*self._store.numbers(ledger.robot), *unsaved}
                self._advance(ledger)

    def unused(self) -> dict[str, str]:
        """Robots of whom nothing, or nothing more, is used, and why: names and words that pass every door."""
        return {name: str(refused)[:MOST_WHY] for name, refused in self._away()} | self._faults()

    def not_used(self) -> list[str]:
        """A line for each history of which nothing, or nothing more, is used, but of who is not `expected`."""
        others = [(name, ": ".join(OTHER)) for name, x in self.ledgers.items() if x.refused[OTHER[0]]]
        away = [(name, str(refused)) for name, refused in self._away() if refused.reason != NOT_EXPECTED]
        return [f"{name}: {why}: not used" for name, why in [*others, *away, *self._faults().items()]]

    def wheelless(self) -> list[str]:
        """A line for each robot that has told none of the wheels that it announced."""
        return [f"{name}: {WHEELLESS}" for name, ledger in self.ledgers.items() if _wheelless(ledger)]

    def _away(self) -> list[tuple[str, RefusedError]]:
        return [(name, refused) for name, refused in self._turned_away.items() if name not in self.ledgers]

    def _faults(self) -> dict[str, str]:
        return {name: x.fault[:MOST_WHY] for name, x in self.ledgers.items() if x.fault and not x.doubted}

    def presence(self, robot: str, *, there: bool) -> None:
        """Whether the robot is there now, known of it or not."""
        if there and len(self._there) < MOST_THERE:
            self._there.add(robot)
        elif not there:
            self._there.discard(robot)
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
            self._store.put([(robot, seq, payload) for (robot, seq), payload in self._unsaved.items()])
            self._unsaved, self._unsaved_size = {}, 0

    def gaps(self, now: float) -> Iterator[tuple[str, int, int]]:
        """Robot, first and last number to ask for now; asked for again, `AGAIN` later, while they do not come."""
        for ledger in self.ledgers.values():
            if ledger.gap_since is None or ledger.fault or now < ledger.gap_since + PATIENCE:
                continue
            more = ledger.answered and ledger.count > ledger.here
            if ledger.asked is not None and not more and now < ledger.asked + AGAIN:
                continue
            ledger.in_vain = 0 if ledger.count > ledger.here else ledger.in_vain + 1
            ledger.asked, ledger.answered, ledger.here = now, False, ledger.count
            until = min([k - 1 for k in ledger.held if k > ledger.next], default=ledger.last)
            yield ledger.robot, ledger.next, min(until, ledger.next + ANSWER - 1)

    def doubts(self, now: float) -> Iterator[tuple[str, int, int]]:
        """Robot, first and last number that the robot itself, and nobody else, is to be asked for now."""
        for ledger in self.ledgers.values():
            when, often = ledger.own_asked
            if now < when + AGAIN:
                continue
            if ledger.doubt is not None:
                first, last = ledger.doubt
            elif not ledger.own and (ledger.rivals or (ledger.there and often < IN_VAIN)):
                first = last = 0
            elif ledger.in_vain >= IN_VAIN and ledger.there and not ledger.fault:
                first = last = ledger.next
            else:
                continue
            ledger.own_asked = now, often + 1
            yield ledger.robot, first, min(last, first + DECIDED_AT_ONCE - 1)

    def decide(self, robot: str, answers: Sequence[bytes], now: float) -> None:
        """What the robot itself answered, all of it: where it tells one thing alone, that is what it told.

        A run of its own takes the place of one that others told in its name; of what was told in two ways, its own
        stands, and what was made of the other is void; what it tells itself and no door lets in ends its history.
        """
        ledger = self.ledgers.get(robot)
        told: dict[int, dict[bytes, str]] = {}
        for payload in answers:
            envelope = envelope_of(payload)
            if envelope is not None and envelope.robot == robot:
                told.setdefault(envelope.seq, {})[payload] = envelope.run
        runs = {run for ways in told.values() for run in ways.values()}
        if ledger is None or len(runs) != 1:  # nothing, or its history itself is told in two ways
            return
        run = runs.pop()
        if run != ledger.run and not ledger.own:
            self._store.forget(robot)
            self._store.forget(robot + RIVALS)
            self._unsaved = {key: payload for key, payload in self._unsaved.items() if key[0] != robot}
            anew = ledger.anew + 1
            ledger = self.ledgers[robot] = Ledger(robot, run, there=ledger.there, refused=ledger.refused, anew=anew)
            self._store.set_about(f"run of {robot}", run)
            self.news.append(f"{robot}: others told a history in its name: it is forgotten, and its own is used")
        elif run != ledger.run:
            return
        if not ledger.own:
            ledger.own, ledger.rivals = True, set()
            self._store.set_about(f"own run of {robot}", run)
            self._reconsider()
        clear = {seq: next(iter(ways)) for seq, ways in told.items() if len(ways) == 1}
        self._settle(ledger, clear)
        if ledger.next in clear and not (ledger.next in ledger.held or ledger.fault):
            self._take_or_end(ledger, clear[ledger.next], now)

    def _settle(self, ledger: Ledger, clear: Mapping[int, bytes]) -> None:
        """Numbers in doubt of which the robot's own way is known by now."""
        if ledger.doubt is None:
            return
        first, last = ledger.doubt
        wrong: list[tuple[str, int, bytes]] = []
        while first <= last and first in clear:
            here = first < ledger.next or first in ledger.held or (first == ledger.next and bool(ledger.fault))
            if not here:
                ledger.held.add(first)
                self._unsaved[ledger.robot, first] = clear[first]
            elif self._payload(ledger.robot, first) != clear[first]:
                wrong.append((ledger.robot, first, clear[first]))
            ledger.settled.add(first)
            first += 1
        ledger.doubt = None if first > last else (first, last)
        if first > last:
            self._store.forget(ledger.robot + RIVALS)
            self.news.append(f"{ledger.robot}: the robot has decided what was told in two ways")
        if wrong:
            self.save()
            self._store.replace(wrong)
            ledger.anew += 1
            ledger.record, ledger.snapshot, ledger.fault, ledger.next = None, None, "", 0
            ledger.held = set(self._store.numbers(ledger.robot))
            self._reconsider()
        ledger.own_asked = float("-inf"), 0
        self._advance(ledger)

    def _take_or_end(self, ledger: Ledger, payload: bytes, now: float) -> None:
        """The robot's own next message is taken, or its history ends before it when no door lets it in."""
        try:
            message = decode(payload)
        except RefusedError as refused:
            ledger.fault = f"message {ledger.next}: {refused}"
            self.news.append(f"{ledger.robot}: nothing is used from message {ledger.next} on: {refused}")
            return
        if isinstance(message, Numbered):
            self._number(ledger, message, payload, now)

    def answered(self, robot: str) -> None:
        """A question about `robot` was answered to its end: the next is asked at once if that has brought anything."""
        if robot in self.ledgers:
            self.ledgers[robot].answered = True

    def log(self, robot: str) -> LandmarkLog | LaserLog | RangeLog | None:
        """What `robot` told up to its first gap; None of one that told no header yet."""
        ledger = self.ledgers[robot]
        record = ledger.record
        if record is None or ledger.sure == 0:
            return None
        if isinstance(record, LandmarkRecord):
            return rows_told(self._messages(ledger))
        if isinstance(record, RangeRecord):
            return ranges_told(self._messages(ledger))
        return scans_told(self._messages(ledger))

    def _messages(self, ledger: Ledger) -> Iterator[Message]:
        """The messages before `sure`, from the store and from what it does not hold yet."""
        for first in range(0, ledger.sure, ANSWER):
            last = min(first + ANSWER, ledger.sure) - 1
            kept = dict(self._store.get(ledger.robot, first, last))
            for seq in range(first, last + 1):
                yield decode(kept.get(seq) or self._unsaved[ledger.robot, seq])


def _begun(header: Header) -> Record:
    if header.sensor == "ranges":
        return RangeRecord(header)
    return LandmarkRecord.begin(header, keep=False) if header.sensor == "landmarks" else LaserRecord(header)


def _wheelless(ledger: Ledger) -> bool:
    return isinstance(ledger.record, LandmarkRecord) and ledger.record.wheelless


def _is_of(robot: str, header: Header) -> bool:
    """Whether the robot's own name ends with the number of the log that it tells."""
    number = re.search(r"\d+$", robot)
    return number is not None and robot_name(str(int(number[0]))) == header.log_robot
