"""The robot drives along its commands: pose, derivative and noise; then the covariance, once the drive is to count.

`Phi` (3, 8) is the pose's derivative by the pose and calibration the drive started from, `Q` (3, 3) the noise gathered.
Between sightings the covariance is not touched: they hold the drive since the last one.
"""

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from .ekf_state import HEAD, LAG, POSE, TURN_SCALE, V_SCALE, Array, Commands, Noise, plain


@kernel
def arc(
    x: Array,
    Phi: Array,
    Q: Array,
    v: float,
    w: float,
    dt: float,
    noise: Noise,
    known: bool,  # noqa: FBT001
) -> None:
    """The pose, its derivatives and its noise after `dt` [s] at commanded `v` [m/s] and `w` [rad/s] on an exact arc."""
    sv, sw = x[V_SCALE], x[TURN_SCALE]
    h = 0.5 * sw * w * dt
    if abs(h) < 1e-4:
        sinc, dsinc = 1.0 - h * h / 6.0, -h / 3.0
    else:
        sinc = np.sin(h) / h
        dsinc = (np.cos(h) - sinc) / h
    c, s = np.cos(x[2] + h), np.sin(x[2] + h)
    step = v * dt
    chord = sv * step * sinc
    dx, dy = chord * c, chord * s
    turn = 0.5 * w * dt  # dh / d(turn scale)
    chord_h = sv * step * dsinc
    for k in range(HEAD):
        theta = Phi[2, k]
        Phi[0, k] -= dy * theta
        Phi[1, k] += dx * theta
    Phi[0, V_SCALE] += step * sinc * c
    Phi[1, V_SCALE] += step * sinc * s
    Phi[0, TURN_SCALE] += (chord_h * c - dy) * turn
    Phi[1, TURN_SCALE] += (chord_h * s + dx) * turn
    Phi[2, TURN_SCALE] += w * dt
    # Q <- F Q F^T, F = I + [-dy, dx] on theta
    q02, q12, q22 = Q[0, 2], Q[1, 2], Q[2, 2]
    Q[0, 0] += -2.0 * dy * q02 + dy * dy * q22
    Q[0, 1] += dx * q02 - dy * q12 - dx * dy * q22
    Q[1, 1] += 2.0 * dx * q12 + dx * dx * q22
    Q[0, 2] -= dy * q22
    Q[1, 2] += dx * q22
    far, bend = abs(step), abs(w) * dt
    if known:
        rest = noise.rest_xy * noise.rest_xy * dt
        along = noise.along * noise.along * far + rest
        across = noise.across * noise.across * far + rest
        heading = noise.drift * noise.drift * far + noise.turn * noise.turn * bend + noise.rest_theta**2 * dt
    else:
        along = noise.lost_xy * noise.lost_xy * dt
        across = along
        heading = noise.lost_theta * noise.lost_theta * dt
    Q[0, 0] += c * c * along + s * s * across
    Q[0, 1] += c * s * (along - across)
    Q[1, 1] += s * s * along + c * c * across
    Q[2, 2] += heading
    Q[1, 0], Q[2, 0], Q[2, 1] = Q[0, 1], Q[0, 2], Q[1, 2]
    x[0] += dx
    x[1] += dy
    x[2] += 2.0 * h


