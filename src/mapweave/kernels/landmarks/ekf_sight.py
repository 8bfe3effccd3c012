"""A sighting of a landmark the map has is worked in: its rank two of the covariance is held back, then released."""

import numpy as np

from .._jit import kernel
from .ekf_state import BEARING_BIAS, HEAD, RANGE_SCALE, Array, Noise, quadratic, wrap

DOUBT = 3  # far sightings in a row that are taken for wrong labels


@kernel
def sight(
    x: Array, P: Array, U: Array, held: int, slot: int, z_range: float, z_bearing: float, noise: Noise, astray: Array
) -> tuple[float, float]:
    """One sighting of a started landmark worked into `x`, its rank two of `P` into U[held : held + 2]: (NIS, weight).

    The covariance is `P - U[:held]^T U[:held]`: a frame's sightings are worked in one by one, but `P`, large, is
    passed over once. Noise is taken at the predicted distance: the measured one favours short readings. A sighting
    far from the prediction counts less, by `trust`, never nothing.
    """
    size = len(x)
    a = HEAD + 2 * slot
    dx, dy = x[a] - x[0], x[a + 1] - x[1]
    r = max(np.sqrt(dx * dx + dy * dy), 1e-6)
    s = x[RANGE_SCALE]
    e0 = z_range - s * r
    e1 = wrap(z_bearing - np.arctan2(dy, dx) + x[2] - x[BEARING_BIAS])
    where = np.array([0, 1, 2, BEARING_BIAS, RANGE_SCALE, a, a + 1])
    ux, uy = dx / r, dy / r
    gx, gy = -dy / (r * r), dx / (r * r)
    H = np.array([[-s * ux, -s * uy, 0.0, 0.0, r, s * ux, s * uy], [-gx, -gy, -1.0, 1.0, 0.0, gx, gy]])
    PHt = np.zeros((2, size))
    for k in range(7):
        add(PHt[0], P[where[k]], H[0, k])
        add(PHt[1], P[where[k]], H[1, k])
    for q in range(held):
        h0 = h1 = 0.0
        for k in range(7):
            h0 += H[0, k] * U[q, where[k]]
            h1 += H[1, k] * U[q, where[k]]
        add(PHt[0], U[q], -h0)
        add(PHt[1], U[q], -h1)
    s00 = s01 = s11 = 0.0
    for k in range(7):
        j = where[k]
        s00 += H[0, k] * PHt[0, j]
        s01 += H[0, k] * PHt[1, j]
        s11 += H[1, k] * PHt[1, j]
    r0 = noise.range_floor**2 + (noise.range_share * r) ** 2
    r1 = noise.bearing**2
    nis = quadratic(e0, e1, s00 + r0, s01, s11 + r1)
    d = np.sqrt(nis)
    weight = trust(d, noise, astray)
    l00 = np.sqrt(s00 + r0 * noise.range_inflation / weight)  # S = L L^T, U = L^-1 H P
    l10 = s01 / l00
    l11 = np.sqrt(s11 + r1 * noise.bearing_inflation / weight - l10 * l10)
    y0 = e0 / l00
    y1 = (e1 - l10 * y0) / l11
    for j in range(size):
        u0 = PHt[0, j] / l00
        u1 = (PHt[1, j] - l10 * u0) / l11
        U[held, j], U[held + 1, j] = u0, u1
        x[j] += u0 * y0 + u1 * y1
    return nis, weight


@kernel
def trust(d: float, noise: Noise, astray: Array) -> float:
    """How much a sighting of normalised innovation `d` counts: all, gate / d, and beyond `far` less by its square.

    That last only while few far ones have come in a row, counted in astray[0]: then it is a wrong label. When all
    are far it is the robot that is elsewhere, and it must find back.
    """
    if d <= noise.gate:
        astray[0] = 0
        return 1.0
    weight: float = noise.gate / d
    if d > noise.far:
        astray[0] += 1
        if astray[0] <= DOUBT:
            weight *= (noise.far / d) ** 2
    return weight


@kernel
def add(to: Array, row: Array, factor: float) -> None:
    """`to += factor * row`, contiguous."""
    for j in range(len(to)):
        to[j] += factor * row[j]


@kernel
def release(P: Array, U: Array, held: int) -> None:
    """`P -= U[:held]^T U[:held]`, symmetric to the bit; `held` is even."""
    n = len(P)
    for i in range(n):
        row = P[i]
        q = 0
        while q + 4 <= held:
            a, b, c, d = U[q], U[q + 1], U[q + 2], U[q + 3]
            ai, bi, ci, di = a[i], b[i], c[i], d[i]
            for j in range(n):
                row[j] -= (ai * a[j] + bi * b[j]) + (ci * c[j] + di * d[j])
            q += 4
        if q < held:
            a, b = U[q], U[q + 1]
            ai, bi = a[i], b[i]
            for j in range(n):
                row[j] -= ai * a[j] + bi * b[j]
