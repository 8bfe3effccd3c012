"""Compiled kernels kept on disk: an entry is used only by the very sources and options that it was made from.

Numba alone keys an entry by the file of the kernel. It does not see an edit of a function which that kernel calls in
another file, it looks an entry up in files whose names an older source used before, and it raises on a torn one.
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

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, UserWideCacheLocator

from .compiling import tell_compiled, tell_compiling
from .own_folder import is_forgotten, own_folder

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
