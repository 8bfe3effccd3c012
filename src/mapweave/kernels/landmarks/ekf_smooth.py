"""Where the robot drove, given the finished map: forward filter and backward pass over poses alone, compiled.

The parameters (calibration and landmarks, the last rows of the EKF's state) are held at their final values; `B` (d, m)
is how the chain moves with them, so that their covariance enters each pose's: cov = S + B P_parameters B^T. That is
the Rauch-Tung-Striebel smoother of the whole state at the cost of a few dimensions. The chain is the pose (d = 3) and,
without odometry, speed and turn rate (d = 5).
"""

from typing import TypeAlias

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from ..dense import add_product, product, put, solved, transposed
from .ekf import (
    BEARING_BIAS,
    COAST_STEP,
    HEAD,
    POSE,
    RANGE_SCALE,
    TURN_SCALE,
    V_SCALE,
    Commands,
    Noise,
    PoseRows,
    SightingRows,
    arc,
    clear,
    drive,
    plain,
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
    PHt = product(P, transposed(H))
    S = product(H, PHt)
    r0 = noise.range_floor**2 + (noise.range_share * r) ** 2
    r1 = noise.bearing**2
    far = np.sqrt(quadratic(e[0], e[1], S[0, 0] + r0, S[0, 1], S[1, 1] + r1))
    weight = trust(far, noise, astray)
    S[0, 0] += r0 * noise.range_inflation / weight
    S[1, 1] += r1 * noise.bearing_inflation / weight
    Kt = solved(S, transposed(PHt))
    K = transposed(Kt)
    for i in range(d):
        x[i] += K[i, 0] * e[0] + K[i, 1] * e[1]
    add_product(P, PHt, Kt, -1.0)
    moved = product(H, B)
    moved[0, RANGE_SCALE - POSE] += r
    moved[1, BEARING_BIAS - POSE] += 1.0
    moved[0, a - POSE] += s * ux
    moved[0, a + 1 - POSE] += s * uy
    moved[1, a - POSE] += gx
    moved[1, a + 1 - POSE] += gy
    add_product(B, K, moved, -1.0)


@kernel
def coasted(x: Array, dt: float, noise: Noise, F: Array, Q: Array) -> None:
    """`ekf_apply_drive.coast` for the chain alone: moves `x[:5]`, fills its derivative F (5, 5) and noise Q (5, 5)."""
    steps = max(1, cell_of(np.ceil(dt / COAST_STEP)))
    h = dt / steps
    keep_v, keep_w = np.exp(-h / noise.speed_time), np.exp(-h / noise.spin_time)
    Phi, own = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    A = np.zeros((5, 5))
    put(F, np.eye(5))
    put(Q, A)
    for _ in range(steps):
        clear(Phi, own)
        arc(x, Phi, own, 1.0, 1.0, h, noise, plain(0) > 0)
        put(A[:POSE], Phi)
        A[3, 3], A[4, 4] = keep_v, keep_w
        x[V_SCALE] *= keep_v
        x[TURN_SCALE] *= keep_w
        put(F, product(A, F))
        put(Q, product(product(A, Q), transposed(A)))
        for i in range(POSE):
            for k in range(POSE):
                Q[i, k] += own[i, k]
        Q[3, 3] += noise.speed**2 * (1.0 - keep_v**2)
        Q[4, 4] += noise.spin**2 * (1.0 - keep_w**2)


@kernel
def advance(
    x: Array, P: Array, B: Array, F: Array, Q: Array, now: float, end: float, commands: Commands,
    at: int, noise: Noise,
) -> int:  # fmt: skip
    """Moves the chain from `now` to `end` [s]: `x`, `P`, `B` in place, F and Q filled; returns the command in force."""
    if noise.speed > 0.0:
        coasted(x, end - now, noise, F, Q)
        put(B, product(F, B))
    else:
        Phi = np.zeros((POSE, HEAD))
        clear(Phi, Q)
        now, at = drive(x, Phi, Q, now, end, commands, at, noise)
        put(F, Phi)
        put(B, product(F, B))
        for i in range(POSE):
            for k in range(HEAD - POSE):
                B[i, k] += Phi[i, POSE + k]
    moved = product(product(F, P), transposed(F))
    for i in range(len(P)):
        for k in range(len(P)):
            P[i, k] = moved[i, k] + Q[i, k]
    return at


@kernel
def smooth(
    final: Array, P_final: Array, t: float, commands: Commands, sightings: SightingRows, node_t: Array, noise: Noise,
    track: PoseRows,
) -> None:  # fmt: skip
    """Fills `track`, cov (n, 3, 3), at its stamps: all of odometry and sightings in order from `t` on.

    final, P_final: the EKF's last state; node_t: the distinct stamps of the sightings, ascending; slots below zero are
    passed over. The start is known exactly: it is the frame.
    """
    d = 5 if noise.speed > 0.0 else POSE
    m = len(final) - POSE
    n = len(node_t) + 1
    x = final.copy()
    for i in range(d):
        x[i] = 0.0
    P, B, F, Q = np.zeros((d, d)), np.zeros((d, m)), np.zeros((d, d)), np.zeros((d, d))
    if d == 5:
        P[3, 3], P[4, 4] = noise.speed**2, noise.spin**2
    before, after = np.zeros((n, d)), np.zeros((n, d))  # predicted and filtered, later smoothed
    P_before, P_after, move = np.zeros((n, d, d)), np.zeros((n, d, d)), np.zeros((n, d, d))
    B_before, B_after = np.zeros((n, d, m)), np.zeros((n, d, m))
    astray = np.zeros(1, np.int64)
    starts = np.full(n, -1, np.int64)  # command in force at each node
    put(P_after[0], P)
    now, at, j = t, plain(-1), 0
    for k in range(1, n):
        at = advance(x, P, B, F, Q, now, node_t[k - 1], commands, at, noise)
        now = node_t[k - 1]
        starts[k] = at
        keep(x, P, B, before[k], P_before[k], B_before[k])
        put(move[k], F)
        while j < len(sightings.t) and sightings.t[j] == now:
            if sightings.slot[j] >= 0:
                fix(x, P, B, sightings.slot[j], sightings.range[j], sightings.bearing[j], noise, astray)
            j += 1
        keep(x, P, B, after[k], P_after[k], B_after[k])
    back(before, P_before, B_before, move, after, P_after, B_after)
    total = marginal(P_after, B_after, P_final)
    if d == POSE:
        between(final, t, commands, noise, node_t, after, total, starts, track)
        return
    for k in range(len(track.t)):
        for i in range(POSE):
            track.pose[k, i] = after[k + 1, i]
        track.pose[k, 2] = wrap(track.pose[k, 2])
        put(track.cov[k], total[k + 1])


@kernel
def keep(x: Array, P: Array, B: Array, x_to: Array, P_to: Array, B_to: Array) -> None:
    """The chain at a node, into the tables."""
    for i in range(len(x_to)):
        x_to[i] = x[i]
    put(P_to, P)
    put(B_to, B)


@kernel
def back(
    before: Array, P_before: Array, B_before: Array, move: Array, after: Array, P_after: Array, B_after: Array
) -> None:
    """Rauch-Tung-Striebel: `after`, filtered, becomes smoothed, its covariance and its sensitivity with it."""
    d = P_before.shape[1]
    for k in range(len(after) - 2, -1, -1):
        ahead = P_before[k + 1].copy()
        change_P, change_B = P_after[k + 1] - P_before[k + 1], B_after[k + 1] - B_before[k + 1]
        for i in range(d):
            ahead[i, i] += 1e-14
        Gt = solved(ahead, product(move[k + 1], P_after[k]))
        G = transposed(Gt)
        for i in range(d):
            for j in range(d):
                after[k, i] += G[i, j] * (after[k + 1, j] - before[k + 1, j])
        add_product(P_after[k], product(G, change_P), Gt, 1.0)
        add_product(B_after[k], G, change_B, 1.0)


@kernel
def marginal(P: Array, B: Array, P_final: Array) -> Array:
    """(n, 3, 3) covariance of each pose, the parameters' own worked in."""
    parameters = P_final[POSE:, POSE:].copy()
    if P.shape[1] == 5:  # speed and turn rate are in the chain
        for i in range(2):
            for j in range(len(parameters)):
                parameters[i, j] = parameters[j, i] = 0.0
    total = np.zeros((len(P), POSE, POSE))
    for k in range(len(P)):
        part = B[k, :POSE].copy()
        put(total[k], P[k])
        add_product(total[k], product(part, parameters), transposed(part), 1.0)
    return total


@kernel
def between(
    final: Array, t: float, commands: Commands, noise: Noise, node_t: Array, node: Array, node_cov: Array,
    starts: Array, track: PoseRows,
) -> None:  # fmt: skip
    """Drives from each smoothed node towards the next and bends the path so that it arrives: a noisy bridge."""
    pose, cov = track.pose, track.cov
    n, rows = len(node), len(track.t)
    Phi, Q = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    x = final.copy()
    row = 0
    for k in range(n):
        start = t if k == 0 else node_t[k - 1]
        end = node_t[k] if k + 1 < n else np.inf
        clear(Phi, Q)
        for i in range(POSE):
            x[i] = node[k, i]
        now, at = start, starts[k]
        first = row
        while row < rows and track.t[row] < end:
            now, at = drive(x, Phi, Q, now, track.t[row], commands, at, noise)
            for i in range(POSE):
                pose[row, i] = x[i]
            put(cov[row], Q)
            row += 1
        if k + 1 == n:  # after the last sighting: on from there
            for i in range(first, row):
                F = carry(node[k], pose[i])
                add_product(cov[i], product(F, node_cov[k]), transposed(F), 1.0)
        else:
            now, at = drive(x, Phi, Q, now, end, commands, at, noise)
            for i in range(first, row):
                share = (track.t[i] - start) / max(end - start, 1e-9)
                bend(pose[i], cov[i], share, x, Q, node[k + 1], node_cov[k], node_cov[k + 1])
        for i in range(first, row):
            pose[i, 2] = wrap(pose[i, 2])


@kernel
def carry(a: Array, b: Array) -> Array:
    """The derivative of pose `b` by pose `a` it was driven from."""
    F = np.eye(POSE)
    F[0, 2] = -(b[1] - a[1])
    F[1, 2] = b[0] - a[0]
    return F


@kernel
def bend(
    pose: Array, cov: Array, share: float, arrived: Array, Q: Array, node: Array, cov_from: Array, cov_to: Array
) -> None:
    """A pose on the path, `share` of it done, bent so that `arrived`, with the path's noise Q, becomes `node`."""
    miss = np.zeros((POSE, 1))
    total = Q.copy()
    for i in range(POSE):
        miss[i, 0] = node[i] - arrived[i]
        total[i, i] += 1e-14
    miss[2, 0] = wrap(miss[2, 0])
    Gt = solved(total, product(carry(pose, arrived), cov))
    G = transposed(Gt)
    step = product(G, miss)
    add_product(cov, product(G, Q), Gt, -1.0)
    for i in range(POSE):
        pose[i] += step[i, 0]
        for j in range(POSE):
            cov[i, j] += (1.0 - share) * cov_from[i, j] + share * cov_to[i, j]
