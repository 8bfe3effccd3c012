"""Keyframes gathered into submaps, and what is looked for in them.

Inputs are plain arrays: keyframe poses (n, 3) in one frame, and for each keyframe its points (k, 2) in its own frame
[m], with their brightness q (k,) where the scanner tells it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.records import frozen
from ..core.rows import spread
from .place_search import (
    Fit,
    LikelihoodField,
    PlaceConfig,
    PlacesFound,
    Window,
    everywhere,
    likelihood_field,
    refine,
    search,
)

Cloud = Float[np.ndarray, "n 2"]
Clouds = Sequence[Float[np.ndarray, "_ 2"]]
Lights = Sequence[Float[np.ndarray, " _"]]


@config
class LaserSubmapConfig:
    around: int = 12  # keyframes before and after the one in the middle
    voxel: float = 0.05  # [m] a submap's points are means of squares this wide
    query_before: int = 8  # keyframes before the last one that a query holds
    query_voxel: float = 0.15  # [m] a side: one point of the scan is tried in each
    query_points: int = 400  # of the scan that are tried, at most


@dataclass(frozen=True, slots=True)
class LaserSubmap:
    """The walls seen from keyframes first to last (both in it), in the frame of keyframe `anchor`."""

    anchor: int
    first: int
    last: int
    field: LikelihoodField


@dataclass(frozen=True, slots=True)
class Query:
    """Points looked for in a place. points: (n, 2) [m] in the frame of keyframe `anchor`; q: (n,) or None."""

    anchor: int
    points: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"] | None


@dataclass(frozen=True, slots=True)
class PlaceMatch:
    """A query in a place: where it fits, how well compared with the second place, and the refined pose.

    fit: None where nothing was found. correction: [m] between the found pose and the refined one.
    """

    places: PlacesFound
    fit: Fit | None
    correction: float


def submap_around(
    poses: Float[np.ndarray, "n 3"],
    points: Clouds,
    anchor: int,
    q: Lights | None = None,
    cfg: LaserSubmapConfig | None = None,
    place: PlaceConfig | None = None,
) -> LaserSubmap:
    """The submap around keyframe `anchor`; at the ends of the trajectory it holds fewer keyframes."""
    cfg = cfg or LaserSubmapConfig()
    first, last = max(0, anchor - cfg.around), min(len(poses) - 1, anchor + cfg.around)
    cloud, light = gathered(poses, points, range(first, last + 1), poses[anchor], cfg.voxel, q)
    return LaserSubmap(anchor, first, last, likelihood_field(cloud, light, place))


def query_at(
    poses: Float[np.ndarray, "n 3"],
    points: Clouds,
    anchor: int,
    q: Lights | None = None,
    cfg: LaserSubmapConfig | None = None,
) -> Query:
    """What keyframe `anchor` and those just before it saw, thinned evenly to the points a search takes."""
    cfg = cfg or LaserSubmapConfig()
    members = range(max(0, anchor - cfg.query_before), anchor + 1)
    return _thinned(anchor, *gathered(poses, points, members, poses[anchor], cfg.query_voxel, q), cfg)


def query_around(
    poses: Float[np.ndarray, "n 3"],
    points: Clouds,
    anchor: int,
    q: Lights | None = None,
    cfg: LaserSubmapConfig | None = None,
) -> Query:
    """What keyframe `anchor` and those before and after it saw, as many as a submap has, thinned evenly."""
    cfg = cfg or LaserSubmapConfig()
    members = range(max(0, anchor - cfg.around), min(len(poses) - 1, anchor + cfg.around) + 1)
    return _thinned(anchor, *gathered(poses, points, members, poses[anchor], cfg.query_voxel, q), cfg)


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
    """One point, and one q, for every square of a grid that holds any: their mean. Ordered by row, then column."""
    if not len(points):
        return points, q
    at = np.floor(points / voxel).astype(np.int64)
    at -= at.min(axis=0)
    key = at[:, 1] * (int(at[:, 0].max()) + 1) + at[:, 0]
    _, which, count = np.unique(key, return_inverse=True, return_counts=True)
    mean = [np.bincount(which, points[:, k]) / count for k in range(2)]
    return np.column_stack(mean), None if q is None else np.bincount(which, q) / count


def locate(
    query: Query,
    place: LikelihoodField,
    window: Window | None = None,
    *,
    least: float = 0.0,
    least_ratio: float = 0.0,
) -> PlaceMatch:
    """The query searched in `place` (everywhere, when no window is given) and refined where it fits best."""
    window = everywhere(place) if window is None else window
    places = search(place, query.points, window, query.q, least=least, least_ratio=least_ratio)
    if places.best is None:
        return PlaceMatch(places, None, 0.0)
    fit = refine(place, query.points, places.best.pose)
    return PlaceMatch(places, fit, float(np.hypot(*(fit.pose[:2] - places.best.pose[:2]))))


def _thinned(anchor: int, cloud: Cloud, light: Float[np.ndarray, " n"] | None, cfg: LaserSubmapConfig) -> Query:
    keep = spread(len(cloud), cfg.query_points)
    cloud, light = cloud[keep], None if light is None else light[keep]
    return Query(anchor, frozen(cloud), None if light is None else frozen(light))
