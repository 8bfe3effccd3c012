"""One scan laid into, or taken out of, a dense grid in whole numbers; many poses scored against a finished one."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel, parallel_kernel, prange
from ..cells import cell_of

UNIT = 1 << 16  # parts of a cell, and of a feature of 1, that sums count in
WEIGHT = 1 << 24  # parts of a weight of 1: sums stay within 63 bits for eight million returns a cell
LONGEST = 1 << 20  # cells that a beam may cross: 50 km of 5 cm


class CellCounts(NamedTuple):
    """Cells of `cell` [m], of which `corner` (2,) int64 is that of entry [0, 0], and what was seen in them.

    hits, far, passes: (rows, cols) int32, returns, returns from far, beams that went through; sums: (rows, cols, 4)
    int64, of the returns' weight times (offset in the cell x and y, feature, 1), in parts of `UNIT` and `WEIGHT`.
    """

    hits: np.ndarray
    far: np.ndarray
    passes: np.ndarray
    sums: np.ndarray
    corner: np.ndarray
    cell: float


@kernel
def lay_scan(
    counts: CellCounts,
    sensor: np.ndarray,
    points: np.ndarray,
    light: np.ndarray,
    ends: np.ndarray,
    near: float,
    sign: int,
) -> None:
    """`counts` hold one scan more (`sign` 1) or less (-1).

    sensor: (2,); points: (n, 2) returns; ends: (m, 2) where beams that came to nothing were last known free, all [m] in
    the map; light: (n, 2) feature and weight of every return. Returns from beyond `near` [m] count as `far` ones. A
    beam passes every cell it crosses before the one it ends in; a beam without return passes that one too. The same
    pose counts the same, wherever the corner lies.
    """
    hits, far, passes, sums, corner, cell = counts
    for i in range(points.shape[0]):
        jx, jy = walk(passes, corner, cell, sensor[0], sensor[1], points[i, 0], points[i, 1], sign)
        if 0 <= jy < hits.shape[0] and 0 <= jx < hits.shape[1]:
            away = (points[i, 0] - sensor[0]) ** 2 + (points[i, 1] - sensor[1]) ** 2 > near * near
            if away:
                far[jy, jx] += sign
            else:
                hits[jy, jx] += sign
            vx, vy = points[i, 0] / cell, points[i, 1] / cell
            weight = sign * np.int64(light[i, 1] * WEIGHT)
            sums[jy, jx, 0] += weight * np.int64((vx - np.floor(vx)) * UNIT)
            sums[jy, jx, 1] += weight * np.int64((vy - np.floor(vy)) * UNIT)
            sums[jy, jx, 2] += weight * np.int64(light[i, 0] * UNIT)
            sums[jy, jx, 3] += weight
    for i in range(ends.shape[0]):
        jx, jy = walk(passes, corner, cell, sensor[0], sensor[1], ends[i, 0], ends[i, 1], sign)
        if 0 <= jy < hits.shape[0] and 0 <= jx < hits.shape[1]:
            passes[jy, jx] += sign


@kernel
def walk(
    passes: np.ndarray, corner: np.ndarray, cell: float, x0: float, y0: float, x1: float, y1: float, sign: int
) -> tuple[int, int]:
    """`passes` changes by `sign` in every cell from (x0, y0) to before that of (x1, y1), whose column and row come.

    A beam over `LONGEST` cells is none: it changes nothing, and ends outside.
    """
    rows, cols = passes.shape
    ux, uy, vx, vy = x0 / cell, y0 / cell, x1 / cell, y1 / cell
    fx, fy, gx, gy = cell_of(ux), cell_of(uy), cell_of(vx), cell_of(vy)
    dx, dy = vx - ux, vy - uy
    sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    tx = math.inf if dx == 0.0 else (fx + (1 if dx > 0 else 0) - ux) / dx
    ty = math.inf if dy == 0.0 else (fy + (1 if dy > 0 else 0) - uy) / dy
    stepx = math.inf if dx == 0.0 else abs(1.0 / dx)
    stepy = math.inf if dy == 0.0 else abs(1.0 / dy)
    ix, iy = fx - corner[0], fy - corner[1]
    jx, jy = gx - corner[0], gy - corner[1]
    if not abs(dx) + abs(dy) < LONGEST:
        return -1, -1
    for _ in range(abs(jx - ix) + abs(jy - iy)):
        if 0 <= iy < rows and 0 <= ix < cols:
            passes[iy, ix] += sign
        if tx < ty:
            ix += sx
            tx += stepx
        else:
            iy += sy
            ty += stepy
    return jx, jy


@parallel_kernel
def score_field(
    near: np.ndarray,
    origin: np.ndarray,
    cell: float,
    poses: np.ndarray,
    points: np.ndarray,
    alpha: float,
    cap: float,
    matched_under: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean over the beams of `min(D, cap)` (P,) [m^2], and how many beams have a D under `matched_under` (P,).

    near: (rows, cols, 3), x, y, q of the occupied cell nearest to each cell; poses: (P, 3); points: (n, 3) x, y, q in
    the robot frame; D as in [Hara07], alpha [m^2]. Beams that end outside the table are charged `cap`.
    """
    rows, cols = near.shape[0], near.shape[1]
    n = points.shape[0]
    mean = np.empty(poses.shape[0])
    matched = np.empty(poses.shape[0], dtype=np.int64)
    for p in prange(poses.shape[0]):
        c, s = math.cos(poses[p, 2]), math.sin(poses[p, 2])
        total, count = 0.0, 0
        for i in range(n):
            x = poses[p, 0] + c * points[i, 0] - s * points[i, 1]
            y = poses[p, 1] + s * points[i, 0] + c * points[i, 1]
            col, row = cell_of((x - origin[0]) / cell), cell_of((y - origin[1]) / cell)
            d = cap
            if 0 <= row < rows and 0 <= col < cols:
                ex, ey = near[row, col, 0] - x, near[row, col, 1] - y
                eq = near[row, col, 2] - points[i, 2]
                d = min(cap, ex * ex + ey * ey + alpha * eq * eq)
            total += d
            count += 1 if d < matched_under else 0
        mean[p] = total / max(n, 1)
        matched[p] = count
    return mean, matched
