"""A few Gauss-Newton steps of many particles, each against its own map, by the scan's own lines."""

import math

import numpy as np

from .._jit import parallel_kernel, prange
from .local_map import solve3
from .tiles import CELLS, cell_index, nearest_in_map


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
) -> np.ndarray:
    """Poses (P, 3) after `iterations` steps from `poses`.

    Minimises `information / n sum(rho(e_n) + tangent rho(e_t)) + delta^T prior delta` over the nearest cells under D
    (3x3, at most `cap` [m^2]): e_n, e_t [m] along the beam's own line normal and tangent, rho Geman-McClure of width
    kappa [m], delta the deviation from where the particle started, in its own frame; prior: (3, 3).
    """
    n = points.shape[0]
    per_metre = np.float32(1.0 / cell)
    ox, oy = np.float32(origin[0]), np.float32(origin[1])
    cx, cy = width * CELLS, table.shape[1] // width * CELLS
    a, most = np.float32(alpha), np.float32(cap)
    per_beam = information / max(n, 1)
    k2 = kappa * kappa
    out = np.empty_like(poses)
    for p in prange(poses.shape[0]):
        row = table[rows[p]]
        tx, ty, th = poses[p, 0], poses[p, 1], poses[p, 2]
        c0, s0 = math.cos(th), math.sin(th)
        for _ in range(iterations):
            c, s = math.cos(th), math.sin(th)
            h00 = h01 = h02 = h11 = h12 = h22 = 0.0
            g0 = g1 = g2 = 0.0
            for i in range(n):
                rx = c * points[i, 0] - s * points[i, 1]
                ry = s * points[i, 0] + c * points[i, 1]
                wx, wy, q = np.float32(tx + rx), np.float32(ty + ry), points[i, 2]
                ix, iy = cell_index(wx, ox, per_metre, cx), cell_index(wy, oy, per_metre, cy)
                _, k = nearest_in_map(pool, row, width, ix, iy, wx, wy, q, a, most)
                if k < 0:
                    continue
                dx_, dy_ = np.float64(wx - pool[k]), np.float64(wy - pool[k + 1])
                mx = c * normals[i, 0] - s * normals[i, 1]
                my = s * normals[i, 0] + c * normals[i, 1]
                e = mx * dx_ + my * dy_
                robust = k2 / (k2 + e * e)
                w = per_beam * robust * robust
                j2 = my * rx - mx * ry
                f = -my * dx_ + mx * dy_
                robust = k2 / (k2 + f * f)
                v = per_beam * tangent * robust * robust
                i2 = mx * rx + my * ry
                h00 += w * mx * mx + v * my * my
                h01 += w * mx * my - v * my * mx
                h02 += w * mx * j2 - v * my * i2
                h11 += w * my * my + v * mx * mx
                h12 += w * my * j2 + v * mx * i2
                h22 += w * j2 * j2 + v * i2 * i2
                g0 += w * mx * e - v * my * f
                g1 += w * my * e + v * mx * f
                g2 += w * j2 * e + v * i2 * f
            # the prior, turned into the map frame: R H R^T and R H R^T (x - x0)
            p00 = c0 * c0 * prior[0, 0] - 2 * c0 * s0 * prior[0, 1] + s0 * s0 * prior[1, 1]
            p01 = c0 * s0 * (prior[0, 0] - prior[1, 1]) + (c0 * c0 - s0 * s0) * prior[0, 1]
            p11 = s0 * s0 * prior[0, 0] + 2 * c0 * s0 * prior[0, 1] + c0 * c0 * prior[1, 1]
            p02 = c0 * prior[0, 2] - s0 * prior[1, 2]
            p12 = s0 * prior[0, 2] + c0 * prior[1, 2]
            ux, uy, ut = tx - poses[p, 0], ty - poses[p, 1], th - poses[p, 2]
            g0 += p00 * ux + p01 * uy + p02 * ut
            g1 += p01 * ux + p11 * uy + p12 * ut
            g2 += p02 * ux + p12 * uy + prior[2, 2] * ut
            d0, d1, d2 = solve3(h00 + p00, h01 + p01, h02 + p02, h11 + p11, h12 + p12, h22 + prior[2, 2], g0, g1, g2)
            tx -= d0
            ty -= d1
            th -= d2
        out[p, 0], out[p, 1], out[p, 2] = tx, ty, th
    return out
