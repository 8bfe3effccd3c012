"""Many poses against one finished map, by a table of each cell's nearest occupied cell."""

import math

import numpy as np

from .._jit import parallel_kernel, prange
from ..cells import cell_of


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
