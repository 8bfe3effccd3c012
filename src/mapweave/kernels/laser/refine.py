"""A few Gauss-Newton steps of many particles, each against its own map, by the scan's own lines; who lives on."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import inlined_kernel, kernel, parallel_kernel, prange
from .local_map import solve3
from .tiles import (
    BEAMS,
    CHUNKS,
    BlockMemory,
    MapCells,
    NearestRule,
    TileMaps,
    blocks_of,
    cells_of,
    frame_of,
    nearest,
    read_windows,
    scored,
)

OWN = 6 * BEAMS  # what a block of beams has in the particle's frame: x, y, normal, lever arms along normal and tangent
TERMS = 9 * BEAMS  # what a block of beams adds to the normal equations: h00 h01 h02 h11 h12 h22 g0 g1 g2
Sums = tuple[float, float, float, float, float, float, float, float, float]


class ScanCost(NamedTuple):
    """What a scan that lies beside its map costs: `information` [1/m^2] of all beams together, the share of it that
    counts along a line, `tangent`, and the width of the robust cost, `kappa` [m].
    """

    information: float
    tangent: float
    kappa: float


@kernel
def own_of(points: np.ndarray, normals: np.ndarray, size: int) -> np.ndarray:
    """`OWN` of every block of beams: in the particle's frame they are the same for all particles; zeros fill up."""
    own = np.zeros(6 * size)
    for i in range(points.shape[0]):
        at = i // BEAMS * OWN + i % BEAMS
        x, y, mx, my = np.float64(points[i, 0]), np.float64(points[i, 1]), normals[i, 0], normals[i, 1]
        own[at], own[at + BEAMS], own[at + 2 * BEAMS], own[at + 3 * BEAMS] = x, y, mx, my
        own[at + 4 * BEAMS] = my * x - mx * y
        own[at + 5 * BEAMS] = mx * x + my * y
    return own


@inlined_kernel
def carried_steps(
    own: np.ndarray, of: int, tx: float, ty: float, c: float, s: float, x: np.ndarray, y: np.ndarray, at: int
) -> None:
    """A block of beams at the pose (tx, ty) turned by (c, s), rounded once."""
    for i in range(BEAMS):
        rx, ry = own[np.uint64(of + i)], own[np.uint64(of + BEAMS + i)]
        x[np.uint64(at + i)] = np.float32(tx + (c * rx - s * ry))
        y[np.uint64(at + i)] = np.float32(ty + (s * rx + c * ry))


@inlined_kernel
def added(terms: np.ndarray, of: int, count: int, sums: Sums) -> Sums:
    """`sums` and the terms of the first `count` beams of a block, one beam after the other."""
    h00, h01, h02, h11, h12, h22, g0, g1, g2 = sums
    for i in range(count):
        h00 += terms[np.uint64(of + i)]
        h01 += terms[np.uint64(of + BEAMS + i)]
        h02 += terms[np.uint64(of + 2 * BEAMS + i)]
        h11 += terms[np.uint64(of + 3 * BEAMS + i)]
        h12 += terms[np.uint64(of + 4 * BEAMS + i)]
        h22 += terms[np.uint64(of + 5 * BEAMS + i)]
        g0 += terms[np.uint64(of + 6 * BEAMS + i)]
        g1 += terms[np.uint64(of + 7 * BEAMS + i)]
        g2 += terms[np.uint64(of + 8 * BEAMS + i)]
    return h00, h01, h02, h11, h12, h22, g0, g1, g2


@kernel
def stepped(
    tx: float, ty: float, th: float, x0: float, y0: float, th0: float, c: float, s: float, prior: np.ndarray, sums: Sums
) -> tuple[float, float, float]:
    """The pose after one step; (x0, y0, th0): where the particle started, in whose frame `prior` (3, 3) holds it."""
    h00, h01, h02, h11, h12, h22, g0, g1, g2 = sums
    ux, uy, turn = tx - x0, ty - y0, th - th0
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
    return tx - (c * d0 - s * d1), ty - (s * d0 + c * d1), th - d2


