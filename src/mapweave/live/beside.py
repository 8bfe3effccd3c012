"""Work done beside everything else, in a thread that no process waits for when it ends."""

from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import TypeVar

Result = TypeVar("Result")


def beside(work: Callable[[], Result]) -> Future[Result]:
    """What `work` gives, or what it raises, once it is done in a thread of its own."""
    done: Future[Result] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # noqa: BLE001  (who asks for the result gets it)
            done.set_exception(error)

    Thread(target=run, name="beside", daemon=True).start()
    return done
