"""Geometry of walls: how far, whether a straight move touches one, what lies inside closed ones, beams against them."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of


class Raster(NamedTuple):
    """Square cells of side `cell` [m]; corner: (2,) [m], the lower left one of cell (0, 0); row 0 lowest y."""

    corner: np.ndarray
    cell: float


class Sector(NamedTuple):
    """What a sensor has in view: up to `reach` [m] away and `half_angle` [rad] to either side of straight ahead."""

    reach: float
    half_angle: float


@kernel
def _to_segment(px: float, py: float, segments: np.ndarray, k: int) -> float:
    """Squared distance [m^2] from a point to segment k."""
    ax, ay = segments[k, 0], segments[k, 1]
    ex, ey = segments[k, 2] - ax, segments[k, 3] - ay
    length2 = ex * ex + ey * ey
    u = 0.0
    if length2 > 0.0:
        u = min(1.0, max(0.0, ((px - ax) * ex + (py - ay) * ey) / length2))
    dx, dy = px - ax - u * ex, py - ay - u * ey
    return float(dx * dx + dy * dy)


@kernel
def distance_to_walls(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance [m] (n,) from each of `points` (n, 2) to the nearest of `segments` (s, 4); infinite without walls."""
    out = np.full(points.shape[0], np.inf)
    for i in range(points.shape[0]):
        for k in range(segments.shape[0]):
            out[i] = min(out[i], _to_segment(points[i, 0], points[i, 1], segments, k))
        out[i] = np.sqrt(out[i])
    return out


@kernel
def mark_near(near: np.ndarray, segments: np.ndarray, radius: float, raster: Raster) -> None:
    """Cells of `near` (ny, nx) whose centre is nearer than `radius` to a segment become True, in place."""
    origin, cell = raster.corner, raster.cell
    ny, nx = near.shape
    for k in range(segments.shape[0]):
        left, right = min(segments[k, 0], segments[k, 2]), max(segments[k, 0], segments[k, 2])
        low, high = min(segments[k, 1], segments[k, 3]), max(segments[k, 1], segments[k, 3])
        x0 = max(0, cell_of((left - radius - origin[0]) / cell))
        x1 = min(nx - 1, cell_of((right + radius - origin[0]) / cell))
        y0 = max(0, cell_of((low - radius - origin[1]) / cell))
        y1 = min(ny - 1, cell_of((high + radius - origin[1]) / cell))
        for iy in range(y0, y1 + 1):
            y = origin[1] + (iy + 0.5) * cell
            for ix in range(x0, x1 + 1):
                if _to_segment(origin[0] + (ix + 0.5) * cell, y, segments, k) < radius * radius:
                    near[iy, ix] = True


