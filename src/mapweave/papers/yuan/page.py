"""The figures and the page of `reproduce yuan`."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...report.html import Page
from ...report.style import TRUTH, Target, colour, figure, marker

Spread = Mapping[str, tuple[Sequence[int], Sequence[float]]]


def write(
    where: Path,
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[object]]]],
    differences: Sequence[str],
    spread: Spread,
    printed: tuple[float, ...],
    ablation: Mapping[str, float],
    runs: int,
) -> None:
    """`report.html` and `figures/*.png` in `where`.

    spread: planner -> steps and map error [m] of each run; printed: the paper's two robots; ablation: name -> mean
    steps.
    """
    draw_spread(where / "figures" / "planners.png", spread, printed)
    draw_ablation(where / "figures" / "ablation.png", ablation)
    page = Page(
        "Yuan, Huang, Tao, Xi (2009), reproduced",
        f"100 x 80 m with 29 landmarks, a new layout a run, {runs} runs a row; identities known unless said",
    )
    captions = (
        ("planners.png", "Two robots: steps and map error of every run; the star is the paper's mean."),
        (
            "ablation.png",
            "Mean steps of the paper's planner without each term; a run ends at 1,000 steps at the latest.",
        ),
    )
    for k, (title, head, rows) in enumerate(tables):
        page.section(title)
        page.table(head, rows)
        if k < len(captions):
            page.figure(where / "figures" / captions[k][0], captions[k][1])
    page.section("What differs, and why")
    for sentence in differences:
        page.text(sentence)
    page.write(where / "report.html")


def draw_spread(path: Target, spread: Spread, printed: tuple[float, ...]) -> None:
    """Steps against map error, one mark a run."""
    with figure(path, 6.4, 3.8) as (_, ax):
        for k, (name, (steps, error)) in enumerate(spread.items()):
            if len(steps) == len(error):
                ax.plot(steps, error, marker(k), color=colour(k), ms=4, ls="none", label=name, alpha=0.8)
        ax.plot([printed[2]], [printed[3]], "*", color=TRUTH, ms=11, label="paper, mean of 30", zorder=5)
        ax.set(xlabel="steps", ylabel="map error [m]")
        ax.set_xlim(left=0)
        ax.set_ylim(bottom=0)
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_ablation(path: Path, ablation: Mapping[str, float]) -> None:
    """Mean steps, one bar a variant."""
    with figure(path, 6.4, 0.4 * len(ablation) + 0.9) as (_, ax):
        names = list(ablation)[::-1]
        bars = ax.barh(names, [ablation[n] for n in names], color=colour(0), height=0.6)
        ax.bar_label(bars, fmt="%.0f", padding=3, fontsize=8)
        ax.set(xlabel="mean steps", xlim=(0, 1.12 * max(ablation.values())))
        ax.grid(visible=False, axis="y")
