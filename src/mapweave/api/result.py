"""What every verb gives, as a type."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@runtime_checkable
class Result(Protocol):
    """The one protocol of results, whatever verb gave them.

    metrics: what stands in `metrics.json`; summary: a few lines for people; write: the files the command writes;
    plot: the main picture; notebooks show the head of a page.
    """

    @property
    def metrics(self) -> dict[str, Any]: ...
    def summary(self) -> str: ...
    def write(self, folder: Path | str, *, force: bool = False) -> None: ...
    def plot(self) -> "Figure": ...
    def _repr_html_(self) -> str: ...
