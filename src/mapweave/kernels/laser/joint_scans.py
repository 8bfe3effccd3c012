"""Scans matched point to line against many others at once, each through a table of its beams by direction.

Scans are rows `start[i]:start[i + 1]` of points (m, 2) [m] and unit normals (m, 2), in the robot's frame. A table row
holds for each of its sectors around the scanner the return there (its row, or -1): whatever lies near a point in space
lies near it in direction.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel, parallel_kernel, prange
from ..cells import cell_of
from .local_map import solve3

WIDEST = 12  # sectors to either side that are searched at most
Pair = tuple[float, float]  # numbers side by side cost what two arguments cost, a row of an array much more


class ScanLines(NamedTuple):
    """The returns of n scans: start (n + 1,), points (m, 2), normals (m, 2), and lined (m,) which normals hold."""

    start: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    lined: np.ndarray


class BeamIndex(NamedTuple):
    """Of n scans what `beams_by_direction` gives, table (n, sectors), and sensor (n, 2) where their scanners were."""

    table: np.ndarray
    sensor: np.ndarray


class LineGate(NamedTuple):
    """Which line a return belongs to: one within `gate`, whose normal has a cosine of `agree` at least with its own."""

    gate: float
    agree: float


@kernel
def beams_by_direction(
    start: np.ndarray, points: np.ndarray, lined: np.ndarray, sensor: np.ndarray, sectors: int
) -> np.ndarray:
    """(n, sectors) int32: the nearest return with a line in each sector around `sensor` (n, 2) [m], or -1."""
    n = start.shape[0] - 1
    table = np.full((n, sectors), -1, np.int32)
    for i in range(n):
        held = np.full(sectors, np.inf)
        for k in range(start[i], start[i + 1]):
            if not lined[k]:
                continue
            x, y = points[k, 0] - sensor[i, 0], points[k, 1] - sensor[i, 1]
            at = cell_of((math.atan2(y, x) + math.pi) * (sectors / (2.0 * math.pi))) % sectors
            r = x * x + y * y
            if r < held[at]:
                held[at] = r
                table[i, at] = k
    return table


@kernel
def match_beam(
    table: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    eye: Pair,
    place: Pair,
    normal: Pair,
    gate: float,
    agree: float,
) -> int:
    """The return nearest to `place` [m] within `gate` [m] whose normal agrees with `normal`; -1 when there is none.

    table: one row, of the scan taken with its scanner at `eye` [m].
    """
    (ex, ey), (x, y), (nx, ny) = eye, place, normal
    sectors = table.shape[0]
    dx, dy = x - ex, y - ey
    r = math.sqrt(dx * dx + dy * dy)
    at = cell_of((math.atan2(dy, dx) + math.pi) * (sectors / (2.0 * math.pi)))
    wide = WIDEST
    if r * WIDEST * 2.0 * math.pi > gate * sectors:
        wide = cell_of(gate / r * sectors / (2.0 * math.pi)) + 1
    best, found = gate * gate, -1
    for d in range(-wide, wide + 1):
        k = table[(at + d) % sectors]
        if k < 0:
            continue
        px, py = points[k, 0] - x, points[k, 1] - y
        e = px * px + py * py
        if e < best and normals[k, 0] * nx + normals[k, 1] * ny >= agree:
            best, found = e, k
    return found


@parallel_kernel
def match_pairs(
    first: np.ndarray,
    second: np.ndarray,
    relative: np.ndarray,
    scans: ScanLines,
    index: BeamIndex,
    rule: LineGate,
    width: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every scan `second[k]` against the lines of `first[k]`, at pose `relative[k]` (3,) of second in first.

    Information (p, 3, 3) and gradient (p, 3) of half the sum of Geman-McClure costs of `width` [m], unit sigma, over
    x, y, theta of `relative`; returns that found a line within `gate` (p,); those of them within `width` (p,).
    """
    (start, points, normals, lined), (table, sensor), (gate, agree) = scans, index, rule
    p = first.shape[0]
    H, g = np.zeros((p, 3, 3)), np.zeros((p, 3))
    matched, near = np.zeros(p, np.int64), np.zeros(p, np.int64)
    k2 = width * width
    for m in prange(p):
        i, j = first[m], second[m]
        c, s = math.cos(relative[m, 2]), math.sin(relative[m, 2])
        h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = 0.0
        for k in range(start[j], start[j + 1]):
            if not lined[k]:
                continue
            rx, ry = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
            nx, ny = c * normals[k, 0] - s * normals[k, 1], s * normals[k, 0] + c * normals[k, 1]
            x, y = relative[m, 0] + rx, relative[m, 1] + ry
            eye = sensor[i, 0], sensor[i, 1]
            at = match_beam(table[i], points, normals, eye, (x, y), (nx, ny), gate, agree)
            if at < 0:
                continue
            mx, my = normals[at, 0], normals[at, 1]
            e = mx * (x - points[at, 0]) + my * (y - points[at, 1])
            robust = k2 / (k2 + e * e)
            w = robust * robust
            matched[m] += 1
            if abs(e) < width:
                near[m] += 1
            turn = my * rx - mx * ry
            h00 += w * mx * mx
            h01 += w * mx * my
            h02 += w * mx * turn
            h11 += w * my * my
            h12 += w * my * turn
            h22 += w * turn * turn
            g0 += w * mx * e
            g1 += w * my * e
            g2 += w * turn * e
        H[m, 0, 0], H[m, 0, 1], H[m, 0, 2], H[m, 1, 1], H[m, 1, 2], H[m, 2, 2] = h00, h01, h02, h11, h12, h22
        H[m, 1, 0], H[m, 2, 0], H[m, 2, 1] = h01, h02, h12
        g[m, 0], g[m, 1], g[m, 2] = g0, g1, g2
    return H, g, matched, near


