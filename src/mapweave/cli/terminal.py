"""Between a command and the terminal: what it prints, the numbers it is given, progress, Ctrl-C.

Progress goes to stderr: bars on a terminal, elsewhere a line every half minute. Ctrl-C counts also where it falls into
code that swallows exceptions, as a compiler's callbacks do. What Zenoh refuses before any of our code sees it, such as
strangers and names that are not one's own, it tells in log lines on the process's own output alone: they are counted.
"""

import math
import os
import re
import signal
import sys
import time
from _thread import interrupt_main
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from threading import Event, Thread, Timer, current_thread, main_thread
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Self

from ..core.errors import UsageError

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

    from ..core.workers import Progress as OnProgress


AGAIN = 0.1  # [s] after which an interruption that was swallowed is asked for again
QUIET = 30.0  # [s] between two lines of progress where there is no terminal
COMPILING = "compiling (first run only)"


def say(line: str = "") -> None:
    """One line on stdout."""
    print(line)  # noqa: T201


def warn(line: str) -> None:
    """One line on stderr."""
    print(f"mapweave: {' '.join(line.split())}", file=sys.stderr)  # noqa: T201


def say_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Columns as wide as they need to be, numbers right."""
    text = [[_cell(v) for v in row] for row in rows]
    width = [max(len(h), *(len(row[k]) for row in text)) if text else len(h) for k, h in enumerate(head)]
    for line in [list(head), *text]:
        say("  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(line, width, strict=True))))


def _cell(value: object) -> str:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    """`count` finite numbers; raises UsageError naming the option."""
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise UsageError(f"{option}: expected {count} numbers joined by commas, found {text!r}")
    return values


def pair(text: str | None, option: str) -> tuple[float, float] | None:
    """Two finite numbers, None where nothing is told; raises UsageError naming the option."""
    if text is None:
        return None
    first, second = numbers(text, 2, option)
    return first, second


def degrees(text: str, option: str) -> tuple[float, float]:
    """Two angles that are told in degrees [rad]; raises UsageError naming the option."""
    first, step = numbers(text, 2, option)
    return math.radians(first), math.radians(step)


@contextmanager
def progress() -> "Iterator[OnProgress]":
    """A progress callback on stderr: one bar a stage with the time left, or a line now and then where nobody watches.

    That kernels are being compiled is told when they are.
    """
    from ..kernels.compiling import compiling_told

    with _bars() if sys.stderr.isatty() else _lines() as shown:
        last: tuple[str, float, float | None] = ("starting", 0.0, None)

        def on_progress(stage: str, done: float, total: float | None = None) -> None:
            nonlocal last
            last = stage, done, total
            shown(stage, done, total)

        with compiling_told(lambda now: shown(*((COMPILING, 0.0, None) if now else last))):
            yield on_progress


@contextmanager
def _bars() -> "Iterator[OnProgress]":
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    bars: dict[str, TaskID] = {}
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as drawn:

        def on_progress(stage: str, done: float, total: float | None = None) -> None:
            if stage != COMPILING and COMPILING in bars:
                drawn.remove_task(bars.pop(COMPILING))
            if stage not in bars:
                bars[stage] = drawn.add_task(stage, total=total)
            drawn.update(bars[stage], completed=done, total=total)

        yield on_progress


@contextmanager
def _lines() -> "Iterator[OnProgress]":
    """Every `QUIET` seconds a line: the stage worked on, how far it is, and about how long it will take."""
    state = Stage("starting", time.monotonic())
    over = Event()

    def on_progress(stage: str, done: float, total: float | None = None) -> None:
        nonlocal state
        now = time.monotonic()
        if total and done >= total:
            stage, done, total = f"after {stage}", 0.0, None  # what comes now names itself, or takes so long
        begun, first = (state.begun, state.first) if stage == state.name else (now, done)
        state = Stage(stage, begun, first, done, total)

    def tell() -> None:
        while not over.wait(QUIET):
            with suppress(OSError, ValueError, AttributeError):  # nobody listens any more
                sys.stderr.write(f"mapweave: {state.line(time.monotonic())}\n")
                sys.stderr.flush()

    teller = Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield on_progress
    finally:
        over.set()
        teller.join()


@dataclass(frozen=True, slots=True)
class Stage:
    """What is worked on. begun [s], first: clock and part done when first heard of; total: None where unknown."""

    name: str
    begun: float
    first: float = 0.0
    done: float = 0.0
    total: float | None = None

    def line(self, now: float) -> str:
        """The stage for people, with the time left as its pace so far tells it."""
        if not self.total:
            return f"{self.name}, {now - self.begun:.0f} s"
        share = f"{self.name}, {100 * self.done / self.total:.0f} %"
        if self.done <= self.first:
            return share
        left = (now - self.begun) * (self.total - self.done) / (self.done - self.first)
        return f"{share}, about {_duration(left)} left"


def _duration(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 90
        else f"{seconds / 60:.0f} min"
        if seconds < 5400
        else f"{seconds / 3600:.1f} h"
    )


class Interruption:
    """While it lasts, `asked` says whether Ctrl-C was pressed; where that is swallowed it is raised again."""

    def __init__(self) -> None:
        self.asked = False
        self._mine = False

    def __enter__(self) -> Self:
        ours = current_thread() is main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if ours:
            signal.signal(signal.SIGINT, self._ask)
            self._hook_before, sys.unraisablehook = sys.unraisablehook, self._swallowed
            self._mine = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._mine:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook = self._hook_before

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        signal.default_int_handler(number, frame)

    def _swallowed(self, what: "sys.UnraisableHookArgs") -> None:
        """An exception nobody can catch: an interruption is asked for again a little later."""
        if not self.asked:
            self._hook_before(what)
        elif what.exc_type is KeyboardInterrupt:
            again = Timer(AGAIN, interrupt_main)
            again.daemon = True
            again.start()


@contextmanager
def until_interrupted() -> "Iterator[Event]":
    """An event that the first Ctrl-C (or SIGTERM) sets; a second one interrupts as everywhere."""
    stop = Event()
    if current_thread() is not main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ask(number: int, frame: object) -> None:  # noqa: ARG001
        stop.set()
        for n, handler in before.items():
            signal.signal(n, handler)

    for number in before:
        signal.signal(number, ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class FlowingHelp:
    """Cyclopts' own look, with every description as one paragraph."""

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        from cyclopts.help import DefaultFormatter, InlineText
        from rich.text import Text

        for entry in panel.entries:
            description = entry.description
            if isinstance(description, InlineText) and isinstance(description.primary_renderable, Text):
                description.primary_renderable = Text(" ".join(description.primary_renderable.plain.split()))
        DefaultFormatter()(console, options, panel)

    def render_usage(self, console: "Console", options: "ConsoleOptions", usage: object) -> None:
        """The line above all, as Cyclopts has it."""
        from cyclopts.help import DefaultFormatter

        DefaultFormatter().render_usage(console, options, usage)


