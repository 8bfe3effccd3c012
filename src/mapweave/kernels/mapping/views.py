"""How many views of one map see each wall of another, and how many see through it."""

import math

import numpy as np

from .._jit import kernel
from ..cells import cell_of


@kernel
def judge_walls(
    poses: np.ndarray,
    views: np.ndarray,
    walls: np.ndarray,
    sides: np.ndarray,
    reach: float,
    same: float,
    same_share: float,
    through: float,
    sided: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(w,) views that see each wall, and (w,) views that go on behind it.

    poses: (n, 3) of the views in the frame of the walls (w, 2) [m]; views: (n, bins) [m], the nearest return in each
    direction, infinite where there is none; sides: (w, 2) unit normals on the side a wall was seen from, or zero.
    A wall further than `reach` [m] is not asked for. It is seen where a view's return in its direction, or in one of
    those beside it, is within `same` [m] and `same_share` of its range; seen through where all three go on for more
    than `through` [m]. A view from the other side, by a cosine of more than `sided`, does not see it.
    """
    count, bins = walls.shape[0], views.shape[1]
    seen, gone = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for k in range(poses.shape[0]):
        x, y, c, s = poses[k, 0], poses[k, 1], math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(count):
            dx, dy = walls[i, 0] - x, walls[i, 1] - y
            r = math.sqrt(dx * dx + dy * dy)
            if not r <= reach:  # nor what is no number
                continue
            turn = math.atan2(c * dy - s * dx, c * dx + s * dy) / (2.0 * math.pi)
            middle = cell_of(turn * bins)
            nearest, like, known = math.inf, False, True
            for beside in range(-1, 2):
                there = views[k, (middle + beside) % bins]
                known &= there < math.inf
                like |= abs(there - r) < same + same_share * r
                nearest = min(nearest, there)
            if not known:
                continue
            if not like:
                gone[i] += nearest - r > through
            elif -(dx * sides[i, 0] + dy * sides[i, 1]) > -sided * r:
                seen[i] += 1
    return seen, gone