@kernel
def drive(
    x: Array,
    Phi: Array,
    Q: Array,
    t: float,
    until: float,
    commands: Commands,
    at: int,
    noise: Noise,
) -> tuple[float, int]:
    """Drives from `t` to `until` [s]; returns the time and command then in force.

    Command i holds from its stamp + lag until the next one, but `noise.hold` at most; then, and before the first
    command was given, the robot may go anywhere. `at` is the command in force, -1 before the first.
    """
    n = len(commands.t)
    lag = x[LAG]
    while t < until:
        v = w = 0.0
        known = n > 0 and commands.t[0] <= t
        expiry = np.inf
        if at >= 0:
            expiry = commands.t[at] + lag + noise.hold
            if t < expiry:
                v, w = commands.v[at], commands.w[at]
            else:
                known, expiry = False, np.inf
        follows = commands.t[at + 1] + lag if at + 1 < n else np.inf
        end = min(until, follows, expiry)
        if end > t:
            arc(x, Phi, Q, v, w, end - t, noise, known)
            t = end
        if follows <= end:
            at += 1
            dv, dw = v - commands.v[at], w - commands.w[at]
            Phi[0, LAG] += x[V_SCALE] * dv * np.cos(x[2])
            Phi[1, LAG] += x[V_SCALE] * dv * np.sin(x[2])
            Phi[2, LAG] += x[TURN_SCALE] * dw
    return t, at


COAST_STEP = 0.1  # [s]


@kernel
def apply_drive(
    P: Array,
    size: int,
    Phi: Array,
    Q: Array,
) -> None:
    """Works the drive since the last sighting into `P` and clears it."""
    rows = np.zeros((POSE, size))
    for i in range(POSE):
        for j in range(size):
            total = 0.0
            for k in range(HEAD):
                total += Phi[i, k] * P[k, j]
            rows[i, j] = total
    for i in range(POSE):
        for j in range(POSE, size):
            P[i, j] = rows[i, j]
            P[j, i] = rows[i, j]
    for i in range(POSE):
        for j in range(i, POSE):
            total = Q[i, j]
            for k in range(HEAD):
                total += rows[i, k] * Phi[j, k]
            P[i, j] = total
            P[j, i] = total
    clear(Phi, Q)


@kernel
def clear(
    Phi: Array,
    Q: Array,
) -> None:
    """No drive since the last sighting."""
    Phi[:, :] = 0.0
    Q[:, :] = 0.0
    for i in range(POSE):
        Phi[i, i] = 1.0


@kernel
def pose_covariance(
    P: Array,
    Phi: Array,
    Q: Array,
    out: Array,
) -> None:
    """The pose's covariance now, (xx, xy, xt, yy, yt, tt) into `out`, with the drive that is not applied."""
    k = 0
    for i in range(POSE):
        for j in range(i, POSE):
            total = Q[i, j]
            for a in range(HEAD):
                inner = 0.0
                for b in range(HEAD):
                    inner += P[a, b] * Phi[j, b]
                total += Phi[i, a] * inner
            out[k] = total
            k += 1


@kernel
def coast(x: Array, P: Array, size: int, dt: float, noise: Noise) -> None:
    """`dt` [s] of a robot without odometry: it keeps speed and turn rate, and forgets them slowly.

    Then `x[V_SCALE]` is its speed [m/s] and `x[TURN_SCALE]` its turn rate [rad/s], each an Ornstein-Uhlenbeck process.
    """
    steps = max(1, cell_of(np.ceil(dt / COAST_STEP)))
    h = dt / steps
    keep_v, keep_w = np.exp(-h / noise.speed_time), np.exp(-h / noise.spin_time)
    Phi, Q = np.zeros((POSE, HEAD)), np.zeros((POSE, POSE))
    for _ in range(steps):
        clear(Phi, Q)
        arc(x, Phi, Q, 1.0, 1.0, h, noise, plain(0) > 0)
        apply_drive(P, size, Phi, Q)
        x[V_SCALE] *= keep_v
        x[TURN_SCALE] *= keep_w
        for j in range(size):
            P[V_SCALE, j] *= keep_v
            P[TURN_SCALE, j] *= keep_w
        for j in range(size):
            P[j, V_SCALE] *= keep_v
            P[j, TURN_SCALE] *= keep_w
        P[V_SCALE, V_SCALE] += noise.speed**2 * (1.0 - keep_v**2)
        P[TURN_SCALE, TURN_SCALE] += noise.spin**2 * (1.0 - keep_w**2)
