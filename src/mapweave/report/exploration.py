"""Explorations as pages and maps to move about in: what was known when, where robots drove, what they mapped."""

from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy.spatial import ConvexHull, QhullError

from ..core.records import Track
from ..exploration.landmarks.config import ExploreConfig
from ..exploration.landmarks.experiment import ExploreResult, LandmarkRunRecord
from ..exploration.laser.experiment import LaserRunRecord
from ..kernels.exploration.objective import mark_half_disc
from ..kernels.walls.segments import Raster, Sector
from ..kernels.walls.sight import mark_in_sight
from .html import Page
from .scene import Scene
from .style import MUTED, PALETTE, SEQUENTIAL, TRUTH, Sheet, as_map, colour, draw_lines, figure, marker, rendered

BORDERS = "submaps as they were handed over"
MAPPED, FRAME, REFUSED, WALL = PALETTE[5], "#9AA0A6", PALETTE[5], PALETTE[5]


def first_seen(run: LandmarkRunRecord, cfg: ExploreConfig) -> Float[np.ndarray, "rows columns"]:
    """The step at which each cell of the field was first seen, row 0 lowest; NaN: never."""
    width, height = run.world.upper - run.world.lower
    cell, sector = cfg.mission.cell, Sector(cfg.submap.reach, cfg.submap.half_angle)
    shape = (int(np.ceil(height / cell)), int(np.ceil(width / cell)))
    seen, first = np.zeros(shape, dtype=bool), np.full(shape, np.nan)
    raster = Raster(run.world.lower, cell)
    for moment in (run.first_look, *run.moments):
        for pose in moment.poses[~np.isnan(moment.poses[:, 0])]:  # of robots that are known to be in the map
            if run.floor is None:
                mark_half_disc(seen, pose, sector, raster)
            else:
                mark_in_sight(seen, pose, sector, raster, run.floor.walls.segments)
        first[seen & np.isnan(first)] = moment.step
    return first


def landmark_scene(run: LandmarkRunRecord, cfg: ExploreConfig) -> Scene:
    """The first run of a landmark world."""
    first, cell = first_seen(run, cfg), cfg.mission.cell
    scene = Scene("The field, what was seen of it when, and where the robots drove", [BORDERS], clock="step")
    (x0, y0), (x1, y1) = run.world.lower, run.world.upper
    rows, columns = first.shape
    known = ~np.isnan(first)
    extent = (float(x0), float(x0 + columns * cell), float(y0), float(y0 + rows * cell))
    scene.grid("explored", known, np.zeros_like(known), extent, first)
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], float)
    scene.lines("field", np.concatenate([corners[:-1], corners[1:]], axis=1), FRAME)
    if run.floor is not None:
        scene.lines("walls", run.floor.walls.segments, TRUTH)
    for _, j, points in run.submap_borders:
        ring = _border(points)
        scene.lines(BORDERS, np.concatenate([ring[:-1], ring[1:]], axis=1), colour(j))
    moments = (run.first_look, *run.moments)
    steps = np.array([moment.step for moment in moments], float)
    poses = np.array([moment.true_poses for moment in moments])
    for j, name in enumerate(run.robots):
        scene.track(name, f"{name}, true place", Track(steps, poses[:, j]), colour(j))
    true = run.world.landmarks
    scene.points("true landmarks", [str(i) for i in range(len(true))], true, TRUTH, named=False, shape="star")
    marks = run.map.landmarks
    n = len(marks)
    cov = marks.cov.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
    labels = []
    for name, (x, y), P in zip(marks.ids, marks.mean, cov, strict=True):
        source = run.source.get(name)
        off = "" if source is None else f"\n{np.hypot(*(true[source] - (x, y))):.3f} m from its true place"
        labels.append(
            f"landmark {name}, as mapped\n({x:.3f}, {y:.3f}) m\nsd {np.sqrt(np.trace(P) / 2):.3f} m an axis{off}"
        )
    cells = np.clip(((marks.mean - run.world.lower) / cell).astype(int), 0, [columns - 1, rows - 1])
    since = [None if np.isnan(step) else float(step) for step in first[cells[:, 1], cells[:, 0]]]
    scene.points("mapped landmarks", marks.ids, marks.mean, MAPPED, labels, cov, named=False, since=since)
    return scene


def _border(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "corners 2"]:
    """The hull of a submap as a ring; nothing where its corners lie on a line."""
    corners: list[int] = []
    if len(points) > 2:
        with suppress(QhullError):
            corners = [int(k) for k in ConvexHull(points).vertices]
    return points[[*corners, *corners[:1]]]


