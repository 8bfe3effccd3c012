"""An exploration with lasers as a page: the map against the walls, how it came about, why loops were closed or not."""

from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..core.walls import Walls
from ..exploration.laser.config import WALL_TOLERANCE
from ..exploration.laser.experiment import LaserExploreResult, LaserRunRecord, MapSnapshot, refusals
from ..laser.occupancy_mapper import Occupancy
from .exploration import laser_exploration_scene, save_gif, seeds_told
from .html import Page
from .style import (
    MARKERS,
    PALETTE,
    SEQUENTIAL,
    TRUTH,
    Sheet,
    as_map,
    colour,
    draw_lines,
    figure,
    marker,
    rendered,
    shades,
)

SHADES = ("#DADDE1", "#FFFFFF", "#3C4043")  # unknown, free, occupied
WALL = "#D55E00"
FRONTIER = "#E69F00"
FEW_SNAPSHOTS = 60
GIF_DPI = 95


def draw_stages(path: Path, run: LaserRunRecord) -> None:
    """The map at each quarter of the run: frontiers where known ground ends, and the robots."""
    width, height = _size(run)
    steps = np.array([snapshot.step for snapshot in run.snapshots])
    with figure(path, width, height, nrows=2, ncols=2, sharex=True, sharey=True) as (fig, axes):
        for ax, share in zip(axes.flat, (0.25, 0.5, 0.75, 1.0), strict=True):
            snapshot = run.snapshots[int(np.argmin(np.abs(steps - share * steps[-1])))]
            _occupancy(ax, snapshot.grid)
            cells = snapshot.grid.centres(np.argwhere(frontier_cells(snapshot.grid)))
            ax.plot(*cells.T, "s", color=FRONTIER, ms=1.6, label="frontier", zorder=3)
            for j, name in enumerate(run.robots):
                ax.plot(
                    *snapshot.poses[j, :2], _marker(j), color=colour(j), mec=TRUTH, mew=0.4, ms=5, label=name, zorder=4
                )
            _frame(ax, run)
            ax.set_title(f"step {snapshot.step}, {100 * snapshot.explored:.0f} % mapped")
            ax.label_outer()
        fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)


def draw_explored(path: Path, run: LaserRunRecord) -> None:
    """The step at which each reachable place was first known to be free."""
    image = np.full(run.building.reached.shape, np.nan)
    image[run.building.reached] = run.seen_at
    x, y, h = float(run.building.lower[0]), float(run.building.lower[1]), run.building.cell
    rows, cols = run.building.reached.shape
    with figure(path, *_size(run)) as (fig, ax):
        extent = (x, x + cols * h, y, y + rows * h)
        shown = ax.imshow(image, origin="lower", extent=extent, cmap=SEQUENTIAL, interpolation="nearest")
        never = np.full((rows, cols), np.nan)
        never[run.building.reached & np.isnan(image)] = 1.0
        ax.imshow(never, origin="lower", extent=extent, cmap=shades([WALL]), interpolation="nearest", zorder=2)
        left = int(np.isnan(run.seen_at).sum())
        if left:
            ax.plot([], [], "s", color=WALL, label=f"never mapped ({left * h * h:.1f} m²)")
        draw_lines(ax, run.place.world.segments.reshape(-1, 2, 2), TRUTH, 0.5, zorder=2)
        _frame(ax, run)
        fig.colorbar(shown, ax=ax, label="first known free at step", shrink=0.85)
        if left:
            fig.legend(loc="outside lower center")
        ax.grid(visible=False)


