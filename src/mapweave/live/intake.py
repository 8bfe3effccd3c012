"""Messages that wait to be worked in: so many bytes at most, and no speaker takes the place or the time of another."""

from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from time import monotonic

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
