"""The map of robots that hang together, in squares that are drawn anew where something changed and nowhere else."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..kernels.laser.sweep import lay_sweep
from .tile_bytes import SIDE, pack
from .tiles import COARSER, LEVELS, Cells, cells_of, coarser

SHIFT = 0.5  # [cells] that a pose moves before its returns are laid anew, or
TURN = float(np.radians(0.5))  # [rad] that it turns
NO_ENDS = np.zeros((0, 2))
SquareKey = tuple[int, int, int]  # level, column and row


class Seen(NamedTuple):
    """points: (n, 2) returns and sensor: (2,) where they were seen from [m], in the robot's frame."""

    points: Float[np.ndarray, "n 2"]
    sensor: Float[np.ndarray, "2"]


@dataclass(slots=True)
class Canvas:
    """Counts of returns and beams in cells of `resolution` [m], kept for the squares in which anything was seen.

    laid: robot -> where each of its keyframes lies now (n, 3), NaN before it is laid; packed: the squares of every
    level as they were drawn last. What is taken out leaves no trace: counts are whole numbers.
    """

    resolution: float
    laid: dict[str, Float[np.ndarray, "n 3"]] = field(default_factory=dict)
    packed: dict[SquareKey, bytes] = field(default_factory=dict)
    _counts: dict[tuple[int, int], Int[np.ndarray, "2 side side"]] = field(default_factory=dict)
    _cells: list[dict[tuple[int, int], Cells]] = field(default_factory=lambda: [{} for _ in range(LEVELS)])
    _changed: set[tuple[int, int]] = field(default_factory=set)

    def update(
        self,
        poses: Mapping[str, Float[np.ndarray, "n 3"]],
        seen: Callable[[str, int], Seen],
        most: int,
    ) -> int:
        """Lay keyframes that are not where `poses` say, `most` of them; how many are left for another time.

        Those that were not laid yet come first, then those that moved, the latest ones before others. seen: what
        keyframe number k of a robot saw, the same whenever it is asked.
        """
        fresh: list[tuple[str, int]] = []
        moved: list[tuple[str, int]] = []
        for robot, pose in poses.items():
            old = self.laid.get(robot, np.zeros((0, 3)))
            if len(old) < len(pose):
                old = np.concatenate([old, np.full((len(pose) - len(old), 3), np.nan)])
                self.laid[robot] = old
            d = pose - old[: len(pose)]
            new = np.isnan(d[:, 0])
            far = np.hypot(d[:, 0], d[:, 1]) > SHIFT * self.resolution
            turned = np.abs(se2.wrap_angle(np.where(new, 0.0, d[:, 2]))) > TURN
            fresh += [(robot, int(k)) for k in np.flatnonzero(new)]
            moved += [(robot, int(k)) for k in np.flatnonzero(far | turned)[::-1]]
        off = [*fresh, *moved]
        for robot, k in off[:most]:
            self._lay(robot, k, poses[robot][k], seen(robot, k))
        return max(len(off) - most, 0)

    def _lay(self, robot: str, k: int, pose: Float[np.ndarray, "3"], seen: Seen) -> None:
        before = self.laid[robot][k]
        if not np.isnan(before[0]):
            self._count(before, seen, -1)
        self._count(pose, seen, 1)
        self.laid[robot][k] = pose

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
        low, high = np.floor(every.min(axis=0)).astype(np.int64), np.floor(every.max(axis=0)).astype(np.int64)
        columns, rows = (high - low + 1).tolist()
        hits, passes = np.zeros((2, rows * SIDE, columns * SIDE), np.int32)
        lay_sweep(
            hits,
            hits,
            passes,
            _unread(hits.shape),
            SIDE * low,
            self.resolution,
            eye,
            points,
            np.zeros((len(points), 2)),
            NO_ENDS,
            np.inf,
            1,
        )
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
