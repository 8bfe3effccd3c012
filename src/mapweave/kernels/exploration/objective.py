"""Exploration's inner loops: what a control would do to the map's uncertainty, and how much new ground it would see."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from ..walls.segments import Raster, Sector


class MotionAndSight(NamedTuple):
    """One step of a robot and what it sees. period: [s]; Q: (3, 3) noise of a step; R: (2, 2) of a sighting."""

    period: float
    Q: np.ndarray
    R: np.ndarray
    sector: Sector


@kernel
def mark_half_disc(explored: np.ndarray, pose: np.ndarray, sector: Sector, raster: Raster) -> None:
    """Cells whose centre the `sector` of `pose` holds become True in `explored` (ny, nx), in place."""
    ny, nx = explored.shape
    reach, half_angle = sector.reach, sector.half_angle
    origin, cell = raster.corner, raster.cell
    c, s = np.cos(pose[2]), np.sin(pose[2])
    cos_half = np.cos(half_angle)
    x0 = max(0, cell_of((pose[0] - reach - origin[0]) / cell))
    x1 = min(nx - 1, cell_of((pose[0] + reach - origin[0]) / cell))
    y0 = max(0, cell_of((pose[1] - reach - origin[1]) / cell))
    y1 = min(ny - 1, cell_of((pose[1] + reach - origin[1]) / cell))
    for iy in range(y0, y1 + 1):
        dy = origin[1] + (iy + 0.5) * cell - pose[1]
        for ix in range(x0, x1 + 1):
            dx = origin[0] + (ix + 0.5) * cell - pose[0]
            d2 = dx * dx + dy * dy
            if d2 <= reach * reach and dx * c + dy * s >= cos_half * np.sqrt(d2) - 1e-9:
                explored[iy, ix] = True


@kernel
def unexplored_cells(explored: np.ndarray, poses: np.ndarray, sector: Sector, raster: Raster) -> np.ndarray:
    """How many unexplored cells (m,) the sensor would cover from each of `poses` (m, 3): N_g of [Yuan09] eq. 19."""
    ny, nx = explored.shape
    reach, half_angle = sector.reach, sector.half_angle
    origin, cell = raster.corner, raster.cell
    out = np.zeros(poses.shape[0], dtype=np.int64)
    cos_half = np.cos(half_angle)
    for k in range(poses.shape[0]):
        px, py = poses[k, 0], poses[k, 1]
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        x0 = max(0, cell_of((px - reach - origin[0]) / cell))
        x1 = min(nx - 1, cell_of((px + reach - origin[0]) / cell))
        y0 = max(0, cell_of((py - reach - origin[1]) / cell))
        y1 = min(ny - 1, cell_of((py + reach - origin[1]) / cell))
        count = 0
        for iy in range(y0, y1 + 1):
            dy = origin[1] + (iy + 0.5) * cell - py
            for ix in range(x0, x1 + 1):
                if not explored[iy, ix]:
                    dx = origin[0] + (ix + 0.5) * cell - px
                    d2 = dx * dx + dy * dy
                    if d2 <= reach * reach and dx * c + dy * s >= cos_half * np.sqrt(d2) - 1e-9:
                        count += 1
        out[k] = count
    return out


@kernel
def map_uncertainty(cov: np.ndarray) -> float:
    """C of a submap covariance (3 + 2n, 3 + 2n): pi sqrt det of its pose block and of each landmark's.

    [Yuan09] eq. 17.
    """
    a, b, c = cov[0, 0], cov[0, 1], cov[0, 2]
    d, e, f = cov[1, 1], cov[1, 2], cov[2, 2]
    det = a * (d * f - e * e) - b * (b * f - e * c) + c * (b * e - d * c)
    total = np.pi * np.sqrt(max(det, 0.0))
    n = (cov.shape[0] - 3) // 2
    for i in range(n):
        k = 3 + 2 * i
        total += np.pi * np.sqrt(max(cov[k, k] * cov[k + 1, k + 1] - cov[k, k + 1] * cov[k, k + 1], 0.0))
    return float(total)


@kernel
def _correct(P: np.ndarray, pose: np.ndarray, landmark: np.ndarray, row: int, R: np.ndarray) -> None:
    """`P` after a sighting of the landmark whose block starts at `row`, in place, by the Kalman update."""
    size = P.shape[0]
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    q = dx * dx + dy * dy
    r = np.sqrt(q)
    ux, uy, gx, gy = dx / r, dy / r, -dy / q, dx / q
    PH = np.empty((size, 2))
    K = np.empty((size, 2))
    for k in range(size):
        PH[k, 0] = ux * (P[k, row] - P[k, 0]) + uy * (P[k, row + 1] - P[k, 1])
        PH[k, 1] = gx * (P[k, row] - P[k, 0]) + gy * (P[k, row + 1] - P[k, 1]) - P[k, 2]
    s00 = ux * (PH[row, 0] - PH[0, 0]) + uy * (PH[row + 1, 0] - PH[1, 0]) + R[0, 0]
    s01 = ux * (PH[row, 1] - PH[0, 1]) + uy * (PH[row + 1, 1] - PH[1, 1]) + R[0, 1]
    s11 = gx * (PH[row, 1] - PH[0, 1]) + gy * (PH[row + 1, 1] - PH[1, 1]) - PH[2, 1] + R[1, 1]
    det = s00 * s11 - s01 * s01
    for k in range(size):
        K[k, 0] = (PH[k, 0] * s11 - PH[k, 1] * s01) / det
        K[k, 1] = (PH[k, 1] * s00 - PH[k, 0] * s01) / det
    for i in range(size):
        for k in range(i, size):
            P[i, k] -= K[i, 0] * PH[k, 0] + K[i, 1] * PH[k, 1]
            P[k, i] = P[i, k]


@kernel
def _predict(P: np.ndarray, fx: float, fy: float, Q: np.ndarray) -> None:
    """`P` after `F P F^T + Q` with F the identity but for d x / d theta = fx and d y / d theta = fy, in place."""
    P[0] += fx * P[2]
    P[1] += fy * P[2]
    P[:, 0] += fx * P[:, 2]
    P[:, 1] += fy * P[:, 2]
    P[:3, :3] += Q


@kernel
def expected_uncertainty(
    pose: np.ndarray,
    landmarks: np.ndarray,
    cov: np.ndarray,
    controls: np.ndarray,
    model: MotionAndSight,
) -> np.ndarray:
    """What C (m,) would be after each of `controls` (m, 2) = v, w and an update with what should then be in view.

    Covariance form of [Yuan09] eq. 18: it stays defined when the pose block is singular, as in a fresh submap.
    pose: (3,); landmarks: (n, 2); cov: (3 + 2n, 3 + 2n).
    """
    period, Q, R = model.period, model.Q, model.R
    reach, half_angle = model.sector.reach, model.sector.half_angle
    out = np.empty(controls.shape[0])
    P = np.empty_like(cov)
    after = np.empty(3)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for u in range(controls.shape[0]):
        d = controls[u, 0] * period
        after[0], after[1], after[2] = pose[0] + d * c, pose[1] + d * s, pose[2] + controls[u, 1] * period
        P[:] = cov
        _predict(P, -d * s, d * c, Q)
        for j in range(landmarks.shape[0]):
            dx, dy = landmarks[j, 0] - after[0], landmarks[j, 1] - after[1]
            r = np.sqrt(dx * dx + dy * dy)
            b = np.arctan2(dy, dx) - after[2]
            b -= 2 * np.pi * np.floor((b + np.pi) / (2 * np.pi))
            if 1e-6 < r <= reach and abs(b) <= half_angle:
                _correct(P, after, landmarks[j], 3 + 2 * j, R)
        out[u] = map_uncertainty(P)
    return out
