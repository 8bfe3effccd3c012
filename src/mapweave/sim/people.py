"""People walking up and down where the robot drives."""

import numpy as np
from jaxtyping import Float

from .route import Route

RADIUS, SPEED, ASIDE, APART = 0.22, (0.6, 1.4), 0.6, 0.6  # [m], [m/s], [m] off the line, [m] kept from the robot


def walking(
    count: int, route: Route, t: Float[np.ndarray, " m"], robot: Float[np.ndarray, "m 3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "m d 3"], Float[np.ndarray, " d"]]:
    """Discs (m, d, 3) as x y radius at the times `t` [s], and the reflectance (d,) of their clothes.

    Each walks at its own speed between the ends of the route, turning round there; one that would stand in the robot
    is not there (radius 0).
    """
    total = route.total
    speed = rng.uniform(*SPEED, count) * np.where(rng.random(count) < 0.5, 1.0, -1.0)
    start, aside = rng.uniform(0, total, count), rng.uniform(-ASIDE, ASIDE, count)
    discs = np.zeros((len(t), count, 3))
    for k in range(count):
        way = np.abs((start[k] + speed[k] * (t - t[0]) + total) % (2 * total) - total)
        poses = route.poses(way)
        discs[:, k, 0] = poses[:, 0] - aside[k] * np.sin(poses[:, 2])
        discs[:, k, 1] = poses[:, 1] + aside[k] * np.cos(poses[:, 2])
        free = np.hypot(discs[:, k, 0] - robot[:, 0], discs[:, k, 1] - robot[:, 1]) > APART
        discs[:, k, 2] = np.where(free, RADIUS, 0.0)
    return discs, rng.uniform(0.1, 0.7, count)
