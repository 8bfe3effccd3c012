"""Every Numba option of the project, said once; and compiled kernels kept on disk.

An entry is used only by the very sources and options that it was made from. Numba alone keys it by the file of the
kernel: it does not see an edit of a function which that kernel calls in another file, it looks an entry up in files
whose names an older source used before, and it raises on a torn one.
"""

import ast
import hashlib
import inspect
import logging
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, UserWideCacheLocator
from numba.core.types.misc import unliteral

from .compiling import is_forgotten, nothing_collected, own_folder, tell_compiled, tell_compiling

log = logging.getLogger(__name__)

BROKEN = (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, ImportError, IndexError, KeyError)


LOCATORS = CompileResultCacheImpl._locator_classes  # noqa: SLF001  (first that of NUMBA_CACHE_DIR, then beside the source)


class OwnFolder(UserWideCacheLocator):
    """The user's folder: every environment finds what another compiled of the same sources, wherever they lie."""

    def __init__(self, kernel: Callable[..., object], file: str) -> None:
        super().__init__(kernel, file)
        self._cache_path = str((own_folder("kernels") or Path()) / kernel.__module__)

    @classmethod
    def from_function(cls, kernel: Callable[..., object], file: str) -> object:
        return None if own_folder("kernels") is None else super().from_function(kernel, file)


class NothingWritable:
    """Where entries are looked for when no folder takes any: that of NUMBA_CACHE_DIR, else beside the kernel."""

    @staticmethod
    def from_function(kernel: Callable[..., object], file: str) -> object:
        return LOCATORS[0 if numba.config.CACHE_DIR else 1](kernel, file)


class Places(CompileResultCacheImpl):
    """Where Numba keeps entries, and where it would raise, those that are there already."""

    _locator_classes = (LOCATORS[0], OwnFolder, *LOCATORS[1:], NothingWritable)


class KernelCache(FunctionCache):
    """The entries of one kernel, in files whose names carry the digest of all that its code depends on.

    A torn entry is told, put aside and built anew; where nothing can be written the kernel is compiled and not kept.
    """

    _impl_class = Places

    def __init__(self, kernel: Callable[..., object], options: str) -> None:
        super().__init__(kernel)
        self._stem: str = self._impl.filename_base
        self._digest = digest(inspect.getfile(kernel), options)
        self._cache_file = IndexDataCacheFile(self.cache_path, f"{self._stem}-{self._digest}", self._digest)

    def load_overload(self, sig: object, target_context: object) -> object:
        found: object = None
        try:
            found = super().load_overload(sig, target_context)
        except BROKEN as error:
            log.warning("%s: compiled code in %s is torn (%r): built anew", self._stem, self.cache_path, error)
            self._put_aside()
        except OSError:
            pass
        if found is None:
            tell_compiling(self._stem)
        return found

    def save_overload(self, sig: object, data: object) -> None:
        try:
            super().save_overload(sig, data)
        except BROKEN:
            self._put_aside()
        except OSError as error:
            _tell_not_kept(error.strerror or str(error))
        tell_compiled(self._stem)
        for old in self._files():
            if self._digest not in old.name and is_forgotten(old):  # other installations may use it
                _remove(old)

    def _put_aside(self) -> None:
        for torn in self._files():
            if self._digest in torn.name:
                _remove(torn)

    def _files(self) -> list[Path]:
        folder = Path(self.cache_path)
        return [f for end in ("nbi", "nbc") for f in folder.glob(f"{self._stem}-*.{end}")]


@cache
def digest(file: str, options: str) -> str:
    """16 hexadecimal digits of the sources that the kernels of `file` are made from, and of what compiles them."""
    compiler = (numba.__version__, numba.config.OPT, numba.config.BOUNDSCHECK, options)
    total = hashlib.sha256(repr(compiler).encode())
    for source in sorted(sources(Path(file).resolve())):
        total.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    return total.hexdigest()[:16]


