"""How far two maps overlap under a transform, and whether one robot saw through what the other saw as walls."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from ..core import se2
from ..core.errors import DataError
from ..core.records import frozen
from .submaps import gathered

MOST_BINS, LEAST_BINS = 360, 60  # directions of a keyframe's view, wider than its beams are apart
FRAMES = 60  # keyframes asked at most
REACH = 8.0  # [m] views are compared up to
BEHIND, ALIKE = 0.4, 0.2  # [m] a wall this much nearer was seen through; one this near is the same
CLOSE = 0.6  # [m] from its walls, and a point seen through may be a wall of a bent map
WALL = 0.2  # [m] walls this near overlap
COARSE = 0.2  # [m] of the points compared


@dataclass(frozen=True, slots=True)
class KeyframeMap:
    """One robot's keyframes in the frame of its own map.

    pose: (n, 3); points: of each keyframe (k, 2) [m] in its own frame; q: their brightness, or None; path: (n,) [m]
    driven up to each keyframe; walls: (w, 2) [m] all points in the map's frame, thinned.
    """

    robot: str
    pose: Float[np.ndarray, "n 3"]
    points: Sequence[Float[np.ndarray, "_ 2"]]
    q: Sequence[Float[np.ndarray, " _"]] | None = None
    path: Float[np.ndarray, " n"] = field(init=False)
    walls: Float[np.ndarray, "w 2"] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", frozen(self.pose))
        if not len(self.pose) or len(self.points) != len(self.pose):
            raise DataError(f"map of {self.robot}: {len(self.pose)} keyframes and points of {len(self.points)}")
        steps = np.hypot(*np.diff(self.pose[:, :2], axis=0).T) if len(self.pose) > 1 else np.zeros(0)
        object.__setattr__(self, "path", frozen(np.concatenate([[0.0], np.cumsum(steps)])))
        cloud, _ = gathered(self.pose, self.points, range(len(self.pose)), np.zeros(3), COARSE)
        object.__setattr__(self, "walls", frozen(cloud))


@dataclass(frozen=True, slots=True)
class SeenAlike:
    """alike, through: points of both maps that the other robot saw as walls too, and that it saw through.

    clear: of what both saw, the share alike when points seen through close to the other's walls are left out: bent maps
    and slanted views make such points, another place makes points amid free floor.
    """

    alike: int
    through: int
    clear: float = 0.0

    @property
    def share(self) -> float:
        """Of what both saw, how much is alike; 0 when they saw nothing in common."""
        return self.alike / max(self.alike + self.through, 1)


def seen_alike(a: KeyframeMap, b: KeyframeMap, transform: Float[np.ndarray, "3"]) -> SeenAlike:
    """What each robot's views say of the other's walls, where b's map lies at `transform` in a's.

    Of the two directions the one that agrees less counts.
    """
    one = _views_of_walls(a, b, transform)
    other = _views_of_walls(b, a, se2.inverse(transform))
    least = one if one.share <= other.share else other
    return replace(least, clear=min(one.clear, other.clear))


def _views_of_walls(a: KeyframeMap, b: KeyframeMap, transform: np.ndarray) -> SeenAlike:
    """Walls of b in the views of a. A view is the nearest return in each direction; what is behind it is unknown."""
    walls = se2.act(transform, b.walls)
    tree = cKDTree(walls)
    near = [k for k in range(len(a.pose)) if len(tree.query_ball_point(a.pose[k, :2], REACH)) > 10]
    if len(near) > FRAMES:
        near = [near[k] for k in np.linspace(0, len(near) - 1, FRAMES).round().astype(int).tolist()]
    bins = _bins(a)
    same, through = np.zeros(len(walls), dtype=np.int64), np.zeros(len(walls), dtype=np.int64)
    for k in near:
        seen = np.array(tree.query_ball_point(a.pose[k, :2], REACH), dtype=np.int64)
        r_a, angle_a = _polar(a.points[k], bins)
        view = np.full(bins, np.inf)
        np.minimum.at(view, angle_a, r_a)
        r, at = _polar(se2.act(se2.inverse(a.pose[k]), walls[seen]), bins)
        around = np.stack([view[(at + d) % bins] for d in (-1, 0, 1)])
        known = np.isfinite(around).all(axis=0)
        like = known & (np.abs(around - r) < ALIKE + 0.02 * r).any(axis=0)
        same[seen] += like
        through[seen] += known & ~like & (around.min(axis=0) - r > BEHIND)
    judged = same + through > 0
    alike, unlike = judged & (same >= through), judged & (same < through)
    away = int(np.sum(np.asarray(cKDTree(a.walls).query(walls[unlike])[0]) > CLOSE)) if unlike.any() else 0
    return SeenAlike(int(alike.sum()), int(unlike.sum()), int(alike.sum()) / max(int(alike.sum()) + away, 1))


def wall_overlap(walls: Float[np.ndarray, "m 2"], b: KeyframeMap, transform: Float[np.ndarray, "3"]) -> float:
    """Share of b's walls that lie on `walls` of map a, or of those on b's, whichever is more."""
    other = se2.act(transform, gathered(b.pose, b.points, range(len(b.pose)), np.zeros(3), 0.1)[0])
    to_walls, to_other = cKDTree(walls).query(other)[0], cKDTree(other).query(walls)[0]
    return float(max(np.mean(to_walls < WALL), np.mean(to_other < WALL)))


def _bins(a: KeyframeMap) -> int:
    """Directions so wide that hardly one between two beams of the scanner stays empty."""
    gaps = [
        np.diff(np.sort(np.arctan2(p[:, 1], p[:, 0]))) for p in a.points[:: max(1, len(a.points) // 20)] if len(p) > 2
    ]
    gap = float(np.median(np.concatenate(gaps))) if gaps else 0.0
    return int(np.clip(2.0 * np.pi / max(1.5 * gap, 1e-3), LEAST_BINS, MOST_BINS))


def _polar(points: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranges [m] and the directions' bin numbers."""
    angle = np.arctan2(points[:, 1], points[:, 0])
    return np.hypot(points[:, 0], points[:, 1]), np.floor((angle / (2 * np.pi)) * bins).astype(np.int64) % bins
