"""What a control or a plan of laps would bring: how sure the map would be, how much new ground would be seen."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from ..dense import solved
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


class LapRules(NamedTuple):
    """How robots steer through their places. controls: (m, 2) offered; period: [s]; lower, upper: (2,) [m], the field.

    arrived: [m] from a place at which it is reached; heading_cost: [m/rad] that a wrong heading counts as.
    """

    controls: np.ndarray
    period: float
    lower: np.ndarray
    upper: np.ndarray
    arrived: float
    heading_cost: float


class LandmarkSensor(NamedTuple):
    """R: (2, 2) noise of range [m] and bearing [rad]; nearer sightings than `least_range` [m] tell no more.

    After step `known_until`, in what is planned only, `margin` [m] of the reach is not counted on. look_every: [steps]
    between the looks counted, each for as many: a divisor of the steps between two poses.
    """

    sector: Sector
    R: np.ndarray
    least_range: float
    known_until: int
    margin: float
    look_every: int


class LapSightings(NamedTuple):
    """What each of n points shows of itself and of the poses that see it: the terms of the normal equations.

    own: (n, 3) information about the point itself, xx, xy, yy; counts: (n,) how many poses see it; nodes: (n, most)
    which, rising; tie: (n, most, 3, 2) of pose and point; poses: (n, most, 3, 3) of the pose alone.
    """

    own: np.ndarray
    counts: np.ndarray
    nodes: np.ndarray
    tie: np.ndarray
    poses: np.ndarray


@kernel
def drive_laps(
    ways: np.ndarray,
    counts: np.ndarray,
    starts: np.ndarray,
    rules: LapRules,
    steps: int,
) -> np.ndarray:
    """Poses (M, steps + 1, 3) of robots that steer through their places in turn, without noise, and then stand still.

    ways: (M, k, 2) [m], counts: (M,) places used of each; starts: (M, 3). The rules are those of
    `landmarks.objective.steer`.
    """
    controls, period, arrived, heading_cost = rules.controls, rules.period, rules.arrived, rules.heading_cost
    lower, upper = rules.lower, rules.upper
    M = len(starts)
    track = np.empty((M, steps + 1, 3))
    for j in range(M):
        x, y, th = starts[j, 0], starts[j, 1], starts[j, 2]
        track[j, 0] = starts[j]
        at = 0
        for t in range(1, steps + 1):
            while at < counts[j] and np.hypot(ways[j, at, 0] - x, ways[j, at, 1] - y) < arrived:
                at += 1
            if at < counts[j]:
                gx, gy = ways[j, at, 0], ways[j, at, 1]
                best, nx, ny, nth = np.inf, x, y, th
                c, s = np.cos(th), np.sin(th)
                last, bearing = np.nan, 0.0
                for u in range(len(controls)):
                    d = controls[u, 0] * period
                    ux, uy, uth = x + d * c, y + d * s, th + controls[u, 1] * period
                    if ux < lower[0] or ux > upper[0] or uy < lower[1] or uy > upper[1]:
                        continue
                    if d != last:
                        last, bearing = d, np.arctan2(gy - uy, gx - ux)
                    off = bearing - uth
                    off -= 2 * np.pi * np.floor((off + np.pi) / (2 * np.pi))
                    cost = np.hypot(gx - ux, gy - uy) + heading_cost * abs(off)
                    if cost < best:
                        best, nx, ny, nth = cost, ux, uy, uth
                x, y, th = nx, ny, nth
            track[j, t, 0], track[j, t, 1], track[j, t, 2] = x, y, th
    return track


@kernel
def seen_shares(track: np.ndarray, explored: np.ndarray, sector: Sector, raster: Raster) -> np.ndarray:
    """Share (steps + 1,) of the cells seen by each step of `track` (M, steps + 1, 3), `explored` (ny, nx) before it."""
    seen = explored.copy()
    out = np.empty(track.shape[1])
    for t in range(track.shape[1]):
        for j in range(track.shape[0]):
            if t == 0 or not np.array_equal(track[j, t], track[j, t - 1]):
                mark_half_disc(seen, track[j, t], sector, raster)
        out[t] = seen.mean()
    return out


@kernel
def odometry_information(track: np.ndarray, every: int, Q: np.ndarray) -> np.ndarray:
    """Information (3 K, 3 K) that odometry gives about the poses at steps every, 2 every, ... of each robot in turn.

    Errors in world axes; the first poses are certain. Q: (3, 3) noise of a step.
    """
    M, n = track.shape[0], (track.shape[1] - 1) // every
    S = np.zeros((3 * M * n, 3 * M * n))
    for j in range(M):
        for k in range(n):
            P = np.zeros((3, 3))
            for t in range(k * every, (k + 1) * every):
                dx, dy = track[j, t + 1, 0] - track[j, t, 0], track[j, t + 1, 1] - track[j, t, 1]
                P[0] -= dy * P[2]
                P[1] += dx * P[2]
                P[:, 0] -= dy * P[:, 2]
                P[:, 1] += dx * P[:, 2]
                P += Q
            W = solved(P, np.eye(3))
            b = 3 * (j * n + k)
            S[b : b + 3, b : b + 3] += W
            if k == 0:
                continue
            a = b - 3
            F = np.eye(3)
            F[0, 2] = -(track[j, (k + 1) * every, 1] - track[j, k * every, 1])
            F[1, 2] = track[j, (k + 1) * every, 0] - track[j, k * every, 0]
            WF = W @ F
            S[b : b + 3, a : a + 3] -= WF
            S[a : a + 3, b : b + 3] -= WF.T
            S[a : a + 3, a : a + 3] += F.T @ WF
    return S


@kernel
def _directions(dx: float, dy: float, r: float) -> tuple[float, float, float, float]:
    """By how much range and bearing to a point at (dx, dy), `r` away, change as it moves along x and y."""
    return dx / r, dy / r, -(dy / r) / r, (dx / r) / r


SURELY_BEYOND = 1.0 + 1e-9  # times the squared reach: more than rounding can make of a point within


@kernel
def _in_view(heading: float, dx: float, dy: float, reach: float, cos_half: float) -> bool:
    """Whether a pose of this `heading` [rad] shows the point at (dx, dy) from it."""
    if dx * dx + dy * dy > SURELY_BEYOND * reach * reach:
        return False  # most looks, without a root and a turn
    r = np.hypot(dx, dy)
    return bool(r <= reach and dx * np.cos(heading) + dy * np.sin(heading) >= cos_half * r)


@kernel
def _still(track: np.ndarray, j: int, t: int, look: int) -> bool:
    """Whether robot j is at step `t` of `track` just where it was `look` steps before."""
    a, b = t, t - look
    return bool(
        track[j, a, 0] == track[j, b, 0] and track[j, a, 1] == track[j, b, 1] and track[j, a, 2] == track[j, b, 2]
    )


@kernel
def _sightings(
    track: np.ndarray,
    every: int,
    point: np.ndarray,
    sensor: LandmarkSensor,
    B: np.ndarray,
    C: np.ndarray,
    nodes: np.ndarray,
) -> tuple[int, float, float, float]:
    """Fills nodes (which poses see `point`), B (k, 3, 2) and C (k, 3, 3); k and the point's own information.

    A look from between two poses is one of the nearer, displaced as the drive was.
    """
    M, n = track.shape[0], (track.shape[1] - 1) // every
    k, a00, a01, a11 = 0, 0.0, 0.0, 0.0
    least_range, look = sensor.least_range, min(sensor.look_every, every)
    cos_half = np.cos(sensor.sector.half_angle)
    wr, wb = look / sensor.R[0, 0], look / sensor.R[1, 1]
    h = np.zeros((2, 3))
    for j in range(M):
        for i in range(n + 1):
            at = i * every
            seen = False
            begin = at - every // look // 2 * look
            first = begin if i > 0 else 0
            for t in range(first, min(n * every + 1, begin + every), look):
                dx, dy = point[0] - track[j, t, 0], point[1] - track[j, t, 1]
                reach = sensor.sector.reach - (sensor.margin if t > sensor.known_until else 0.0)
                if not _in_view(track[j, t, 2], dx, dy, reach, cos_half) or (t >= look and _still(track, j, t, look)):
                    continue  # out of sight, or the robot stood still since the last look
                r = np.hypot(dx, dy)
                ux, uy, gx, gy = _directions(dx, dy, max(r, least_range))
                a00 += wr * ux * ux + wb * gx * gx
                a01 += wr * ux * uy + wb * gx * gy
                a11 += wr * uy * uy + wb * gy * gy
                if i == 0:
                    continue
                if not seen:
                    B[k] = 0.0
                    C[k] = 0.0
                    nodes[k] = j * n + i - 1
                    seen = True
                lx, ly = track[j, t, 0] - track[j, at, 0], track[j, t, 1] - track[j, at, 1]
                h[0, 0], h[0, 1], h[0, 2] = -ux, -uy, ux * ly - uy * lx
                h[1, 0], h[1, 1], h[1, 2] = -gx, -gy, gx * ly - gy * lx - 1.0
                for a in range(3):
                    B[k, a, 0] += wr * h[0, a] * ux + wb * h[1, a] * gx
                    B[k, a, 1] += wr * h[0, a] * uy + wb * h[1, a] * gy
                    for b in range(3):
                        C[k, a, b] += wr * h[0, a] * h[0, b] + wb * h[1, a] * h[1, b]
            if seen:
                k += 1
    return k, a00, a01, a11


@kernel
def lap_sightings(track: np.ndarray, every: int, points: np.ndarray, sensor: LandmarkSensor) -> LapSightings:
    """All sightings of `points` (n, 2) from the poses at steps 0, every, 2 every, ... of `track` (M, steps + 1, 3)."""
    n, most = len(points), track.shape[0] * ((track.shape[1] - 1) // every + 1)
    own, counts = np.empty((n, 3)), np.empty(n, dtype=np.int64)
    nodes = np.empty((n, most), dtype=np.int64)
    tie, poses = np.empty((n, most, 3, 2)), np.empty((n, most, 3, 3))
    for m in range(n):
        k, a00, a01, a11 = _sightings(track, every, points[m], sensor, tie[m], poses[m], nodes[m])
        counts[m], own[m, 0], own[m, 1], own[m, 2] = k, a00, a01, a11
    return LapSightings(own, counts, nodes, tie, poses)


@kernel
def add_landmark_information(S: np.ndarray, seen: LapSightings) -> None:
    """Adds to S what landmarks tell about the poses that see them, in place.

    The landmark itself is eliminated: what is left ties together all poses that see it. S stays symmetric.
    """
    for m in range(len(seen.counts)):
        k, a00, a01, a11 = seen.counts[m], seen.own[m, 0], seen.own[m, 1], seen.own[m, 2]
        B, C, nodes = seen.tie[m], seen.poses[m], seen.nodes[m]
        det = a00 * a11 - a01 * a01
        if k == 0 or det <= 0:
            continue
        for i in range(k):
            r = 3 * nodes[i]
            for a in range(3):
                f0 = (B[i, a, 0] * a11 - B[i, a, 1] * a01) / det
                f1 = (B[i, a, 1] * a00 - B[i, a, 0] * a01) / det
                for b in range(3):
                    S[r + a, r + b] += C[i, a, b]
                for q in range(i, k):  # nodes rise: the half above the diagonal
                    c = 3 * nodes[q]
                    for b in range(3):
                        S[r + a, c + b] -= f0 * B[q, b, 0] + f1 * B[q, b, 1]
    for r in range(1, len(S)):
        for c in range(r):
            S[r, c] = S[c, r]


@kernel
def landmark_errors(P: np.ndarray, seen: LapSightings) -> np.ndarray:
    """Expected root mean square error (n,) [m] of each landmark, NaN of one that would not be seen.

    P: (3 K, 3 K) covariance of the poses, as `odometry_information` orders them; read on and above its diagonal.
    """
    out = np.full(len(seen.counts), np.nan)
    for m in range(len(seen.counts)):
        k, a00, a01, a11 = seen.counts[m], seen.own[m, 0], seen.own[m, 1], seen.own[m, 2]
        B, nodes = seen.tie[m], seen.nodes[m]
        det = a00 * a11 - a01 * a01
        if det <= 0:
            continue
        v00, v01, v11 = 0.0, 0.0, 0.0  # B' P B
        for i in range(k):
            r = 3 * nodes[i]
            for a in range(3):
                w0, w1 = 0.0, 0.0
                for q in range(i + 1, k):
                    c = 3 * nodes[q]
                    for b in range(3):
                        w0 += P[r + a, c + b] * B[q, b, 0]
                        w1 += P[r + a, c + b] * B[q, b, 1]
                v00 += 2.0 * B[i, a, 0] * w0
                v01 += B[i, a, 0] * w1 + B[i, a, 1] * w0
                v11 += 2.0 * B[i, a, 1] * w1
                for b in range(3):
                    p = P[r + min(a, b), r + max(a, b)]
                    v00 += B[i, a, 0] * p * B[i, b, 0]
                    v01 += B[i, a, 0] * p * B[i, b, 1]
                    v11 += B[i, a, 1] * p * B[i, b, 1]
        i00, i01, i11 = a11 / det, -a01 / det, a00 / det
        x = i00 * (v00 * i00 + v01 * i01) + i01 * (v01 * i00 + v11 * i01)
        y = i01 * (v00 * i01 + v01 * i11) + i11 * (v01 * i01 + v11 * i11)
        out[m] = np.sqrt(i00 + i11 + x + y)
    return out
