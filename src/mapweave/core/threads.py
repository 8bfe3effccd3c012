"""Linear algebra on one thread, so that the same input gives the same bytes however many cores there are.

A BLAS splits a matrix product among its threads, and where it splits decides the order of the sums: the last digits of
the result, and whatever a threshold makes of them, would depend on the machine. The matrices here are small or come as
the fronts of a sparse factor, where waiting for threads costs more than they compute.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from threading import Lock
from typing import Any, ParamSpec, TypeVar

import scipy.linalg  # noqa: F401  (brings SciPy's own BLAS in; a limit holds for libraries loaded before it)
from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
T = TypeVar("T")


class _Limit:
    """The limit, set by the first who asks and lifted by the last: it belongs to the whole process."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.depth = 0
        self.libraries = ThreadpoolController()  # NumPy's and SciPy's, once: to look for them takes milliseconds
        self.limits: Any = None

    def enter(self) -> None:
        with self.lock:
            if self.depth == 0:
                self.limits = self.libraries.limit(limits=1, user_api="blas")
            self.depth += 1

    def leave(self) -> None:
        with self.lock:
            self.depth -= 1
            if self.depth == 0 and self.limits is not None:
                self.limits.restore_original_limits()
                self.limits = None


_limit = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within, and in functions decorated with it, BLAS and LAPACK use one thread, outside as many as before.

    A limit that another thread of the same program holds just now stays in force.
    """
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()


def keep_one_blas_thread() -> None:
    """From now on BLAS and LAPACK use one thread in this process: for processes of our own."""
    _limit.enter()


class OneThreadExecutor(Executor):
    """The executor given, with every task run on one BLAS thread. Ending it is left to whoever made it."""

    def __init__(self, executor: Executor) -> None:
        self.executor = executor

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        return self.executor.submit(_run, fn, args, kwargs)


def _run(fn: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any]) -> T:
    with one_blas_thread():
        return fn(*args, **kwargs)