@parallel_kernel
def refine(  # noqa: PLR0915  (what a beam adds is said here, where the compiler sees that no arrays overlap)
    grid: TileMaps,
    rows: np.ndarray,
    poses: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    rule: NearestRule,
    cost: ScanCost,
    prior: np.ndarray,
    iterations: int,
    least: np.ndarray,
) -> np.ndarray:
    """Poses (P, 3) after `iterations` steps from `poses`; least: (P, n) float32, what `windows.score` says of them.

    Minimises `information / n sum(rho(e_n) + tangent rho(e_t)) + delta^T prior delta` over the nearest cells under D
    (3x3, at most `cap` [m^2]): e_n, e_t [m] along the beam's own line normal and tangent, rho Geman-McClure of width
    kappa [m], delta the deviation from where the particle started, in its own frame; prior: (3, 3). Each step is worked
    out in the particle's frame, where a beam's normal and lever arms are the same for all particles. No `least` are
    worked out where it has no rows.
    """
    n, particles = points.shape[0], poses.shape[0]
    pool, table, width, frame = grid.pool, grid.table, grid.width, frame_of(grid)
    alpha, cap = np.float32(rule.alpha), np.float32(rule.cap)
    per_beam, tangent, k2 = cost.information / max(n, 1), cost.tangent, cost.kappa * cost.kappa
    plain = blocks_of(points)
    size = plain.shape[0] // 2
    own = own_of(points, normals, size)
    out = np.empty_like(poses)
    chunks = min(particles, CHUNKS)
    windows, held = np.zeros(chunks * 27 * size, np.float32), np.empty(chunks * size, np.int64)
    x, y = np.empty(chunks * BEAMS, np.float32), np.empty(chunks * BEAMS, np.float32)
    ex, ey = np.empty(chunks * BEAMS, np.float32), np.empty(chunks * BEAMS, np.float32)
    d = np.empty(chunks * BEAMS, np.float32)
    cells, moved = np.empty(chunks * BEAMS, np.int64), np.empty(chunks * BEAMS, np.int32)
    terms = np.empty(chunks * TERMS)
    for chunk in prange(chunks):
        at, of, to = chunk * BEAMS, chunk * size, chunk * TERMS
        maps = MapCells(pool, table, width, frame, alpha, cap)
        memory = BlockMemory(x, y, cells, moved, ex, ey, d, held, windows, at, of)
        for p in range(chunk * particles // chunks, (chunk + 1) * particles // chunks):
            row = np.uint64(rows[p])
            tx, ty, th = poses[p, 0], poses[p, 1], poses[p, 2]
            for i in range(size):
                held[np.uint64(of + i)] = -1
            for _ in range(iterations):
                c, s = math.cos(th), math.sin(th)
                h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = 0.0
                for first in range(0, n, BEAMS):
                    count, own_at = min(BEAMS, n - first), first * 6
                    carried_steps(own, own_at, tx, ty, c, s, x, y, at)
                    cells_of(x, y, at, frame, cells)
                    read_windows(maps, row, points, first, count, memory)
                    nearest(memory, first, cap)
                    for i in range(BEAMS):
                        mx, my = own[np.uint64(own_at + 2 * BEAMS + i)], own[np.uint64(own_at + 3 * BEAMS + i)]
                        j2, i2 = own[np.uint64(own_at + 4 * BEAMS + i)], own[np.uint64(own_at + 5 * BEAMS + i)]
                        dx, dy = -np.float64(ex[np.uint64(at + i)]), -np.float64(ey[np.uint64(at + i)])
                        bx, by = c * dx + s * dy, c * dy - s * dx
                        e, f = mx * bx + my * by, mx * by - my * bx
                        robust = k2 / (k2 + e * e)
                        w = per_beam * robust * robust
                        robust = k2 / (k2 + f * f)
                        v = per_beam * tangent * robust * robust
                        hit = d[np.uint64(at + i)] < cap
                        w, v = w if hit else 0.0, v if hit else 0.0
                        wx, wy, vx, vy = w * mx, w * my, v * mx, v * my
                        terms[np.uint64(to + i)] = wx * mx + vy * my
                        terms[np.uint64(to + BEAMS + i)] = wx * my - vy * mx
                        terms[np.uint64(to + 2 * BEAMS + i)] = wx * j2 - vy * i2
                        terms[np.uint64(to + 3 * BEAMS + i)] = wy * my + vx * mx
                        terms[np.uint64(to + 4 * BEAMS + i)] = wy * j2 + vx * i2
                        terms[np.uint64(to + 5 * BEAMS + i)] = w * j2 * j2 + v * i2 * i2
                        terms[np.uint64(to + 6 * BEAMS + i)] = wx * e - vy * f
                        terms[np.uint64(to + 7 * BEAMS + i)] = wy * e + vx * f
                        terms[np.uint64(to + 8 * BEAMS + i)] = w * j2 * e + v * i2 * f
                    h00, h01, h02, h11, h12, h22, g0, g1, g2 = added(
                        terms, to, count, (h00, h01, h02, h11, h12, h22, g0, g1, g2)
                    )
                tx, ty, th = stepped(
                    tx, ty, th, poses[p, 0], poses[p, 1], poses[p, 2], c, s, prior,
                    (h00, h01, h02, h11, h12, h22, g0, g1, g2),
                )  # fmt: skip
            out[p, 0], out[p, 1], out[p, 2] = tx, ty, th
            if least.shape[0]:
                scored(maps, row, points, plain, (tx, ty, th), memory, least, p)
    return out


@kernel
def systematic(weights: np.ndarray, u: float) -> np.ndarray:
    """Ancestors (n,) drawn by one number `u` in [0, 1): particle i is drawn floor or ceil of n w_i times.

    weights: (n,) >= 0, any sum > 0. Survivors keep their own place: where i lives, ancestors[i] = i.
    """
    n = weights.shape[0]
    total = 0.0
    for i in range(n):
        total += weights[i]
    count = np.zeros(n, np.int64)
    sum_to, drawn = 0.0, 0
    for i in range(n):
        sum_to += weights[i] / total * n
        while drawn < n and drawn + u < sum_to:
            count[i] += 1
            drawn += 1
    k = n - 1
    while drawn < n:  # rounding left some undrawn: the last particle of any weight takes them
        while k > 0 and not weights[k] > 0.0:
            k -= 1
        count[k] += 1
        drawn += 1
    ancestors = np.empty(n, np.int64)
    parent = 0
    for i in range(n):
        if count[i] > 0:
            ancestors[i] = i
            continue
        while count[parent] < 2:
            parent += 1
        ancestors[i] = parent
        count[parent] -= 1
    return ancestors
