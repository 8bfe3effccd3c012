"""Pages and pictures that are no reports of maps: installations, live robots, simulated worlds, the page that edits."""

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.records import Track
from .html import Page
from .scene import Scene, Shape, script
from .style import LANDMARK, MUTED, TRUTH, Target, colour, figure

if TYPE_CHECKING:
    from .style import Axes


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
    """Every check with a mark that tells how it came out, and how long calls of a kernel took [s], if any."""
    rows = np.arange(len(checks))[::-1]
    parts: dict[str, Any] = {"ncols": 2, "width_ratios": (3, 2)} if seconds else {}
    with figure(target, 9.0, 0.24 * len(checks) + 0.9, squeeze=False, **parts) as (_, axes):
        left: Axes = axes[0, 0]
        for row, (name, value, good) in zip(rows.tolist(), checks, strict=True):
            tint, shape = (MUTED, "o") if good is None else (GOOD, "o") if good else (BAD, "X")
            left.plot([0.0], [row], shape, color=tint, markersize=8)
            left.text(0.15, row, f"{name}: {value}", va="center")
        left.set_xlim(-0.2, 4.0)
        left.set_ylim(-0.7, len(checks) - 0.3)
        left.set_title("checks")
        left.axis("off")
        if not seconds:
            return
        right: Axes = axes[0, 1]
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


def draw_world(
    target: Target,
    title: str,
    ways: Mapping[str, Float[np.ndarray, "n 2"]],
    places: Float[np.ndarray, "m 2"] | None = None,
    walls: Float[np.ndarray, "w 4"] | None = None,
    pairs: Sequence[tuple[int, int]] = (),
) -> None:
    """True paths [m] by robot, places (landmarks or robots), walls (x0, y0, x1, y1), and who of `places` sees whom."""
    scene = Scene(title)
    scene.lines("walls", np.zeros((0, 4)) if walls is None else walls, TRUTH)
    if places is not None:
        scene.lines("who sees whom", places[np.array(pairs, int).reshape(-1, 2)].reshape(-1, 4), MUTED)
        shape: Shape = "star" if ways else "dot"
        scene.points("landmarks" if ways else "robots", [""] * len(places), places, TRUTH, named=False, shape=shape)
    for k, (name, way) in enumerate(ways.items()):
        poses = np.column_stack([way, np.zeros(len(way))])
        scene.track(name, name, Track(np.arange(len(way), dtype=float), poses), colour(k))
    scene.draw(target)


_BODY = """
<div id="map"></div>
<p id="told" role="status">reading the map</p>
<div class="bar edit"><label id="whole" hidden>map <select id="part"></select></label>
<label id="other" hidden>lay on it <select id="lay"></select></label><span id="hand" hidden>drag to move, with shift to
turn <label>by <input id="turn" type="range" min="-180" max="180" step="0.5" value="0"></label>
<button id="here">it lies here</button></span>
<label>drag to <select id="cells"><option value="">move</option><option value="free">erase walls</option>
<option value="unknown">forget a region</option></select></label>
<button id="undo">undo</button><button id="save">save</button></div>
<div id="place" class="card" hidden><b></b><span></span><div class="bar">
<button data-word="together">believe it</button><button data-word="apart">forbid it</button>
<button data-word="undecided">as the scans say</button></div></div>
<h2 id="robots" hidden>Robots</h2><table id="pairs" hidden></table>
<h2>What is doubtful</h2><ul id="findings"></ul>
"""


def editing_page(title: str) -> str:
    """The whole page; it asks `/state.json` for what it shows and posts to `/decide`, `/undo`, `/save`."""
    page = Page(
        title,
        "Click a line between two places to believe or forbid it, or drag over walls to erase; all is solved anew.",
    )
    page.parts.append(_BODY)
    return page.html(f"{script()}{_script()}")


@cache
def _script() -> str:
    return (files(__package__) / "editing.js").read_text(encoding="utf-8")