def sources(file: Path) -> set[Path]:
    """`file` and every file that it imports by a relative import, and those that they import."""
    found: set[Path] = set()
    left = [file]
    while left:
        now = left.pop()
        if now not in found:
            found.add(now)
            left += _imported(now)
    return found


@cache
def _imported(file: Path) -> tuple[Path, ...]:
    out = []
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = file.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            names = [base.with_suffix(".py"), base / "__init__.py", *(base / f"{a.name}.py" for a in node.names)]
            out += [name for name in names if name.is_file()]
    return tuple(out)


@cache
def _tell_not_kept(reason: str) -> None:
    """Once a process and reason, whatever the number of kernels."""
    log.warning("compiled code is not kept (%s), every run compiles anew: MAPWEAVE_CACHE_DIR names a folder", reason)


def _remove(file: Path) -> None:
    with suppress(OSError):
        os.unlink(file)  # noqa: PTH108  (a file that another process removed first is no error)


F = TypeVar("F", bound=Callable[..., Any])

prange = numba.prange


def kernel(fn: F) -> F:
    """`fn` compiled, cached on disk, exact IEEE arithmetic, one thread, without the GIL."""
    return _cached(_compiled(fn), fn, "kernel")


def inlined_kernel(fn: F) -> F:
    """`kernel` that becomes part of the machine code of each kernel that calls it.

    In the loops of a `parallel_kernel` whose arrays are arguments or made outside of them, none is a part of another
    and none has a second name, the compiler knows that no two arrays overlap, and works on several numbers at once.
    """
    return _cached(_compiled(fn, forceinline=True), fn, "inlined")


def parallel_kernel(fn: F) -> F:
    """`kernel` whose `prange` loops use threads; results must not depend on how many.

    Its arithmetic is exact IEEE too: where sums may be reordered, a kernel that was just compiled and the same one read
    from the disk are optimised differently and differ in the last digit.
    """
    return _cached(_compiled(fn, parallel=True), fn, "parallel")


def set_threads(n: int) -> None:
    """Parallel kernels use at most `n` threads from here on; 0: as many as there are cores that nobody uses now.

    Threads that have to wait for a core make every parallel loop wait: on a busy machine fewer are faster.
    """
    most = int(numba.config.NUMBA_NUM_THREADS)
    if n == 0:
        n = round(most - os.getloadavg()[0]) if hasattr(os, "getloadavg") else most
    numba.set_num_threads(max(1, min(n, most)))


def _compiled(fn: F, **options: bool) -> Any:
    """The dispatcher of `fn`: compiled for an int, and not again for each constant that another kernel hands it.

    Nobody takes a kernel's address, so that the wrapper that C would call is not made: what compiles is smaller.
    """
    dispatcher = numba.njit(nogil=True, no_cfunc_wrapper=True, **options)(fn)
    if dispatcher is not fn:
        any_int = dispatcher.get_call_template
        dispatcher.get_call_template = lambda args, kws: any_int(
            [unliteral(a) for a in args], {name: unliteral(a) for name, a in kws.items()}
        )
    return dispatcher


def _cached(dispatcher: Any, fn: F, options: str) -> F:
    """The dispatcher with a cache of its own; `fn` itself, which has none, where Numba compiles nothing."""
    if dispatcher is not fn:
        dispatcher._cache = KernelCache(fn, options)  # noqa: SLF001
        dispatcher.compile = nothing_collected()(dispatcher.compile)
    return dispatcher  # type: ignore[no-any-return]


def threads() -> int:
    """How many threads parallel kernels use at most."""
    return int(numba.config.NUMBA_NUM_THREADS)


def cache_root(fn: Callable[..., Any]) -> Path | None:
    """The folder under which compiled kernels are kept, that of `fn` among them; None where nothing is compiled."""
    cache = getattr(fn, "_cache", None)
    if cache is None:
        return None
    folder = Path(cache.cache_path)
    return Path(__file__).parent if folder.name == "__pycache__" else folder.parent
