"""How far two maps overlap under a transform, and whether one robot saw through what the other saw as walls."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..core import se2
from ..core.errors import DataError
from ..core.findings import Finding
from ..core.names import robot_name
from ..core.records import freeze, frozen
from ..core.rows import spread
from ..kernels.laser.place_search import fit_normals
from ..kernels.walls.sight import Looks, judge_walls
from ..laser.place_search import gathered
from ..laser.robot_graph import RobotGraph
from .submaps import PlaceSubmap, extent, make_submap, middles, way_of

VIEW_REACH = 8.0  # [m] views are compared up to
VIEW_THROUGH = 0.4  # [m] by which a view goes on behind a wall that was seen through
SAME_WALL = 0.2  # [m] and
SAME_WALL_SHARE = 0.02  # [m/m] of its range, within which a wall of the view is the same wall
CLOSE = 0.6  # [m] from its walls a point seen through may be a wall of a bent map
COARSE_POINTS = 0.2  # [m] between the points of walls that are compared
WALL_LINE = 0.5  # [m] points this near make a line,
WALL_THICK = 0.3  # which may be so thick, of its length, to have a side
SIDED = 0.2  # cosine from which on a wall was seen from that side

OFTEN = 3  # views that show a wall, and that go through it: neither was somebody who walked by
PATCH, BESIDE = 1.5, 0.45  # [m] wide at least are walls drawn twice, of points this near: doors and people are not
SEEN_THROUGH = 0.015  # of the walls of a right map at most: 30 of 31 real ones have 0.011; 50 of 55 bent ones more
WALLED = 0.97  # of what two robots of one map saw is alike, but for what is no patch: 0.99 and more in right maps
TWICE = 2  # views that say something of a wall, from which on it counts in what a map says of itself
ASKED = 60  # keyframes whose views are asked, at most,
VIEWS = 200  # and of a map by itself
MOST_BINS, LEAST_BINS = 360, 60  # directions of a keyframe's view, wider than its beams are apart
WALLS_MEET = 0.2  # [m] within which walls overlap
LIT_LEAST = 150  # points of walls that meet, at least, whose brightness is compared,
LIT_UNEVEN = 0.05  # and the standard deviation of their brightness, at least
FEW = 10  # walls within reach of a view that says nothing of them
SQUARELY = np.array([0.75, 0.9, 0.96])  # cosines of incidence from one of which on glass is seen,
DEEP = 1.0  # [m] by which views go on behind it: people who walk along a wall have it nearer behind them
PANE = 0.6  # [m] wide it is at least
LEAST_GLASS = 8  # of the points of walls, from which on it is told
GLASS_SEEN, GLASS_GONE = 2, 3  # by so many views at least, while so many go through it at more of a slant
LOOKS = Looks(VIEW_REACH, SAME_WALL, SAME_WALL_SHARE, VIEW_THROUGH, DEEP, SIDED)


@dataclass(frozen=True, slots=True)
class KeyframeMap:
    """One robot's keyframes in the frame of its own map.

    pose: (n, 3); points: of each keyframe (k, 2) [m] in its own frame; q: their brightness, or None; path: (n,) [m]
    driven up to each; walls: (w, 2) [m] points in the map's frame, thinned, but for those that the robot itself saw
    through later or before: people who walked by, doors that moved; walls_q: (w,) their brightness;
    walls_side: (w, 2) unit normals on the side they were seen from, zero where that was both or they make no line;
    glass: (g, 2) [m] of the walls those that only views which look at them squarely show, and are no `walls`;
    views: (n, bins) [m] of each keyframe the nearest return in each direction, infinite where there is none; asked: how
    many of them, at most, tell what was seen through; border: of each keyframe why a new segment begins there (none:
    nowhere one does); submaps: what it is recognised by, none over a border; through: share of its walls that make
    lines, those that some views show, which other views go through over the width of a wall; own: share of its walls
    that more of its views go through than show: people, and things that moved.
    """

    robot: str
    pose: Float[np.ndarray, "n 3"]
    points: Sequence[Float[np.ndarray, "_ 2"]]
    q: Sequence[Float[np.ndarray, " _"]] | None = None
    asked: int = ASKED
    border: Sequence[str] = ()
    submaps: tuple[PlaceSubmap, ...] = field(init=False, repr=False)
    path: Float[np.ndarray, " n"] = field(init=False)
    walls: Float[np.ndarray, "w 2"] = field(init=False, repr=False)
    walls_q: Float[np.ndarray, " w"] | None = field(init=False, repr=False)
    walls_side: Float[np.ndarray, "w 2"] = field(init=False, repr=False)
    glass: Float[np.ndarray, "g 2"] = field(init=False, repr=False)
    views: Float[np.ndarray, "n bins"] = field(init=False, repr=False)
    through: float = field(init=False)
    own: float = field(init=False)

    def __post_init__(self) -> None:
        freeze(self, "pose")
        if not len(self.pose) or len(self.points) != len(self.pose):
            raise DataError(f"map of {self.robot}: {len(self.pose)} keyframes and points of {len(self.points)}")
        steps = np.hypot(*np.diff(self.pose[:, :2], axis=0).T) if len(self.pose) > 1 else np.zeros(0)
        object.__setattr__(self, "path", frozen(np.concatenate([[0.0], np.cumsum(steps)])))
        cloud, q = self.cloud(COARSE_POINTS, self.q)
        object.__setattr__(self, "walls", frozen(cloud))
        object.__setattr__(self, "walls_q", None if q is None else frozen(q))
        lines = fit_normals(self.walls, WALL_LINE)
        object.__setattr__(self, "walls_side", frozen(self._sides(lines)))
        object.__setattr__(self, "views", frozen(self._views()))
        object.__setattr__(self, "submaps", tuple(self._submaps()))
        lined = (self.walls_side != 0.0).any(axis=1)  # legs of tables and chairs are not
        normals = np.where(lined[:, None], self.walls_side, lines[:, :2])
        seen_by, through_by, deep_by = _judged(self, self.walls, normals, lined)
        glass = (lines[:, 2] < WALL_THICK) & _as_glass(seen_by, deep_by)
        glass[glass] = _patched(self.walls[glass], PANE)
        same, through = seen_by.sum(axis=1), through_by.sum(axis=1)
        seen, both = np.maximum(same, through) >= OFTEN, np.minimum(same, through) >= OFTEN
        wide = _patched(self.walls[both & lined & ~glass], PATCH)
        object.__setattr__(self, "through", int(wide.sum()) / max(int((seen & lined).sum()), 1))
        lasting = (same >= through) & ~glass
        judged = (same + through >= TWICE) & ~glass
        object.__setattr__(self, "own", int((judged & ~lasting).sum()) / max(int(judged.sum()), 1))
        object.__setattr__(self, "glass", frozen(self.walls[glass]))
        for name in ("walls", "walls_side", "walls_q"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(values[lasting]))

    def cloud(
        self, voxel: float, values: Sequence[Float[np.ndarray, " _"]] | None = None
    ) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"] | None]:
        """All points in the map's frame, one in a square of side `voxel` [m], and the mean of `values` there."""
        return gathered(self.pose, self.points, range(len(self.pose)), np.zeros(3), voxel, values)

    def _submaps(self) -> list[PlaceSubmap]:
        starts = [0, *(k for k, why in enumerate(self.border) if why and k), len(self.pose)]
        out = []
        for start, end in pairwise(starts):
            way = way_of(self.pose[start:end])
            for anchor in middles(way):
                low, high = extent(way, anchor)
                rows = slice(start + low, start + high + 1)
                q = None if self.q is None else self.q[rows]
                new = make_submap(start + anchor, start + low, self.pose[rows], self.points[rows], q)
                out += [] if new is None else [new]
        return out

    def _sides(self, lines: Float[np.ndarray, "w 3"]) -> Float[np.ndarray, "w 2"]:
        home = [-p / np.maximum(np.hypot(*p.T), 1e-9)[:, None] for p in self.points]
        back = [u @ se2.rotation(float(pose[2])).T for u, pose in zip(home, self.pose, strict=True)]
        seen = [self.cloud(COARSE_POINTS, [u[:, k] for u in back])[1] for k in range(2)]
        facing = sum(lines[:, k] * np.asarray(seen[k]) for k in range(2))
        sided = (np.abs(facing) > SIDED) & (lines[:, 2] < WALL_THICK)
        return np.asarray(lines[:, :2] * (np.sign(facing) * sided)[:, None])

    def _views(self) -> Float[np.ndarray, "n bins"]:
        views = np.full((len(self.pose), _bins(self.points)), np.inf)
        r, at = _polar(np.concatenate(self.points), views.shape[1])
        np.minimum.at(views, (np.repeat(np.arange(len(views)), [len(p) for p in self.points]), at), r)
        return views


