"""Who hears that a kernel is being compiled, because none of its code is kept for these arguments."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listeners: list[Callable[[str], None]] = []


@contextmanager
def compiling_told(to: Callable[[str], None]) -> Iterator[None]:
    """Within, `to` is called with the name of every kernel whose compilation begins in this process."""
    _listeners.append(to)
    try:
        yield
    finally:
        _listeners.remove(to)


def tell_compiling(name: str) -> None:
    for to in tuple(_listeners):
        to(name)
