"""An exploration as pictures: where the robots drove, what they mapped, how fast the field became known."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon
from PIL import Image
from scipy.spatial import ConvexHull, QhullError

from ..exploration.landmarks.experiment import ExploreResult, LandmarkRunRecord
from .exploration_scene import first_seen, landmark_scene
from .html import Page
from .style import MUTED, SEQUENTIAL, TRUTH, Sheet, Target, as_map, colour, draw_ellipse, figure, marker

FRAMES = 48
TALLEST = 24.0  # inches, of a figure, however narrow the field


def write_exploration(folder: Path, result: ExploreResult) -> None:
    """report.html and figures/ in `folder`."""
    first = result.first
    draw_map(folder / "figures" / "map.png", first)
    draw_progress(folder / "figures" / "progress.png", first, result)
    seen_at = first_seen(first, result.mission.cfg)
    draw_explored(folder / "figures" / "explored.png", first, seen_at, result.mission.cfg.mission.cell)
    draw_animation(folder / "figures" / "first_run.gif", first)
    s, m = result.averages(), result.mission
    noise = "as configured" if result.noise is None else f"{result.noise:g} of the printed"
    page = Page(
        f"Exploration of {result.scenario}",
        f"{len(first.robots)} robots, planner {m.planner}, identities {m.cfg.submap.association}, motion noise "
        f"{noise}, until {m.until}, {seeds_told(result.seed, s['runs'])}",
    )
    page.cards(
        [
            ("runs finished", f"{s['finished']} of {s['runs']}"),
            ("steps, mean", f"{s['steps_mean']:.0f}"),
            ("map error", _unit(s["map_error_m"], "m")),
            ("uncertainty C/N", _unit(s["c_per_n_m2"], "m²")),
            ("NEES per degree of freedom (honest: 1)", _unit(s["nees_per_dof"], "")),
        ]
    )
    page.section("The first run")
    scene = landmark_scene(first, seen_at, m.cfg.mission.cell)
    caption = "What was seen when, where the robots truly were, and the map; figures/map.png has the submaps' borders."
    page.scene(scene, caption, folder / "figures" / "map.png")
    page.figure(folder / "figures" / "explored.png", "When each cell was first seen; lines: the frontier at quarters")
    every = "; steps and errors of all runs" if len(result.runs) > 1 else ""
    page.figure(folder / "figures" / "progress.png", f"Explored share of the field{every}")
    page.section("Every run")
    head = ["run", "seed", "finished", "steps", "map error [m]", "C/N [m²]", "NEES/dof", "duplicates", "missed"]
    walled = first.floor is not None
    if walled:
        head += ["met a wall", "landmarks nobody can see"]
    rows = [
        [
            r.run,
            r.seed,
            "yes" if r.finished else "no",
            r.steps,
            r.map_error,
            r.c_per_n,
            r.nees_per_dof,
            r.duplicates,
            r.missed,
            *((r.collisions, r.hidden) if walled else ()),
        ]
        for r in result.runs
    ]
    page.table(head, rows)
    if walled:
        page.section("Walls")
        for line in result.lines_on_walls():
            page.text(f"{line[0].upper()}{line[1:]}.")
        page.text(
            "Robots know the plan. A robot whose true motion would touch a wall is stopped short of it. The field is "
            "what can be seen from ground a robot reaches; shaded cells are no part of it."
        )
    page.section("How to read it")
    page.text(
        "A step is one control of every robot. Map error is the mean distance of mapped landmarks to the true ones in "
        "the global frame, without alignment. C/N is the mean area pi sqrt det of a landmark's covariance. NEES per "
        "degree of freedom is 1 for an honest map; above 1 it is overconfident. mapweave map replays log/."
    )
    page.write(folder / "report.html")


def seeds_told(first: int, runs: int) -> str:
    """What a page says of the seeds of its runs."""
    return f"seed {first}" if runs == 1 else f"seeds {first} to {first + runs - 1}"


def draw_map(path: Target, run: LandmarkRunRecord) -> None:
    """Trajectories, landmarks with 95 % ellipses, truth, and the borders of submaps at hand-over."""
    width, height = run.world.upper - run.world.lower
    with figure(path, 8.0, min(8.0 * float(height / width), TALLEST) + 0.6) as (_, ax):
        _field(ax, run)
        for step, j, points in run.submap_borders:
            del step
            _border(ax, points, colour(j))
        poses = np.array([m.true_poses for m in (run.first_look, *run.moments)])
        for j, name in enumerate(run.robots):
            ax.plot(poses[:, j, 0], poses[:, j, 1], color=colour(j), label=f"{name}, true path", zorder=3)
            ax.plot(*run.world.starts[j, :2], marker=marker(j), color=colour(j), ms=7, zorder=4)
        marks = run.map.landmarks
        for i in range(len(marks)):
            draw_ellipse(ax, marks.mean[i], marks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], "#D55E00", zorder=4)
        ax.plot(*marks.mean.T, "+", color="#D55E00", ms=6, zorder=5, label="landmark, mapped (95 %)")
        ax.plot(*run.world.landmarks.T, "*", color=TRUTH, ms=5, zorder=5, label="landmark, true")
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=4)


def draw_explored(path: Path, run: LandmarkRunRecord, first: Float[np.ndarray, "rows columns"], cell: float) -> None:
    """The step at which each cell was `first` seen, and the frontier at each quarter of the run."""
    width, height = run.world.upper - run.world.lower
    shape = first.shape
    with figure(path, 8.0, min(7.2 * float(height / width), TALLEST) + 0.4) as (fig, ax):
        _field(ax, run)
        (x0, y0), (x1, y1) = run.world.lower, run.world.lower + cell * np.array(shape[::-1])
        image = ax.imshow(first, origin="lower", extent=(x0, x1, y0, y1), cmap=SEQUENTIAL, interpolation="nearest")
        quarters = [0.25 * k * max(len(run.moments), 1) for k in (1, 2, 3)]
        filled = np.where(np.isnan(first), len(run.moments) + 1.0, first)
        if filled.min() < filled.max():
            centres = [lo + cell * (np.arange(n) + 0.5) for lo, n in ((x0, shape[1]), (y0, shape[0]))]
            ax.contour(*centres, filled, levels=sorted(set(quarters)), colors="white", linewidths=1.0)
        fig.colorbar(image, ax=ax, label="first seen at step", shrink=0.85)
        ax.grid(visible=False)


def draw_progress(path: Path, run: LandmarkRunRecord, result: ExploreResult) -> None:
    """Explored share against steps for the first run; steps against map error where there are several."""
    pairs = [(r.steps, r.map_error) for r in result.runs if r.map_error is not None]
    panels = 2 if len(pairs) > 1 else 1
    with figure(path, 4.0 * panels + 1.0 * (panels == 1), 3.2, ncols=panels, squeeze=False) as (_, axes):
        ax = axes[0, 0]
        ax.plot([m.step for m in run.moments], [100 * m.explored for m in run.moments], color=colour(0))
        handed = [(m.step, 100 * m.explored) for m in run.moments if m.handed_over]
        if handed:
            ax.plot(*np.array(handed).T, marker(2), color=colour(1), ms=4, ls="none", label="a submap handed over")
            ax.legend()
        ax.set(xlabel="step", ylabel="explored [%]", ylim=(0, 102))
        ax.set_title("First run")
        if panels == 1:
            return
        ax = axes[0, 1]
        ax.plot(*np.array(pairs).T, "o", color=colour(0), ms=4)
        ax.set(xlabel="steps", ylabel="map error [m]")
        ax.set_ylim(bottom=0)
        ax.set_title("All runs")


def draw_animation(path: Path, run: LandmarkRunRecord) -> None:
    """The first run as a small animated GIF: paths so far, what each robot sees, landmarks."""
    moments = (run.first_look, *run.moments)
    every = max(1, len(moments) // FRAMES)
    shown = [*moments[::every], moments[-1]]
    poses = np.array([m.true_poses for m in moments])
    width, height = run.world.upper - run.world.lower
    frames: list[Image.Image] = []
    with figure(Sheet(), 5.2, min(5.2 * float(height / width), TALLEST) + 0.4) as (fig, ax):
        _field(ax, run)
        ax.plot(*run.world.landmarks.T, "*", color=TRUTH, ms=4, zorder=5)
        lines = [ax.plot([], [], color=colour(j))[0] for j in range(len(run.robots))]
        heads = [ax.plot([], [], marker(j), color=colour(j), ms=7)[0] for j in range(len(run.robots))]
        title = ax.set_title("", loc="left")
        for moment in shown:
            for j in range(len(run.robots)):
                lines[j].set_data(poses[: moment.step + 1, j, 0], poses[: moment.step + 1, j, 1])
                heads[j].set_data([moment.true_poses[j, 0]], [moment.true_poses[j, 1]])
            title.set_text(f"step {moment.step}, {100 * moment.explored:.0f} % explored")
            frames.append(rendered(fig))
    path.parent.mkdir(parents=True, exist_ok=True)
    save_gif(path, frames)


def save_gif(path: Path, frames: list[Image.Image], kept: tuple[str, ...] = ()) -> None:
    """An animation in 32 colours: those of its last frame, and `kept` ones that cover little of it."""
    sample = frames[-1].copy()
    for k, shade in enumerate(kept):
        sample.paste(shade, (32 * k, 0, 32 * k + 32, 64))
    palette = sample.quantize(32)
    small = [f.quantize(32, palette=palette, dither=Image.Dither.NONE) for f in frames]
    small[0].save(path, save_all=True, append_images=small[1:], duration=140, loop=0, optimize=True)


def rendered(fig: Any, dpi: int = 80) -> Image.Image:
    """The figure as it is now: the first frame of an animation lays it out, the others keep that layout."""
    canvas: Any = FigureCanvasAgg(fig)
    fig.set_dpi(dpi)
    canvas.draw()
    fig.set_layout_engine("none")
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def _field(ax: Any, run: LandmarkRunRecord) -> None:
    (x0, y0), (x1, y1) = run.world.lower, run.world.upper
    ax.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=MUTED, lw=1)
    if run.floor is not None:
        rows, cols = run.floor.field.shape
        shade = np.ma.masked_where(run.floor.field, np.ones((rows, cols)))
        extent = (x0, x0 + cols * run.floor.cell, y0, y0 + rows * run.floor.cell)
        ax.imshow(shade, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=4, interpolation="nearest", zorder=1)
        ax.add_collection(
            LineCollection(list(run.floor.walls.segments.reshape(-1, 2, 2)), colors=TRUTH, linewidths=1.2, zorder=2)
        )
    as_map(ax)
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=(x0 - 2, x1 + 2), ylim=(y0 - 2, y1 + 2))


def _border(ax: Any, points: np.ndarray, color: str) -> None:
    if len(points) < 3:
        return
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:
        return
    ax.add_patch(Polygon(corners, fill=True, facecolor=color, alpha=0.06, edgecolor=color, lw=0.6))


def _unit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}".strip()