STRANGER, FORGED = "strangers", "not on the access list"
REASONS = (  # words of a line, what it counts as; None: of no interest
    (re.compile(r"is unauthorized to"), FORGED),
    (re.compile(r"access_control"), None),
    (re.compile(r"interceptor"), None),
    (re.compile(r"Skipping name verification"), None),
    (
        re.compile(r"zenoh_link_tls.*(received fatal alert|invalid peer certificate|peer sent no certificates)"),
        STRANGER,
    ),
)
DENIED = re.compile(r"CertCommonName\((?P<who>[^)]*)\).* is unauthorized to (?P<what>.+) \(\w+\) on (?P<key>\S+)")
HEARD_THERE = re.compile(r"[^/]+/[^/]+/@map\b")  # keys that robots listen at
FIRST_JUDGED = "Reply"
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
LOG_LEVELS = "error,zenoh_link_tls=warn,zenoh::net::routing::interceptor::access_control=trace"


@contextmanager
def watched() -> Iterator[Counter[str]]:
    """Counts of what was refused; while it lasts, this process's own words go past Zenoh's."""
    counts: Counter[str] = Counter()
    sys.stdout.flush()
    ours = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    before, sys.stdout = sys.stdout, os.fdopen(ours, "w", buffering=1, encoding=sys.stdout.encoding, errors="replace")
    reader = Thread(target=_read, args=(reading, counts), daemon=True)
    reader.start()
    try:
        yield counts
    finally:
        sys.stdout.flush()
        os.dup2(sys.stdout.fileno(), 1)  # the pipe's last writer goes: the reader ends
        reader.join(1.0)
        sys.stdout.close()
        sys.stdout = before


def reason_of(line: str) -> tuple[bool, str | None]:
    """Whether Zenoh's line is understood, and what it counts as, if anything."""
    plain = COLOUR.sub("", line)
    for words, reason in REASONS:
        if words.search(plain):
            return True, reason
    return False, None


class Denials:
    """Which of Zenoh's lines on denied words tell of words that were said.

    As soon as somebody listens at a key Zenoh judges all that might be said there, and logs each denial in one go, the
    reply first: robots, which listen to map processes, were accused of what they never tried.
    """

    def __init__(self) -> None:
        self._judged: set[tuple[str, str]] = set()

    def said(self, line: str) -> bool:
        """Whether this one is about a word that was said."""
        denial = DENIED.search(line)
        if denial is None or not HEARD_THERE.match(denial["key"]):
            return True
        pair = (denial["who"], denial["key"])
        if denial["what"] == FIRST_JUDGED:
            self._judged.add(pair)
        return pair not in self._judged


def plain(reason: str, line: str) -> str:
    """A refusal in words: who was refused what."""
    denial = DENIED.search(line)
    if reason == FORGED and denial is not None:
        return f"refused: {reason}: {denial['who']} may not {denial['what'].lower()} on {denial['key']}"
    if reason == STRANGER:
        why = line.rpartition("unicast: ")[2].partition(". Hint")[0].strip()
        return f"refused: {reason}: a process without a valid certificate of this team's authority ({why})"
    return f"refused: {reason}: {line.strip()}"


def _read(reading: int, counts: Counter[str]) -> None:
    denials = Denials()
    with os.fdopen(reading, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            known, reason = reason_of(line)
            text = COLOUR.sub("", line)
            if reason is not None and (reason != FORGED or denials.said(text)):
                counts[reason] += 1
                if counts[reason] == 1:
                    print(plain(reason, text), file=sys.stderr)  # noqa: T201
            elif not known:
                sys.stderr.write(line)
