"""Work done beside everything else, in a thread that no process waits for when it ends."""

from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from threading import Thread, Timer
from typing import TypeVar

from .isolation import in_words

HUNG = 300.0  # [s] without a sign of life: no piece of work takes as long, with all that it compiles the first time

Result = TypeVar("Result")


def beside(work: Callable[[], Result], limit: float | None = None) -> Future[Result]:
    """What `work` gives, or the Exception that it ends with, once it is done in a thread of its own.

    Beyond `limit` (`HUNG`) [s] it is given up: a TimeoutError, whatever comes of it later.
    """
    done: Future[Result] = Future()
    limit = HUNG if limit is None else limit
    watch = Timer(limit, lambda: _end(done, TimeoutError(f"given up after {limit:g} s")))
    watch.daemon = True

    def run() -> None:
        try:
            result = work()
        except BaseException as error:  # noqa: BLE001  (who asks for the result gets it)
            _end(done, error if isinstance(error, Exception) else RuntimeError(in_words(error)))
        else:
            with suppress(InvalidStateError):  # given up
                done.set_result(result)
        watch.cancel()

    Thread(target=run, name="beside", daemon=True).start()
    watch.start()
    return done


def _end(done: Future[Result], error: Exception) -> None:
    with suppress(InvalidStateError):
        done.set_exception(error)
