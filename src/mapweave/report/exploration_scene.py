"""Explorations to move about in, through time: what was known when, where the robots drove, what they mapped."""

import numpy as np
from jaxtyping import Float

from ..core.records import Track
from ..exploration.landmarks.config import ExploreConfig
from ..exploration.landmarks.experiment import LandmarkRunRecord
from ..exploration.laser.experiment import LaserRunRecord
from ..kernels.exploration.objective import mark_half_disc
from ..kernels.walls.segments import Raster, Sector
from ..kernels.walls.sight import mark_in_sight
from .scene import Scene
from .style import PALETTE, TRUTH, colour

MAPPED, FRAME, REFUSED, WALL = PALETTE[5], "#9AA0A6", PALETTE[5], PALETTE[5]


def first_seen(run: LandmarkRunRecord, cfg: ExploreConfig) -> Float[np.ndarray, "rows columns"]:
    """The step at which each cell of the field was first seen, row 0 lowest; NaN: never."""
    width, height = run.world.upper - run.world.lower
    cell, sector = cfg.mission.cell, Sector(cfg.submap.reach, cfg.submap.half_angle)
    shape = (int(np.ceil(height / cell)), int(np.ceil(width / cell)))
    seen, first = np.zeros(shape, dtype=bool), np.full(shape, np.nan)
    raster = Raster(run.world.lower, cell)
    for moment in (run.first_look, *run.moments):
        for pose in moment.poses:
            if run.floor is None:
                mark_half_disc(seen, pose, sector, raster)
            else:
                mark_in_sight(seen, pose, sector, raster, run.floor.walls.segments)
        first[seen & np.isnan(first)] = moment.step
    return first


def landmark_scene(run: LandmarkRunRecord, first: Float[np.ndarray, "rows columns"], cell: float) -> Scene:
    """The first run of a landmark world. first: the step at which each cell was first seen."""
    scene = Scene("The field, what was seen of it when, and where the robots drove", axes="x, y in m", clock="step")
    (x0, y0), (x1, y1) = run.world.lower, run.world.upper
    rows, columns = first.shape
    known = ~np.isnan(first)
    extent = (float(x0), float(x0 + columns * cell), float(y0), float(y0 + rows * cell))
    scene.grid("explored", known, np.zeros_like(known), extent, first)
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], float)
    scene.lines("field", np.concatenate([corners[:-1], corners[1:]], axis=1), FRAME)
    if run.floor is not None:
        scene.lines("walls", run.floor.walls.segments, TRUTH)
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
        scene.track(name, name, run.tracks[j], colour(j))
    return scene


def _inside(
    origin: Float[np.ndarray, "2"], resolution: float, shape: tuple[int, ...], at: Float[np.ndarray, "n 2"]
) -> np.ndarray:
    """Which places lie on a grid of that shape."""
    upper = origin + resolution * np.array(shape[::-1])
    return np.asarray(((at >= origin) & (at < upper)).all(axis=1))
