"""What every verb gives, as a type; and what scores share: they can be written as a folder of their own."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    from ..report.style import Axes, Figure
from abc import abstractmethod
from collections.abc import Sequence
from numbers import Real

from ..core.findings import Finding, Verdict
from ..core.version import __version__
from ..io.directory import read_json, result_file, write_json
from ..report.result import ResultBase, Rows


@runtime_checkable
class Result(Protocol):
    """What the result of every verb can do.

    metrics: what stands in `metrics.json`; summary: a few lines for people; write: the files the command writes;
    plot: the main picture; notebooks show the head of a page with it.
    """

    @property
    def metrics(self) -> dict[str, Any]: ...
    def summary(self) -> str: ...
    def write(self, folder: Path | str, *, force: bool = False) -> None: ...
    def plot(self, ax: "Axes | None" = None) -> "Figure": ...
    def _repr_html_(self) -> str: ...


@runtime_checkable
class MapResult(Result, Protocol):
    """What every kind of log's `map` gives: typed in its own way, and able to put itself into a folder.

    maps: `TeamMap`s of landmark logs, the largest first; `LaserMap`s of laser logs, one a robot. findings: what is
    wrong or worth knowing; verdict: what they make of the result, "good", "doubtful" or "bad".
    """

    @property
    def maps(self) -> tuple[Any, ...]: ...
    @property
    def findings(self) -> tuple[Finding, ...]: ...
    @property
    def verdict(self) -> Verdict: ...
    def lines(self) -> list[str]: ...
    def write_into(self, folder: Path) -> None: ...
    def finish(self, folder: Path) -> None: ...


class EvaluationBase(ResultBase):
    """Base of scores: `as_json` has the documented keys; `metrics` adds the version, as in `metrics.json`."""

    __slots__ = ()

    @abstractmethod
    def as_json(self) -> dict[str, Any]: ...

    @property
    @abstractmethod
    def unscored(self) -> str:
        """Why nothing could be scored; empty where something was."""

    @property
    def metrics(self) -> dict[str, Any]:
        return {"version": __version__, **self.as_json()}

    def headline(self) -> Rows:
        plain = [(name, value) for name, value in self.as_json().items() if isinstance(value, str | Real)]
        return ("score", "value"), plain

    def add_to(self, folder: Path, truth: Sequence[Path]) -> None:
        """The result scored holds this score: `evaluation` in its `metrics.json`, and the end of its `report.html`.

        A file that is not there is left so, a trajectory that was scored alone too. Raises ReaderError where
        metrics.json is damaged, OSError where nothing can be written.
        """
        if folder.is_file():
            return
        metrics, report = folder / "metrics.json", folder / "report.html"
        held = read_json(metrics)
        if report.is_file():
            from ..report.score import add_score  # noqa: PLC0415  (figures cost half a second)

            add_score(report, [p.name for p in truth], self.lines(), self.headline()[1], self.draw, self.as_json())
        with result_file(metrics) as work:
            write_json(work, {**held, "evaluation": self.as_json()})

    def write_into(self, folder: Path) -> None:
        from ..report.score import write_score_report  # noqa: PLC0415  (figures cost half a second)

        write_score_report(folder, self.lines(), self.headline()[1], self.draw)
        write_json(folder / "metrics.json", self.metrics)
