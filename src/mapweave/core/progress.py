"""Progress on long work: one callback for the whole house, and the one that says nothing."""

from typing import Protocol, runtime_checkable


@runtime_checkable
class Progress(Protocol):
    """Told `done` of `total` (None when unknown) of the stage named."""

    def __call__(self, stage: str, done: float, total: float | None = None) -> None: ...


def no_progress(stage: str, done: float, total: float | None = None) -> None:
    """Progress nobody watches."""
