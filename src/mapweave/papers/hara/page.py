"""The figures and the page of `reproduce hara`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ...laser.laser_map import GridMap
from ...report.html import Page
from ...report.style import MUTED, SEQUENTIAL, TRUTH, Target, as_map, colour, figure


@runtime_checkable
class Shown(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def figure(self) -> str: ...
    @property
    def grid(self) -> GridMap: ...
    @property
    def track(self) -> Float[np.ndarray, "n 2"]: ...
    @property
    def truth(self) -> Float[np.ndarray, "m 2"]: ...


def write(
    where: Path, pictures: Sequence[Shown], head: Sequence[str], rows: Sequence[Sequence[object]], notes: Sequence[str]
) -> None:
    """`report.html` and `figures/*.png` in `where`."""
    figures = where / "figures"
    paper = [p for p in pictures if p.figure]
    draw_maps(figures / "maps.png", paper)
    draw_maps(figures / "geometry.png", [p for p in pictures if not p.figure])
    page = Page("reproduce hara", "Maps of a 200 m loop from scans with received light intensity")
    page.section("Figs. 4 to 7, side by side")
    page.figure(figures / "maps.png", "Cells in the colour of the light they send back; dashed: the truth.")
    page.section("Trajectory error")
    page.table(head, rows)
    page.section("The same without intensity, and matching on lines")
    page.figure(figures / "geometry.png", "Grey cells: no intensity used.")
    page.section("What differs from the paper, and why")
    for note in notes:
        page.text(note)
    page.write(where / "report.html")


def draw_maps(path: Target, pictures: Sequence[Shown]) -> None:
    """One panel a method, all at one scale."""
    across = 2
    down = -(-len(pictures) // across)
    with figure(path, 11.0, 3.6 * down + 0.3, nrows=down, ncols=across, squeeze=False) as (_, axes):
        for ax, p in zip(axes.ravel(), pictures, strict=False):
            cells = p.grid.cells()
            bare = not cells[:, 2].any()
            colours = {"color": MUTED} if bare else {"c": cells[:, 2], "cmap": SEQUENTIAL, "vmin": 0.0, "vmax": 1.0}
            ax.scatter(cells[:, 0], cells[:, 1], s=1.2, marker="s", linewidths=0, **colours)
            ax.plot(*p.track.T, color=colour(5), linewidth=0.8)
            ax.plot(*p.truth.T, color=TRUTH, linewidth=0.8, linestyle="--")
            as_map(ax, f"{p.figure}: {p.name}" if p.figure else p.name)
        for ax in axes.ravel()[len(pictures) :]:
            ax.set_visible(False)
