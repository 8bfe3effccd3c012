"""A few Gauss-Newton steps of many particles, each against its own map, by the scan's own lines."""

import math

import numpy as np

from .._jit import parallel_kernel, prange
from .local_map import solve3
from .tiles import CELLS, nearest_in_map, world_points


@parallel_kernel
def refine(  # noqa: PLR0915  (one loop over the beams)
    pool: np.ndarray,
    table: np.ndarray,
    width: int,
    origin: np.ndarray,
    cell: float,
    rows: np.ndarray,
    poses: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    alpha: float,
    cap: float,
    information: float,
    tangent: float,
    kappa: float,
    prior: np.ndarray,
    iterations: int,
    least: np.ndarray,
) -> np.ndarray:
    """Poses (P, 3) after `iterations` steps from `poses`; least: (P, n) float32, what `tiles.score` says of them then.

    Minimises `information / n sum(rho(e_n) + tangent rho(e_t)) + delta^T prior delta` over the nearest cells under D
    (3x3, at most `cap` [m^2]): e_n, e_t [m] along the beam's own line normal and tangent, rho Geman-McClure of width
    kappa [m], delta the deviation from where the particle started, in its own frame; prior: (3, 3). Each step is worked
    out in the particle's frame, where a beam's normal and lever arms are the same for all particles. The D are worked
    out while the particle's tiles are at hand; none are where `least` has no rows.
    """
    n = points.shape[0]
    per_metre = np.float32(1.0 / cell)
    corner = np.float32(origin[0]), np.float32(origin[1])
    cells = width * CELLS, table.shape[1] // width * CELLS
    a, most, across = np.float32(alpha), np.float32(cap), np.float32((0.499 * cell) ** 2)
    per_beam = information / max(n, 1)
    k2 = kappa * kappa
    own = np.empty((n, 6))  # x, y, normal, lever arms of the errors along normal and tangent
    for i in range(n):
        own[i, 0], own[i, 1] = np.float64(points[i, 0]), np.float64(points[i, 1])
        own[i, 2], own[i, 3] = normals[i, 0], normals[i, 1]
        own[i, 4] = own[i, 3] * own[i, 0] - own[i, 2] * own[i, 1]
        own[i, 5] = own[i, 2] * own[i, 0] + own[i, 3] * own[i, 1]
    out = np.empty_like(poses)
    for p in prange(poses.shape[0]):
        row = table[rows[p]]
        tx, ty, th = poses[p, 0], poses[p, 1], poses[p, 2]
        for _ in range(iterations):
            c, s = math.cos(th), math.sin(th)
            h00 = h01 = h02 = h11 = h12 = h22 = 0.0
            g0 = g1 = g2 = 0.0
            for i in range(n):
                rx, ry, mx, my, j2, i2 = own[i, 0], own[i, 1], own[i, 2], own[i, 3], own[i, 4], own[i, 5]
                wx, wy = np.float32(tx + (c * rx - s * ry)), np.float32(ty + (s * rx + c * ry))
                _, at = nearest_in_map(
                    pool, row, width, cells, corner, per_metre, wx, wy, points[i, 2], a, most, across
                )
                if at < 0:
                    continue
                dx, dy = np.float64(wx - pool[np.uint64(at)]), np.float64(wy - pool[np.uint64(at) + np.uint64(1)])
                bx, by = c * dx + s * dy, c * dy - s * dx
                e, f = mx * bx + my * by, mx * by - my * bx
                robust = k2 / (k2 + e * e)
                w = per_beam * robust * robust
                robust = k2 / (k2 + f * f)
                v = per_beam * tangent * robust * robust
                wx_, wy_, vx_, vy_ = w * mx, w * my, v * mx, v * my
                h00 += wx_ * mx + vy_ * my
                h01 += wx_ * my - vy_ * mx
                h02 += wx_ * j2 - vy_ * i2
                h11 += wy_ * my + vx_ * mx
                h12 += wy_ * j2 + vx_ * i2
                h22 += w * j2 * j2 + v * i2 * i2
                g0 += wx_ * e - vy_ * f
                g1 += wy_ * e + vx_ * f
                g2 += w * j2 * e + v * i2 * f
            # the prior, turned from where the particle started into its frame now
            ux, uy, turn = tx - poses[p, 0], ty - poses[p, 1], th - poses[p, 2]
            ux, uy = c * ux + s * uy, c * uy - s * ux
            ct, st = math.cos(turn), math.sin(turn)
            p00 = ct * ct * prior[0, 0] + 2 * ct * st * prior[0, 1] + st * st * prior[1, 1]
            p01 = ct * st * (prior[1, 1] - prior[0, 0]) + (ct * ct - st * st) * prior[0, 1]
            p11 = st * st * prior[0, 0] - 2 * ct * st * prior[0, 1] + ct * ct * prior[1, 1]
            p02 = ct * prior[0, 2] + st * prior[1, 2]
            p12 = ct * prior[1, 2] - st * prior[0, 2]
            g0 += p00 * ux + p01 * uy + p02 * turn
            g1 += p01 * ux + p11 * uy + p12 * turn
            g2 += p02 * ux + p12 * uy + prior[2, 2] * turn
            d0, d1, d2 = solve3(h00 + p00, h01 + p01, h02 + p02, h11 + p11, h12 + p12, h22 + prior[2, 2], g0, g1, g2)
            tx -= c * d0 - s * d1
            ty -= s * d0 + c * d1
            th -= d2
        out[p, 0], out[p, 1], out[p, 2] = tx, ty, th
        if least.shape[0]:
            x, y = np.empty(n, np.float32), np.empty(n, np.float32)
            world_points(out[p], points, x, y)
            for i in range(n):
                least[p, i], _ = nearest_in_map(
                    pool, row, width, cells, corner, per_metre, x[i], y[i], points[i, 2], a, most, across
                )
    return out