def keyframe_map(graph: RobotGraph, keep: Int[np.ndarray, " k"] | None = None, asked: int = ASKED) -> KeyframeMap:
    """The keyframes of one robot, or those to `keep`, as merging wants them."""
    keep = np.arange(len(graph)) if keep is None else keep
    rows = [graph.rows(i) for i in keep.tolist()]
    q = None if graph.q is None else [graph.q[r] for r in rows]
    border = [graph.border[i] for i in keep.tolist()]
    return KeyframeMap(graph.robot, graph.pose[keep], [graph.points[r] for r in rows], q, asked, border)


def seen_through(seen: KeyframeMap) -> Iterator[Finding]:
    """Whether a robot saw through more of its own walls than people, who stand nowhere for long, and doors explain."""
    if seen.through > SEEN_THROUGH:
        yield Finding("walls-seen-through", seen.robot, None, 100.0 * seen.through)
    if len(seen.glass) >= LEAST_GLASS:
        yield Finding("glass-seen", seen.robot, None, COARSE_POINTS * len(seen.glass))


def glass_returns(graph: RobotGraph, seen: KeyframeMap) -> Bool[np.ndarray, " m"]:
    """Which returns of the keyframes are of glass that `seen`, made of them all, knows."""
    if not len(seen.glass):
        return np.zeros(len(graph.points), dtype=bool)
    owner = np.repeat(np.arange(len(graph)), np.diff(graph.start))
    far, _ = cKDTree(seen.glass).query(se2.act(graph.pose[owner], graph.points), distance_upper_bound=COARSE_POINTS)
    return np.isfinite(far)


