"""Where compiled kernels are kept, and who hears that one is being compiled, because none is kept for its arguments.

The folder is the user's own, shared by all environments and installations: it holds what need not be computed again.
"""

import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

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


FORGOTTEN = 14 * 86400.0  # [s] after which what was not written again is nobody's any more


def own_folder(name: str) -> Path | None:
    """`~/.cache/mapweave/NAME`, or below the folder of MAPWEAVE_CACHE_DIR; None where there is none to be trusted.

    What is read from there is run: a folder that others may write to is not used.
    """
    try:
        named = os.environ.get("MAPWEAVE_CACHE_DIR")
        cached = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(named or Path(cached) / "mapweave") / name
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = folder.stat()
        if hasattr(os, "getuid") and (state.st_uid != os.getuid() or state.st_mode & 0o022):
            return None
    except (OSError, RuntimeError):
        return None
    return folder


def is_forgotten(path: Path) -> bool:
    """Whether `path` was written long ago."""
    return time.time() - path.stat().st_mtime > FORGOTTEN