def draw_walls(path: Path, run: LaserRunRecord, tolerance: float) -> None:
    """Which pieces of wall the map shows, which it misses, and which of its cells are no wall."""
    cells = run.map.centres(np.argwhere(run.map.occupied))
    wrong = cells[_far_from_walls(cells, run.place.world, tolerance)]
    seen = run.building.seen
    shown = np.zeros(len(seen), dtype=bool)
    if len(cells):
        shown = np.asarray(cKDTree(cells).query(seen)[0]) <= tolerance
    with figure(path, *_size(run, legend=True)) as (fig, ax):
        ax.plot(*seen[shown].T, ".", color=TRUTH, ms=1.0)
        ax.plot(*wrong.T, "s", color=colour(4), ms=1.0)
        ax.plot(*seen[~shown].T, "s", color=WALL, ms=1.8)
        for color, label in (
            (TRUTH, f"wall in the map ({100 * shown.mean() if len(shown) else 0:.1f} %)"),
            (WALL, "wall the map misses"),
            (
                colour(4),
                f"cell of the map that is no wall ({100 * len(wrong) / max(len(cells), 1):.1f} % of its cells)",
            ),
        ):
            ax.plot([], [], "s", color=color, ms=4, label=label)
        _frame(ax, run)
        fig.legend(loc="outside lower center", ncols=3)


def draw_progress(path: Path, run: LaserRunRecord) -> None:
    """Against steps: share mapped (dotted: robots found each other), loops closed, how far the robots were off."""
    steps = np.array([m.step for m in run.moments])
    off = np.array([np.hypot(*(m.poses[:, :2] - m.true_poses[:, :2]).T) for m in run.moments])
    with figure(path, 10.0, 3.2, ncols=3) as (fig, (share, loops, error)):
        share.plot(steps, [100 * m.explored for m in run.moments], color=colour(0))
        for before, after in pairwise(run.moments):
            if after.maps < before.maps:
                share.axvline(after.step, color=TRUTH, lw=0.6, ls=":")
        share.set(xlabel="step", ylabel="reachable area mapped [%]", ylim=(0, 102))
        loops.plot(steps, [m.closures for m in run.moments], color=colour(5))
        loops.set(xlabel="step", ylabel="loops closed")
        loops.set_ylim(bottom=0)
        for j, name in enumerate(run.robots):
            alive = np.array([m.scans[j] is not None for m in run.moments])
            line_style = "-" if j < len(PALETTE) else "--"
            error.plot(steps[alive], 100 * off[alive, j], color=colour(j), lw=0.8, ls=line_style, label=name)
        error.set(xlabel="step", ylabel="error of place [cm]")
        error.set_ylim(bottom=0)
        fig.legend(loc="outside lower center", ncols=8)


