"""The lines through a submap's points, and a scan laid onto them."""

import math

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from .icp import column_of, sort_into_cells
from .local_map import solve3


@kernel
def fit_normals(points: np.ndarray, reach: float) -> np.ndarray:
    """(n, 3) for points (n, 2) [m]: unit normal of the line through all within `reach`, and how wide that line is.

    The width is the ratio of scatter across to scatter along, 0 for a wall, 1 for a blob or a point alone.
    """
    n = points.shape[0]
    out = np.zeros((n, 3))
    if n == 0:
        return out
    numbered = np.empty((n, 3))
    for i in range(n):
        numbered[i, 0], numbered[i, 1], numbered[i, 2] = points[i, 0], points[i, 1], i
    ordered, starts, corner, cols = sort_into_cells(numbered, reach)
    rows = (starts.shape[0] - 1) // cols
    for j in range(n):
        x, y, i = ordered[j, 0], ordered[j, 1], int(ordered[j, 2])
        cx, cy = column_of(x - corner[0], reach, cols), column_of(y - corner[1], reach, rows)
        m, sx, sy, xx, xy, yy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for r in range(max(cy - 1, 0), min(cy + 2, rows)):
            for k in range(starts[r * cols + max(cx - 1, 0)], starts[r * cols + min(cx + 1, cols - 1) + 1]):
                dx, dy = ordered[k, 0] - x, ordered[k, 1] - y
                if dx * dx + dy * dy <= reach * reach:
                    m += 1
                    sx += dx
                    sy += dy
                    xx += dx * dx
                    xy += dx * dy
                    yy += dy * dy
        if m == 0:  # what is no number has nothing within reach, not even itself
            out[i, 1], out[i, 2] = 1.0, 1.0
            continue
        xx, xy, yy = xx - sx * sx / m, xy - sx * sy / m, yy - sy * sy / m
        half, gap = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
        along = 0.5 * math.atan2(2.0 * xy, xx - yy)
        out[i, 0], out[i, 1] = -math.sin(along), math.cos(along)
        out[i, 2] = max(half - gap, 0.0) / (half + gap) if m > 2 and half + gap > 0.0 else 1.0
    return out


@kernel
def lay_onto_lines(
    points: np.ndarray,
    start: np.ndarray,
    walls: np.ndarray,
    lines: np.ndarray,
    nearest: np.ndarray,
    origin: np.ndarray,
    cell: float,
    gate: float,
    widths: np.ndarray,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray, int, float]:
    """(pose (3,), H (3, 3), matches, mean squared distance [m^2]) of a scan laid onto the lines of a submap.

    Gauss-Newton on Geman-McClure costs of the distance to the nearest wall point's line, and, as far as that line is
    wide, of the distance along it; `widths` (k,) [m]: of the cost, one an iteration, the last of them until the step is
    under `tolerance`. H: sum of weighted squared Jacobians [unit variance], by a step in the scan's own frame.
    Matches lie within `gate` [m] of their point. walls: (m, 2); lines: (m, 3) of `fit_normals`; nearest: of `stamp`.
    """
    rows, cols = nearest.shape
    pose = start.copy()
    H = np.zeros((3, 3))
    count, squares = 0, 0.0
    last = widths.shape[0] + 20
    for step in range(last + 1):
        width = widths[min(step, widths.shape[0] - 1)]
        k2 = width * width
        c, s = math.cos(pose[2]), math.sin(pose[2])
        g = np.zeros(3)
        H[:] = 0.0
        count, squares = 0, 0.0
        for i in range(points.shape[0]):
            px, py = points[i, 0], points[i, 1]
            x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
            col, row = cell_of((x - origin[0]) / cell), cell_of((y - origin[1]) / cell)
            if not (0 <= row < rows and 0 <= col < cols):
                continue
            k = nearest[row, col]
            if k < 0:
                continue
            dx, dy = x - walls[k, 0], y - walls[k, 1]
            if dx * dx + dy * dy > gate * gate:
                continue
            nx, ny, wide = lines[k, 0], lines[k, 1], lines[k, 2]
            count += 1
            e, f = nx * dx + ny * dy, ny * dx - nx * dy
            squares += e * e + wide * f * f
            for axis in range(2):  # across the line, then along it
                ax, ay, d = (nx, ny, e) if axis == 0 else (ny, -nx, f)
                w = (k2 / (k2 + d * d)) ** 2 * (1.0 if axis == 0 else wide)
                jx, jy = c * ax + s * ay, c * ay - s * ax
                jt = jy * px - jx * py
                g[0] += w * jx * d
                g[1] += w * jy * d
                g[2] += w * jt * d
                H[0, 0] += w * jx * jx
                H[0, 1] += w * jx * jy
                H[0, 2] += w * jx * jt
                H[1, 1] += w * jy * jy
                H[1, 2] += w * jy * jt
                H[2, 2] += w * jt * jt
        if step == last:
            break
        ridge = 1e-3 * (H[0, 0] + H[1, 1]) + 1e-9
        u, v, t = solve3(H[0, 0] + ridge, H[0, 1], H[0, 2], H[1, 1] + ridge, H[1, 2], H[2, 2] + ridge, g[0], g[1], g[2])
        pose[0] -= c * u - s * v
        pose[1] -= s * u + c * v
        pose[2] -= t
        if step >= widths.shape[0] and max(abs(u), abs(v), abs(t)) < tolerance:
            last = step + 1  # H and counts once more, where the scan has come to lie
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    return pose, H, count, squares / max(count, 1)