def laser_exploration_scene(run: LaserRunRecord) -> Scene:
    """The first run of a laser world: cells of the final map as they came to be known."""
    hidden = ["true walls", "truth", "loops closed", "loops refused"]
    scene = Scene("The merged map, as it came about, and where the robots drove", hidden=hidden)
    known = ~run.map.unknown
    since = np.full(known.shape, np.nan)
    t = np.array([0.0, *(moment.t for moment in run.moments)])
    for snapshot in run.snapshots:
        places = run.map.centres(np.argwhere(known & np.isnan(since)))
        then = snapshot.grid.state[tuple(snapshot.grid.cells(places).T)] != -1
        inside = _inside(snapshot.grid.origin, snapshot.grid.resolution, snapshot.grid.state.shape, places)
        at = np.argwhere(known & np.isnan(since))[then & inside]
        since[tuple(at.T)] = t[min(snapshot.step, len(t) - 1)]
    x, y = run.map.origin
    rows, columns = known.shape
    h = run.map.resolution
    extent = (float(x), float(x + columns * h), float(y), float(y + rows * h))
    scene.grid("map", known, run.map.occupied, extent, since)
    scene.lines("true walls", run.place.world.segments, WALL)
    pose = run.graph.pose[:, :2]
    for layer, accepted in (("loops closed", True), ("loops refused", False)):
        those = [c for c in run.closures if c.accepted == accepted]
        ends = np.array([[*pose[c.first], *pose[c.second]] for c in those]).reshape(-1, 4)
        labels = [f"{run.robots[c.robots[0]]} and {run.robots[c.robots[1]]}\n{c.reason}" for c in those]
        scene.lines(layer, ends, PALETTE[2] if accepted else REFUSED, labels, dashed=not accepted)
    for true in run.truths:
        scene.path("truth", true.pose[:, :2], TRUTH)
    for j, name in enumerate(run.robots):
        if len(run.tracks[j].t):
            scene.track(name, name, run.tracks[j], colour(j))
    return scene


def _inside(
    origin: Float[np.ndarray, "2"], resolution: float, shape: tuple[int, ...], at: Float[np.ndarray, "n 2"]
) -> np.ndarray:
    """Which places lie on a grid of that shape."""
    upper = origin + resolution * np.array(shape[::-1])
    return np.asarray(((at >= origin) & (at < upper)).all(axis=1))


FRAMES = 48
TALLEST = 24.0  # inches, of a figure, however narrow the field


def write_exploration(folder: Path, result: ExploreResult) -> None:
    """report.html and figures/ in `folder`."""
    first = result.first
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
    scene = landmark_scene(first, m.cfg)
    caption = "What was seen when, where the robots truly were, and the map."
    page.scene(scene, caption, folder / "figures" / "map.png")
    for line in result.lines_on_team():
        page.text(f"{line[0].upper()}{line[1:]}.")
    page.figure(folder / "figures" / "explored.png", "When each cell was first seen; lines: the frontier at quarters")
    every = "; steps and errors of all runs" if len(result.runs) > 1 else ""
    page.figure(folder / "figures" / "progress.png", f"Explored share of the field{every}")
    page.section("Every run")
    head = ["run", "seed", "finished", "steps", "map error [m]", "C/N [m²]", "NEES/dof", "duplicates", "missed"]
    walled = first.floor is not None
    if walled:
        head += ["met a wall", "landmarks nobody can see"]
    told = attrgetter("steps", "map_error", "c_per_n", "nees_per_dof", "duplicates", "missed")
    met = attrgetter("collisions", "hidden")
    rows = [[r.run, r.seed, "yes" if r.finished else "no", *told(r), *(met(r) if walled else ())] for r in result.runs]
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


def _field(ax: Any, run: LandmarkRunRecord) -> None:
    (x0, y0), (x1, y1) = run.world.lower, run.world.upper
    ax.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=MUTED, lw=1)
    if run.floor is not None:
        rows, cols = run.floor.field.shape
        shade = np.ma.masked_where(run.floor.field, np.ones((rows, cols)))
        extent = (x0, x0 + cols * run.floor.cell, y0, y0 + rows * run.floor.cell)
        ax.imshow(shade, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=4, interpolation="nearest", zorder=1)
        draw_lines(ax, run.floor.walls.segments.reshape(-1, 2, 2), TRUTH, 1.2, zorder=2)
    as_map(ax)
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=(x0 - 2, x1 + 2), ylim=(y0 - 2, y1 + 2))


def _unit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}".strip()
