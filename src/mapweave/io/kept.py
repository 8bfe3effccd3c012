"""Finished parts of long work, kept when it is stopped, and used by the next run that asks for the very same.

A part is known by the digest of all that it is made from: the function, its arguments (of a path: what the file holds),
every source of the package, and the versions of what computes. So a part is never out of date, only in vain. Parts lie
in the user's own cache folder, or in the one that MAPWEAVE_CACHE_DIR names, until the work is done; a folder that
somebody else may write to is not used.
"""

import hashlib
import io
import logging
import os
import pickle
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from ..core.errors import MapweaveError
from ..core.workers import Progress, no_progress
from ..kernels.compiling import is_forgotten, own_folder

log = logging.getLogger(__name__)

T = TypeVar("T")
LEAST = 10.0  # [s] of work that are worth keeping anything of
COMPUTES = ("numpy", "scipy", "numba")
TORN = (
    pickle.UnpicklingError,
    EOFError,
    ValueError,
    TypeError,
    AttributeError,
    ImportError,
    IndexError,
    KeyError,
    OSError,
)


@contextmanager
def kept_parts() -> Iterator[None]:
    """Within, `part` and `parts` keep what they finish; all of it is removed when the block ends without an exception.

    Of work that was stopped within `LEAST` seconds nothing is kept. An exception that leaves the block with parts kept
    says so in a note. Within another such block this one does nothing.
    """
    if _keeper.get() is not None:
        yield
        return
    keeper = _Keeper(_folder())
    token = _keeper.set(keeper)
    try:
        yield
    except BaseException as error:
        keeper.write_waiting()
        if keeper.finished:
            are = "part is" if keeper.finished == 1 else "parts are"
            mended = "once this is mended, " if isinstance(error, MapweaveError) else ""
            error.add_note(f"{keeper.finished} finished {are} kept: {mended}the same command goes on from there")
        raise
    else:
        keeper.forget()
    finally:
        _keeper.reset(token)


def part(function: Callable[..., T], *arguments: object, **unseen: object) -> T:
    """`function(*arguments, **unseen)`, or what an earlier run got from it; `unseen` has no say in the result."""
    keeper = _keeper.get()
    return function(*arguments, **unseen) if keeper is None else keeper.part(function, arguments, unseen)


def parts(
    function: Callable[..., T],
    tasks: Sequence[tuple[object, ...]],
    executor: Executor | None = None,
    stage: str = "",
    on_progress: Progress = no_progress,
) -> list[T]:
    """`function(*task)` of each task, in their order, whoever works on them; told as `stage` after each."""
    keeper = _keeper.get() or _Keeper(None)
    out: list[T] = []
    if executor is None:
        for task in tasks:
            out.append(keeper.part(function, task, {}))
            if stage:
                on_progress(stage, len(out), len(tasks))
        return out
    names = [keeper.name(function, task) for task in tasks]
    earlier = [keeper.earlier(name) for name in names]
    running: list[Future[T] | None] = [
        executor.submit(function, *task) if finished is None else None
        for task, finished in zip(tasks, earlier, strict=True)
    ]
    try:
        for name, finished, future in zip(names, earlier, running, strict=True):
            if future is None:
                assert finished is not None  # noqa: S101  (one of the two is there)
                out.append(finished[0])
            else:
                out.append(future.result())
                keeper.keep(name, out[-1])
            if stage:
                on_progress(stage, len(out), len(tasks))
    except BaseException:
        for name, future in zip(names[len(out) :], running[len(out) :], strict=True):
            if future is not None and not future.cancel() and future.done() and future.exception() is None:
                keeper.keep(name, future.result())
        raise
    return out


class _Keeper:
    """The parts of one run: those read, and those finished, which are written once the run is worth it."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.begun = time.monotonic()
        self.waiting: dict[str, object] = {}
        self.used: set[str] = set()
        self.warned = False

    @property
    def finished(self) -> int:
        return len(self.used)

    def part(self, function: Callable[..., T], arguments: Sequence[object], unseen: dict[str, Any]) -> T:
        name = self.name(function, arguments)
        finished = self.earlier(name)
        if finished is not None:
            earlier: T = finished[0]
            return earlier
        value = function(*arguments, **unseen)
        self.keep(name, value)
        return value

    def name(self, function: Callable[..., object], arguments: Sequence[object]) -> str:
        """The digest of what makes the part; empty where it cannot be known, and nothing is kept then."""
        if self.folder is None:
            return ""
        text = io.BytesIO()
        try:
            _Pickler(text).dump((function, tuple(arguments)))
        except (pickle.PicklingError, TypeError, AttributeError, OSError, RecursionError):
            return ""
        return hashlib.sha256(_sources().encode() + text.getbuffer()).hexdigest()[:40]

    def earlier(self, name: str) -> tuple[Any] | None:
        """The part that an earlier run finished, in a tuple, or None."""
        if self.folder is None or not name:
            return None
        try:
            value = pickle.loads((self.folder / name).read_bytes())  # noqa: S301  (our own, see `_folder`)
        except TORN:
            return None
        self.used.add(name)
        if not self.warned:
            self.warned = True
            log.warning("going on with the finished parts of a run that was stopped")
        return (value,)

    def keep(self, name: str, value: object) -> None:
        if self.folder is None or not name:
            return
        self.waiting[name] = value
        self.write_waiting()

    def write_waiting(self) -> None:
        """Every part there is stands in the folder, if the work is worth it by now."""
        if time.monotonic() - self.begun >= LEAST:
            for name, value in self.waiting.items():
                self._write(name, value)
            self.waiting.clear()

    def _write(self, name: str, value: object) -> None:
        folder = self.folder
        if folder is None:
            return
        with suppress(OSError, pickle.PicklingError, TypeError, AttributeError):
            data = pickle.dumps(value)
            handle, aside = tempfile.mkstemp(dir=folder, prefix=".")
            try:
                with os.fdopen(handle, "wb") as out:
                    out.write(data)
                Path(aside).replace(folder / name)
                self.used.add(name)
            finally:
                Path(aside).unlink(missing_ok=True)

    def forget(self) -> None:
        """The run is done: its parts are gone."""
        if self.folder is not None:
            for name in self.used:
                with suppress(OSError):
                    (self.folder / name).unlink()


_keeper: ContextVar[_Keeper | None] = ContextVar("_keeper", default=None)


class _Pickler(pickle.Pickler):
    """Paths stand for what they hold."""

    def reducer_override(self, value: object) -> Any:
        return (str, (str(value), _held(value))) if isinstance(value, Path) else NotImplemented


def _held(path: Path) -> str:
    """The digest of a file, or of all files in a folder with their names."""
    total = hashlib.sha256()
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        total.update(os.fsencode(file.relative_to(path)) + b"\0")
        with file.open("rb") as data:
            total.update(hashlib.file_digest(data, "sha256").digest())
    return total.hexdigest()


@cache
def _sources() -> str:
    """The digest of the package and of what it computes with."""
    total = hashlib.sha256(repr([platform.python_version(), *map(version, COMPUTES)]).encode())
    root = Path(__file__).parents[1]
    for source in sorted(root.rglob("*.py")):
        total.update(str(source.relative_to(root)).encode() + b"\0" + source.read_bytes() + b"\0")
    return total.hexdigest()


def _folder() -> Path | None:
    """The user's own folder for parts, old ones removed; None where there is none to be trusted."""
    folder = own_folder("parts")
    with suppress(OSError):
        for old in folder.iterdir() if folder is not None else ():
            if is_forgotten(old):
                old.unlink(missing_ok=True)
    return folder
