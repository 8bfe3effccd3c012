"""Whatever fails on what one robot told costs that robot's part alone: who it is, and what can be made without it.

What may hang as well is done beside everything else, in a thread that no process waits for when it ends.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from threading import Thread, Timer
from typing import TypeVar

from ..core.errors import MapweaveError, UsageError

Made = TypeVar("Made")


def in_words(error: BaseException) -> str:
    """What failed, in one line: an error of ours by its text, any other with its name."""
    text = " ".join(str(error).split())
    return text if isinstance(error, MapweaveError) and text else f"{type(error).__name__}: {text}".removesuffix(": ")


def without_culprits(
    robots: Sequence[str], make: Callable[[Sequence[str]], Made]
) -> tuple[Made | None, tuple[str, ...], dict[str, str]]:
    """What `make` gives of as many of `robots` as it can, of which, and why it failed with each of the others.

    Where `make` fails for all together, halves are asked, and halves of those that fail beside what holds so far: one
    among n costs about 2 log n calls. A robot is left out where it fails beside those held that come before it; where
    that is most of them, it is asked from the other end as well, lest one takes all others with it. None where nothing
    could be made.
    """
    made, failed = _held(robots, robots, make)
    if len(robots) > 1 and 2 * len(failed) > len(robots):
        again = _held(robots, robots[::-1], make)
        made, failed = min((made, failed), again, key=lambda one: len(one[1]))
    return made, tuple(name for name in robots if name not in failed), failed


def _held(
    robots: Sequence[str], order: Sequence[str], make: Callable[[Sequence[str]], Made]
) -> tuple[Made | None, dict[str, str]]:
    """What `make` gives of those of `robots` that hold, tried in this order, and why the others do not."""
    best: Made | None = None
    held: set[str] = set()
    failed: dict[str, str] = {}
    waiting = [order]
    while waiting:
        block = waiting.pop()
        try:
            best = make([name for name in robots if name in held or name in block])
            held |= set(block)
        except UsageError:  # what was asked for, and no robot's fault
            raise
        except Exception as error:  # noqa: BLE001  (whatever it is, the others get their map)
            if len(block) > 1:
                half = len(block) // 2
                waiting += [block[half:], block[:half]]
            elif block:
                failed[block[0]] = in_words(error)
    return best, failed


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
