"""How many views of one map see each wall of another, and how many see through it, by how squarely they look at it."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of


class Looks(NamedTuple):
    """How views look at walls [m]."""

    reach: float  # no farther
    same: float  # a view's return within this, and
    same_share: float  # [m/m] of its range, is of the same wall
    through: float  # a view goes on behind a wall by more,
    deep: float  # and far behind it
    side: float  # cosine by more of which a view is on one side of a wall


@kernel
def judge_walls(
    poses: np.ndarray,
    views: np.ndarray,
    walls: np.ndarray,
    normals: np.ndarray,
    sided: np.ndarray,
    looks: Looks,
    squarely: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(w, b + 1) views that see each wall, that go on behind it, and of these far behind it, by cosines of incidence
    parted at `squarely` (b,).

    poses: (n, 3) of the views in the frame of the walls (w, 2) [m]; views: (n, bins) [m], the nearest return in each
    direction, infinite where there is none; normals: (w, 2) unit, of a wall that is `sided` (w,) on the side it was
    seen from. A wall further than `reach` is not asked for. It is seen where a view's return in its direction, or in
    one of those beside it, is within `same` and `same_share` of its range; seen through where all three go on for more
    than `through` or `deep`. A view from the other side does not see it.
    """
    count, bins, steps = walls.shape[0], views.shape[1], squarely.shape[0]
    seen, gone, far = np.zeros((3, count, steps + 1), np.int64)
    for k in range(poses.shape[0]):
        x, y, c, s = poses[k, 0], poses[k, 1], math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(count):
            dx, dy = walls[i, 0] - x, walls[i, 1] - y
            r = math.sqrt(dx * dx + dy * dy)
            if not r <= looks.reach:  # nor what is no number
                continue
            turn = math.atan2(c * dy - s * dx, c * dx + s * dy) / (2.0 * math.pi)
            middle = cell_of(turn * bins)
            nearest, like, known = math.inf, False, True
            for beside in range(-1, 2):
                there = views[k, (middle + beside) % bins]
                known &= there < math.inf
                like |= abs(there - r) < looks.same + looks.same_share * r
                nearest = min(nearest, there)
            if not known:
                continue
            towards = -(dx * normals[i, 0] + dy * normals[i, 1])
            band = 0
            while band < steps and abs(towards) >= squarely[band] * r:
                band += 1
            if not like:
                gone[i, band] += nearest - r > looks.through
                far[i, band] += nearest - r > looks.deep
            elif not sided[i] or towards > -looks.side * r:
                seen[i, band] += 1
    return seen, gone, far
