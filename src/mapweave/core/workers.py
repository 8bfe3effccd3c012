"""Where independent tasks run: an executor of the caller's, processes of our own, or here."""

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context


@contextmanager
def worker_pool(jobs: int, tasks: int, executor: Executor | None = None) -> Iterator[Executor | None]:
    """The executor given, else up to `jobs` processes, else None where one is enough: the work is done here.

    Processes are spawned: a fork of a process that runs compiled threads is not safe.
    """
    if executor is not None or min(jobs, tasks) < 2:
        yield executor
        return
    with ProcessPoolExecutor(min(jobs, tasks), mp_context=get_context("spawn")) as pool:
        yield pool
