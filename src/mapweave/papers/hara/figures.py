"""The figures of `reproduce hara`."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ...laser.laser_map import GridMap
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


def draw_maps(path: Target, pictures: Sequence[Shown]) -> None:
    """One panel a method, all at one scale."""
    across = 2
    down = -(-len(pictures) // across)
    with figure(path, 11.0, 3.6 * down + 0.3, nrows=down, ncols=across, squeeze=False) as (_, axes):
        for ax, p in zip(axes.ravel(), pictures, strict=False):
            cells = p.grid.cells()
            no_intensity = not cells[:, 2].any()
            colours = (
                {"color": MUTED} if no_intensity else {"c": cells[:, 2], "cmap": SEQUENTIAL, "vmin": 0.0, "vmax": 1.0}
            )
            ax.scatter(cells[:, 0], cells[:, 1], s=1.2, marker="s", linewidths=0, **colours)
            ax.plot(*p.track.T, color=colour(5), linewidth=0.8)
            ax.plot(*p.truth.T, color=TRUTH, linewidth=0.8, linestyle="--")
            as_map(ax, f"{p.figure}: {p.name}" if p.figure else p.name)
        for ax in axes.ravel()[len(pictures) :]:
            ax.set_visible(False)


def draw_alpha(path: Target, alphas: Sequence[float], error: np.ndarray, estimate: np.ndarray, at: np.ndarray) -> None:
    """Error against alpha, one line a drive and their mean, and the estimates where they fell."""
    with figure(path, 6.0, 3.6) as (_, ax):
        for each in error.T:
            ax.plot(alphas, each, color=MUTED, linewidth=0.8)
        ax.plot(alphas, error.mean(axis=1), "o-", color=colour(0), label="mean of the drives")
        ax.plot(estimate, at, "*", color=TRUTH, markersize=10, linestyle="none", label="alpha found from the log")
        ax.set_xscale("log")
        ax.set_ylim(bottom=0)
        ax.set_xlabel("alpha [m² per q²]")
        ax.set_ylabel("trajectory error [m]")
        ax.legend()


def draw_gate(path: Target, widths: Sequence[float], alone: np.ndarray, gated: np.ndarray, odometry: float) -> None:
    """Error without and with the gate over how far apart pairs may lie at first; one mark a drive."""
    with figure(path, 6.0, 3.6) as (_, ax):
        for k, (name, error) in enumerate((("Intensity-ICP", alone), ("gated", gated))):
            ax.plot(widths, error.mean(axis=1), "o-", color=colour(k), label=f"{name}, mean")
            for each in error.T:
                ax.plot(widths, each, ".", color=colour(k), alpha=0.6)
        ax.axhline(odometry, color=TRUTH, linestyle=":", label="odometry, mean")
        ax.set_ylim(bottom=0)
        ax.set_xlabel("pairs are taken up to [m]")
        ax.set_ylabel("trajectory error [m]")
        ax.legend()
