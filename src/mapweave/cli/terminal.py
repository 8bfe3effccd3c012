"""Between a command and the terminal: what it prints, the numbers it is given, progress, Ctrl-C.

Progress goes to stderr and is silent where that is no terminal. Ctrl-C counts also where it falls into code that
swallows exceptions, as a compiler's callbacks do.
"""

import math
import signal
import sys
from _thread import interrupt_main
from collections.abc import Sequence
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Self

from ..core.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..core.workers import Progress as OnProgress

AGAIN = 0.1  # [s] after which an interruption that was swallowed is asked for again


def say(line: str = "") -> None:
    """One line on stdout."""
    print(line)  # noqa: T201


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


@contextmanager
def progress() -> "Iterator[OnProgress]":
    """A progress callback drawn as one bar a stage."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    bars: dict[str, TaskID] = {}
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    ) as drawn:

        def on_progress(stage: str, done: float, total: float | None = None) -> None:
            if stage not in bars:
                bars[stage] = drawn.add_task(stage, total=total)
            drawn.update(bars[stage], completed=done, total=total)

        yield on_progress


class Interruption:
    """While it lasts, `asked` says whether Ctrl-C was pressed; where that is swallowed it is raised again."""

    def __init__(self) -> None:
        self.asked = False
        self._mine = False

    def __enter__(self) -> Self:
        ours = current_thread() is main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if ours:
            signal.signal(signal.SIGINT, self._ask)
            self._told, sys.unraisablehook = sys.unraisablehook, self._swallowed
            self._mine = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._mine:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook = self._told

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        signal.default_int_handler(number, frame)

    def _swallowed(self, what: "sys.UnraisableHookArgs") -> None:
        """An exception nobody can catch: an interruption is asked for again a little later."""
        if not self.asked:
            self._told(what)
        elif what.exc_type is KeyboardInterrupt:
            again = Timer(AGAIN, interrupt_main)
            again.daemon = True
            again.start()
