"""Keyframes gathered into one cloud, and what is looked for in a place.

Inputs are plain arrays: keyframe poses (n, 3) in one frame, and for each keyframe its points (k, 2) in its own frame
[m], with their brightness q (k,) where the scanner tells it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import EstimateError
from ..core.records import frozen
from ..core.rows import spread

MOST_VOXELS = 1 << 31  # along an axis, so that one number of 63 bits tells both
Cloud = Float[np.ndarray, "n 2"]
Clouds = Sequence[Float[np.ndarray, "_ 2"]]
Lights = Sequence[Float[np.ndarray, " _"]]


VOXEL = 0.15  # [m] a side: one point of a query is tried in each,
MOST = 400  # points, at most


@dataclass(frozen=True, slots=True)
class Query:
    """Points looked for in a place. points: (n, 2) [m] in the frame of keyframe `anchor`; q: (n,) or None."""

    anchor: int
    points: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"] | None


def query_around(
    poses: Float[np.ndarray, "n 3"], points: Clouds, anchor: int, around: int, q: Lights | None = None
) -> Query:
    """What keyframe `anchor` and the `around` before and after it saw, thinned evenly to the points a search takes."""
    members = range(max(0, anchor - around), min(len(poses) - 1, anchor + around) + 1)
    cloud, light = gathered(poses, points, members, poses[anchor], VOXEL, q)
    keep = spread(len(cloud), MOST)
    return Query(anchor, frozen(cloud[keep]), None if light is None else frozen(light[keep]))


def gathered(
    poses: Float[np.ndarray, "n 3"],
    points: Clouds,
    members: Sequence[int],
    frame: Float[np.ndarray, "3"],
    voxel: float,
    q: Lights | None = None,
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"] | None]:
    """The points of keyframes `members` seen from pose `frame`, and their q: the means of squares `voxel` [m] wide."""
    if not len(members):
        return np.zeros((0, 2)), None if q is None else np.zeros(0)
    seen = [se2.act(se2.between(frame, poses[k]), points[k]) for k in members]
    light = None if q is None else np.concatenate([q[k] for k in members])
    return voxelled(np.concatenate(seen), voxel, light)


def voxelled(
    points: Cloud, voxel: float, q: Float[np.ndarray, " n"] | None = None
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"] | None]:
    """One point, and one q, for every square of a grid that holds any: their mean. Ordered by row, then column.

    Raises EstimateError for points that lie farther out or apart than `MOST_VOXELS` of them.
    """
    if not len(points):
        return points, q
    low = points.min(axis=0)
    if not (np.ptp(points, axis=0) < MOST_VOXELS * voxel).all() or not (np.abs(low) < MOST_VOXELS * voxel).all():
        raise EstimateError(f"points from {low} to {points.max(axis=0)} m are no submap")
    at = np.floor(points / voxel).astype(np.int64)
    at -= at.min(axis=0)
    key = at[:, 1] * (int(at[:, 0].max()) + 1) + at[:, 0]
    _, which, count = np.unique(key, return_inverse=True, return_counts=True)
    mean = [np.bincount(which, points[:, k]) / count for k in range(2)]
    return np.column_stack(mean), None if q is None else np.bincount(which, q) / count