@kernel
def _side(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> float:
    """Twice the signed area of the triangle a, b, p: positive where p lies left of a -> b."""
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@kernel
def _within(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> bool:
    """Whether p, known to lie on the line through a and b, lies between them."""
    return min(ax, bx) <= px <= max(ax, bx) and min(ay, by) <= py <= max(ay, by)


@kernel
def touches(ax: float, ay: float, bx: float, by: float, segments: np.ndarray, k: int) -> bool:
    """Whether the straight move a -> b meets segment k; ends count."""
    cx, cy, dx, dy = segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]
    c, d = _side(ax, ay, bx, by, cx, cy), _side(ax, ay, bx, by, dx, dy)
    if (c > 0.0 and d > 0.0) or (c < 0.0 and d < 0.0):
        return False
    a, b = _side(cx, cy, dx, dy, ax, ay), _side(cx, cy, dx, dy, bx, by)
    if (a > 0.0 and b > 0.0) or (a < 0.0 and b < 0.0):
        return False
    if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0:
        return (
            _within(ax, ay, bx, by, cx, cy)
            or _within(ax, ay, bx, by, dx, dy)
            or _within(cx, cy, dx, dy, ax, ay)
            or _within(cx, cy, dx, dy, bx, by)
        )
    return True


@kernel
def enclosed(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Which of `points` (n, 2) an odd number of segments lies right of: those inside, where segments close up."""
    out = np.zeros(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        for k in range(segments.shape[0]):
            y0, y1 = segments[k, 1], segments[k, 3]
            if (y0 > py) != (y1 > py):
                x = segments[k, 0] + (py - y0) * (segments[k, 2] - segments[k, 0]) / (y1 - y0)
                if x > px:
                    out[i] = not out[i]
    return out


@kernel
def enclosed_cells(segments: np.ndarray, raster: Raster, rows: int, cols: int) -> np.ndarray:
    """`enclosed` of the centres of a raster's cells (rows, cols), in one sweep over the segments."""
    lower, cell = raster.corner, raster.cell
    turns = np.zeros((rows, cols + 1), dtype=np.bool_)  # by how many columns' centres a crossing lies right of
    for k in range(segments.shape[0]):
        y0, y1 = segments[k, 1], segments[k, 3]
        first = max(0, cell_of((min(y0, y1) - lower[1]) / cell - 0.5))
        last = min(rows, cell_of(np.ceil((max(y0, y1) - lower[1]) / cell - 0.5)) + 1)
        for row in range(first, last):
            py = lower[1] + (row + 0.5) * cell
            if (y0 > py) != (y1 > py):
                x = segments[k, 0] + (py - y0) * (segments[k, 2] - segments[k, 0]) / (y1 - y0)
                col = min(cols, max(0, cell_of(np.ceil((x - lower[0]) / cell - 0.5))))
                turns[row, col] = not turns[row, col]
    out = np.zeros((rows, cols), dtype=np.bool_)
    for row in range(rows):
        inside = False
        for col in range(cols - 1, -1, -1):
            if turns[row, col + 1]:
                inside = not inside
            out[row, col] = inside
    return out


@kernel
def sight_on_raster(free: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the straight line from a to b (x, y in cells, cell (0, 0) from 0 to 1) runs over free cells alone.

    A line through a cell's corner needs both cells beside the corner free. Outside `free` (ny, nx) nothing is.
    """
    ny, nx = free.shape
    ix, iy = cell_of(a[0]), cell_of(a[1])
    ex, ey = cell_of(b[0]), cell_of(b[1])
    dx, dy = b[0] - a[0], b[1] - a[1]
    sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    tx = ((ix + (dx > 0)) - a[0]) / dx if dx != 0.0 else np.inf
    ty = ((iy + (dy > 0)) - a[1]) / dy if dy != 0.0 else np.inf
    step_x = abs(1.0 / dx) if dx != 0.0 else np.inf
    step_y = abs(1.0 / dy) if dy != 0.0 else np.inf
    for _ in range(abs(ex - ix) + abs(ey - iy) + 1):
        if not (0 <= ix < nx and 0 <= iy < ny) or not free[iy, ix]:
            return False
        if ix == ex and iy == ey:
            return True
        if abs(tx - ty) < 1e-9:
            if not (0 <= ix + sx < nx and 0 <= iy + sy < ny and free[iy, ix + sx] and free[iy + sy, ix]):
                return False
            ix, iy, tx, ty = ix + sx, iy + sy, tx + step_x, ty + step_y
        elif tx < ty:
            ix, tx = ix + sx, tx + step_x
        else:
            iy, ty = iy + sy, ty + step_y
    return False


@kernel
def distance_of_moves(a: np.ndarray, b: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] from each straight move a (n, 2) -> b (n, 2) to the nearest segment; 0 where they meet."""
    out = np.full(a.shape[0], np.inf)
    move = np.empty((1, 4))
    for i in range(a.shape[0]):
        move[0, 0], move[0, 1], move[0, 2], move[0, 3] = a[i, 0], a[i, 1], b[i, 0], b[i, 1]
        for k in range(segments.shape[0]):
            if touches(a[i, 0], a[i, 1], b[i, 0], b[i, 1], segments, k):
                out[i] = 0.0
                break
            out[i] = min(out[i], _to_segment(a[i, 0], a[i, 1], segments, k), _to_segment(b[i, 0], b[i, 1], segments, k))
            out[i] = min(out[i], _to_segment(segments[k, 0], segments[k, 1], move, 0))
            out[i] = min(out[i], _to_segment(segments[k, 2], segments[k, 3], move, 0))
        out[i] = np.sqrt(out[i])
    return out


@kernel
def free_share(a: np.ndarray, b: np.ndarray, radius: float, segments: np.ndarray) -> float:
    """How much of the straight move a (2,) -> b (2,) a disc of `radius` can make without coming nearer to a wall.

    1 where the whole move is clear. A disc that stands nearer already may move as long as it does not come nearer.
    """
    here, there = a.copy().reshape(1, 2), np.empty((1, 2))
    least = min(radius, distance_of_moves(here, here, segments)[0]) - 1e-9
    there[0] = b
    if distance_of_moves(here, there, segments)[0] >= least:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(40):
        share = 0.5 * (low + high)
        there[0] = a + share * (b - a)
        if distance_of_moves(here, there, segments)[0] >= least:
            low = share
        else:
            high = share
    return low


NONE = -1  # number of the wall of a beam that meets none


@kernel
def cast(
    sensor: np.ndarray, angles: np.ndarray, segments: np.ndarray, discs: np.ndarray, far: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First hit of every beam of every scan.

    sensor: (m, 3) poses; angles: (n,) [rad]; segments: (s, 4) as x0 y0 x1 y1, or (s, 5) with the cosine of incidence
    from which on each stops a beam, as glass does; discs: (m, d, 3) as x y radius, one set a scan. Returns range (m, n)
    [m] (infinite beyond `far`), what was hit (m, n) (segment k, or s + disc, or -1), and the cosine of incidence (m, n)
    in [0, 1].
    """
    m, n, s, d = sensor.shape[0], angles.shape[0], segments.shape[0], discs.shape[1]
    glass = segments.shape[1] > 4
    rng = np.full((m, n), np.inf)
    what = np.full((m, n), NONE, dtype=np.int64)
    cosine = np.zeros((m, n))
    near = np.empty(s, dtype=np.int64)
    for i in range(m):
        px, py, heading = sensor[i, 0], sensor[i, 1], sensor[i, 2]
        count = _in_reach(px, py, segments, far, near)
        for j in range(n):
            ux, uy = np.cos(heading + angles[j]), np.sin(heading + angles[j])
            best, hit, across = far, NONE, 0.0
            for k in range(count):
                a = near[k]
                r, slant = meet(px, py, ux, uy, segments, a)
                if r < best and not (glass and slant < segments[a, 4]):
                    best, hit, across = r, a, slant
            for k in range(d):
                r, slant = meet_disc(px, py, ux, uy, discs[i, k])
                if r < best:
                    best, hit, across = r, s + k, slant
            if hit != NONE:
                rng[i, j], what[i, j], cosine[i, j] = best, hit, across
    return rng, what, cosine


@kernel
def meet(px: float, py: float, ux: float, uy: float, segments: np.ndarray, a: int) -> tuple[float, float]:
    """Where the beam from p along the unit vector u meets segment a, infinite if nowhere; cosine of incidence."""
    ex, ey = segments[a, 2] - segments[a, 0], segments[a, 3] - segments[a, 1]
    det = ux * ey - uy * ex
    if det == 0.0:
        return np.inf, 0.0
    wx, wy = segments[a, 0] - px, segments[a, 1] - py
    r = (wx * ey - wy * ex) / det
    along = (wx * uy - wy * ux) / det
    if r <= 0.0 or along < 0.0 or along > 1.0:
        return np.inf, 0.0
    return r, abs(det) / np.sqrt(ex * ex + ey * ey)


@kernel
def meet_disc(px: float, py: float, ux: float, uy: float, disc: np.ndarray) -> tuple[float, float]:
    """As `meet`, for a disc (3,) as x y radius."""
    wx, wy, radius = disc[0] - px, disc[1] - py, disc[2]
    middle = wx * ux + wy * uy
    square = radius * radius - (wx * wx + wy * wy - middle * middle)
    if radius <= 0.0 or square <= 0.0:
        return np.inf, 0.0
    r = middle - np.sqrt(square)
    return (r, np.sqrt(square) / radius) if r > 0.0 else (np.inf, 0.0)


@kernel
def _in_reach(px: float, py: float, segments: np.ndarray, far: float, out: np.ndarray) -> int:
    """Writes the segments that come nearer than `far` to `out` and returns how many."""
    count = 0
    for k in range(segments.shape[0]):
        mx, my = 0.5 * (segments[k, 0] + segments[k, 2]), 0.5 * (segments[k, 1] + segments[k, 3])
        half = 0.5 * np.hypot(segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1])
        if np.hypot(mx - px, my - py) <= far + half:
            out[count] = k
            count += 1
    return count
