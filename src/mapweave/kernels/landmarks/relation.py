"""What sightings between two frames say of how one lies in the other: cost, gradient and information."""

import numpy as np

from .._jit import kernel
from .submap import wrapped

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
