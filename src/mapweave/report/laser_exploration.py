"""An exploration with lasers as a page: the map against the walls, how it came about, why loops were closed or not."""

from pathlib import Path

from ..exploration.laser.experiment import LaserExploreResult, refusals
from .exploration import seeds_told
from .exploration_scene import laser_exploration_scene
from .html import Page
from .laser_exploration_figures import (
    draw_animation,
    draw_closures,
    draw_explored,
    draw_map,
    draw_progress,
    draw_stages,
    draw_walls,
)


def write_laser_exploration(folder: Path, result: LaserExploreResult) -> None:
    """report.html and figures/ in `folder`."""
    first, s, m = result.first, result.averages(), result.mission
    figures = folder / "figures"
    page = Page(
        f"Exploration of {result.scenario}",
        f"{len(first.robots)} robots with lasers, planner {m.planner}, odometry errors x {result.noise:g}, until "
        f"{m.until}, {seeds_told(result.seed, s['runs'])}",
    )
    page.cards(
        [
            ("runs finished", f"{s['finished']} of {s['runs']}"),
            ("steps, mean", f"{s['steps_mean']:.0f}"),
            ("reachable area mapped", f"{100 * s['area_mapped']:.2f} %"),
            ("collisions", str(s["collisions"])),
            ("map error", _unit(s["map_error_m"], "m")),
            ("trajectory RMSE", _unit(s["trajectory_rmse_m"], "m")),
            ("loops closed per run", f"{s['closures']:.0f}"),
        ]
    )
    for name, count in zip(first.robots, first.collisions, strict=True):
        if count:
            page.text(f"{name} was stopped by a wall or another robot {count} times in the first run", warn=True)
    page.section("The first run")
    draw_map(figures / "map.png", first)
    caption = "The merged map as it came to be known, and where the robots drove; each cell as it was in the end."
    page.scene(laser_exploration_scene(first), caption, figures / "map.png")
    draw_stages(figures / "stages.png", first)
    page.figure(figures / "stages.png", "The map at each quarter of the run, with its frontiers and the robots")
    draw_explored(figures / "explored.png", first)
    page.figure(figures / "explored.png", "When each place a robot can reach was first known to be free")
    draw_animation(figures / "first_run.gif", first)
    draw_progress(figures / "progress.png", first)
    page.figure(
        figures / "progress.png", "Share of the reachable area mapped; errors of the robots' places as they drove"
    )
    page.section("How good the map is")
    draw_walls(figures / "walls.png", first, m.cfg.tolerance)
    page.figure(
        figures / "walls.png",
        f"Walls that can be seen, in the map within {m.cfg.tolerance:g} m or missed; cells of the map that are no wall",
    )
    draw_closures(figures / "closures.png", first)
    page.figure(figures / "closures.png", "Loops closed within a robot and between two; closures tried and refused")
    refused = refusals(first.closures)
    if refused:
        page.table(
            ["closures refused because", "how often"], [[why.replace("#", "…"), n] for why, n in refused.items()]
        )
    page.table(
        ["robot", "scans", "matched", "by odometry", "without returns", "keyframes", "driven [m]", "collisions"],
        _robots(result),
    )
    _left_out(page, result)
    page.section("Every run")
    page.table(*_runs(result))
    page.section("How to read it")
    page.text(
        "A step is half a second of every robot. Reachable is what a robot's disc gets to from the starts; mapped is "
        "what of it the merged map knows to be free. Map error is the mean distance of the map's occupied cells to the "
        "nearest true wall, in the frame of the first robot's start, without alignment. NEES per degree of freedom is "
        "the mean over keyframe poses: 1 for honest covariances, above 1 overconfident. The logs replay with "
        "mapweave map."
    )
    page.write(folder / "report.html")


def _robots(result: LaserExploreResult) -> list[list[object]]:
    first, rows = result.first, []
    for j, name in enumerate(first.robots):
        status, way = first.status[j], first.truths[j].pose[:, :2]
        length = float(sum(((way[1:] - way[:-1]) ** 2).sum(axis=1) ** 0.5))
        counts = [status.get(what, 0) for what in ("matched", "odometry", "empty")]
        rows.append(
            [name, sum(status.values()), *counts, int((first.owner == j).sum()), round(length, 1), first.collisions[j]]
        )
    return rows


def _left_out(page: Page, result: LaserExploreResult) -> None:
    first = result.first
    for x, y, area in first.building.shut:
        page.text(f"left out: {area:.1f} m² around ({x:.1f}, {y:.1f}) m, where no robot gets to")
    for what, places in (
        ("ground that the map shows and no robot gets to", first.pockets),
        ("a place that was given up after several tries", first.given_up),
    ):
        for x, y in places:
            page.text(f"left out: {what}, around ({x:.1f}, {y:.1f}) m")


def _runs(result: LaserExploreResult) -> tuple[list[str], list[list[object]]]:
    head = ["run", "seed", "finished", "steps", "mapped [%]", "collisions", "map error [m]", "trajectory RMSE [m]"]
    head += ["walls true [%]", "walls found [%]", "NEES/dof", "loops", "refused", "false"]
    rows: list[list[object]] = []
    for r in result.runs:
        shares = [None if v is None else 100 * v for v in (r.wall_precision, r.wall_recall)]
        rows.append(
            [
                r.run,
                r.seed,
                "yes" if r.finished else "no",
                r.steps,
                100 * r.area_mapped,
                r.collisions,
                r.map_error,
                r.trajectory_rmse,
                *shares,
                r.nees_per_dof,
                r.closures,
                r.refused,
                r.misassociations,
            ]
        )
    return head, rows


def _unit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}".strip()
