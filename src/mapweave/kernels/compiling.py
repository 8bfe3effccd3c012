"""Who hears that kernels are being compiled, because no code is kept for their arguments, and that it is done."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listeners: list[Callable[[bool], None]] = []
_begun: list[str] = []  # kernels being compiled, the innermost last


@contextmanager
def compiling_told(to: Callable[[bool], None]) -> Iterator[None]:
    """Within, `to(True)` is called when this process begins to compile, `to(False)` when nothing is left to compile."""
    _listeners.append(to)
    try:
        yield
    finally:
        _listeners.remove(to)


@contextmanager
def nothing_collected() -> Iterator[None]:
    """Within nothing looks for garbage, which takes a tenth of the time of compiling and more of that of importing."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def tell_compiling(name: str) -> None:
    """The kernel `name` is compiled from here on."""
    _begun.append(name)
    if len(_begun) == 1:
        _tell(now=True)


def tell_compiled(name: str) -> None:
    """The kernel `name` is compiled, and whatever it called."""
    if name in _begun:
        del _begun[_begun.index(name) :]
        if not _begun:
            _tell(now=False)


def _tell(*, now: bool) -> None:
    for to in tuple(_listeners):
        to(now)
