"""One step of a robot's submap filter: drive, work the sightings in, start new landmarks; new arrays come back.

The state is the pose (3,), the landmarks (n, 2) and their covariance P (3 + 2n, 3 + 2n), pose first. Sightings between
two frames also say how one lies in the other: cost, gradient and information.
"""

from typing import TypeAlias

import numpy as np

from .._jit import kernel

Array: TypeAlias = np.ndarray

CLOSE = 3.0  # deviations of the range within which a reading is near nothing
TOUCHING = 1e-9  # [m] nearer than this no direction is defined


@kernel
def wrapped(angle: float) -> float:
    """`angle` [rad] in (-pi, pi]."""
    turn: float = np.pi - angle
    out: float = np.pi - (turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi)))
    return out


@kernel
def predicted(pose: Array, P: Array, v: float, w: float, period: float, Q: Array) -> tuple[Array, Array]:
    """The pose and P after `period` [s] at `v` [m/s] and `w` [rad/s]: `F P F^T + Q`, symmetric to the bit."""
    n = len(P)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    d = v * period
    fx, fy = -d * s, d * c
    after = np.array([pose[0] + d * c, pose[1] + d * s, wrapped(pose[2] + w * period)])
    out = P.copy()
    for j in range(3, n):
        out[0, j] += fx * P[2, j]
        out[1, j] += fy * P[2, j]
        out[j, 0], out[j, 1] = out[0, j], out[1, j]
    xt, yt, tt = P[0, 2] + fx * P[2, 2], P[1, 2] + fy * P[2, 2], P[2, 2]
    out[0, 0] += fx * (P[0, 2] + xt) + Q[0, 0]
    out[0, 1] += fx * P[1, 2] + fy * xt + Q[0, 1]
    out[1, 1] += fy * (P[1, 2] + yt) + Q[1, 1]
    out[0, 2], out[1, 2], out[2, 2] = xt + Q[0, 2], yt + Q[1, 2], tt + Q[2, 2]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return after, out


@kernel
def sight_jacobian(pose: Array, point: Array, H: Array) -> None:
    """Derivative of range and bearing of `point` by the pose and the point, into H (2, 5)."""
    dx, dy = point[0] - pose[0], point[1] - pose[1]
    r = max(np.sqrt(dx * dx + dy * dy), TOUCHING)
    ux, uy, gx, gy = dx / r, dy / r, -dy / (r * r), dx / (r * r)
    H[0, 0], H[0, 1], H[0, 2], H[0, 3], H[0, 4] = -ux, -uy, 0.0, ux, uy
    H[1, 0], H[1, 1], H[1, 2], H[1, 3], H[1, 4] = -gx, -gy, -1.0, gx, gy


@kernel
def innovation(pose: Array, mean: Array, P: Array, index: Array) -> tuple[Array, Array]:
    """`H P` (2m, 3 + 2n) and `H P H^T` (2m, 2m) of sightings of the landmarks `index` (m,), in order."""
    m, size = len(index), len(P)
    HP, S = np.zeros((2 * m, size)), np.empty((2 * m, 2 * m))
    H = np.empty((m, 2, 5))
    where = np.array([0, 1, 2, 0, 0])
    for k in range(m):
        sight_jacobian(pose, mean[index[k]], H[k])
        where[3], where[4] = 3 + 2 * index[k], 4 + 2 * index[k]
        for i in range(2):
            to = HP[2 * k + i]
            for a in range(5):
                h, row = H[k, i, a], P[where[a]]
                for j in range(size):
                    to[j] += h * row[j]
    for k in range(m):
        where[3], where[4] = 3 + 2 * index[k], 4 + 2 * index[k]
        for i in range(2):
            for q in range(2 * k + i + 1):
                total = 0.0
                for a in range(5):
                    total += HP[q, where[a]] * H[k, i, a]
                S[2 * k + i, q] = total
                S[q, 2 * k + i] = total
    return HP, S


@kernel
def whiten(S: Array, rows: Array, y: Array) -> None:
    """With `S = L L^T`, in place: `L` in S's lower triangle, `L^-1 rows` in rows (m, n), `L^-1 y` in y (m,)."""
    n = rows.shape[1]
    for i in range(len(S)):
        row = rows[i]
        for k in range(i):
            total = S[i, k]
            for q in range(k):
                total -= S[i, q] * S[k, q]
            factor, done = total / S[k, k], rows[k]
            S[i, k] = factor
            S[i, i] -= factor * factor
            y[i] -= factor * y[k]
            for j in range(n):
                row[j] -= factor * done[j]
        S[i, i] = np.sqrt(S[i, i])
        y[i] /= S[i, i]
        for j in range(n):
            row[j] /= S[i, i]


