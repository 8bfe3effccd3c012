"""Results appear whole or not at all: written aside, then put in place, whenever the process ends.

What a killed process left aside is removed by the next that writes to the same place. Two names change places in one
step, and a lock says who still writes where: what file systems offer beyond Python's own.
"""

import ctypes
import json
import math
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError, UsageError

MARKERS = ("metrics.json", "simulation.json")  # what tells an earlier result from anything else
ASIDE = ".unfinished-"  # in the name of whatever is not in place yet
SETTLED = 60.0  # [s] after which what stands aside and is held by nobody was left behind
LONGEST = 40  # letters of a target's name that the name aside repeats
HERE = {"linux": -100, "darwin": -2}  # AT_FDCWD: names are relative to the working directory
SWAP = 2  # RENAME_EXCHANGE of Linux, RENAME_SWAP of Darwin
TRIES = 10  # of changing names, while others do


def check_target(out: Path | str | None, *, force: bool = False, reads: Iterable[object] = ()) -> None:
    """Raises UsageError unless `out` may be (re)placed: absent, empty, an earlier mapweave result, or `force`.

    None, where nothing is to be written, always may.

    Raises it also where the folder that `out` belongs to cannot be written, and, `force` or not, where replacing `out`
    would take away what the job reads: one of `reads` (paths; anything else is passed over) is `out` or lies in it.
    """
    if out is None:
        return
    out = Path(out)
    for path in reads:
        if isinstance(path, str | os.PathLike) and Path(path).resolve().is_relative_to(out.resolve()):
            raise UsageError(f"{out}: {path} is read from there, and the result would replace it; give another --out")
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out}: exists and is not a directory")
    there = next(p for p in out.absolute().parents if p.exists())
    if not there.is_dir():
        raise UsageError(f"{out}: {there} is not a directory")
    if not os.access(there, os.W_OK | os.X_OK):
        raise UsageError(f"{out}: cannot be written: no permission to write in {there}")
    if force or not out.exists() or not any(out.iterdir()):
        return
    if not _is_result(out):
        raise UsageError(f"{out}: not empty and not a mapweave result; give another --out or --force")


@contextmanager
def result_directory(out: Path, *, force: bool = False) -> Iterator[Path]:
    """A fresh directory to write into; it takes the place of `out` when the block ends without an exception.

    At every moment `out` is what it was before or the new result, whole. Of two processes the last stays.
    """
    check_target(out, force=force)
    target = out.resolve()
    with naming(out):
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target)
        work = Path(tempfile.mkdtemp(prefix=_aside(target), dir=target.parent))
        try:
            with held(work):
                work.chmod(0o755)
                yield work
                put_in_place(work, target)
        finally:
            shutil.rmtree(work, ignore_errors=True)  # of a failure; or the result that was there before


@contextmanager
def result_file(out: Path) -> Iterator[Path]:
    """A path to write to; it takes the place of the file `out` when the block ends without an exception."""
    with naming(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        _sweep(out)
        handle, name = tempfile.mkstemp(prefix=_aside(out), dir=out.parent)
        os.close(handle)
        work = Path(name)
        try:
            with held(work):
                yield work
                work.chmod(0o644)
                work.replace(out)
        except BaseException:
            work.unlink(missing_ok=True)
            raise


@contextmanager
def naming(out: Path) -> Iterator[None]:
    """An error of the file system names `out`, which was asked for, in place of a name aside, its folder's or none."""
    try:
        yield
    except OSError as error:
        at = error.filename
        if error.errno is None or not (at is None or ASIDE in str(at) or out.is_relative_to(str(at))):
            raise
        raise OSError(error.errno, f"cannot be written: {os.strerror(error.errno)}", str(out)) from error


def _aside(target: Path) -> str:
    return f".{target.name[:LONGEST]}{ASIDE}"


def _sweep(target: Path) -> None:
    """What killed processes left beside `target` is gone."""
    for left in target.parent.glob(f"{_escaped(_aside(target))}*"):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime < SETTLED or is_held(left):
                continue
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink()


def _escaped(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def write_json(path: Path, value: Any) -> None:
    """`value` as indented JSON with keys in the order given; arrays become lists, NaN and infinity null."""
    text = json.dumps(plain(value), indent=1, ensure_ascii=False) + "\n"
    path.write_text(text, encoding="utf-8", errors="backslashreplace")  # bytes that are no letters read back the same


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in `path`; raises ReaderError when it cannot be read or is none."""
    try:
        value = json.loads(path.read_text(encoding="utf-8-sig"), parse_float=_finite, parse_constant=_finite)
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ReaderError(path, f"expected JSON: {error}") from None
    except RecursionError:
        raise ReaderError(path, "expected JSON, found brackets nested too deep") from None
    if not isinstance(value, dict):
        raise ReaderError(path, f"expected a JSON object, found {type(value).__name__}")
    return value


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(f"{word} is not finite")
    return value


def plain(value: Any) -> Any:
    """`value` in JSON's own types."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def no_result(folder: Path, expected: str = "a mapweave result with metrics.json") -> ReaderError:
    """What is said of a folder without a result, or without what was expected of it."""
    there = f"expected {expected}, found none"
    return ReaderError(folder, there if folder.exists() else "no such file or folder")


def _is_result(out: Path) -> bool:
    return any(_has_version(out / name) for name in MARKERS)


def _has_version(path: Path) -> bool:
    try:
        return "version" in read_json(path)
    except ReaderError:
        return False


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
