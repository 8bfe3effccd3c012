"""Scans at known poses as a grid map: laid at once, or kept up to date, exactly, as their poses move.

And what of it is free, occupied and unknown: the map a planner drives on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ..core import se2
from ..core.config import config
from ..core.errors import DataError
from ..core.records import freeze
from ..kernels.laser.scan_laying import UNIT, WEIGHT, CellCounts, lay_scan
from .beam import Beams, insertion_weight
from .laser_map import GridMap
from .robot_graph import RobotGraph

UNKNOWN, FREE, OCCUPIED = -1, 0, 1  # what a cell is


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Square cells over one rectangle, row 0 lowest y, column 0 lowest x.

    resolution: cell side [m]; origin: (2,) lower-left corner [m]; state: (rows, cols) int8, UNKNOWN, FREE or OCCUPIED.
    """

    resolution: float
    origin: Float[np.ndarray, "2"]
    state: Int[np.ndarray, "rows cols"]

    def __post_init__(self) -> None:
        freeze(self, "origin")
        freeze(self, "state", dtype=np.int8)

    @property
    def free(self) -> Bool[np.ndarray, "rows cols"]:
        return np.asarray(self.state == FREE)

    @property
    def occupied(self) -> Bool[np.ndarray, "rows cols"]:
        return np.asarray(self.state == OCCUPIED)

    @property
    def unknown(self) -> Bool[np.ndarray, "rows cols"]:
        return np.asarray(self.state == UNKNOWN)

    def cells(self, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """Rows (iy, ix) of the cells that hold `points` [m]; points outside come to the nearest cell of the border."""
        at = np.floor((np.asarray(points, float) - self.origin) / self.resolution).astype(np.int64)[..., ::-1]
        return np.asarray(np.clip(at, 0, np.array(self.state.shape) - 1))

    def centres(self, cells: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Middles [m] of `cells` given as rows (iy, ix)."""
        return np.asarray(self.origin + (cells[..., ::-1] + 0.5) * self.resolution)


def from_counts(
    resolution: float,
    origin: Float[np.ndarray, "2"],
    hits: Int[np.ndarray, "rows cols"],
    passes: Int[np.ndarray, "rows cols"],
    share: float,
) -> Occupancy:
    """Occupied where at least `share` of a cell's beams ended, free where others went through, unknown elsewhere.

    A wall that is seen along its face lets most beams through its cells, so `share` is well below one half.
    """
    beams = hits.astype(np.int64) + passes
    state = np.full(hits.shape, UNKNOWN, dtype=np.int8)
    state[beams > 0] = FREE
    state[(hits > 0) & (hits >= share * beams)] = OCCUPIED
    return Occupancy(resolution, origin, state)


def of_grid(grid: GridMap, share: float) -> Occupancy:
    """The occupancy of a grid map, cell by cell; see `from_counts`."""
    return from_counts(grid.resolution, grid.origin, grid.hits, grid.passes, share)


def without_gaps(map_: Occupancy) -> Occupancy:
    """The same map with gaps of up to two unknown cells between free ones known to be free.

    Beams a degree apart are 9 cm apart at 5 m: a fine map has gaps between them where nothing stands.
    """
    closed = ndimage.binary_closing(np.pad(map_.free, 2), np.ones((3, 3), dtype=bool))[2:-2, 2:-2]
    state = np.array(map_.state)
    state[map_.unknown & closed] = FREE
    return Occupancy(map_.resolution, map_.origin, state)


LAYING_BESIDE = 0.15  # [m] of a wall seen from near: far returns are of that wall
LAYING_CLEAR = 4.0  # so many beams through for each far return and a cell is free all the same
LAYING_SHIFT = 0.5  # [cells] that a scan's pose must move before it is laid anew, or
LAYING_TURN = float(np.radians(0.5))  # [rad] that it must turn

MOST_CELLS = 1e9  # of a map, which takes some thirty bytes each
MARGIN = 80  # cells the arrays grow by beyond what is needed
EDGE = 2  # cells round the map that is handed over


@runtime_checkable
class LaidScan(Protocol):
    """What a map takes of a scan, in the robot frame: as `Returns`."""

    @property
    def points(self) -> Float[np.ndarray, "n 2"]: ...
    @property
    def ends(self) -> Float[np.ndarray, "m 2"]: ...
    @property
    def origin(self) -> Float[np.ndarray, "2"]: ...
    @property
    def light(self) -> Float[np.ndarray, "n 2"] | None: ...


class Returns(NamedTuple):
    """points: (n, 2) returns, ends: (m, 2) how far silent beams are free, origin: (2,) the sensor, all [m] in the robot
    frame; light: (n, 2) feature and weight, None for no feature and weight 1.
    """

    points: Float[np.ndarray, "n 2"]
    ends: Float[np.ndarray, "m 2"]
    origin: Float[np.ndarray, "2"]
    light: Float[np.ndarray, "n 2"] | None = None


NO_ENDS = np.zeros((0, 2))


@config
class LayingConfig:
    """How scans are laid into a map that is kept up to date."""

    near: float = np.inf  # [m] a wall seen from within is not drawn again by returns from beyond


AT_ONCE = LayingConfig()


def render(
    scans: Sequence[Beams],
    poses: Float[np.ndarray, "m 3"],
    sensors: Float[np.ndarray, "m 3"],
    resolution: float,
    frame: str,
    glass: Float[np.ndarray, "g 2"] = NO_ENDS,
) -> GridMap:
    """The map of `scans` taken at `poses` (robot in `frame`) with the sensor at `sensors` on the robot."""
    laid = [Returns(b.s, NO_ENDS, T[:2], np.column_stack([b.q, b.w])) for b, T in zip(scans, sensors, strict=True)]
    return render_returns(laid, poses, resolution, frame, glass)


def keyframe_returns(graph: RobotGraph, *, lit: bool = True) -> list[Returns]:
    """The returns of every keyframe of `graph`; without `lit` no feature goes with them."""
    laid = []
    for i in range(len(graph)):
        s = graph.points[graph.rows(i)]
        q = np.zeros(len(s)) if graph.q is None or not lit else graph.q[graph.rows(i)]
        w = insertion_weight(np.hypot(*(s - graph.sensor[i]).T))
        laid.append(Returns(s, NO_ENDS, graph.sensor[i], np.column_stack([q, w])))
    return laid


def render_keyframes(graph: RobotGraph, resolution: float, frame: str) -> GridMap:
    """The map of the keyframes of `graph` alone, in the frame of its poses."""
    return render_returns(keyframe_returns(graph), graph.pose, resolution, frame, graph.panes())


def render_returns(
    laid: Sequence[LaidScan],
    poses: Float[np.ndarray, "m 3"],
    resolution: float,
    frame: str,
    glass: Float[np.ndarray, "g 2"] = NO_ENDS,
) -> GridMap:
    """The map of returns taken at `poses` (robot in `frame`). glass: returns of panes [m] in `frame`."""
    mapper = OccupancyMapper(resolution)
    mapper.update(laid, poses)
    return mapper.grid(frame, glass)


class OccupancyMapper:
    """Counts of returns and beams over the cells of one resolution [m]. `update` changes them.

    All are whole numbers, sums of points too: what is taken out leaves no trace.
    """

    def __init__(self, resolution: float, cfg: LayingConfig = AT_ONCE) -> None:
        self.resolution, self.cfg = resolution, cfg
        self.corner = np.zeros(2, dtype=np.int64)  # cell of the arrays' lower left entry
        self.hits = np.zeros((0, 0), np.int32)
        self.far = np.zeros((0, 0), np.int32)  # returns from beyond `cfg.near`
        self.passes = np.zeros((0, 0), np.int32)
        self.sums = np.zeros((0, 0, 4), np.int64)
        self.laid = np.zeros((0, 3))  # where each scan lies now

    def update(self, scans: Sequence[LaidScan], poses: Float[np.ndarray, "n 3"]) -> int:
        """Every scan lies within `shift` and `turn` of its pose; returns how many were laid anew."""
        old = self.laid
        d = poses[: len(old)] - old
        far = np.hypot(d[:, 0], d[:, 1]) > LAYING_SHIFT * self.resolution
        shifted = np.flatnonzero(far | (np.abs(se2.wrap_angle(d[:, 2])) > LAYING_TURN))
        for k in shifted.tolist():
            self._lay(scans[k], self.laid[k], -1)
        new = [*shifted.tolist(), *range(len(old), len(scans))]
        self.laid = np.concatenate([self.laid, poses[len(old) :]])
        self._grow([self._bounds(scans[k], poses[k]) for k in new])
        for k in new:
            self.laid[k] = poses[k]
            self._lay(scans[k], self.laid[k], 1)
        return len(new)

    def grid(self, frame: str = "map", glass: Float[np.ndarray, "g 2"] = NO_ENDS) -> GridMap:
        """The map so far, cut to what was seen.

        Beams that went through cells in which returns of `glass` [m] lie say nothing of them. Returns scatter with
        their range: where a wall was seen from nearer than `near`, far ones beside it do not draw it again; a cell that
        they alone would make a wall is unknown.
        """
        h = self.resolution
        seen = self.hits + self.far + self.passes
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            shape = (2 * EDGE + 1, 2 * EDGE + 1)
            none, zero = np.zeros(shape, np.int32), np.zeros(shape)
            return GridMap(h, np.array([-EDGE * h, -EDGE * h]), none, none, np.zeros((*shape, 2)), zero, zero, frame)
        window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        hits, far, passes = (np.pad(a[window], EDGE) for a in (self.hits, self.far, self.passes))
        if far.any():
            beside = widened(hits > 0, max(1, round(LAYING_BESIDE / h)))
            again = beside & (far > 0) & (hits == 0) & (LAYING_CLEAR * far > passes)
            hits = np.where(beside, hits, hits + far)
            passes[again] = 0
        low = self.corner + np.array([cols[0], rows[0]]) - EDGE
        pane = np.floor(glass / h).astype(np.int64) - low
        x, y = pane[((pane >= 0) & (pane < hits.T.shape)).all(axis=1)].T
        passes[y, x] = np.where(hits[y, x] > 0, 0, passes[y, x])
        mean, feature, weight = np.zeros((*hits.shape, 2)), np.zeros(hits.shape), np.zeros(hits.shape)
        row, col = np.nonzero(hits)
        cell = np.column_stack([col, row]) + low
        at = (row - EDGE + rows[0], col - EDGE + cols[0])
        sums, returns = self.sums[at], self.hits[at] + self.far[at]
        parts = UNIT * np.maximum(sums[:, 3:], 1)
        mean[row, col] = h * (cell + sums[:, :2] / parts)
        feature[row, col] = sums[:, 2] / parts[:, 0]
        weight[row, col] = sums[:, 3] / WEIGHT * hits[row, col] / returns  # of those returns that count
        return GridMap(h, low * h, hits, passes, mean, feature, weight, frame)

    def _lay(self, scan: LaidScan, pose: np.ndarray, sign: int) -> None:
        sensor = se2.act(pose, scan.origin)
        points, ends = se2.act(pose, scan.points), se2.act(pose, scan.ends)
        light = scan.light if scan.light is not None else np.tile([0.0, 1.0], (len(points), 1))
        counts = CellCounts(self.hits, self.far, self.passes, self.sums, self.corner, self.resolution)
        lay_scan(counts, sensor, points, light, ends, self.cfg.near, sign)

    def _bounds(self, scan: LaidScan, pose: np.ndarray) -> np.ndarray:
        """Lower and upper cell [x0 y0 x1 y1] the scan touches."""
        every = se2.act(pose, np.concatenate([scan.origin[None], scan.points, scan.ends])) / self.resolution
        return np.concatenate([np.floor(every.min(axis=0)), np.floor(every.max(axis=0))]).astype(np.int64)

    def _grow(self, bounds: list[np.ndarray]) -> None:
        if not bounds:
            return
        every = np.array(bounds)
        low, high = every[:, :2].min(axis=0), every[:, 2:].max(axis=0) + 1
        rows, cols = self.hits.shape
        upper = self.corner + np.array([cols, rows])
        if self.hits.size:
            if (low >= self.corner).all() and (high <= upper).all():
                return
            low = np.where(low < self.corner, low - MARGIN, self.corner)
            high = np.where(high > upper, high + MARGIN, upper)
        dx, dy = (self.corner - low if self.hits.size else np.zeros(2, dtype=np.int64)).tolist()
        width, height = (high - low).tolist()
        if width * height > MOST_CELLS:
            raise DataError(
                f"a map of {width:.3g} x {height:.3g} cells of {self.resolution:g} m: expected at most {MOST_CELLS:g}"
            )
        for name in ("hits", "far", "passes", "sums"):
            old = getattr(self, name)
            new = np.zeros((height, width, *old.shape[2:]), old.dtype)
            new[dy : dy + rows, dx : dx + cols] = old
            setattr(self, name, new)
        self.corner = low


def widened(cells: Bool[np.ndarray, "rows cols"], by: int) -> Bool[np.ndarray, "rows cols"]:
    """The cells within `by` columns and `by` rows of one that is set."""
    out = cells
    for _ in range(2):
        near = out.copy()
        for k in range(1, by + 1):
            near[:, k:] |= out[:, :-k]
            near[:, :-k] |= out[:, k:]
        out = near.T
    return np.asarray(out)
