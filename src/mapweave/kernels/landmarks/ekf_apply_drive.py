"""A drive is worked into the covariance: at once for a robot with commands, step by step for one without.

Between sightings the covariance is not touched: `Phi` and `Q` of `ekf_drive` hold the drive since the last one.
"""

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from .ekf_drive import arc
from .ekf_state import HEAD, POSE, TURN_SCALE, V_SCALE, Array, Noise, plain

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
