"""A landmark starts: once enough sightings agree on its place, with its covariances to all that is known."""

import numpy as np

from .._jit import kernel
from .ekf_state import BEARING_BIAS, HEAD, RANGE_SCALE, Array, Noise

CANDIDATES = 8  # sightings of a landmark not yet started that are remembered


@kernel
def consider(
    x: Array,
    slot: int,
    z_range: float,
    z_bearing: float,
    noise: Noise,
    waiting: Array,
    n_waiting: Array,
) -> bool:
    """Whether a landmark not yet started may start with this sighting: enough remembered ones agree on its place.

    waiting: (slots, CANDIDATES, 2) places seen so far, the oldest overwritten; n_waiting: (slots,) how many there were.
    """
    r = z_range / x[RANGE_SCALE]
    phi = x[2] + z_bearing - x[BEARING_BIAS]
    px, py = x[0] + r * np.cos(phi), x[1] + r * np.sin(phi)
    spread = noise.range_floor**2 + (noise.range_share * r) ** 2 + (noise.bearing * r) ** 2
    agree = 1
    for k in range(min(n_waiting[slot], CANDIDATES)):
        dx, dy = waiting[slot, k, 0] - px, waiting[slot, k, 1] - py
        if dx * dx + dy * dy < 9.0 * 2.0 * spread:
            agree += 1
    k = n_waiting[slot] % CANDIDATES
    waiting[slot, k, 0], waiting[slot, k, 1] = px, py
    n_waiting[slot] += 1
    return agree >= noise.agree


@kernel
def begin(
    x: Array,
    P: Array,
    size: int,
    slot: int,
    z_range: float,
    z_bearing: float,
    noise: Noise,
) -> None:
    """Starts the landmark of `slot` from one sighting (drive applied), with its cross-covariances."""
    a = HEAD + 2 * slot
    s = x[RANGE_SCALE]
    r = z_range / s
    phi = x[2] + z_bearing - x[BEARING_BIAS]
    c, n = np.cos(phi), np.sin(phi)
    x[a] = x[0] + r * c
    x[a + 1] = x[1] + r * n
    where = np.array([0, 1, 2, BEARING_BIAS, RANGE_SCALE])
    G = np.array([[1.0, 0.0, -r * n, r * n, -r * c / s], [0.0, 1.0, r * c, -r * c, -r * n / s]])
    for i in range(2):
        for j in range(size):
            total = 0.0
            for k in range(5):
                total += G[i, k] * P[where[k], j]
            P[a + i, j] = total
    for j in range(size):
        P[j, a], P[j, a + 1] = P[a, j], P[a + 1, j]
    v0 = (noise.range_floor**2 + (noise.range_share * r) ** 2) * noise.range_inflation / (s * s)
    v1 = noise.bearing**2 * noise.bearing_inflation * r * r
    N = np.array([[c * c * v0 + n * n * v1, c * n * (v0 - v1)], [c * n * (v0 - v1), n * n * v0 + c * c * v1]])
    for i in range(2):
        for j in range(2):
            total = N[i, j]
            for k in range(5):
                total += P[a + i, where[k]] * G[j, k]
            P[a + i, a + j] = total