@kernel
def corrected(pose: Array, mean: Array, P: Array, index: Array, z: Array, R: Array) -> tuple[Array, Array, Array]:
    """Pose, landmarks and P after the sightings z (m, 2) of the landmarks `index` (m,), in one Kalman update.

    With `S = L L^T` and `W = L^-1 H P` the covariance is `P - W^T W`, symmetric to the bit.
    """
    W, S = innovation(pose, mean, P, index)
    size, y = len(P), np.empty(len(S))
    for k in range(len(index)):
        dx, dy = mean[index[k], 0] - pose[0], mean[index[k], 1] - pose[1]
        y[2 * k] = z[k, 0] - np.sqrt(dx * dx + dy * dy)
        y[2 * k + 1] = wrapped(z[k, 1] - wrapped(np.arctan2(dy, dx) - pose[2]))
        for i in range(2):
            for j in range(2):
                S[2 * k + i, 2 * k + j] += R[i, j]
    whiten(S, W, y)
    out, move = P.copy(), np.zeros(size)
    for q in range(len(S)):
        row = W[q]
        for i in range(size):
            to, factor = out[i], row[i]
            move[i] += y[q] * factor
            for j in range(size):
                to[j] -= factor * row[j]
    after, marks = np.empty(3), np.empty_like(mean)
    after[0], after[1], after[2] = pose[0] + move[0], pose[1] + move[1], wrapped(pose[2] + move[2])
    for k in range(len(mean)):
        marks[k, 0], marks[k, 1] = mean[k, 0] + move[3 + 2 * k], mean[k, 1] + move[4 + 2 * k]
    return after, marks, out


@kernel
def across(r: float, R: Array) -> float:
    """The range [m] at which a bearing's noise acts when `r` was read: a reading near nothing says little of it."""
    out: float = max(r, CLOSE * np.sqrt(R[0, 0]))
    return out


@kernel
def too_near(pose: Array, mean: Array, P: Array, index: Array, factor: float, R: Array) -> Array:
    """Which landmarks of `index` (m,) lie within `factor` deviations of where they are relative to the robot."""
    out = np.zeros(len(index), dtype=np.bool_)
    for k in range(len(index)):
        i = 3 + 2 * index[k]
        dx, dy = mean[index[k], 0] - pose[0], mean[index[k], 1] - pose[1]
        spread = P[i, i] + P[i + 1, i + 1] + P[0, 0] + P[1, 1] - 2.0 * (P[i, 0] + P[i + 1, 1])
        out[k] = spread < 4.0 * R[0, 0] and dx * dx + dy * dy < factor * factor * spread
    return out


@kernel
def placed(pose: Array, mean: Array, P: Array, j: int, z: Array, R: Array) -> tuple[Array, Array, Array]:
    """Pose, landmarks and P after one sighting z (2,) of landmark j, taken as the place where z puts it.

    Range and bearing bend within the spread of a landmark close by; its place relative to the robot does not.
    """
    size, i = len(P), 3 + 2 * j
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ux, uy, rho = np.cos(z[1]), np.sin(z[1]), across(z[0], R)
    dx, dy = mean[j, 0] - pose[0], mean[j, 1] - pose[1]
    px, py = c * dx + s * dy, c * dy - s * dx
    H = np.array([[-c, -s, py, c, s], [s, -c, -px, -s, c]])
    where = np.array([0, 1, 2, i, i + 1])
    G = np.array([[ux, -rho * uy], [uy, rho * ux]])
    S, HP = G @ R @ G.T, np.zeros((2, size))
    for q in range(2):
        for a in range(5):
            for k in range(size):
                HP[q, k] += H[q, a] * P[where[a], k]
    for q in range(2):
        for w in range(2):
            for a in range(5):
                S[q, w] += HP[q, where[a]] * H[w, a]
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    e0, e1 = z[0] * ux - px, z[0] * uy - py
    y0, y1 = (S[1, 1] * e0 - S[0, 1] * e1) / det, (S[0, 0] * e1 - S[1, 0] * e0) / det
    dx_all, out = HP[0] * y0 + HP[1] * y1, P.copy()
    for k in range(size):
        k0 = (S[1, 1] * HP[0, k] - S[0, 1] * HP[1, k]) / det
        k1 = (S[0, 0] * HP[1, k] - S[1, 0] * HP[0, k]) / det
        for q in range(k + 1):
            out[k, q] -= k0 * HP[0, q] + k1 * HP[1, q]
            out[q, k] = out[k, q]
    after = np.array([pose[0] + dx_all[0], pose[1] + dx_all[1], wrapped(pose[2] + dx_all[2])])
    marks = np.empty_like(mean)
    for k in range(len(mean)):
        marks[k, 0], marks[k, 1] = mean[k, 0] + dx_all[3 + 2 * k], mean[k, 1] + dx_all[4 + 2 * k]
    return after, marks, out


