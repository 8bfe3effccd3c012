"""How every figure looks: one palette for any colour vision, units on both axes, small files.

This module alone knows Matplotlib, and imports it where something is drawn: it costs half a second.
"""
# ruff: noqa: PLC0415

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

from ..core.errors import UsageError
from ..core.gaussian import ellipse

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure as Figure
    from matplotlib.figure import SubFigure
    from matplotlib.transforms import Bbox

# Okabe and Ito's palette, told apart with any colour vision; black is kept for truth, and brown stands where they have
# a yellow that nobody sees on white.
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#A0522D")
TRUTH = "#000000"
MUTED = "#9AA0A6"
LANDMARK = "#7A8088"  # seen on white and on black
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SEQUENTIAL = "cividis"
DPI = 110
GLYPH = r"Glyph \d+ .* missing from font"  # of a warning that nobody needs: the page shows the letter
GAP = 5.0  # [s]
INK = "#2B2F33"
NAME = "name of a point"  # of texts that `figure` keeps apart
BESIDE: Sequence[tuple[int, int, Literal["left", "center", "right"], Literal["bottom", "center", "top"]]] = (
    (5, 4, "left", "bottom"), (5, -4, "left", "top"), (-5, 4, "right", "bottom"), (-5, -4, "right", "top"),
    (0, 7, "center", "bottom"), (0, -7, "center", "top"), (8, 0, "left", "center"), (-8, 0, "right", "center"),
)  # fmt: skip

MOST_LETTERS = 16  # of a name in a picture
MOST_TOLD = 2 * len(PALETTE)  # entries of a legend
FACTORS = (1, 2, 5, 10, 20, 50, 100)  # by which ellipses are drawn larger

_RC: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E6E8EB",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.2,
    "figure.facecolor": "white",
    "text.parse_math": False,  # names of robots and landmarks are shown as they are, dollar signs too
}


def brief(name: str) -> str:
    """A name as pictures have room for it."""
    return name if len(name) <= MOST_LETTERS else f"{name[: MOST_LETTERS - 1]}…"


