"""The figures and the page of `reproduce kojima`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from ...core import se2
from ...report.html import Page
from ...report.style import MUTED, TRUTH, Target, as_map, colour, figure, marker


@dataclass(frozen=True, slots=True)
class Table:
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True, slots=True)
class Curve:
    """Trace of the covariance after each update: mean and 5 to 95 % band over the worlds, and its limit."""

    reading: str
    name: str
    mean: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    limit: float


@dataclass(frozen=True, slots=True)
class Pictures:
    """What the figures show.

    errors: by reading, (RLS, proposed) landmark errors of each world [m]; bars: landmark error [m] by (baseline,
    weights); the rest is one world: truth, start poses, fused landmarks and frame.
    """

    first_step: int
    curves: Sequence[Curve]
    errors: Mapping[str, tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]]
    printed: tuple[float, float]
    bars: Mapping[tuple[str, str], float]
    truth: Float[np.ndarray, "n 2"]
    start: Float[np.ndarray, "2 3"]
    radius: float
    fused: Float[np.ndarray, "n 2"]
    frame: Float[np.ndarray, "3"]


def write(where: Path, pictures: Pictures, tables: Sequence[Table], differences: Sequence[str]) -> None:
    """`report.html` and `figures/*.png` in `where`."""
    figures = where / "figures"
    draw_trace(figures / "trace.png", pictures)
    _errors(figures / "errors.png", pictures)
    _bars(figures / "unequal.png", pictures)
    _world(figures / "world.png", pictures)
    page = Page(
        "Kojima, Okawa, Namerikawa (2012), reproduced",
        "Two robots map five landmarks each with EKF-SLAM, share two, stop, and merge their maps 700 times.",
    )
    page.text(
        "The covariances of this experiment count the same maps 700 times, as the paper does. They are kept to be "
        "compared with the print and are overconfident; fusing in this package uses every map once.",
        warn=True,
    )
    captions = {
        0: (
            ("errors.png", "Landmark error of every world under both weightings: they lie on the line of equality."),
            ("world.png", "One world: true and merged landmarks, the two circles and the robots' first poses."),
        ),
        1: (("trace.png", "Trace of the global covariance while the robots stand; bands hold 90 % of the worlds."),),
        3: (("unequal.png", "Where weights pay: landmark error of merged maps of unequal quality."),),
    }
    for k, table in enumerate(tables):
        page.section(table.title)
        page.table(table.head, table.rows)
        for name, caption in captions.get(k, ()):
            page.figure(figures / name, caption)
    page.section("What differs, and why")
    for sentence in differences:
        page.text(sentence)
    page.write(where / "report.html")


def draw_trace(path: Target, p: Pictures) -> None:
    readings = list(dict.fromkeys(c.reading for c in p.curves))
    titles = {"prior": "map 1 is the prior", "measurement": "map 1 is a measurement"}
    with figure(path, 8.0, 3.8, ncols=len(readings)) as (_, axes):
        for ax, reading in zip(axes, readings, strict=True):
            for k, curve in enumerate(c for c in p.curves if c.reading == reading):
                step = p.first_step + np.arange(len(curve.mean))
                ax.fill_between(step[1:], curve.low[1:], curve.high[1:], color=colour(k), alpha=0.2, linewidth=0)
                ax.plot(step[1:], curve.mean[1:], color=colour(k), linestyle=("-", "--")[k % 2], label=curve.name)
            if curve.limit > 0:
                ax.axhline(curve.limit, color=TRUTH, linestyle=":", label="limit, Theorem 2 corrected")
            ax.set_yscale("log")
            ax.set_xlabel("step [0.1 s]")
            ax.set_title(titles[reading])
            ax.legend()
        axes[0].set_ylabel("trace of the covariance [m² + rad²]")


def _errors(path: Path, p: Pictures) -> None:
    with figure(path, 5.2, 4.6) as (_, ax):
        every = np.concatenate([*(e for pair in p.errors.values() for e in pair), p.printed])
        ends = [100 * float(every.min()) / 1.3, 100 * float(every.max()) * 1.3]
        ax.plot(ends, ends, color=MUTED, linewidth=0.8, label="equal")
        for k, (reading, (plain, proposed)) in enumerate(p.errors.items()):
            ax.plot(
                100 * plain,
                100 * proposed,
                linestyle="none",
                marker=marker(k),
                markersize=5 - 2 * k,
                color=colour(k),
                alpha=0.7,
                label=f"ours, map 1 as {reading}",
            )
        ax.plot(100 * p.printed[0], 100 * p.printed[1], "*", color=TRUTH, markersize=11, label="the paper's Table 2")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlim(*ends)
        ax.set_ylim(*ends)
        ax.set_aspect("equal")
        ax.set_xlabel("landmark error with RLS [cm]")
        ax.set_ylabel("landmark error with the proposed weights [cm]")
        ax.legend(loc="upper left")


def _bars(path: Path, p: Pictures) -> None:
    rules, names = (list(dict.fromkeys(key[k] for key in p.bars)) for k in (0, 1))
    with figure(path, 6.0, 3.4) as (_, ax):
        width = 0.8 / len(names)
        for k, name in enumerate(names):
            x = np.arange(len(rules)) + (k - (len(names) - 1) / 2) * width
            drawn = ax.bar(x, [100 * p.bars[rule, name] for rule in rules], 0.92 * width, color=colour(k), label=name)
            ax.bar_label(drawn, fmt="%.2f", fontsize=8, padding=2)
        ax.set_xticks(np.arange(len(rules)), [f"{rule} baseline" for rule in rules])
        ax.set_ylabel("landmark RMSE [cm]")
        ax.margins(y=0.22)
        ax.grid(visible=False, axis="x")
        ax.legend(ncols=len(names), loc="upper left")


def _world(path: Path, p: Pictures) -> None:
    with figure(path, 6.0, 5.4) as (_, ax):
        turn = np.linspace(0, 2 * np.pi, 200)
        for k, side in enumerate((1.0, -1.0)):
            centre = se2.act(p.start[k], np.array([0.0, side * p.radius]))
            circle = centre + p.radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
            ax.plot(*circle.T, color=colour(k), linewidth=0.9, label=f"path of robot {k + 1}")
        _arrow(ax, p.start[0], TRUTH)
        _arrow(ax, p.start[1], TRUTH)
        _arrow(ax, p.frame, colour(2))
        ax.plot(
            *p.truth.T, linestyle="none", marker="s", markersize=9, markerfacecolor="none", color=TRUTH, label="true"
        )
        ax.plot(*p.fused.T, linestyle="none", marker="x", color=colour(2), label="merged")
        ax.plot(*p.truth[:2].T, linestyle="none", marker="o", markersize=16, markerfacecolor="none", color=MUTED,
                label="in common")  # fmt: skip
        as_map(ax)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _arrow(ax: Axes, pose: Float[np.ndarray, "3"], color: str) -> None:
    tip = se2.act(pose, np.array([0.12, 0.0]))
    ax.annotate("", xy=(tip[0], tip[1]), xytext=(pose[0], pose[1]), arrowprops={"arrowstyle": "->", "color": color})