@parallel_kernel
def refine_poses(
    pose: np.ndarray,
    scans: ScanLines,
    near: np.ndarray,
    keyframe_pose: np.ndarray,
    keyframes: ScanLines,
    index: BeamIndex,
    rule: LineGate,
    widths: np.ndarray,
    per_return: float,
    sd: np.ndarray,
) -> np.ndarray:
    """(s, 3): each scan's pose after one Gauss-Newton step for each of `widths` [m] against the lines of keyframes.

    near: (s, k) the keyframes each scan is matched against, -1 for none; the gate of `rule` counts in
    widths; per_return: information [1/m^2] of one matched return; sd: (3,) [m, m, rad] of the pose given.
    """
    scan_start, scan_points, scan_normals, scan_lined = scans
    (_, points, normals, _), (table, sensor), (gate, agree) = keyframes, index, rule
    out = pose.copy()
    for m in prange(pose.shape[0]):
        x0, y0, t0 = pose[m, 0], pose[m, 1], pose[m, 2]
        tx, ty, th = x0, y0, t0
        for r in range(widths.shape[0]):
            k2 = widths[r] * widths[r]
            reach = gate * widths[r]
            h00 = h11 = 1.0 / (sd[0] * sd[0])
            h22 = 1.0 / (sd[2] * sd[2])
            h01 = h02 = h12 = 0.0
            g0, g1, g2 = h00 * (tx - x0), h11 * (ty - y0), h22 * (th - t0)
            for a in range(near.shape[1]):
                i = near[m, a]
                if i < 0:
                    continue
                ci, si = math.cos(keyframe_pose[i, 2]), math.sin(keyframe_pose[i, 2])
                dx, dy = tx - keyframe_pose[i, 0], ty - keyframe_pose[i, 1]
                lx, ly = ci * dx + si * dy, -si * dx + ci * dy
                c, s = math.cos(th - keyframe_pose[i, 2]), math.sin(th - keyframe_pose[i, 2])
                for k in range(scan_start[m], scan_start[m + 1]):
                    if not scan_lined[k]:
                        continue
                    rx, ry = (
                        c * scan_points[k, 0] - s * scan_points[k, 1],
                        s * scan_points[k, 0] + c * scan_points[k, 1],
                    )
                    nx = c * scan_normals[k, 0] - s * scan_normals[k, 1]
                    ny = s * scan_normals[k, 0] + c * scan_normals[k, 1]
                    x, y = lx + rx, ly + ry
                    eye = sensor[i, 0], sensor[i, 1]
                    at = match_beam(table[i], points, normals, eye, (x, y), (nx, ny), reach, agree)
                    if at < 0:
                        continue
                    mx, my = normals[at, 0], normals[at, 1]
                    e = mx * (x - points[at, 0]) + my * (y - points[at, 1])
                    robust = k2 / (k2 + e * e)
                    w = per_return * robust * robust
                    turn = my * rx - mx * ry
                    ax, ay = ci * mx - si * my, si * mx + ci * my
                    h00 += w * ax * ax
                    h01 += w * ax * ay
                    h02 += w * ax * turn
                    h11 += w * ay * ay
                    h12 += w * ay * turn
                    h22 += w * turn * turn
                    g0 += w * ax * e
                    g1 += w * ay * e
                    g2 += w * turn * e
            d0, d1, d2 = solve3(h00, h01, h02, h11, h12, h22, g0, g1, g2)
            tx -= d0
            ty -= d1
            th -= d2
        out[m, 0], out[m, 1], out[m, 2] = tx, ty, th
    return out
