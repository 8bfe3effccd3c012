"""Every Numba option of the project, said once."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.types.misc import unliteral

from ._cache import KernelCache
from .compiling import nothing_collected

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
