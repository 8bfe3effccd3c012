"""What every verb gives, as a type; and what scores share: they can be written as a folder of their own."""

import json
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast, overload, runtime_checkable

from ..core.errors import ReaderError, UsageError
from ..core.findings import Finding, Verdict
from ..core.paths import checked_arguments
from ..core.version import __version__
from ..io.directory import MARKERS, no_result, plain, read_json, result_file, write_json
from ..io.saved_result import read_result
from ..report.result import ResultBase, Rows
from ..report.team_figures import add_score, write_score_report

if TYPE_CHECKING:
    from ..report.style import Axes, Figure


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


IN_WORDS = {  # types of results as a command's user knows them
    "LaserResult": "a map of laser logs",
    "TeamResult": "a map of landmark logs",
    "MixedResult": "a map of a mixed team",
    "RangeResult": "a map by ranges",
    "LocalizeResult": "a robot's way in a map",
    "Located": "robots placed by bearings",
    "Moved": "moving robots placed by bearings",
    "LaserExploration": "an exploration with lasers",
    "LandmarkExploration": "an exploration among landmarks",
}


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
            add_score(report, [p.name for p in truth], self.lines(), self.headline()[1], self.draw, self.as_json())
        with result_file(metrics) as work:
            write_json(work, {**held, "evaluation": self.as_json()})

    def write_into(self, folder: Path) -> None:
        write_score_report(folder, self.lines(), self.headline()[1], self.draw)
        write_json(folder / "metrics.json", self.metrics)


R = TypeVar("R", bound=ResultBase)
LATER = ("timing", "evaluation")  # what a metrics.json says of a run and of a score made since, not of the result


@overload
def load(folder: Path | str) -> Result: ...
@overload
def load(folder: Path | str, kind: type[R]) -> R: ...
@checked_arguments
def load(folder: Path | str, kind: type[R] | None = None) -> Result | R:
    """The result that a verb wrote into `folder`, as the verb returned it: to be drawn, scored, fused or written again.

    Parameters
    ----------
    folder
        What a verb wrote.
    kind
        The type that is expected, as `TeamResult`: for type checkers, and checked (any).

    Raises
    ------
    ReaderError
        For a folder that holds no result, not all of one or one of another version, and where a file was edited.
    UsageError
        For a result of another kind.

    Examples
    --------
    >>> drive = simulate_laser("drive.mcap", CorridorConfig(distance=4.0), seed=1)
    >>> made = map("drive.mcap", "out")
    >>> load("out", LaserResult).maps[0].grid.shape == made.maps[0].grid.shape
    True
    """
    home = Path(folder)
    path = next((path for path in (home / name for name in MARKERS) if path.is_file()), None)
    if path is None:
        raise no_result(home)
    metrics = read_json(path)
    result = read_result(home)
    if kind is not None and not isinstance(result, kind):
        wanted, found = (f"{IN_WORDS.get(k.__name__, 'another result')} ({k.__name__})" for k in (kind, type(result)))
        raise UsageError(f"{folder}: expected {wanted}, found {found}")
    made = json.loads(json.dumps(plain(result.metrics)))
    if changed := [key for key in made | metrics if key not in LATER and made.get(key) != metrics.get(key)]:
        raise ReaderError(path, f"{changed[0]}: it is not as the result wrote it, but damaged or edited")
    known: dict[str, Any] = {"metrics": metrics, "timing": metrics.get("timing", {})}
    there = {f.name for f in fields(result)} if is_dataclass(result) else set()
    return cast("Result", replace(cast("Any", result), **{name: known[name] for name in known.keys() & there}))