def draw_animation(path: Path, run: LaserRunRecord) -> None:
    """The first run as a small animated GIF: the map as it grew, the robots on it."""
    snapshots = run.snapshots[:: max(1, len(run.snapshots) // FEW_SNAPSHOTS)]
    if snapshots[-1] is not run.snapshots[-1]:
        snapshots = (*snapshots, run.snapshots[-1])
    width, height = _size(run)
    frames = []
    with figure(Sheet(), 6.0, 6.0 * height / width) as (fig, ax):
        image = _occupancy(ax, _onto(snapshots[0], run))
        heads = [
            ax.plot([], [], _marker(j), color=colour(j), mec=TRUTH, mew=0.4, ms=5, ls="none")[0]
            for j in range(len(run.robots))
        ]
        _frame(ax, run)
        title = ax.set_title("", loc="left")
        for snapshot in snapshots:
            image.set_data(_onto(snapshot, run).state + 1)
            for j, head in enumerate(heads):
                head.set_data([snapshot.poses[j, 0]], [snapshot.poses[j, 1]])
            title.set_text(f"step {snapshot.step}, {100 * snapshot.explored:.0f} % mapped")
            frames.append(rendered(fig, GIF_DPI))
    path.parent.mkdir(parents=True, exist_ok=True)
    save_gif(path, frames, tuple(dict.fromkeys(colour(j) for j in range(len(run.robots)))))


def frontier_cells(grid: Occupancy) -> np.ndarray:
    """Free cells (rows, cols) beside unknown ones."""
    return np.asarray(grid.free & ndimage.binary_dilation(grid.unknown))


def _onto(snapshot: MapSnapshot, run: LaserRunRecord) -> Occupancy:
    """The snapshot's cells on a raster over the whole world, the same for all snapshots."""
    grid, h = snapshot.grid, snapshot.grid.resolution
    cols, rows = np.ceil((run.place.upper - run.place.lower) / h).astype(int) + 2
    low = run.place.lower - h
    centres = np.stack(np.meshgrid(low[0] + (np.arange(cols) + 0.5) * h, low[1] + (np.arange(rows) + 0.5) * h), axis=-1)
    at = np.floor((centres - grid.origin) / h).astype(int)
    inside = ((at >= 0) & (at < grid.state.shape[::-1])).all(axis=-1)
    state = np.full((rows, cols), -1, dtype=np.int8)
    state[inside] = grid.state[at[inside][:, 1], at[inside][:, 0]]
    return Occupancy(h, low, state)


def _far_from_walls(cells: np.ndarray, world: Walls, tolerance: float) -> np.ndarray:
    return np.asarray(Walls(world.segments, world.reflectance).clearance(cells) > tolerance)


def _occupancy(ax: Any, grid: Occupancy) -> Any:
    rows, cols = grid.state.shape
    (x, y), h = grid.origin, grid.resolution
    ax.grid(visible=False)
    extent = (x, x + cols * h, y, y + rows * h)
    look = {"extent": extent, "origin": "lower", "interpolation": "nearest", "zorder": 1}
    return ax.imshow(grid.state + 1, cmap=shades(SHADES), vmin=0, vmax=2, **look)


def _frame(ax: Any, run: LaserRunRecord) -> None:
    (x0, y0), (x1, y1) = run.place.lower, run.place.upper
    as_map(ax)
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=(x0 - 1, x1 + 1), ylim=(y0 - 1, y1 + 1))


def _size(run: LaserRunRecord, *, legend: bool = False) -> tuple[float, float]:
    width, height = run.place.upper - run.place.lower + 2.0
    return 9.0, float(np.clip(8.0 * height / width + 0.7 + 0.5 * legend, 3.0, 11.0))


def _marker(j: int) -> str:
    return marker(j + j // len(MARKERS))


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
    caption = "The merged map as it came to be known, and where the robots drove; each cell as it was in the end."
    scene = laser_exploration_scene(first)
    page.scene(scene, caption, figures / "map.png")
    page.figure(
        figures / "stages.png",
        "The map at each quarter of the run, with its frontiers and the robots",
        draw_stages,
        first,
    )
    page.figure(
        figures / "explored.png", "When each place a robot can reach was first known to be free", draw_explored, first
    )
    draw_animation(figures / "first_run.gif", first)
    page.figure(
        figures / "progress.png",
        "Share of the reachable area mapped; errors of the robots' places as they drove"
        + (" (dotted: robots found each other)" if m.apart else ""),
        draw_progress,
        first,
    )
    page.section("How good the map is")
    page.figure(
        figures / "walls.png",
        f"Walls that can be seen, in the map within {WALL_TOLERANCE:g} m or missed; cells of the map that are no wall",
        draw_walls,
        first,
        WALL_TOLERANCE,
    )
    scene.draw(figures / "closures.png", hidden=("truth",))
    page.figure(figures / "closures.png", "Loops closed, and closures tried and refused")
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
    if m.apart:
        _meetings(page, first)
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


def _meetings(page: Page, first: LaserRunRecord) -> None:
    page.section("How the robots found each other")
    for robots in first.maps[1:]:
        page.text(f"{', '.join(robots)}: not found in the map of {first.robots[0]}, nor is what they mapped", warn=True)
    page.table(
        ["step", "robots", "decision", "saw each other", "saw nobody there", "reason"],
        [
            [m.step, " and ".join(m.robots), "one map" if m.joined else "refused", m.seen, m.through, m.reason]
            for m in first.meetings
        ],
    )


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
    errors, loops = attrgetter("map_error", "trajectory_rmse"), attrgetter("closures", "refused", "misassociations")
    rows: list[list[object]] = []
    for r in result.runs:
        shares = [None if v is None else 100 * v for v in (r.wall_precision, r.wall_recall)]
        run = (r.run, r.seed, "yes" if r.finished else "no", r.steps, 100 * r.area_mapped, r.collisions)
        rows.append([*run, *errors(r), *shares, r.nees_per_dof, *loops(r)])
    return head, rows


def _unit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}".strip()