@dataclass(frozen=True, slots=True)
class SeenAlike:
    """alike, through: points of both maps that the other robot saw as walls too, and that it saw through.

    clear: of what both saw, the share alike when points seen through close to the other's walls are left out: bent maps
    and slanted views make such points, another place makes points amid free floor; walled: the same when of those only
    points count that stand in patches as wide as a wall: people and doors make others.
    """

    alike: int
    through: int
    clear: float = 0.0
    walled: float = 0.0

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
    return replace(least, clear=min(one.clear, other.clear), walled=min(one.walled, other.walled))


def _views_of_walls(a: KeyframeMap, b: KeyframeMap, transform: np.ndarray) -> SeenAlike:
    """Walls of b in the views of a."""
    walls = se2.act(transform, b.walls)
    sided = (b.walls_side != 0.0).any(axis=1)
    seen, gone, _ = _judged(a, walls, b.walls_side @ se2.rotation(float(transform[2])).T, sided)
    same, through = seen.sum(axis=1), gone.sum(axis=1)
    judged = same + through > 0
    unlike = walls[judged & (same < through)]
    away = unlike[np.asarray(cKDTree(a.walls).query(unlike)[0]) > CLOSE] if len(unlike) else unlike
    alike = int(judged.sum()) - len(unlike)
    clear, walled = (alike / max(alike + count, 1) for count in (len(away), int(_patched(away, PATCH).sum())))
    return SeenAlike(alike, len(unlike), clear, walled)


def _judged(
    a: KeyframeMap, walls: Float[np.ndarray, "w 2"], normals: Float[np.ndarray, "w 2"], sided: Bool[np.ndarray, " w"]
) -> tuple[Int[np.ndarray, "w b"], Int[np.ndarray, "w b"], Int[np.ndarray, "w b"]]:
    """How many views of a see each of these walls, see through it, and far, in the frame of a, by how squarely.

    A view is the nearest return in each direction; what is behind it is unknown. A wall that was seen from one side
    and in the view from the other says nothing.
    """
    if not len(walls):
        nothing = np.zeros((0, len(SQUARELY) + 1), dtype=np.int64)
        return nothing, nothing, nothing
    around = np.asarray(cKDTree(walls).query_ball_point(a.pose[:, :2], VIEW_REACH, return_length=True))
    near = np.flatnonzero(around > FEW)
    near = near[spread(len(near), a.asked)]
    return judge_walls(a.pose[near], a.views[near], frozen(walls), frozen(normals), sided, LOOKS, SQUARELY)


