"""Long work: where its tasks run, on how many threads of linear algebra, and who hears how far it is.

A BLAS splits a matrix product among its threads, and where it splits decides the order of the sums: the last digits of
the result, and whatever a threshold makes of them, would depend on the machine. So everything runs on one: the matrices
here are small or come as the fronts of a sparse factor, where waiting for threads costs more than they compute.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from threading import Lock
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, TypeVar, runtime_checkable

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


@contextmanager
def worker_pool(jobs: int, tasks: int, executor: Executor | None = None) -> Iterator[Executor | None]:
    """The executor given, else up to `jobs` processes, else None where one is enough: the work is done here.

    Processes are spawned: a fork of a process that runs compiled threads is not safe. Everywhere linear algebra runs on
    one thread, so that a result does not depend on where it was computed.
    """
    if executor is not None:
        yield OneThreadExecutor(executor)
        return
    if min(jobs, tasks) < 2:
        yield None
        return
    context = get_context("spawn")
    with ProcessPoolExecutor(min(jobs, tasks), mp_context=context, initializer=keep_one_blas_thread) as pool:
        yield pool


P = ParamSpec("P")
T = TypeVar("T")


def _libraries() -> "ThreadpoolController":
    """NumPy's and SciPy's BLAS, both loaded: a limit holds for libraries loaded before it."""
    import scipy.linalg  # noqa: F401, PLC0415  (an option that is refused shall not wait for it)
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415

    return ThreadpoolController()


class _Limit:
    """The limit, set by the first who asks and lifted by the last: it belongs to the whole process."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.depth = 0
        self.libraries: ThreadpoolController | None = None
        self.limits: Any = None

    def enter(self) -> None:
        with self.lock:
            if self.depth == 0:
                if self.libraries is None:  # once: to look for them takes milliseconds
                    self.libraries = _libraries()
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


@runtime_checkable
class Progress(Protocol):
    """A callback that long work tells how far it is: `done` of `total` (None when unknown) of the stage named."""

    def __call__(self, stage: str, done: float, total: float | None = None) -> None: ...


def no_progress(stage: str, done: float, total: float | None = None) -> None:
    """Progress nobody watches."""
