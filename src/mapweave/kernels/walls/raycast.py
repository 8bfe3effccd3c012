"""Beams against walls and people: exact planar ray casting."""

import numpy as np

from .._jit import kernel

NONE = -1  # number of the wall of a beam that meets none


@kernel
def cast(
    sensor: np.ndarray, angles: np.ndarray, segments: np.ndarray, discs: np.ndarray, far: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First hit of every beam of every scan.

    sensor: (m, 3) poses; angles: (n,) [rad]; segments: (s, 4) as x0 y0 x1 y1, or (s, 5) with the cosine of incidence
    from which on each stops a beam, as glass does; discs: (m, d, 3) as x y radius, one set a scan. Returns range (m, n)
    [m] (infinite beyond `far`), what was hit (m, n) (segment k, or s + disc, or -1), and the cosine of incidence (m, n)
    in [0, 1].
    """
    m, n, s, d = sensor.shape[0], angles.shape[0], segments.shape[0], discs.shape[1]
    glass = segments.shape[1] > 4
    rng = np.full((m, n), np.inf)
    what = np.full((m, n), NONE, dtype=np.int64)
    cosine = np.zeros((m, n))
    near = np.empty(s, dtype=np.int64)
    for i in range(m):
        px, py, heading = sensor[i, 0], sensor[i, 1], sensor[i, 2]
        count = _in_reach(px, py, segments, far, near)
        for j in range(n):
            ux, uy = np.cos(heading + angles[j]), np.sin(heading + angles[j])
            best, hit, across = far, NONE, 0.0
            for k in range(count):
                a = near[k]
                r, slant = meet(px, py, ux, uy, segments, a)
                if r < best and not (glass and slant < segments[a, 4]):
                    best, hit, across = r, a, slant
            for k in range(d):
                r, slant = meet_disc(px, py, ux, uy, discs[i, k])
                if r < best:
                    best, hit, across = r, s + k, slant
            if hit != NONE:
                rng[i, j], what[i, j], cosine[i, j] = best, hit, across
    return rng, what, cosine


@kernel
def meet(px: float, py: float, ux: float, uy: float, segments: np.ndarray, a: int) -> tuple[float, float]:
    """Where the beam from p along the unit vector u meets segment a, infinite if nowhere; cosine of incidence."""
    ex, ey = segments[a, 2] - segments[a, 0], segments[a, 3] - segments[a, 1]
    det = ux * ey - uy * ex
    if det == 0.0:
        return np.inf, 0.0
    wx, wy = segments[a, 0] - px, segments[a, 1] - py
    r = (wx * ey - wy * ex) / det
    along = (wx * uy - wy * ux) / det
    if r <= 0.0 or along < 0.0 or along > 1.0:
        return np.inf, 0.0
    return r, abs(det) / np.sqrt(ex * ex + ey * ey)


@kernel
def meet_disc(px: float, py: float, ux: float, uy: float, disc: np.ndarray) -> tuple[float, float]:
    """As `meet`, for a disc (3,) as x y radius."""
    wx, wy, radius = disc[0] - px, disc[1] - py, disc[2]
    middle = wx * ux + wy * uy
    square = radius * radius - (wx * wx + wy * wy - middle * middle)
    if radius <= 0.0 or square <= 0.0:
        return np.inf, 0.0
    r = middle - np.sqrt(square)
    return (r, np.sqrt(square) / radius) if r > 0.0 else (np.inf, 0.0)


@kernel
def _in_reach(px: float, py: float, segments: np.ndarray, far: float, out: np.ndarray) -> int:
    """Writes the segments that come nearer than `far` to `out` and returns how many."""
    count = 0
    for k in range(segments.shape[0]):
        mx, my = 0.5 * (segments[k, 0] + segments[k, 2]), 0.5 * (segments[k, 1] + segments[k, 3])
        half = 0.5 * np.hypot(segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1])
        if np.hypot(mx - px, my - py) <= far + half:
            out[count] = k
            count += 1
    return count
