"""A Dask cluster as the place where logs are worked on: its scheduler, spoken to as an executor."""

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..core.errors import EstimateError, UsageError

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

WAIT = 10.0  # [s] for the scheduler, and for a first worker


class ClusterExecutor(Executor):
    """Tasks on the workers of a Dask client. What is lost with its worker is tried elsewhere by Dask itself."""

    def __init__(self, client: Any) -> None:
        self.executor = client.get_executor(pure=False)

    def submit(self, fn: "Callable[..., Any]", /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = self.executor.submit(fn, *args, **kwargs)
        return future


@contextmanager
def cluster_executor(address: str, executor: Executor | None) -> Iterator[Executor]:
    """An executor on the cluster whose scheduler is at `address` (`tcp://host:8786`), closed at the end.

    Raises UsageError where an `executor` is given too, Dask is not installed, nobody answers there, or no worker is
    there; EstimateError where the workers are lost on the way.
    """
    if executor is not None:
        raise UsageError("--cluster: expected it or an executor, found both")
    try:
        from distributed import Client  # noqa: PLC0415  (an extra)
        from distributed.client import FutureCancelledError  # noqa: PLC0415
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError:
        raise UsageError("--cluster: Dask is not installed: pip install 'mapweave[cluster]'") from None
    with _quiet():
        try:
            client = Client(address, timeout=WAIT, set_as_default=False)
        except (OSError, TimeoutError, ValueError, TypeError) as error:
            raise UsageError(f"--cluster {address}: no Dask scheduler answers there ({_why(error)})") from None
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            client.close()
            raise UsageError(f"--cluster {address}: the scheduler there has no worker") from None
        try:
            yield ClusterExecutor(client)
        except (KilledWorker, FutureCancelledError, OSError) as error:
            if isinstance(error, OSError) and error.filename is not None:  # a file of ours, not the network
                raise
            raise EstimateError(f"--cluster {address}: its workers were lost: {_why(error)}") from None
        finally:
            client.close()


def _why(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


@contextmanager
def _quiet() -> Iterator[None]:
    """Within, Dask's own log lines are not printed: what matters comes as one error."""
    log = logging.getLogger("distributed")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)