def gaps(t: Float[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Before which poses of a track nothing is known for long: a line through there would show a path nobody drove.

    Longer than five seconds and than ten usual steps. t: stamps [s], ascending.
    """
    steps = np.diff(t)
    if not len(steps):
        return np.zeros(0, np.intp)
    return np.asarray(np.flatnonzero(steps > max(GAP, 10.0 * float(np.median(steps)))) + 1)


def colour(k: int) -> str:
    return PALETTE[k % len(PALETTE)]


def marker(k: int) -> str:
    return MARKERS[k % len(MARKERS)]


@dataclass(slots=True)
class Sheet:
    """Holds the figure that is drawn on it, where a path would take its file; on `ax` of another one, where given."""

    figure: "Figure | SubFigure | None" = None
    ax: "Axes | None" = None


Target = Path | Sheet


@contextmanager
def figure(path: Target, width: float = 7.0, height: float = 5.0, **layout: Any) -> Iterator[tuple[Any, Any]]:
    """A figure of `width` x `height` inches and its axes (`layout`: as `Figure.subplots`); saved or left on a sheet.

    A letter of a robot's name that the font lacks is a box in the picture, and no warning: the report's page shows it.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(_RC), warnings.catch_warnings():
        warnings.filterwarnings("ignore", GLYPH, UserWarning)
        if isinstance(path, Sheet) and path.ax is not None:
            if layout.get("nrows", 1) * layout.get("ncols", 1) > 1:
                raise UsageError("ax: this picture has several parts: leave ax out, and plot() gives a figure of them")
            path.figure = path.ax.figure
            yield path.ax.figure, path.ax if layout.get("squeeze", True) else np.array([[path.ax]])
            return
        fig = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
        FigureCanvasAgg(fig)
        axes = fig.subplots(**layout)
        yield fig, axes
        if isinstance(path, Sheet):
            _finish(fig)
            path.figure = fig
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        save(fig, path)


def save(fig: "Figure", path: Path) -> None:
    """A figure in which all is drawn becomes a PNG without a program's name."""
    _finish(fig)
    fig.savefig(path, dpi=DPI, metadata={"Software": None})


def _finish(fig: "Figure") -> None:
    _plain_log_ticks(fig)
    _keep_names_apart(fig)


def _plain_log_ticks(fig: "Figure") -> None:
    """Logarithmic axes say 0.02 and 500; between powers of ten only where the axis spans less than two of them."""
    from matplotlib.ticker import FuncFormatter

    for ax in fig.axes:
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            if axis.get_scale() != "log":
                continue
            short = high < 100 * low
            axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
            axis.set_minor_formatter(FuncFormatter(lambda v, _, short=short: _between_powers(v) if short else ""))


def _between_powers(value: float) -> str:
    """2 and 5 times a power of ten as they are written; nothing for others."""
    digit = round(value / 10 ** np.floor(np.log10(value)))
    return f"{value:g}" if digit in {2, 5} else ""


def name_points(ax: "Axes", names: Sequence[str], places: Float[np.ndarray, "n 2"]) -> None:
    """Every name beside its point, where it covers no other in the finished figure; left out where there is no room."""
    for name, (x, y) in zip(names, places, strict=True):
        text = ax.annotate(
            brief(name), (x, y), (5, 4), textcoords="offset points", fontsize=8, color=INK, zorder=6, gid=NAME
        )
        text.set_in_layout(False)


def _keep_names_apart(fig: "Figure") -> None:
    from matplotlib.text import Annotation

    names = [t for ax in fig.axes for t in ax.texts if t.get_gid() == NAME and isinstance(t, Annotation)]
    if len(names) < 2:
        return
    fig.draw_without_rendering()  # lays the axes out
    taken: list[Bbox] = []
    for text in names:
        for x, y, across, along in BESIDE:
            text.set(ha=across, va=along)
            text.xyann = (x, y)
            here = text.get_window_extent().padded(1)
            if here.count_overlaps(taken) == 0:
                taken.append(here)
                break
        else:
            text.set_visible(False)


def drawn(draw: Callable[[Sheet], object], ax: "Axes | None" = None) -> "Figure":
    """The figure that `draw` draws, saved nowhere; the one of `ax`, where it is to be drawn there."""
    from matplotlib.figure import Figure

    sheet = Sheet(ax=ax)
    draw(sheet)
    if sheet.figure is None:
        raise RuntimeError("nothing was drawn")
    whole = sheet.figure.figure
    assert isinstance(whole, Figure)  # noqa: S101  (what a figure or a part of one lies in at last)
    return whole


def png(draw: Callable[[Sheet], object], most: int) -> bytes:
    """What `draw` draws as a PNG of at most so many bytes, the coarser the more there is in it."""
    sheet, dpi, data = drawn(draw), float(DPI), b""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", GLYPH, UserWarning)
        while not data or (len(data) > most and dpi > 1.0):
            buffer = BytesIO()
            sheet.savefig(buffer, dpi=dpi, metadata={"Software": None})
            data, dpi = buffer.getvalue(), 0.7 * dpi
    return data


def as_map(ax: "Axes", title: str = "", unit: str = "m") -> None:
    """Equal axes, named with their unit."""
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel(f"x [{unit}]")
    ax.set_ylabel(f"y [{unit}]")
    if title:
        ax.set_title(title)


def draw_ellipse(
    ax: "Axes",
    mean: Float[np.ndarray, "2"],
    cov: Float[np.ndarray, "2 2"],
    color: str,
    scale: float = 1.0,
    **more: Any,
) -> None:
    """The 95 % region of a 2D Gaussian, its half axes times `scale`."""
    from matplotlib.patches import Ellipse

    a, b, angle = ellipse(cov)
    ax.add_patch(
        Ellipse(
            (float(mean[0]), float(mean[1])),
            2 * scale * a,
            2 * scale * b,
            angle=np.degrees(angle),
            fill=False,
            edgecolor=color,
            linewidth=0.9,
            **more,
        )
    )


def draw_ellipses(
    ax: "Axes",
    at: Float[np.ndarray, "n 2"],
    half: Float[np.ndarray, "2 n"],
    angle: Float[np.ndarray, " n"],
    **look: Any,
) -> None:
    """Ellipses about `at`, of such half axes, the first of which is turned by `angle` [rad] from the axis x."""
    from matplotlib.collections import EllipseCollection

    axes = (2 * half[0], 2 * half[1], np.degrees(angle))
    ax.add_collection(EllipseCollection(*axes, units="xy", offsets=at, offset_transform=ax.transData, **look))


def draw_lines(ax: "Axes", ends: Float[np.ndarray, "n 2 2"], colour: str, width: float, **look: Any) -> None:
    """A line between every two `ends`."""
    from matplotlib.collections import LineCollection

    ax.add_collection(LineCollection(list(ends), colors=colour, linewidths=width, **look))


def shades(colours: Sequence[str]) -> "Colormap":
    """The colours of cells that are 0, 1 and so on."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(list(colours))


def rendered(fig: "Figure", dpi: int = 80) -> Image.Image:
    """The figure as it is now: the first frame of an animation lays it out, the others keep that layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(fig)
    fig.set_dpi(dpi)
    canvas.draw()
    fig.set_layout_engine("none")
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def legend_beside(ax: "Axes", rows: int) -> None:
    """A legend right of the axes, each name once, in columns of `rows`; none of so many that colours come again."""
    named: dict[str, Any] = {}
    for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
        named.setdefault(name, handle)
    if 0 < len(named) <= min(3 * rows, MOST_TOLD):
        columns = -(-len(named) // rows)
        ax.legend([*named.values()], [*named], loc="upper left", bbox_to_anchor=(1.0, 1.0), ncols=columns)


def larger(typical: float, most: float) -> int:
    """The largest round factor by which `typical` stays below `most`, at least 1."""
    return ([f for f in FACTORS if f * typical < most] or [1])[-1]
