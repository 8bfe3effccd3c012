"""What every verb gives has one face: lines for people, a page's head for notebooks, files, the main picture."""

from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast, runtime_checkable

from ..core.paths import checked_arguments
from ..core.signatures import readable
from ..io.directory import result_directory
from ..io.saved_result import write_result
from .elements import tag
from .html import list_files
from .style import drawn, png

if TYPE_CHECKING:
    from .style import Axes, Figure, Target

Rows = tuple[Sequence[str], Sequence[Sequence[object]]]
MOST_LINES, MOST_ROWS, MOST_LETTERS = 8, 12, 240  # of a page's head
MOST_PICTURE = 100_000  # [bytes] of its picture: a notebook of many results can still be mailed

R = TypeVar("R", bound="ResultBase")


@runtime_checkable
class HasMetrics(Protocol):
    @property
    def metrics(self) -> Mapping[str, Any]: ...


def written(result: R, out: Path | str | None, *, force: bool = False) -> R:
    """`result`, which stands in `out` now, where that is given."""
    if out is not None:
        result.write(out, force=force)
    return result


class ResultBase(ABC):
    """Base of results. A subclass has `metrics` too: what stands in `metrics.json`."""

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        """`help` on a result tells its signatures as that on a verb does."""
        super().__init_subclass__(**options)
        readable(cls)

    @abstractmethod
    def lines(self) -> list[str]:
        """What came out, line by line, for people."""

    @abstractmethod
    def write_into(self, folder: Path) -> None:
        """All files into `folder`, which is there and empty."""

    def write_data(self, folder: Path) -> None:
        """What other verbs read of `write_into`'s files, into `folder`; pages and pictures may be missing."""
        self.write_into(folder)

    @abstractmethod
    def draw(self, target: "Target") -> object:
        """The main picture on `target`."""

    def headline(self) -> Rows:
        """Head and rows of the table that tells the most; here the plain figures among the metrics."""
        metrics = cast("HasMetrics", self).metrics
        plain = [(name, value) for name, value in metrics.items() if isinstance(value, str | Real)]
        return ("what", "value"), plain

    def summary(self) -> str:
        """What came out, in a few lines for people."""
        return "\n".join(self.lines())

    @checked_arguments
    def write(self, folder: Path | str, *, force: bool = False) -> None:
        """The folder that the command writes: an earlier result there is replaced whole.

        Raises UsageError when something other than a result stands there, unless `force`.
        """
        with result_directory(Path(folder), force=force) as work:
            self.write_into(work)
            self.finish(work)

    def finish(self, folder: Path) -> None:
        """`folder`, into which all is written, holds what `load` reads, and its page lists the files there."""
        write_result(folder, self)
        list_files(folder)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """The main picture as a Matplotlib figure; on `ax`, where that is given, and then the figure `ax` is of.

        Raises UsageError for a picture of several parts, which needs a figure of its own.
        """
        return drawn(self.draw, ax)

    def _repr_html_(self) -> str:
        """The head of a page for notebooks: what `summary` says, the main picture and the table that tells the most."""
        picture = b64encode(png(self.draw, MOST_PICTURE)).decode("ascii")
        lines = self.lines()
        text = [part for line in lines[:MOST_LINES] for part in (tag("br"), _cut(line))][1:]
        if len(lines) > MOST_LINES:
            text += [tag("br"), f"and {len(lines) - MOST_LINES} lines more in ", tag("code", "summary()")]
        head, rows = self.headline()
        top = tag("thead", tag("tr", *(tag("th", _cut(name)) for name in head)))
        body = tag("tbody", *(tag("tr", *(tag("td", _cell(v)) for v in row)) for row in rows[:MOST_ROWS]))
        return tag(
            "div",
            tag("b", type(self).__name__),
            tag("p", *text),
            tag("img", alt="the map", style="max-width:100%", src=f"data:image/png;base64,{picture}"),
            tag("table", top, body),
            *([tag("p", f"and {len(rows) - MOST_ROWS} rows more")] if len(rows) > MOST_ROWS else []),
        )

    def __repr__(self) -> str:
        first = next(iter(self.lines()), "")
        return f"<{type(self).__name__}: {_cut(first)}>"


def _cell(value: object) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else _cut(str(value))


def _cut(text: str) -> str:
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 2]} …"
