"""The figures of `reproduce hamatani`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from ...report.style import MUTED, TRUTH, Target, as_map, colour, figure


@dataclass(frozen=True, slots=True)
class Pictures:
    """One run: true positions, the guess and the result with nothing known, the same with robots 1 and 2 known.

    once: the batch estimate of a single set of sightings, 1 and 2 known; drift: by name, the mean error of a side [m]
    after each update.
    """

    truth: Float[np.ndarray, "n 2"]
    first: Float[np.ndarray, "n 2"]
    free: Float[np.ndarray, "n 2"]
    first_known: Float[np.ndarray, "n 2"]
    known: Float[np.ndarray, "n 2"]
    once: Float[np.ndarray, "n 2"]
    drift: tuple[tuple[str, Float[np.ndarray, " k"]], ...]


def draw_initial(target: Target, pictures: Pictures) -> None:
    """The first guesses beside the truth."""
    panels = (("nothing known", pictures.first), ("1 and 2 known", pictures.first_known))
    _layouts(target, pictures.truth, panels, "first guess")


def draw_final(target: Target, pictures: Pictures) -> None:
    """The estimates after all updates beside the truth."""
    panels = (("nothing known", pictures.free), ("1 and 2 known", pictures.known))
    _layouts(target, pictures.truth, panels, "estimate", pictures.once)


def _layouts(
    path: Target, truth: np.ndarray, panels: Sequence[tuple[str, np.ndarray]], name: str, once: np.ndarray | None = None
) -> None:
    with figure(path, 8.4, 3.9, ncols=len(panels)) as (_, axes):
        for ax, (title, x) in zip(axes, panels, strict=True):
            for a, b in zip(truth, x, strict=True):
                ax.plot([a[0], b[0]], [a[1], b[1]], color=MUTED, linewidth=0.8)
            ax.plot(*truth.T, "o", color=TRUTH, fillstyle="none", markersize=9, label="truth")
            ax.plot(*x.T, "x", color=colour(0), markersize=7, markeredgewidth=1.8, label=name)
            if name == "estimate" and title == "nothing known":
                _outline(ax, truth, x)
            if once is not None and title != "nothing known":
                ax.plot(*once.T, "+", color=colour(1), markersize=9, label="batch, one set of sightings")
            for k, p in enumerate(truth):
                ax.annotate(str(k + 1), p, textcoords="offset points", xytext=(7, 7), color=TRUTH, fontsize=8)
            as_map(ax, title)
            ax.margins(0.12)
            ax.legend(loc="best")


def worst(x: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(x - truth, axis=1).max())


def _outline(ax: Axes, truth: np.ndarray, x: np.ndarray) -> None:
    """The true outline, scaled and moved onto `x`."""
    a, b = truth - truth.mean(axis=0), x - x.mean(axis=0)
    fitted = x.mean(axis=0) + (a * b).sum() / (a * a).sum() * a
    ring = fitted[[0, 1, 2, 4, 3, 0]]
    ax.plot(*ring.T, "--", color=colour(1), linewidth=1.0, label="truth, moved and scaled")


def draw_drift(path: Target, pictures: Pictures) -> None:
    with figure(path, 6.0, 3.4) as (_, ax):
        for k, (name, curve) in enumerate(pictures.drift):
            ax.plot(1 + np.arange(len(curve)), curve, color=colour(k), linestyle=("-", "--")[k % 2], label=name)
        ax.set_yscale("log")
        ax.set_xlabel("update")
        ax.set_ylabel("error of a side of 10 m [m]")
        ax.legend()
