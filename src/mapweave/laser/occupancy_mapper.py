"""The merged grid, kept up to date: a scan whose pose moved is taken out and laid in again, exactly."""

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..kernels.laser.sweep import UNIT, lay_sweep
from .keyframes import Sweep
from .laser_map import GridMap

MARGIN = 80  # cells the arrays grow by beyond what is needed
EDGE = 2  # cells round the map that is handed over
BESIDE = 0.15  # [m] of a wall seen from near: far returns are of that wall
CLEAR = 4  # so many beams through for each far return and a cell is free all the same
TURN = float(np.radians(0.5))


class OccupancyMapper:
    """Counts of returns and beams over the cells of one resolution [m]. `update` changes them.

    All are whole numbers, sums of points too: what is taken out leaves no trace.
    """

    def __init__(self, resolution: float, near: float = np.inf) -> None:
        self.resolution, self.near = resolution, near
        self.corner = np.zeros(2, dtype=np.int64)  # cell of the arrays' lower left entry
        self.hits = np.zeros((0, 0), np.int32)
        self.far = np.zeros((0, 0), np.int32)  # returns from beyond `near`
        self.passes = np.zeros((0, 0), np.int32)
        self.sums = np.zeros((0, 0, 2), np.int64)
        self.laid = np.zeros((0, 3))  # where each sweep lies now

    def update(self, sweeps: list[Sweep], poses: Float[np.ndarray, "n 3"]) -> int:
        """Every sweep lies within half a cell and half a degree of its pose; returns how many were laid anew."""
        old = self.laid
        d = poses[: len(old)] - old
        far = np.hypot(d[:, 0], d[:, 1]) > 0.5 * self.resolution
        moved = np.flatnonzero(far | (np.abs(se2.wrap_angle(d[:, 2])) > TURN))
        for k in moved.tolist():
            self._lay(sweeps[k], self.laid[k], -1)
        new = [*moved.tolist(), *range(len(old), len(sweeps))]
        self.laid = np.concatenate([self.laid, poses[len(old) :]])
        self._grow([self._bounds(sweeps[k], poses[k]) for k in new])
        for k in new:
            self.laid[k] = poses[k]
            self._lay(sweeps[k], self.laid[k], 1)
        return len(new)

    def grid(self) -> GridMap:
        """The map so far, cut to what was seen.

        Returns scatter with their range: where a wall was seen from nearer than `near`, far ones beside it do not
        draw it again; a cell that they alone would make a wall is unknown.
        """
        h = self.resolution
        seen = self.hits + self.far + self.passes
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            shape = (2 * EDGE + 1, 2 * EDGE + 1)
            none, zero = np.zeros(shape, np.int32), np.zeros(shape)
            return GridMap(h, np.array([-EDGE * h, -EDGE * h]), none, none, np.zeros((*shape, 2)), zero, zero)
        window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        hits, far, passes = (np.pad(a[window], EDGE) for a in (self.hits, self.far, self.passes))
        beside = widened(hits > 0, max(1, round(BESIDE / h)))
        again = beside & (far > 0) & (hits == 0) & (CLEAR * far > passes)
        hits = np.where(beside, hits, hits + far)
        passes[again] = 0
        low = self.corner + np.array([cols[0], rows[0]]) - EDGE
        mean = np.zeros((*hits.shape, 2))
        row, col = np.nonzero(hits)
        cell = np.column_stack([col, row]) + low
        at = (row - EDGE + rows[0], col - EDGE + cols[0])
        mean[row, col] = h * (cell + self.sums[at] / (UNIT * (self.hits[at] + self.far[at])[:, None]))
        return GridMap(h, low * h, hits, passes, mean, np.zeros(hits.shape), hits.astype(np.float32))

    def _lay(self, sweep: Sweep, pose: np.ndarray, sign: int) -> None:
        eye = se2.act(pose, sweep.origin)
        points, ends = se2.act(pose, sweep.points), se2.act(pose, sweep.ends)
        lay_sweep(
            self.hits,
            self.far,
            self.passes,
            self.sums,
            self.corner,
            self.resolution,
            eye,
            points,
            ends,
            self.near,
            sign,
        )

    def _bounds(self, sweep: Sweep, pose: np.ndarray) -> np.ndarray:
        """Lower and upper cell [x0 y0 x1 y1] the sweep touches."""
        every = se2.act(pose, np.concatenate([sweep.origin[None], sweep.points, sweep.ends])) / self.resolution
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
