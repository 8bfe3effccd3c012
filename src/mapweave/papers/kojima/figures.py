"""The figures of `reproduce kojima`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from ...core import se2
from ...report.style import MUTED, TRUTH, Target, as_map, colour, draw_ellipse, figure, marker
from .world import SEEN


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
class FigureData:
    """What the figures show.

    errors: by reading, (RLS, proposed) landmark errors of each world [m]; bars: landmark error [m] by (baseline,
    weights); the rest is one world: truth, start poses, either robot's map in its own frame with the truth there,
    and by weighting the merged landmarks and the frame of robot 2.
    """

    first_step: int
    curves: Sequence[Curve]
    errors: Mapping[str, tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]]
    printed: tuple[float, float]
    bars: Mapping[tuple[str, str], float]
    truth: Float[np.ndarray, "n 2"]
    start: Float[np.ndarray, "2 3"]
    radius: float
    local_mean: Float[np.ndarray, "2 5 2"]
    local_cov: Float[np.ndarray, "2 10 10"]
    local_truth: Float[np.ndarray, "2 5 2"]
    merged: Mapping[str, tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "3"]]]


ENLARGED = 10.0  # how much larger than life the regions of local maps are drawn
_TRUE: dict[str, Any] = {
    "linestyle": "none",
    "marker": "s",
    "markersize": 9,
    "markerfacecolor": "none",
    "color": TRUTH,
}


def draw_trace(path: Target, p: FigureData) -> None:
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


def draw_errors(path: Target, p: FigureData) -> None:
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


def draw_bars(path: Target, p: FigureData) -> None:
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


def draw_local_map(path: Target, p: FigureData, k: int) -> None:
    """Robot k's map in its own frame: its trajectory, the landmarks it found, their 95 % regions ten times as large."""
    with figure(path, 5.2, 4.6) as (_, ax):
        mean, cov = p.local_mean[k], p.local_cov[k]
        _circle(ax, np.zeros(3), (1.0, -1.0)[k] * p.radius, colour(k), f"path of robot {k + 1}")
        _arrow(ax, np.zeros(3), TRUTH)
        ax.plot(*p.local_truth[k].T, **_TRUE, label="true")
        ax.plot(*mean.T, linestyle="none", marker="x", color=colour(k), label="EKF-SLAM")
        for at, (point, name) in enumerate(zip(mean, SEEN[k], strict=True)):
            draw_ellipse(ax, point, cov[2 * at : 2 * at + 2, 2 * at : 2 * at + 2], colour(k), ENLARGED)
            ax.annotate(str(name + 1), point, textcoords="offset points", xytext=(7, 7), color=TRUTH, fontsize=8)
        as_map(ax, f"local map {k + 1}, ellipses x {ENLARGED:g}")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_global_map(path: Target, p: FigureData) -> None:
    """The merged map with either weighting, on the truth."""
    with figure(path, 6.0, 5.4) as (_, ax):
        for k, side in enumerate((1.0, -1.0)):
            _circle(ax, p.start[k], side * p.radius, MUTED, f"path of robot {k + 1}")
            _arrow(ax, p.start[k], TRUTH)
        ax.plot(*p.truth.T, **_TRUE, label="true")
        for at, (name, (points, frame)) in enumerate(p.merged.items()):
            ax.plot(*points.T, linestyle="none", marker=("+", "x")[at], color=colour(at), markersize=8, label=name)
            _arrow(ax, frame, colour(at))
        ax.plot(
            *p.truth[:2].T, linestyle="none", marker="o", markersize=16, markerfacecolor="none", color=MUTED,
            label="in common",
        )  # fmt: skip
        as_map(ax)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _circle(ax: Axes, start: Float[np.ndarray, "3"], radius: float, color: str, name: str) -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    centre = se2.act(start, np.array([0.0, radius]))
    ring = centre + abs(radius) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    ax.plot(*ring.T, color=color, linewidth=0.9, label=name)


def _arrow(ax: Axes, pose: Float[np.ndarray, "3"], color: str) -> None:
    tip = se2.act(pose, np.array([0.12, 0.0]))
    ax.annotate("", xy=(tip[0], tip[1]), xytext=(pose[0], pose[1]), arrowprops={"arrowstyle": "->", "color": color})
