"""Ctrl-C, also where it falls into code that swallows exceptions, as a compiler's callbacks do."""

import signal
import sys
from _thread import interrupt_main
from threading import Timer, current_thread, main_thread
from types import FrameType, TracebackType
from typing import Self

AGAIN = 0.1  # [s]


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
