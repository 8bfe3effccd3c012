"""What is in view among walls: cells and points no segment hides, from where a place is seen, what is seen through."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from .segments import Raster, Sector, _to_segment, touches


@kernel
def _near(px: float, py: float, segments: np.ndarray, reach: float) -> np.ndarray:
    """The segments within `reach` of a point: no other can hide what lies within `reach`."""
    out = np.empty_like(segments)
    count = 0
    for k in range(segments.shape[0]):
        if _to_segment(px, py, segments, k) <= reach * reach:
            out[count] = segments[k]
            count += 1
    return out[:count]


@kernel
def _clear(ax: float, ay: float, bx: float, by: float, segments: np.ndarray) -> bool:
    for k in range(segments.shape[0]):  # noqa: SIM110  (compiled)
        if touches(ax, ay, bx, by, segments, k):
            return False
    return True


@kernel
def points_in_sight(place: np.ndarray, points: np.ndarray, reach: float, segments: np.ndarray) -> np.ndarray:
    """Which of `points` (n, 2) lie within `reach` of `place` (2,) with no wall between."""
    near = _near(place[0], place[1], segments, reach)
    out = np.zeros(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - place[0], points[i, 1] - place[1]
        out[i] = dx * dx + dy * dy <= reach * reach and _clear(place[0], place[1], points[i, 0], points[i, 1], near)
    return out


@kernel
def mark_in_sight(explored: np.ndarray, pose: np.ndarray, sector: Sector, raster: Raster, segments: np.ndarray) -> None:
    """Cells whose centre the `sector` of `pose` holds and no wall hides become True in `explored`, in place."""
    ny, nx = explored.shape
    reach, half_angle = sector.reach, sector.half_angle
    origin, cell = raster.corner, raster.cell
    near = _near(pose[0], pose[1], segments, reach)
    c, s, cos_half = np.cos(pose[2]), np.sin(pose[2]), np.cos(half_angle)
    x0 = max(0, cell_of((pose[0] - reach - origin[0]) / cell))
    x1 = min(nx - 1, cell_of((pose[0] + reach - origin[0]) / cell))
    y0 = max(0, cell_of((pose[1] - reach - origin[1]) / cell))
    y1 = min(ny - 1, cell_of((pose[1] + reach - origin[1]) / cell))
    for iy in range(y0, y1 + 1):
        y = origin[1] + (iy + 0.5) * cell
        for ix in range(x0, x1 + 1):
            if explored[iy, ix]:
                continue
            x = origin[0] + (ix + 0.5) * cell
            dx, dy = x - pose[0], y - pose[1]
            d2 = dx * dx + dy * dy
            if d2 <= reach * reach and dx * c + dy * s >= cos_half * np.sqrt(d2) - 1e-9:
                explored[iy, ix] = _clear(pose[0], pose[1], x, y, near)


@kernel
def unexplored_in_sight(
    explored: np.ndarray, poses: np.ndarray, sector: Sector, raster: Raster, segments: np.ndarray
) -> np.ndarray:
    """How many unexplored cells (m,) come into view from each of `poses` (m, 3) among walls.

    What can be seen from a place is found once for all headings that follow each other there.
    """
    ny, nx = explored.shape
    reach, half_angle = sector.reach, sector.half_angle
    origin, cell = raster.corner, raster.cell
    out = np.zeros(poses.shape[0], dtype=np.int64)
    cos_half = np.cos(half_angle)
    seen = np.empty((ny * nx, 3))
    count = 0
    for k in range(poses.shape[0]):
        px, py = poses[k, 0], poses[k, 1]
        if k == 0 or px != poses[k - 1, 0] or py != poses[k - 1, 1]:
            near = _near(px, py, segments, reach)
            count = 0
            x0 = max(0, cell_of((px - reach - origin[0]) / cell))
            x1 = min(nx - 1, cell_of((px + reach - origin[0]) / cell))
            y0 = max(0, cell_of((py - reach - origin[1]) / cell))
            y1 = min(ny - 1, cell_of((py + reach - origin[1]) / cell))
            for iy in range(y0, y1 + 1):
                y = origin[1] + (iy + 0.5) * cell
                for ix in range(x0, x1 + 1):
                    if explored[iy, ix]:
                        continue
                    x = origin[0] + (ix + 0.5) * cell
                    dx, dy = x - px, y - py
                    d2 = dx * dx + dy * dy
                    if d2 <= reach * reach and _clear(px, py, x, y, near):
                        seen[count, 0], seen[count, 1], seen[count, 2] = dx, dy, np.sqrt(d2)
                        count += 1
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for i in range(count):
            if seen[i, 0] * c + seen[i, 1] * s >= cos_half * seen[i, 2] - 1e-9:
                out[k] += 1
    return out


@kernel
def _sees(row: int, col: int, x: float, y: float, lower: np.ndarray, cell: float, near: np.ndarray) -> bool:
    return _clear(lower[0] + (col + 0.5) * cell, lower[1] + (row + 0.5) * cell, x, y, near)


@kernel
def _seen_by_neighbours(
    row: int, col: int, x: float, y: float, stand: np.ndarray, lower: np.ndarray, cell: float, near: np.ndarray
) -> int:
    """From how many of the eight cells around (row, col) where a robot may stand the point is in sight."""
    count = 0
    for r in range(max(0, row - 1), min(stand.shape[0], row + 2)):
        for c in range(max(0, col - 1), min(stand.shape[1], col + 2)):
            if (r != row or c != col) and stand[r, c] and _sees(r, c, x, y, lower, cell, near):
                count += 1
    return count


@kernel
def nearest_views(
    points: np.ndarray, stand: np.ndarray, raster: Raster, reach: float, segments: np.ndarray, neighbours: int
) -> np.ndarray:
    """For each point (n, 2) the nearest cell (row, col) of `stand` (ny, nx) within `reach` that has it in sight.

    At least `neighbours` of the cells around that one must have it in sight too, so that a robot need not stand
    exactly there. (-1, -1) where there is none. raster: of `stand`.
    """
    lower, cell = raster.corner, raster.cell
    out = np.full((points.shape[0], 2), -1, dtype=np.int64)
    rings = cell_of(np.ceil(reach / cell)) + 1
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        near = _near(x, y, segments, reach + 2 * cell)
        row, col = cell_of((y - lower[1]) / cell), cell_of((x - lower[0]) / cell)
        best = reach
        for ring in range(rings):
            if (ring - 1) * cell > best:
                break
            for r in range(max(0, row - ring), min(stand.shape[0], row + ring + 1)):
                for c in range(max(0, col - ring), min(stand.shape[1], col + ring + 1)):
                    if (abs(r - row) != ring and abs(c - col) != ring) or not stand[r, c]:
                        continue
                    d = np.hypot(lower[0] + (c + 0.5) * cell - x, lower[1] + (r + 0.5) * cell - y)
                    if d >= best or not _sees(r, c, x, y, lower, cell, near):
                        continue
                    if _seen_by_neighbours(r, c, x, y, stand, lower, cell, near) >= neighbours:
                        best = d
                        out[i, 0], out[i, 1] = r, c
    return out


class Looks(NamedTuple):
    """How views look at walls [m]."""

    reach: float  # no farther
    same: float  # a view's return within this, and
    same_share: float  # [m/m] of its range, is of the same wall
    through: float  # a view goes on behind a wall by more,
    deep: float  # and far behind it
    side: float  # cosine by more of which a view is on one side of a wall


@kernel
def judge_walls(
    poses: np.ndarray,
    views: np.ndarray,
    walls: np.ndarray,
    normals: np.ndarray,
    sided: np.ndarray,
    looks: Looks,
    squarely: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(w, b + 1) views that see each wall, that go on behind it, and of these far behind it, by cosines of incidence
    parted at `squarely` (b,).

    poses: (n, 3) of the views in the frame of the walls (w, 2) [m]; views: (n, bins) [m], the nearest return in each
    direction, infinite where there is none; normals: (w, 2) unit, of a wall that is `sided` (w,) on the side it was
    seen from. A wall further than `reach` is not asked for. It is seen where a view's return in its direction, or in
    one of those beside it, is within `same` and `same_share` of its range; seen through where all three go on for more
    than `through` or `deep`. A view from the other side does not see it.
    """
    count, bins, steps = walls.shape[0], views.shape[1], squarely.shape[0]
    seen, gone, far = np.zeros((3, count, steps + 1), np.int64)
    for k in range(poses.shape[0]):
        x, y, c, s = poses[k, 0], poses[k, 1], math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(count):
            dx, dy = walls[i, 0] - x, walls[i, 1] - y
            r = math.sqrt(dx * dx + dy * dy)
            if not r <= looks.reach:  # nor what is no number
                continue
            turn = math.atan2(c * dy - s * dx, c * dx + s * dy) / (2.0 * math.pi)
            middle = cell_of(turn * bins)
            nearest, like, known = math.inf, False, True
            for beside in range(-1, 2):
                there = views[k, (middle + beside) % bins]
                known &= there < math.inf
                like |= abs(there - r) < looks.same + looks.same_share * r
                nearest = min(nearest, there)
            if not known:
                continue
            towards = -(dx * normals[i, 0] + dy * normals[i, 1])
            band = 0
            while band < steps and abs(towards) >= squarely[band] * r:
                band += 1
            if not like:
                gone[i, band] += nearest - r > looks.through
                far[i, band] += nearest - r > looks.deep
            elif not sided[i] or towards > -looks.side * r:
                seen[i, band] += 1
    return seen, gone, far
