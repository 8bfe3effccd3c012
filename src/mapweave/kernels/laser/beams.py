"""Lines through neighbouring beams: normals and the cosine of incidence, by total least squares."""

import math

import numpy as np

from .._jit import kernel


@kernel
def beam_lines(
    x: np.ndarray, y: np.ndarray, r: np.ndarray, hit: np.ndarray, half: int, near: float, near_share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit normals (n, 2) towards the sensor, cosines of incidence (n,), and points (n,) each line was fitted to.

    x, y: (n,) [m], r: (n,) [m] in the sensor frame, in beam order. A neighbour within `half` beams takes part when
    its range differs by less than `near + near_share r` [m]. Under three points: the normal is the beam's own
    direction back, and the cosine is 1.
    """
    n = x.shape[0]
    normal = np.zeros((n, 2))
    cosine = np.ones(n)
    count = np.zeros(n, dtype=np.int64)
    for i in range(n):
        if not hit[i]:
            continue
        limit = near + near_share * r[i]
        m = 0
        sx = sy = sxx = sxy = syy = 0.0
        for k in range(max(0, i - half), min(n, i + half + 1)):
            if not hit[k] or abs(r[k] - r[i]) > limit:
                continue
            dx, dy = x[k] - x[i], y[k] - y[i]
            m += 1
            sx += dx
            sy += dy
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
        away = r[i] if r[i] != 0.0 else 1.0  # a return at the sensor has no direction
        bx, by = -x[i] / away, -y[i] / away
        count[i] = m
        if m < 3:
            normal[i, 0], normal[i, 1] = bx, by
            continue
        cxx = sxx - sx * sx / m
        cxy = sxy - sx * sy / m
        cyy = syy - sy * sy / m
        along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
        nx, ny = -math.sin(along), math.cos(along)
        c = nx * bx + ny * by
        if c < 0.0:
            nx, ny, c = -nx, -ny, -c
        normal[i, 0], normal[i, 1] = nx, ny
        cosine[i] = c
    return normal, cosine, count
