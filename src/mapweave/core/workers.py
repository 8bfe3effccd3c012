"""Where independent tasks run: an executor of the caller's, processes of our own, or here."""

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

from .threads import OneThreadExecutor, keep_one_blas_thread


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
