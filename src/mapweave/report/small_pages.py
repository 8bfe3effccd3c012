"""Pages of results that are no maps: what an installation lacks, and what a robot told its team."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .html import Page
from .style import LANDMARK, MUTED, Target, colour, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Check = tuple[str, str, bool | None]  # what is looked at, what was found; None: not there, and not needed
GOOD, BAD = colour(2), colour(5)


def write_small_page(
    folder: Path, title: str, lines: Sequence[str], table: tuple[Sequence[str], Sequence[Sequence[object]]], png: Path
) -> None:
    """`report.html` in `folder`: the lines, the picture `png`, the table."""
    page = Page(title, lines[0] if lines else "")
    for line in lines[1:]:
        page.text(line)
    page.figure(png, title)
    page.table(*table)
    page.write(folder / "report.html")


def draw_checks(target: Target, checks: Sequence[Check], seconds: Sequence[tuple[str, float]]) -> None:
    """Every check with a mark that tells how it came out, and beside them how long calls of a kernel took [s]."""
    rows = np.arange(len(checks))[::-1]
    with figure(target, 9.0, 0.24 * len(checks) + 0.9, ncols=2, width_ratios=(3, 2)) as (_, axes):
        left: Axes
        left, right = axes
        for row, (name, value, good) in zip(rows.tolist(), checks, strict=True):
            tint, shape = (MUTED, "o") if good is None else (GOOD, "o") if good else (BAD, "X")
            left.plot([0.0], [row], shape, color=tint, markersize=8)
            left.text(0.15, row, f"{name}: {value}", va="center")
        left.set_xlim(-0.2, 4.0)
        left.set_ylim(-0.7, len(checks) - 0.3)
        left.set_title("checks")
        left.axis("off")
        right.plot([name for name, _ in seconds], [s for _, s in seconds], "o", color=LANDMARK, markersize=9)
        right.margins(x=0.4, y=0.2)
        right.set_ylabel("time a kernel took [s]")
        if all(s > 0 for _, s in seconds):
            right.set_yscale("log")
        right.grid(visible=False, axis="x")


def draw_messages(target: Target, sizes: Sequence[int], heard_by: int) -> None:
    """How much a robot told its team, message by message [kB]."""
    total = np.concatenate([[0.0], np.cumsum(np.asarray(sizes, dtype=np.float64))]) / 1e3
    with figure(target, 6.4, 3.2) as (_, ax):
        ax.step(np.arange(len(total)), total, where="post", color=colour(0))
        ax.set_xlabel("messages")
        ax.set_ylabel("told in all [kB]")
        ax.set_title(f"all heard by {heard_by} map process{'' if heard_by == 1 else 'es'}")