@kernel
def grown(pose: Array, mean: Array, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    """Landmarks and P with those first seen as z (m, 2) at the end, by inverse observation, all covariances right."""
    n, size, m = len(mean), len(P), len(z)
    marks, out = np.empty((n + m, 2)), np.empty((size + 2 * m, size + 2 * m))
    marks[:n] = mean
    for i in range(size):
        for j in range(size):
            out[i, j] = P[i, j]
    for k in range(m):
        a, r = size + 2 * k, z[k, 0]
        c, s = np.cos(pose[2] + z[k, 1]), np.sin(pose[2] + z[k, 1])
        marks[n + k, 0], marks[n + k, 1] = pose[0] + r * c, pose[1] + r * s
        gx, gy = -r * s, r * c
        for j in range(a):  # the rows of what is known by now, others of these new ones among it
            out[a, j] = out[0, j] + gx * out[2, j]
            out[a + 1, j] = out[1, j] + gy * out[2, j]
            out[j, a], out[j, a + 1] = out[a, j], out[a + 1, j]
        gx, gy = -across(r, R) * s, across(r, R) * c
        n00 = c * c * R[0, 0] + 2.0 * c * gx * R[0, 1] + gx * gx * R[1, 1]
        n01 = c * s * R[0, 0] + (c * gy + s * gx) * R[0, 1] + gx * gy * R[1, 1]
        n11 = s * s * R[0, 0] + 2.0 * s * gy * R[0, 1] + gy * gy * R[1, 1]
        out[a, a] = out[a, 0] + gx * out[a, 2] + n00
        out[a, a + 1] = out[a, 1] + gy * out[a, 2] + n01
        out[a + 1, a + 1] = out[a + 1, 1] + gy * out[a + 1, 2] + n11
        out[a + 1, a] = out[a, a + 1]
    return marks, out


NEAREST = 1e-9  # [m] a point at the observer's own place has no direction
NEAREST_TELLS = 0.1  # [m] at which a direction tells most of a place: nobody sees anything nearer


@kernel
def relation_normal(
    forward: np.ndarray,
    pose: np.ndarray,
    point: np.ndarray,
    range_: np.ndarray,
    bearing: np.ndarray,
    T: np.ndarray,
    floor: float,
    share: float,
    sd_bearing: float,
) -> tuple[float, np.ndarray, np.ndarray]:
    """The Cauchy cost of m sightings with frame b at `T` (3,) in a, its gradient (3,) and information (3, 3).

    A direction to a point at the observer's own place would tell the place without end; it tells what it would from
    `NEAREST_TELLS`.

    forward: (m,) the observer stands in a at `pose` (m, 3), the target in b at `point` (m, 2); else the other way
    round; range_: (m,) [m], NaN where it is not told; bearing: (m,) [rad]. sd of a range: floor and share of it.
    """
    cost, g, H = 0.0, np.zeros(3), np.zeros((3, 3))
    c, s = np.cos(T[2]), np.sin(T[2])
    r_by, b_by, told = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(bearing)):
        inside = point[i] if forward[i] else pose[i]
        x, y = c * inside[0] - s * inside[1], s * inside[0] + c * inside[1]
        if forward[i]:
            sign, heading = 1.0, pose[i, 2]
            dx, dy = T[0] + x - pose[i, 0], T[1] + y - pose[i, 1]
        else:
            sign, heading = -1.0, pose[i, 2] + T[2]
            dx, dy = point[i, 0] - T[0] - x, point[i, 1] - T[1] - y
        r = max(np.sqrt(dx * dx + dy * dy), NEAREST)
        b_by[0], b_by[1] = -sign * dy / (r * r * sd_bearing), sign * dx / (r * r * sd_bearing)
        b_by[2] = sign * (dy * y + dx * x) / (r * r * sd_bearing)
        told[:] = b_by * r / max(r, NEAREST_TELLS)
        if not forward[i]:
            b_by[2] -= 1.0 / sd_bearing
            told[2] -= 1.0 / sd_bearing
        e_b = wrapped(np.arctan2(dy, dx) - heading - bearing[i]) / sd_bearing
        e_r = 0.0
        r_by[:] = 0.0
        if not np.isnan(range_[i]):
            sd = np.sqrt(floor * floor + share * share * range_[i] * range_[i])
            e_r = (r - range_[i]) / sd
            r_by[0], r_by[1] = sign * dx / (r * sd), sign * dy / (r * sd)
            r_by[2] = sign * (-dx * y + dy * x) / (r * sd)
        q = (e_r * e_r + e_b * e_b) / 4.0
        cost += np.log1p(q)
        weight = 1.0 / (1.0 + q)
        for a in range(3):
            g[a] += weight * (r_by[a] * e_r + b_by[a] * e_b)
            for b in range(3):
                H[a, b] += weight * (r_by[a] * r_by[b] + told[a] * told[b])
    return cost, g, H
