"""Two names change places in one step, and who still writes where: what file systems offer beyond Python's own."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

HERE = {"linux": -100, "darwin": -2}  # AT_FDCWD: names are relative to the working directory
SWAP = 2  # RENAME_EXCHANGE of Linux, RENAME_SWAP of Darwin
TRIES = 10


def put_in_place(work: Path, target: Path) -> None:
    """The directory `work` stands at `target`, in one step; what stood there before stands at `work`, if anything.

    Where the file system cannot exchange names there is an instant at which nothing stands at `target`.
    """
    for _ in range(TRIES):  # another process may put its own there, or take it away, between two steps
        if not target.exists():
            with suppress(OSError):
                work.rename(target)
                return
        elif _exchanged(work, target):
            return
    old = Path(tempfile.mkdtemp(prefix=work.name, dir=work.parent))
    target.replace(old)
    try:
        work.rename(target)
    except OSError:
        old.replace(target)
        raise
    old.rename(work)


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Within, `is_held(path)` is true in every process, until this one ends in whatever way."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:  # directories cannot be opened everywhere
        yield
        return
    try:
        _lock(handle)
        yield
    finally:
        os.close(handle)


def is_held(path: Path) -> bool:
    """Whether a process that lives holds `path`; true also where the file system cannot tell."""
    handle = os.open(path, os.O_RDONLY)
    try:
        return not _lock(handle)
    finally:
        os.close(handle)


def _lock(handle: int) -> bool:
    try:
        import fcntl  # noqa: PLC0415  (not on every system)

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return False
    return True


def _exchanged(one: Path, other: Path) -> bool:
    call = _exchange_call()
    return call is not None and call(HERE[sys.platform], bytes(one), HERE[sys.platform], bytes(other), SWAP) == 0


@cache
def _exchange_call() -> "ctypes._NamedFuncPointer | None":
    names = {"linux": "renameat2", "darwin": "renameatx_np"}
    try:
        call = ctypes.CDLL(None, use_errno=True)[names[sys.platform]]
    except (KeyError, OSError, AttributeError):
        return None
    call.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint]
    return call
