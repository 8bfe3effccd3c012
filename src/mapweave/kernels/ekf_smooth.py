"""Where the robot drove, given the finished map: forward filter and backward pass over poses alone, compiled.

The parameters (calibration and landmarks, the last rows of the EKF's state) are held at their final values; `B` (d, m)
is how the chain moves with them, so that their covariance enters each pose's: cov = S + B P_parameters B^T. That is
the Rauch-Tung-Striebel smoother of the whole state at the cost of a few dimensions. The chain is the pose (d = 3) and,
without odometry, speed and turn rate (d = 5).
"""

from typing import TypeAlias

import numpy as np

from ._jit import kernel
from .ekf import (
    BEARING_BIAS,
    COAST_STEP,
    HEAD,
    POSE,
    RANGE_SCALE,
    TURN_SCALE,
    V_SCALE,
    Noise,
    arc,
    clear,
    drive,
    quadratic,
    trust,
    wrap,
)

Array: TypeAlias = np.ndarray


@kernel
def fix(x: Array, P: Array, B: Array, slot: int, z_range: float, z_bearing: float, noise: Noise, astray: Array) -> None:
    """One sighting of a landmark whose place is a parameter, worked into the chain in `x`, its `P` and `B`."""
    d = len(P)
    a = HEAD + 2 * slot
    dx, dy = x[a] - x[0], x[a + 1] - x[1]
    r = max(np.sqrt(dx * dx + dy * dy), 1e-6)
    s = x[RANGE_SCALE]
    e = np.array([z_range - s * r, wrap(z_bearing - np.arctan2(dy, dx) + x[2] - x[BEARING_BIAS])])
    ux, uy = dx / r, dy / r
    gx, gy = -uy / r, ux / r
    H = np.zeros((2, d))
    H[0, 0], H[0, 1] = -s * ux, -s * uy
    H[1, 0], H[1, 1], H[1, 2] = -gx, -gy, -1.0
    PHt = P @ H.T
    S = H @ PHt
    r0 = noise.range_floor**2 + (noise.range_share * r) ** 2
    r1 = noise.bearing**2
    far = np.sqrt(quadratic(e[0], e[1], S[0, 0] + r0, S[0, 1], S[1, 1] + r1))
    weight = trust(far, noise, astray)
    S[0, 0] += r0 * noise.range_inflation / weight
    S[1, 1] += r1 * noise.bearing_inflation / weight
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    inverse = np.array([[S[1, 1], -S[0, 1]], [-S[1, 0], S[0, 0]]]) / det
    K = PHt @ inverse
    step = K @ e
    for i in range(d):
        x[i] += step[i]
    P[:, :] -= K @ S @ K.T
    moved = H @ B
    moved[0, RANGE_SCALE - POSE] += r
    moved[1, BEARING_BIAS - POSE] += 1.0
    moved[0, a - POSE] += s * ux
    moved[0, a + 1 - POSE] += s * uy
    moved[1, a - POSE] += gx
    moved[1, a + 1 - POSE] += gy
    B -= K @ moved


@kernel
def coasted(x: Array, dt: float, noise: Noise, F: Array, Q: Array) -> None:
    """`kernels.ekf.coast` for the chain alone: moves `x[:5]`, fills its derivative F (5, 5) and noise Q (5, 5)."""
    steps = max(1, int(np.ceil(dt / COAST_STEP)))
    h = dt / steps
    keep_v, keep_w = np.exp(-h / noise.speed_time), np.exp(-h / noise.spin_time)
    Phi, own = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    A = np.zeros((5, 5))
    F[:, :] = np.eye(5)
    Q[:, :] = 0.0
    for _ in range(steps):
        clear(Phi, own)
        arc(x, Phi, own, 1.0, 1.0, h, noise, False)
        A[:POSE, :] = Phi[:, :5]
        A[3, 3], A[4, 4] = keep_v, keep_w
        x[V_SCALE] *= keep_v
        x[TURN_SCALE] *= keep_w
        F[:, :] = A @ F
        Q[:, :] = A @ Q @ A.T
        Q[:POSE, :POSE] += own
        Q[3, 3] += noise.speed**2 * (1.0 - keep_v**2)
        Q[4, 4] += noise.spin**2 * (1.0 - keep_w**2)


@kernel
def advance(
    x: Array, P: Array, B: Array, F: Array, Q: Array, now: float, end: float, cmd_t: Array, cmd_v: Array, cmd_w: Array,
    at: int, noise: Noise,
) -> int:  # fmt: skip
    """Moves the chain from `now` to `end` [s]: `x`, `P`, `B` in place, F and Q filled; returns the command in force."""
    if noise.speed > 0.0:
        coasted(x, end - now, noise, F, Q)
        B[:, :] = F @ B
    else:
        Phi = np.zeros((POSE, HEAD))
        clear(Phi, Q)
        now, at = drive(x, Phi, Q, now, end, cmd_t, cmd_v, cmd_w, at, noise)
        F[:, :] = Phi[:, :POSE]
        B[:, :] = F @ B
        B[:, : HEAD - POSE] += Phi[:, POSE:]
    P[:, :] = F @ P @ F.T + Q
    return at


