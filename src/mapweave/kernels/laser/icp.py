"""Iterative closest point with a feature in the distance: nearest under D on a grid, pose in closed form."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import inlined_kernel, kernel
from ..cells import cell_of

MOST_CELLS = 4096  # along an axis: all of them together take 134 MB at most


class IcpRules(NamedTuple):
    """How scans are laid on each other; see `IcpConfig` of the laser room. cell: [m] of the grid of nearest points."""

    alpha: float
    gate: float
    least_gate: float
    decay: float
    iterations: int
    tolerance: float
    least_pairs: int
    cell: float


@inlined_kernel
def column_of(at: float, cell: float, many: int) -> int:
    """Which of so `many` cells from 0 on holds `at` [m]; the first and the last hold what lies beyond them."""
    return min(max(cell_of(at / cell), 0), many - 1)


@kernel
def sort_into_cells(points: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Points (m, 3) ordered by cell, row-major; starts (rows * cols + 1,); corner (2,) [m]; cols.

    There are `MOST_CELLS` along an axis at most: the first and the last hold what lies beyond.
    """
    m = points.shape[0]
    x0, y0, x1, y1 = math.inf, math.inf, -math.inf, -math.inf
    for i in range(m):
        x0, x1 = min(x0, points[i, 0]), max(x1, points[i, 0])
        y0, y1 = min(y0, points[i, 1]), max(y1, points[i, 1])
    cols, rows = column_of(x1 - x0, cell, MOST_CELLS) + 1, column_of(y1 - y0, cell, MOST_CELLS) + 1
    starts = np.zeros(rows * cols + 1, np.int64)
    key = np.empty(m, np.int64)
    for i in range(m):
        key[i] = column_of(points[i, 1] - y0, cell, rows) * cols + column_of(points[i, 0] - x0, cell, cols)
        starts[key[i] + 1] += 1
    for k in range(rows * cols):
        starts[k + 1] += starts[k]
    at = starts[:-1].copy()
    out = np.empty((m, 3))
    for i in range(m):
        j = at[key[i]]
        at[key[i]] += 1
        out[j, 0], out[j, 1], out[j, 2] = points[i, 0], points[i, 1], points[i, 2]
    return out, starts, np.array([x0, y0]), cols


@kernel
def nearest(
    ordered: np.ndarray,
    starts: np.ndarray,
    corner: np.ndarray,
    cols: int,
    cell: float,
    point: tuple[float, float, float],
    alpha: float,
    limit: float,
    guess: int,
) -> tuple[int, float]:
    """The point of least D to `point` (x, y, q) and that D, among those with D <= `limit` [m^2]; -1 without one.

    `guess`: a point to begin with, or -1; the answer does not depend on it.
    """
    x, y, q = point
    best, found = limit, -1
    if guess >= 0:
        dx, dy, dq = ordered[guess, 0] - x, ordered[guess, 1] - y, ordered[guess, 2] - q
        d = dx * dx + dy * dy + alpha * dq * dq
        if d <= best:
            best, found = d, guess
    reach, inverse = math.sqrt(best), 1.0 / cell
    rows = (starts.shape[0] - 1) // cols
    bx, by = x - corner[0], y - corner[1]
    ix0, ix1 = max(cell_of((bx - reach) * inverse), 0), min(cell_of((bx + reach) * inverse), cols - 1)
    iy0, iy1 = max(cell_of((by - reach) * inverse), 0), min(cell_of((by + reach) * inverse), rows - 1)
    ix0 = min(ix0, cols - 1) if cols == MOST_CELLS else ix0  # the last one holds what lies beyond
    iy0 = min(iy0, rows - 1) if rows == MOST_CELLS else iy0
    if ix0 > ix1:
        return found, best
    for iy in range(iy0, iy1 + 1):
        for k in range(starts[iy * cols + ix0], starts[iy * cols + ix1 + 1]):
            dx, dy, dq = ordered[k, 0] - x, ordered[k, 1] - y, ordered[k, 2] - q
            d = dx * dx + dy * dy + alpha * dq * dq
            if d < best or (d == best and found < 0):
                best, found = d, k
    return found, best


@kernel
def intensity_icp(
    reference: np.ndarray,
    scan: np.ndarray,
    start: np.ndarray,
    rules: IcpRules,
) -> tuple[np.ndarray, int, int, float, np.ndarray]:
    """(pose (3,), pairs, iterations, mean squared distance, pair of each scan point or -1).

    reference: (m, 3) x, y, q in the map; scan: (n, 3) in the robot frame. Pairs under `least_pairs`: it failed, and
    `pose` is where it stood. The pairs name rows of `sort_into_cells(reference, cell)`.
    """
    alpha, gate, least_gate, decay, iterations, tolerance, least_pairs, cell = rules
    pose = start.copy()
    n = scan.shape[0]
    pairs = np.full(n, -1, np.int64)
    if reference.shape[0] == 0:
        return pose, 0, 0, 0.0, pairs
    ordered, starts, corner, cols = sort_into_cells(reference, cell)
    count, mean2, done = 0, 0.0, 0
    for r in range(iterations):
        limit = max(least_gate, gate * decay**r)
        limit *= limit
        c, s = math.cos(pose[2]), math.sin(pose[2])
        count = 0
        mx = my = zx = zy = dot = cross = 0.0
        before = -1
        for i in range(n):
            px, py = scan[i, 0], scan[i, 1]
            k, _ = nearest(
                ordered,
                starts,
                corner,
                cols,
                cell,
                (pose[0] + c * px - s * py, pose[1] + s * px + c * py, scan[i, 2]),
                alpha,
                limit,
                pairs[i] if pairs[i] >= 0 else before,
            )
            pairs[i] = k
            if k < 0:
                continue
            before = k
            qx, qy = ordered[k, 0], ordered[k, 1]
            count += 1
            mx += qx
            my += qy
            zx += px
            zy += py
            dot += px * qx + py * qy
            cross += px * qy - py * qx
        done = r + 1
        if count < least_pairs:
            return pose, count, done, 0.0, pairs
        theta = math.atan2(cross - (zx * my - zy * mx) / count, dot - (zx * mx + zy * my) / count)
        c, s = math.cos(theta), math.sin(theta)
        x, y = (mx - c * zx + s * zy) / count, (my - s * zx - c * zy) / count
        turn = theta - pose[2]
        turn -= 2.0 * math.pi * np.floor((turn + math.pi) / (2.0 * math.pi))
        moved = max(abs(x - pose[0]), abs(y - pose[1]), abs(turn))
        pose[0], pose[1], pose[2] = x, y, theta
        if moved < tolerance and limit <= least_gate * least_gate * 1.0000001:
            break
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(n):
        if pairs[i] >= 0:
            dx = pose[0] + c * scan[i, 0] - s * scan[i, 1] - ordered[pairs[i], 0]
            dy = pose[1] + s * scan[i, 0] + c * scan[i, 1] - ordered[pairs[i], 1]
            mean2 += dx * dx + dy * dy
    return pose, count, done, mean2 / count, pairs
