"""Pictures of simulated worlds: what is true, before any estimator has seen a log."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from .style import MUTED, TRUTH, Target, as_map, colour, figure

FEW = 20  # trajectories told apart by a legend


def draw_world(
    target: Target,
    title: str,
    ways: Mapping[str, Float[np.ndarray, "n 2"]],
    places: Float[np.ndarray, "m 2"] | None = None,
    walls: Float[np.ndarray, "w 4"] | None = None,
    pairs: Sequence[tuple[int, int]] = (),
) -> None:
    """True paths [m] by robot, places (landmarks or robots), walls (x0, y0, x1, y1), and who of `places` sees whom."""
    with figure(target, 7.0, 5.4) as (_, ax):
        if walls is not None:
            for x0, y0, x1, y1 in walls.tolist():
                ax.plot([x0, x1], [y0, y1], color=TRUTH, lw=1.0)
        if places is not None:
            for i, j in pairs:
                ax.plot(*places[[i, j]].T, color=MUTED, lw=0.4, zorder=1)
            ax.plot(*places.T, "*" if ways else "o", color=TRUTH, ms=5, ls="none", zorder=3)
        for k, (name, way) in enumerate(ways.items()):
            ax.plot(*way.T, color=colour(k), lw=0.9, label=name)
            ax.plot(*way[0], "o", color=colour(k), mfc="white", ms=6)
        if 0 < len(ways) <= FEW:
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        as_map(ax, title)
