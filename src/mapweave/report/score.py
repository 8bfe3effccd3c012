"""A score as a page: what was measured against the truth, and the errors as a picture."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..core.names import robot_key
from ..evaluation.team import TeamScore
from .html import Page
from .style import Target, colour, figure

MOST = 40  # errors drawn one by one


def write_score_report(
    folder: Path, lines: Sequence[str], rows: Sequence[Sequence[object]], draw: Callable[[Target], object]
) -> None:
    """`report.html` and `figures/errors.png` in `folder`."""
    page = Page("Score against the truth", lines[0] if lines else "")
    for line in lines[1:]:
        page.text(line)
    draw(folder / "figures" / "errors.png")
    page.figure(folder / "figures" / "errors.png", "Errors against the truth.")
    page.table(("what", "value"), rows)
    page.write(folder / "report.html")


def draw_team_score(target: Target, score: TeamScore) -> None:
    """Every landmark's error, largest first, and every robot's absolute trajectory error [m]."""
    far = np.hypot(*score.landmarks.errors.T) if len(score.landmarks.ids) else np.zeros(0)
    order = np.argsort(-far)[:MOST]
    landmarks = {score.landmarks.ids[k]: float(far[k]) for k in order.tolist()}
    robots = {f"robot {robot_key(name)}": r.ate for name, r in score.robots.items() if r.ate is not None}
    draw_bars(target, {"landmark error [m]": landmarks, "trajectory error, RMS [m]": robots})


def draw_bars(target: Target, groups: Mapping[str, Mapping[str, float]]) -> None:
    """Horizontal bars, one panel a group (its name with the unit), empty groups left out."""
    shown = {name: bars for name, bars in groups.items() if bars} or {"nothing was scored": {}}
    most = max(1, *(len(bars) for bars in shown.values()))
    with figure(target, 4.2 * len(shown) + 0.4, 0.22 * most + 1.1, ncols=len(shown), squeeze=False) as (_, axes):
        for k, (ax, (name, bars)) in enumerate(zip(axes[0], shown.items(), strict=True)):
            ax.barh(list(bars)[::-1], list(bars.values())[::-1], color=colour(k), height=0.7)
            ax.set_xlabel(name)
            ax.grid(visible=False, axis="y")
