"""What scores of every kind share: they are results, and can be written as a folder of their own."""

from abc import abstractmethod
from numbers import Real
from pathlib import Path
from typing import Any

from ..core.version import __version__
from ..io.directory import write_json
from ..report.result import ResultBase, Rows


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

    def write_into(self, folder: Path) -> None:
        from ..report.score import write_score_report  # noqa: PLC0415  (figures cost half a second)

        write_score_report(folder, self.lines(), self.headline()[1], self.draw)
        write_json(folder / "metrics.json", self.metrics)
