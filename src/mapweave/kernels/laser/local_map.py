"""A moving map of the last keyframes on a grid that wraps around, and scan matching against it.

`sums` is float32 (size, size, 9), size a power of two: number of points, their summed offset from the cell's lower
left corner [m] (x, y), their summed offset products (xx, xy, yy), summed beam normals (x, y) and summed feature.
`lines` is float32 (size, size, 6), what matching reads: the cell's mean offset (x, y), the normal of the line through
the 3x3 cells around it (x, y; zero where there is none), mean feature, and how line-like it is (0 to 1). An empty cell
is all zeros in both, so that a map begins as zeros of which no memory is touched before something is seen there.
Cell (ix, iy) of the plane lives at (iy mod size, ix mod size); the map must be smaller than the whole grid.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of


class ScanPoints(NamedTuple):
    """n returns of a scan: s (n, 2) [m] and normal (n, 2) in the robot frame, q (n,) feature.

    apart: (n,) [m] to the nearer of the returns beside each.
    """

    s: np.ndarray
    normal: np.ndarray
    q: np.ndarray
    apart: np.ndarray


class MatchCost(NamedTuple):
    """What a match minimises; see `align_scan`.

    alpha: [m^2] of a squared difference of q; agree: cosine up to which normals are of one wall; information: [1/m^2]
    of all returns together; tangent: the share of errors along a line; kappa: [m] width of the robust kernel; past: [m]
    along a line from its nearest cell, up to which a return may be of it.
    """

    alpha: float
    agree: float
    information: float
    tangent: float
    kappa: float
    past: float


@kernel
def add_points(
    sums: np.ndarray, cell: float, points: np.ndarray, normals: np.ndarray, q: np.ndarray, sign: float
) -> None:
    """Points (n, 2) [m] with unit normals (n, 2) and features (n,) put in (`sign` 1) or taken out again (-1)."""
    mask = sums.shape[0] - 1
    for i in range(points.shape[0]):
        fx, fy = cell_of(points[i, 0] / cell), cell_of(points[i, 1] / cell)
        ix, iy = fx & mask, fy & mask
        if sums[iy, ix, 0] + sign < 0.5:
            for k in range(9):
                sums[iy, ix, k] = 0.0
            continue
        ox, oy = points[i, 0] - fx * cell, points[i, 1] - fy * cell
        sums[iy, ix, 0] += sign
        sums[iy, ix, 1] += sign * ox
        sums[iy, ix, 2] += sign * oy
        sums[iy, ix, 3] += sign * ox * ox
        sums[iy, ix, 4] += sign * ox * oy
        sums[iy, ix, 5] += sign * oy * oy
        sums[iy, ix, 6] += sign * normals[i, 0]
        sums[iy, ix, 7] += sign * normals[i, 1]
        sums[iy, ix, 8] += sign * q[i]


@kernel
def fit_lines(sums: np.ndarray, lines: np.ndarray, cell: float, points: np.ndarray) -> None:
    """`lines` follows `sums` in every cell that `points` (n, 2) [m], put in or taken out, had a part in."""
    mask = sums.shape[0] - 1
    done_x, done_y = -(2**41), -(2**41)
    for i in range(points.shape[0]):
        jx, jy = cell_of(points[i, 0] / cell), cell_of(points[i, 1] / cell)
        if jx == done_x and jy == done_y:
            continue
        done_x, done_y = jx, jy
        for a in range(-1, 2):
            for b in range(-1, 2):
                fit_line(sums, lines, cell, (jx + b) & mask, (jy + a) & mask)


@kernel
def fit_line(sums: np.ndarray, lines: np.ndarray, cell: float, ix: int, iy: int) -> None:
    mask = sums.shape[0] - 1
    n = sums[iy, ix, 0]
    if n < 0.5:
        for column in range(6):
            lines[iy, ix, column] = 0.0
        return
    m = sx = sy = sxx = sxy = syy = tx = ty = 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            c = sums[(iy + a) & mask, (ix + b) & mask]
            k = np.float64(c[0])
            if k < 0.5 or c[6] * sums[iy, ix, 6] + c[7] * sums[iy, ix, 7] < 0.0:
                continue
            dx, dy = b * cell, a * cell
            m += k
            sx += c[1] + k * dx
            sy += c[2] + k * dy
            sxx += c[3] + 2.0 * dx * c[1] + k * dx * dx
            sxy += c[4] + dx * c[2] + dy * c[1] + k * dx * dy
            syy += c[5] + 2.0 * dy * c[2] + k * dy * dy
            tx += c[6]
            ty += c[7]
    lines[iy, ix, 0], lines[iy, ix, 1] = sums[iy, ix, 1] / n, sums[iy, ix, 2] / n
    lines[iy, ix, 4] = sums[iy, ix, 8] / n
    cxx, cxy, cyy = sxx - sx * sx / m, sxy - sx * sy / m, syy - sy * sy / m
    spread = cxx + cyy
    length = math.sqrt(tx * tx + ty * ty)
    if m < 2.5 or spread < 1e-6 * m or length < 1e-6:
        lines[iy, ix, 2], lines[iy, ix, 3], lines[iy, ix, 5] = 0.0, 0.0, 0.0
        return
    along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
    nx, ny = -math.sin(along), math.cos(along)
    if nx * tx + ny * ty < 0.0:
        nx, ny = -nx, -ny
    difference = math.sqrt((cxx - cyy) ** 2 + 4.0 * cxy * cxy)
    lines[iy, ix, 2], lines[iy, ix, 3], lines[iy, ix, 5] = nx, ny, difference / spread


@kernel
def nearest_cell(
    lines: np.ndarray,
    cell: float,
    wx: float,
    wy: float,
    nx: float,
    ny: float,
    q: float,
    alpha: float,
    agree: float,
    past: float,
) -> tuple[float, float, float, float, float, float]:
    """Of the 3x3 cells around (wx, wy) the one of least D whose normal agrees: (D, dx, dy, normal x, y, line-like).

    dx, dy: the point seen from the cell's mean [m]; agree: above 0, so that a cell without a line never does. D is
    infinite when none agrees, and when the point lies farther than `past` [m] along the line from the nearest that
    does: where a wall has not been seen yet, what stands there need not be of it.
    """
    mask = lines.shape[0] - 1
    jx, jy = cell_of(wx / cell), cell_of(wy / cell)
    ox, oy = wx - jx * cell, wy - jy * cell
    best = nearest = math.inf
    along = 0.0
    bx = by = bnx = bny = bw = 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            iy, ix = (jy + a) & mask, (jx + b) & mask
            if lines[iy, ix, 2] * nx + lines[iy, ix, 3] * ny < agree:  # as in most cells, which are empty
                continue
            dx = ox - b * cell - lines[iy, ix, 0]
            dy = oy - a * cell - lines[iy, ix, 1]
            dq = q - lines[iy, ix, 4]
            away = dx * dx + dy * dy
            d = away + alpha * dq * dq
            if d >= 1e6:
                continue
            if away < nearest:
                nearest, along = away, abs(lines[iy, ix, 3] * dx - lines[iy, ix, 2] * dy)
            if d < best:
                best, bx, by, bnx, bny, bw = d, dx, dy, lines[iy, ix, 2], lines[iy, ix, 3], lines[iy, ix, 5]
    if along > past:
        best = math.inf
    return best, bx, by, bnx, bny, bw


@kernel
def count_matches(
    lines: np.ndarray,
    cell: float,
    s: np.ndarray,
    normal: np.ndarray,
    q: np.ndarray,
    alpha: float,
    agree: float,
    pose: np.ndarray,
    reach: float,
) -> int:
    """How many points of the scan lie within `reach` [m] of the line through their nearest cell."""
    c, si = math.cos(pose[2]), math.sin(pose[2])
    matched = 0
    for i in range(s.shape[0]):
        wx = pose[0] + c * s[i, 0] - si * s[i, 1]
        wy = pose[1] + si * s[i, 0] + c * s[i, 1]
        nx = c * normal[i, 0] - si * normal[i, 1]
        ny = si * normal[i, 0] + c * normal[i, 1]
        d, dx, dy, mx, my, _ = nearest_cell(lines, cell, wx, wy, nx, ny, q[i], alpha, agree, math.inf)
        if d < math.inf and abs(mx * dx + my * dy) < reach:
            matched += 1
    return matched


@kernel
def align_scan(  # noqa: PLR0915  (one loop over the beams)
    lines: np.ndarray,
    cell: float,
    scan: ScanPoints,
    cost_of: MatchCost,
    start: np.ndarray,
    predicted: np.ndarray,
    sd: np.ndarray,
    iterations: int,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Gauss-Newton from `start`: pose (3,), its information matrix (3, 3) over robot-frame x, y, theta, and the cost.

    Minimises `information / m sum(rho(e_n) + tangent e_t^2) + sum((delta / sd)^2)`: e_n and e_t along the normal and
    the tangent of the cell's line, rho Geman-McClure of width `kappa` [m], delta the deviation from `predicted` in
    its own frame, m the points of the scan.
    """
    s, normal, q, apart = scan
    alpha, agree, information, tangent, kappa, past = cost_of
    pose = start.copy()
    n = s.shape[0]
    H = np.zeros((3, 3))
    cost = 0.0
    per_beam = information / max(n, 1)
    k2 = kappa * kappa
    for _ in range(iterations):
        c, si = math.cos(pose[2]), math.sin(pose[2])
        h00 = h01 = h02 = h11 = h12 = h22 = 0.0
        g0 = g1 = g2 = 0.0
        cost = 0.0
        for i in range(n):
            rx = c * s[i, 0] - si * s[i, 1]
            ry = si * s[i, 0] + c * s[i, 1]
            nx = c * normal[i, 0] - si * normal[i, 1]
            ny = si * normal[i, 0] + c * normal[i, 1]
            d, dx, dy, mx, my, like = nearest_cell(
                lines, cell, pose[0] + rx, pose[1] + ry, nx, ny, q[i], alpha, agree, max(past, apart[i])
            )
            if not d < math.inf:
                cost += per_beam * k2
                continue
            e = mx * dx + my * dy
            robust = k2 / (k2 + e * e)
            w = per_beam * robust * robust * like
            cost += per_beam * e * e * robust
            j2 = my * rx - mx * ry
            h00 += w * mx * mx
            h01 += w * mx * my
            h02 += w * mx * j2
            h11 += w * my * my
            h12 += w * my * j2
            h22 += w * j2 * j2
            g0 += w * mx * e
            g1 += w * my * e
            g2 += w * j2 * e
            if tangent > 0.0:
                e = my * dx - mx * dy
                robust = k2 / (k2 + e * e)
                w = per_beam * tangent * like * robust * robust
                j2 = -mx * rx - my * ry
                h00 += w * my * my
                h01 -= w * my * mx
                h02 += w * my * j2
                h11 += w * mx * mx
                h12 -= w * mx * j2
                h22 += w * j2 * j2
                g0 += w * my * e
                g1 -= w * mx * e
                g2 += w * j2 * e
        cp, sp = math.cos(predicted[2]), math.sin(predicted[2])
        ex, ey = pose[0] - predicted[0], pose[1] - predicted[1]
        lx, ly = cp * ex + sp * ey, -sp * ex + cp * ey
        turn = pose[2] - predicted[2]
        turn -= 2.0 * math.pi * np.floor((turn + math.pi) / (2.0 * math.pi))
        wx, wy, wt = 1.0 / sd[0] ** 2, 1.0 / sd[1] ** 2, 1.0 / sd[2] ** 2
        h00 += cp * cp * wx + sp * sp * wy
        h01 += cp * sp * (wx - wy)
        h11 += sp * sp * wx + cp * cp * wy
        h22 += wt
        g0 += cp * wx * lx - sp * wy * ly
        g1 += sp * wx * lx + cp * wy * ly
        g2 += wt * turn
        cost += wx * lx * lx + wy * ly * ly + wt * turn * turn
        H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2] = h00, h01, h02, h11, h12, h22
        d0, d1, d2 = solve3(h00, h01, h02, h11, h12, h22, g0, g1, g2)
        pose[0] -= d0
        pose[1] -= d1
        pose[2] -= d2
        if d0 * d0 + d1 * d1 < 1e-10 and abs(d2) < 1e-5:
            break
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    c, si = math.cos(pose[2]), math.sin(pose[2])
    R = np.array([[c, -si, 0.0], [si, c, 0.0], [0.0, 0.0, 1.0]])
    return pose, rotate_information(H, R), cost


@kernel
def rotate_information(H: np.ndarray, R: np.ndarray) -> np.ndarray:
    """`R^T H R` for 3x3 matrices."""
    out = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += R[k, i] * H[k, m] * R[m, j]
            out[i, j] = total
    return out


@kernel
def solve3(
    h00: float, h01: float, h02: float, h11: float, h12: float, h22: float, g0: float, g1: float, g2: float
) -> tuple[float, float, float]:
    """`H^-1 g` of a symmetric positive definite 3x3 by Cholesky; zero when it is not positive definite."""
    if h00 <= 0.0:
        return 0.0, 0.0, 0.0
    a = math.sqrt(h00)
    b, c = h01 / a, h02 / a
    dd = h11 - b * b
    if dd <= 0.0:
        return 0.0, 0.0, 0.0
    d = math.sqrt(dd)
    e = (h12 - b * c) / d
    ff = h22 - c * c - e * e
    if ff <= 0.0:
        return 0.0, 0.0, 0.0
    y0 = g0 / a
    y1 = (g1 - b * y0) / d
    y2 = (g2 - c * y0 - e * y1) / ff
    x1 = (y1 - e * y2) / d
    return (y0 - b * x1 - c * y2) / a, x1, y2
