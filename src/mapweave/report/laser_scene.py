"""Laser maps to move about in: walls, every robot's way, the closures believed and refused."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..core.names import robot_name
from ..core.records import Track
from ..laser.laser_map import GridMap
from ..laser.woven_map import ClosureRow
from .scene import Scene
from .style import LANDMARK, colour

BELIEVED, REFUSED = colour(2), colour(5)


def walls(scene: Scene, grid: GridMap) -> None:
    """The occupied cells of `grid` dark, what beams went through white, the rest open."""
    known = (grid.hits > 0) | (grid.passes > 0)
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return
    window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    occupied = grid.occupancy()[window] > 0.5
    x, y = grid.origin
    h = grid.resolution
    extent = (x + cols[0] * h, x + (cols[-1] + 1) * h, y + rows[0] * h, y + (rows[-1] + 1) * h)
    scene.grid("walls", known[window], occupied, extent)


def laser_scene(
    grid: GridMap,
    tracks: Mapping[str, Track],
    colours: Mapping[str, str],
    closures: Sequence[ClosureRow] = (),
    others: Mapping[str, Track] | None = None,
) -> Scene:
    """Walls and ways, in one frame. tracks: robot -> its way; colours: robot -> colour; others: layer -> a way beside.

    Closures that were refused and other ways are hidden at first.
    """
    scene = Scene("Laser map with the ways of its robots", hidden=["closures refused", *(others or {})])
    walls(scene, grid)
    for accepted, layer, shade in ((True, "closures believed", BELIEVED), (False, "closures refused", REFUSED)):
        rows = [c for c in closures if c.accepted == accepted]
        if rows:
            ends = np.array([c.at.ravel() for c in rows])
            scene.lines(layer, ends, shade, [_told(c) for c in rows], dashed=not accepted)
    for layer, track in (others or {}).items():
        scene.track(layer, layer, track, LANDMARK)
    for robot, track in tracks.items():
        scene.track(robot_name(robot), robot_name(robot), track, colours[robot])
    return scene


def _told(c: ClosureRow) -> str:
    ends = (
        f"{robot_name(robot)} at {stamp:.1f} s" for robot, stamp in ((c.robot_a, c.stamp_a), (c.robot_b, c.stamp_b))
    )
    return f"{', '.join(ends)}\n{c.reason}"