def _as_glass(seen: Int[np.ndarray, "w b"], gone: Int[np.ndarray, "w b"]) -> Bool[np.ndarray, " w"]:
    """Which walls views see that look at them squarely, and others see through."""
    glass = np.zeros(len(seen), dtype=bool)
    for least in range(1, seen.shape[1]):
        square, slant = seen[:, least:].sum(axis=1), seen[:, :least].sum(axis=1)
        passed, slipped = gone[:, least:].sum(axis=1), gone[:, :least].sum(axis=1)
        glass |= (square >= np.maximum(GLASS_SEEN, 2 * passed)) & (slipped >= np.maximum(GLASS_GONE, 2 * slant + 1))
    return glass


def drawn_twice(maps: Sequence[KeyframeMap]) -> Iterator[Finding]:
    """A finding for each two robots, their maps all in one frame, that saw through each other's walls, as wide."""
    for one, other in combinations(maps, 2):
        told = seen_alike(one, other, se2.IDENTITY)
        if told.alike and told.walled < WALLED:
            through = 100.0 * (1.0 - told.walled)
            yield Finding("walls-twice", other.robot, None, {"other": robot_name(one.robot), "value": through})


def lit_alike(a: KeyframeMap, b: KeyframeMap, transform: Float[np.ndarray, "3"]) -> float | None:
    """Correlation of the brightness of walls that meet where b lies at `transform` in a.

    None where too few meet or have a brightness, or all are equally bright.
    """
    if a.walls_q is None or b.walls_q is None or not len(a.walls) or not len(b.walls):
        return None
    far, at = cKDTree(a.walls).query(se2.act(transform, b.walls))
    met = far < WALLS_MEET
    one, other = a.walls_q[np.asarray(at)[met]], b.walls_q[met]
    if len(one) < LIT_LEAST or min(np.std(one), np.std(other)) < LIT_UNEVEN:
        return None
    return float(np.corrcoef(one, other)[0, 1])


def wall_overlap(walls: Float[np.ndarray, "m 2"], b: KeyframeMap, transform: Float[np.ndarray, "3"]) -> float:
    """Share of b's walls that lie on `walls` of map a, or of those on b's, whichever is more."""
    other = se2.act(transform, b.cloud(0.1)[0])
    to_walls, to_other = cKDTree(walls).query(other)[0], cKDTree(other).query(walls)[0]
    return float(max(np.mean(to_walls < WALLS_MEET), np.mean(to_other < WALLS_MEET)))


def _patched(points: Float[np.ndarray, "p 2"], wide: float) -> Bool[np.ndarray, " p"]:
    """Which of the points stand in a patch so wide [m] at least."""
    if not len(points):
        return np.zeros(0, dtype=bool)
    near = cKDTree(points).query_pairs(BESIDE, output_type="ndarray")
    links = sp.coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(points), len(points)))
    patches, of = connected_components(links, directed=False)
    low, high = np.full((patches, 2), np.inf), np.full((patches, 2), -np.inf)
    np.minimum.at(low, of, points)
    np.maximum.at(high, of, points)
    return np.asarray(np.hypot(*(high - low).T) >= wide)[of]


def _bins(keyframes: Sequence[Float[np.ndarray, "_ 2"]]) -> int:
    """Directions so wide that hardly one between two beams of the scanner stays empty."""
    gaps = [
        np.diff(np.sort(np.arctan2(p[:, 1], p[:, 0]))) for p in keyframes[:: max(1, len(keyframes) // 20)] if len(p) > 2
    ]
    gap = float(np.median(np.concatenate(gaps))) if gaps else 0.0
    return int(np.clip(2.0 * np.pi / max(1.5 * gap, 1e-3), LEAST_BINS, MOST_BINS))


def _polar(points: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranges [m] and the directions' bin numbers."""
    angle = np.arctan2(points[:, 1], points[:, 0])
    return np.hypot(points[:, 0], points[:, 1]), np.floor((angle / (2 * np.pi)) * bins).astype(np.int64) % bins
