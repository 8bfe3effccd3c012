"""What a robot's live run gives: how much it told its team, and who has heard all of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.version import __version__
from ..io.directory import write_json
from ..report.result import ResultBase

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False)
class LiveRobot(ResultBase):
    """How a robot's live run ended. messages: sent, all on its disk; heard_by: map processes that have all.

    history: the file that keeps them; sizes: of each message [bytes].
    """

    name: str
    messages: int
    heard_by: int
    history: Path
    sizes: tuple[int, ...]

    @property
    def metrics(self) -> dict[str, Any]:
        return {
            "version": __version__,
            "name": self.name,
            "messages": self.messages,
            "bytes": sum(self.sizes),
            "heard_by": self.heard_by,
            "history": str(self.history),
        }

    def lines(self) -> list[str]:
        heard = f"{self.heard_by} map process{' has' if self.heard_by == 1 else 'es have'} all of them"
        sent = f"{self.name}: {self.messages} messages, {sum(self.sizes) / 1e3:.1f} kB, kept in {self.history}"
        return [sent, heard if self.heard_by else "no map process has all of them yet"]

    def draw(self, target: "Target") -> None:
        """How much it told, message by message."""
        from ..report.small_pages import draw_messages  # noqa: PLC0415  (figures cost half a second)

        draw_messages(target, self.sizes, self.heard_by)

    def write_into(self, folder: Path) -> None:
        """metrics.json, report.html and its picture; the messages themselves stay in the history."""
        from ..report.small_pages import write_small_page  # noqa: PLC0415  (figures cost half a second)

        png = folder / "figures" / "messages.png"
        self.draw(png)
        write_small_page(folder, "What a robot told its team", self.lines(), self.headline(), png)
        write_json(folder / "metrics.json", self.metrics)
