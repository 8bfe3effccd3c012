"""Scans at known poses laid into one dense grid: returns, beams through, mean points."""

import math

import numpy as np

from .._jit import kernel


@kernel
def render(
    hits: np.ndarray,
    passes: np.ndarray,
    sums: np.ndarray,
    corner: np.ndarray,
    cell: float,
    sensor: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
) -> None:
    """One scan: `hits` and `passes` (rows, cols) int32 count up, `sums` (rows, cols, 4) gathers w (x, y, q, 1).

    sensor: (2,) and points: (n, 3) x, y, q in the map; weights: (n,). A beam passes every cell it crosses before the
    one it ends in. What lies outside the grid is left out.
    """
    rows, cols = hits.shape
    for i in range(points.shape[0]):
        ux, uy = (sensor[0] - corner[0]) / cell, (sensor[1] - corner[1]) / cell
        vx, vy = (points[i, 0] - corner[0]) / cell, (points[i, 1] - corner[1]) / cell
        ix, iy = np.int64(math.floor(ux)), np.int64(math.floor(uy))
        jx, jy = np.int64(math.floor(vx)), np.int64(math.floor(vy))
        dx, dy = vx - ux, vy - uy
        sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        tx = math.inf if dx == 0.0 else (ix + (1 if dx > 0 else 0) - ux) / dx
        ty = math.inf if dy == 0.0 else (iy + (1 if dy > 0 else 0) - uy) / dy
        stepx = math.inf if dx == 0.0 else abs(1.0 / dx)
        stepy = math.inf if dy == 0.0 else abs(1.0 / dy)
        for _ in range(abs(jx - ix) + abs(jy - iy)):
            if 0 <= iy < rows and 0 <= ix < cols:
                passes[iy, ix] += 1
            if tx < ty:
                ix += sx
                tx += stepx
            else:
                iy += sy
                ty += stepy
        if 0 <= jy < rows and 0 <= jx < cols:
            hits[jy, jx] += 1
            w = weights[i]
            sums[jy, jx, 0] += w * points[i, 0]
            sums[jy, jx, 1] += w * points[i, 1]
            sums[jy, jx, 2] += w * points[i, 2]
            sums[jy, jx, 3] += w
