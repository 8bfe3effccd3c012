"""The report of a solved pose graph: how well its edges agree, which were dropped, what it looks like."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..laser.robust_graph import SolvedGraph
from .html import Page
from .scene import Scene
from .style import MUTED, colour, figure

MOST_ROWS = 200  # of dropped edges the page lists
MOST_EDGES = 4000  # of a kind in the page's map


def write_solve_report(
    folder: Path, name: str, before: np.ndarray, solved: SolvedGraph, ids: Sequence[int], lines: Sequence[str]
) -> None:
    """`report.html` and `figures/` in `folder`; before: (n, 3) the poses the solve began with."""
    page = Page("Pose graph", f"{name}: the poses that agree best with its edges.")
    page.cards(
        [
            ("poses", f"{len(solved.graph):,}"),
            ("edges", f"{solved.graph.edges:,}"),
            ("chi-square before", f"{solved.chi2_before:.4g}"),
            ("chi-square after", f"{solved.chi2:.4g}"),
            ("degrees of freedom", f"{solved.dof:,}"),
            ("iterations", str(solved.iterations)),
            ("edges dropped", str(len(solved.dropped))),
            ("parts", str(int(solved.component.max()) + 1)),
        ]
    )
    for line in lines[0 if not solved.converged else 1 :]:  # the first one tells what the cards do
        page.text(line, warn=not solved.converged)
    where, squares = folder / "figures" / "graph.png", folder / "figures" / "edges.png"
    caption = "The solved poses and the edges between poses that do not follow each other."
    page.scene(graph_scene(before, solved, ids), caption, where)
    if solved.graph.edges:
        page.figure(
            squares,
            "Squared residual of every edge in standard deviations, and what chance alone would give.",
            _draw_squares,
            solved,
        )
    if solved.dropped:
        page.section("Edges dropped")
        page.table(
            ["edge", "from", "to", "squared sd", "why"],
            [[d.edge, ids[d.first], ids[d.second], f"{d.nis:.4g}", d.reason] for d in solved.dropped[:MOST_ROWS]],
        )
        if len(solved.dropped) > MOST_ROWS:
            page.text(f"and {len(solved.dropped) - MOST_ROWS} more, listed in closures.csv")
    page.write(folder / "report.html")


def graph_scene(before: np.ndarray, solved: SolvedGraph, ids: Sequence[int]) -> Scene:
    """The solved poses to move about in, the edges used and dropped, and where the solve began."""
    graph = solved.graph
    scene = Scene("Pose graph", hidden=["where the solve began"])
    scene.path("where the solve began", before[:, :2], MUTED)
    pose = graph.pose[:, :2]
    step = np.abs(graph.second - graph.first) == 1
    reasons = {d.edge: f"\n{d.reason}" for d in solved.dropped}
    for layer, rows, tint in (
        ("steps", step & solved.used, colour(0)),
        ("closures", ~step & solved.used, colour(2)),
        ("dropped", ~solved.used, colour(5)),
    ):
        every = np.flatnonzero(rows)
        shown = every[np.unique(np.linspace(0, len(every) - 1, min(len(every), MOST_EDGES)).astype(int))]
        left = f" ({len(shown):,} of {len(every):,})" if len(shown) < len(every) else ""
        first, second = graph.first[shown], graph.second[shown]
        labels = [
            f"edge {e}: {ids[i]} to {ids[j]}\nsquared residual {solved.nis[e]:.3g} sd²{reasons.get(e, '')}"
            for e, i, j in zip(shown.tolist(), first.tolist(), second.tolist(), strict=True)
        ]
        ends = np.concatenate([pose[first], pose[second]], axis=1)
        scene.lines(layer + left, ends, tint, () if layer == "steps" else labels, dashed=layer == "dropped")
    held = list(solved.fixed)
    scene.points("held", [str(ids[i]) for i in held], pose[held], colour(1), shape="triangle")
    return scene


def _draw_squares(path: Path, solved: SolvedGraph) -> None:
    nis = np.maximum(solved.nis, 1e-6)
    edges = np.geomspace(1e-3, max(1e3, 1.1 * float(nis.max())), 60)
    with figure(path, 7.0, 3.4) as (_, ax):
        ax.hist(np.clip(nis[solved.used], edges[0], None), edges, color=colour(0), label="used")
        if (~solved.used).any():
            ax.hist(np.clip(nis[~solved.used], edges[0], None), edges, color=colour(5), label="dropped")
        ax.axvline(3.0, color=colour(1), linestyle="--", label="what chance gives on average")
        ax.set_xscale("log")
        ax.set_xlabel("squared residual [sd²]")
        ax.set_ylabel("edges")
        ax.legend()
