"""The map of connected robots, in squares that are drawn anew where something changed and nowhere else."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.errors import EstimateError
from ..kernels.laser.scan_laying import CellCounts, lay_scan
from ..laser.occupancy_mapper import LAYING_SHIFT, LAYING_TURN
from .driven import Seen
from .tiles import COARSER, LEVELS, SIDE, Cells, cells_of, coarser, pack

MOST_SQUARES = 1 << 31  # from the origin: cells are counted in 63 bits
MOST_ACROSS = 64  # squares along an axis that one keyframe sees: it is laid in memory of its own
NO_ENDS = np.zeros((0, 2))
SquareKey = tuple[int, int, int]  # level, column and row


class UnmappableError(EstimateError):
    """A keyframe of `robot` that no map can hold."""

    def __init__(self, robot: str, why: str) -> None:
        super().__init__(why)
        self.robot = robot


class Standing(NamedTuple):
    """The keyframes of one robot. ids: (n,) what each is known by, growing; pose: (n, 3) of each."""

    ids: Int[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]


NOTHING = Standing(np.zeros(0, np.int64), np.zeros((0, 3)))


@dataclass(slots=True)
class TileMapper:
    """Counts of returns and beams in cells of `resolution` [m], kept for the squares in which anything was seen.

    laid: robot -> where each of its keyframes lies now, NaN before it is laid; packed: the squares of every level as
    they were drawn last. What is taken out leaves no trace: counts are whole numbers.
    """

    resolution: float
    laid: dict[str, Standing] = field(default_factory=dict)
    packed: dict[SquareKey, bytes] = field(default_factory=dict)
    _counts: dict[tuple[int, int], Int[np.ndarray, "2 side side"]] = field(default_factory=dict)
    _cells: list[dict[tuple[int, int], Cells]] = field(default_factory=lambda: [{} for _ in range(LEVELS)])
    _changed: set[tuple[int, int]] = field(default_factory=set)

    def update(
        self,
        standing: Mapping[str, Standing],
        seen: Callable[[str, int], Seen],
        most: int,
    ) -> int:
        """Lay keyframes that are not where `standing` says, `most` of them; how many are left for another time.

        Those that were not laid yet come first, then those that moved, the latest ones before others. What is not in
        `standing` any more is taken out at once. seen: what the keyframe of that id saw, the same whenever it is asked,
        of those that went too. Raises UnmappableError for a robot that no
        map can hold: begin a new one without it.
        """
        fresh: list[tuple[str, int]] = []
        shifted: list[tuple[str, int]] = []
        for robot, (ids, pose) in standing.items():
            old = self._aligned(robot, ids, seen)
            d = pose - old
            new = np.isnan(d[:, 0])
            far = np.hypot(d[:, 0], d[:, 1]) > LAYING_SHIFT * self.resolution
            turned = np.abs(se2.wrap_angle(np.where(new, 0.0, d[:, 2]))) > LAYING_TURN
            fresh += [(robot, int(k)) for k in np.flatnonzero(new)]
            shifted += [(robot, int(k)) for k in np.flatnonzero(far | turned)[::-1]]
        off = [*fresh, *shifted]
        for robot, k in off[:most]:
            ids, pose = standing[robot]
            try:
                self._lay(robot, k, pose[k], seen(robot, int(ids[k])))
            except EstimateError as error:
                raise UnmappableError(robot, str(error)) from None
        return max(len(off) - most, 0)

    def _aligned(
        self, robot: str, ids: Int[np.ndarray, " n"], seen: Callable[[str, int], Seen]
    ) -> Float[np.ndarray, "n 3"]:
        """Where keyframes `ids` lie, NaN where they do not yet; others of the robot are taken out."""
        old = self.laid.get(robot, NOTHING)
        if not np.array_equal(old.ids, ids):
            pose = np.full((len(ids), 3), np.nan)
            there = np.isin(old.ids, ids)
            pose[np.searchsorted(ids, old.ids[there])] = old.pose[there]
            for k in np.flatnonzero(~there & ~np.isnan(old.pose[:, 0])).tolist():
                self._count(old.pose[k], seen(robot, int(old.ids[k])), -1)
            self.laid[robot] = Standing(ids, pose)
        return self.laid[robot].pose

    def _lay(self, robot: str, k: int, pose: Float[np.ndarray, "3"], seen: Seen) -> None:
        before = self.laid[robot].pose[k]
        if not np.isnan(before[0]):
            self._count(before, seen, -1)
        self._count(pose, seen, 1)
        self.laid[robot].pose[k] = pose

    def draw(self) -> Mapping[SquareKey, bytes]:
        """The squares of every level, those that changed drawn anew."""
        for at in self._changed:
            hits, passes = self._counts[at]
            self._put(0, at, cells_of(hits, passes))
        above: Iterable[tuple[int, int]] = self._changed
        for level in range(1, LEVELS):
            above = {(i // COARSER, j // COARSER) for i, j in above}
            for i, j in above:
                self._put(level, (i, j), coarser(i, j, self._cells[level - 1]))
        self._changed = set()
        return self.packed

    def _put(self, level: int, at: tuple[int, int], cells: Cells) -> None:
        key = (level, *at)
        if cells.any():
            self._cells[level][at] = cells
            self.packed[key] = pack(cells)
        else:
            self._cells[level].pop(at, None)
            self.packed.pop(key, None)
            if level == 0:
                self._counts.pop(at, None)

    def _count(self, pose: Float[np.ndarray, "3"], seen: Seen, sign: int) -> None:
        if not len(seen.points):
            return
        eye, points = np.asarray(se2.act(pose, seen.sensor)), np.asarray(se2.act(pose, seen.points))
        every = np.vstack([eye, points]) / (self.resolution * SIDE)
        if not (np.abs(every) < MOST_SQUARES).all() or not (np.ptp(every, axis=0) < MOST_ACROSS).all():
            raise EstimateError(f"a keyframe at {pose} whose returns no map can hold")
        low, high = np.floor(every.min(axis=0)).astype(np.int64), np.floor(every.max(axis=0)).astype(np.int64)
        columns, rows = (high - low + 1).tolist()
        hits, passes = np.zeros((2, rows * SIDE, columns * SIDE), np.int32)
        counts = CellCounts(hits, hits, passes, _unread(hits.shape), SIDE * low, self.resolution)
        lay_scan(counts, eye, points, np.zeros((len(points), 2)), NO_ENDS, np.inf, 1)
        for j in range(rows):
            for i in range(columns):
                square = np.s_[SIDE * j : SIDE * (j + 1), SIDE * i : SIDE * (i + 1)]
                if not (passes[square].any() or hits[square].any()):
                    continue
                at = (int(low[0]) + i, int(low[1]) + j)
                if at not in self._counts:
                    self._counts[at] = np.zeros((2, SIDE, SIDE), np.int32)
                self._counts[at][0] += sign * hits[square]
                self._counts[at][1] += sign * passes[square]
                self._changed.add(at)


def _unread(shape: tuple[int, ...]) -> Int[np.ndarray, "rows cols 4"]:
    """Sums over cells that nobody reads, all in one place."""
    return np.lib.stride_tricks.as_strided(np.zeros(4, np.int64), (*shape, 4), (0, 0, 8))
