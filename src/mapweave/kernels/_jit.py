"""Every Numba option of the project, said once."""

import os
from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])

# The subset of fast-math that keeps NaN and infinity meaningful.
SAFE_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}

prange = numba.prange


def kernel(fn: F) -> F:
    """`fn` compiled, cached on disk, exact IEEE arithmetic, one thread, without the GIL."""
    return numba.njit(cache=True, nogil=True)(fn)  # type: ignore[no-any-return]


def fast_kernel(fn: F) -> F:
    """`kernel` with reassociation and fused operations: only where it was measured to pay."""
    return numba.njit(cache=True, nogil=True, fastmath=SAFE_FASTMATH)(fn)  # type: ignore[no-any-return]


def parallel_kernel(fn: F) -> F:
    """`kernel` whose `prange` loops use threads; results must not depend on how many."""
    return numba.njit(cache=True, nogil=True, parallel=True, fastmath=SAFE_FASTMATH)(fn)  # type: ignore[no-any-return]


def set_threads(n: int) -> None:
    """Parallel kernels use at most `n` threads from here on; 0: as many as there are cores that nobody uses now.

    Threads that have to wait for a core make every parallel loop wait: on a busy machine fewer are faster.
    """
    most = int(numba.config.NUMBA_NUM_THREADS)
    if n == 0:
        n = round(most - os.getloadavg()[0]) if hasattr(os, "getloadavg") else most
    numba.set_num_threads(max(1, min(n, most)))
