"""The figures of `reproduce yuan` that are not those of a single run."""

from collections.abc import Mapping, Sequence

from ...report.style import TRUTH, Target, colour, figure, marker

Spread = Mapping[str, tuple[Sequence[int], Sequence[float]]]


def draw_spread(path: Target, spread: Spread, printed: tuple[float, ...]) -> None:
    """Steps against map error [m], one mark a run; printed: the paper's row of Table 1."""
    with figure(path, 6.4, 3.8) as (_, ax):
        for k, (name, (steps, error)) in enumerate(spread.items()):
            if len(steps) == len(error):
                ax.plot(steps, error, marker(k), color=colour(k), ms=4, ls="none", label=name, alpha=0.8)
        ax.plot([printed[2]], [printed[3]], "*", color=TRUTH, ms=11, label="paper, mean of 30", zorder=5)
        ax.set(xlabel="steps", ylabel="map error [m]")
        ax.set_xlim(left=0)
        ax.set_ylim(bottom=0)
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_ablation(path: Target, ablation: Mapping[str, float]) -> None:
    """Mean steps, one bar a variant."""
    with figure(path, 6.4, 0.4 * len(ablation) + 0.9) as (_, ax):
        names = list(ablation)[::-1]
        bars = ax.barh(names, [ablation[n] for n in names], color=colour(0), height=0.6)
        ax.bar_label(bars, fmt="%.0f", padding=3, fontsize=8)
        ax.set(xlabel="mean steps", xlim=(0, 1.12 * max(ablation.values())))
        ax.grid(visible=False, axis="y")