@kernel
def smooth(
    final: Array, P_final: Array, t: float, cmd_t: Array, cmd_v: Array, cmd_w: Array,
    stamp: Array, slots: Array, ranges: Array, bearings: Array, noise: Noise,
    track_t: Array, pose: Array, cov: Array,
) -> None:  # fmt: skip
    """Fills pose (rows, 3) and cov (rows, 3, 3) at `track_t`, all odometry and sighting stamps in order from `t` on.

    final, P_final: the EKF's last state; slots below zero are passed over. The start is known exactly: it is the frame.
    """
    d = 5 if noise.speed > 0.0 else POSE
    m = len(final) - POSE
    node_t = np.unique(stamp)
    n = len(node_t) + 1
    x = final.copy()
    x[:d] = 0.0
    P, B, F, Q = np.zeros((d, d)), np.zeros((d, m)), np.zeros((d, d)), np.zeros((d, d))
    if d == 5:
        P[3, 3], P[4, 4] = noise.speed**2, noise.spin**2
    before, after = np.zeros((n, d)), np.zeros((n, d))  # predicted and filtered, later smoothed
    P_before, P_after, move = np.zeros((n, d, d)), np.zeros((n, d, d)), np.zeros((n, d, d))
    B_before, B_after = np.zeros((n, d, m)), np.zeros((n, d, m))
    astray = np.zeros(1, np.int64)
    starts = np.full(n, -1, np.int64)  # command in force at each node
    P_after[0] = P
    now, at, j = t, -1, 0
    for k in range(1, n):
        at = advance(x, P, B, F, Q, now, node_t[k - 1], cmd_t, cmd_v, cmd_w, at, noise)
        now = node_t[k - 1]
        starts[k] = at
        before[k], P_before[k], B_before[k], move[k] = x[:d], P, B, F
        while j < len(stamp) and stamp[j] == now:
            if slots[j] >= 0:
                fix(x, P, B, slots[j], ranges[j], bearings[j], noise, astray)
            j += 1
        after[k], P_after[k], B_after[k] = x[:d], P, B
    back(before, P_before, B_before, move, after, P_after, B_after)
    total = marginal(P_after, B_after, P_final)
    if d == POSE:
        between(final, t, cmd_t, cmd_v, cmd_w, noise, node_t, after, total, starts, track_t, pose, cov)
        return
    for k in range(len(pose)):
        pose[k] = after[k + 1, :POSE]
        pose[k, 2] = wrap(pose[k, 2])
        cov[k] = total[k + 1]


@kernel
def back(
    before: Array, P_before: Array, B_before: Array, move: Array, after: Array, P_after: Array, B_after: Array
) -> None:
    """Rauch-Tung-Striebel: `after`, filtered, becomes smoothed, its covariance and its sensitivity with it."""
    tiny = 1e-14 * np.eye(P_before.shape[1])
    for k in range(len(after) - 2, -1, -1):
        G = np.linalg.solve(P_before[k + 1] + tiny, move[k + 1] @ P_after[k]).T
        after[k] += G @ (after[k + 1] - before[k + 1])
        P_after[k] += G @ (P_after[k + 1] - P_before[k + 1]) @ G.T
        B_after[k] += G @ (B_after[k + 1] - B_before[k + 1])


@kernel
def marginal(P: Array, B: Array, P_final: Array) -> Array:
    """(n, 3, 3) covariance of each pose, the parameters' own worked in."""
    parameters = P_final[POSE:, POSE:].copy()
    if P.shape[1] == 5:  # speed and turn rate are in the chain
        parameters[:2, :] = 0.0
        parameters[:, :2] = 0.0
    total = np.zeros((len(P), POSE, POSE))
    for k in range(len(P)):
        part = B[k, :POSE].copy()
        total[k] = P[k, :POSE, :POSE] + part @ parameters @ part.T
    return total


@kernel
def between(
    final: Array, t: float, cmd_t: Array, cmd_v: Array, cmd_w: Array, noise: Noise,
    node_t: Array, node: Array, node_cov: Array, starts: Array, track_t: Array, pose: Array, cov: Array,
) -> None:  # fmt: skip
    """Drives from each smoothed node towards the next and bends the way so that it arrives: a bridge with its noise."""
    n, rows = len(node), len(track_t)
    Phi, Q = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    x = final.copy()
    row = 0
    for k in range(n):
        start = t if k == 0 else node_t[k - 1]
        end = node_t[k] if k + 1 < n else np.inf
        clear(Phi, Q)
        x[:POSE] = node[k]
        now, at = start, starts[k]
        first = row
        while row < rows and track_t[row] < end:
            now, at = drive(x, Phi, Q, now, track_t[row], cmd_t, cmd_v, cmd_w, at, noise)
            pose[row] = x[:POSE]
            cov[row] = Q
            row += 1
        if k + 1 == n:  # after the last sighting: on from there
            for i in range(first, row):
                F = carry(node[k], pose[i])
                cov[i] += F @ node_cov[k] @ F.T
        else:
            now, at = drive(x, Phi, Q, now, end, cmd_t, cmd_v, cmd_w, at, noise)
            miss = node[k + 1] - x[:POSE]
            miss[2] = wrap(miss[2])
            inverse = np.linalg.inv(Q + 1e-14 * np.eye(POSE))
            for i in range(first, row):
                share = (track_t[i] - start) / max(end - start, 1e-9)
                own = cov[i].copy()
                G = own @ carry(pose[i], x[:POSE]).T @ inverse
                pose[i] += G @ miss
                cov[i] = own - G @ Q @ G.T + (1.0 - share) * node_cov[k] + share * node_cov[k + 1]
        for i in range(first, row):
            pose[i, 2] = wrap(pose[i, 2])


@kernel
def carry(a: Array, b: Array) -> Array:
    """The derivative of pose `b` by pose `a` it was driven from."""
    F = np.eye(POSE)
    F[0, 2] = -(b[1] - a[1])
    F[1, 2] = b[0] - a[0]
    return F
