"""The grid maps of many particles: one pool of tiles, shared until written to."""

import mmap
import sys

import numpy as np
from jaxtyping import Float, Int

from ..core.config import config
from ..kernels.laser import tiles
from ..kernels.laser.tiles import NearestRule, TileBooks, TileMaps, score

MOST_WEIGHT = 30.0  # W is capped, so that a map can still change
CELL_CAP = 0.04  # [m^2] greatest D a beam is charged

Rows = Int[np.ndarray, " p"]
Poses = Float[np.ndarray, "p 3"]
NOTHING = np.zeros(0, np.float32)
BLOCK = 2  # tiles along a block: the table grows by blocks
MARGIN = 1  # blocks kept empty around what is written, so that a clamped search finds nothing


def growing_memory(size: int) -> mmap.mmap | None:
    """Zeros that can grow in place, without a copy beside them; None where the system has no such memory."""
    if sys.platform == "linux":
        return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return None


@config
class CellConfig:
    size: float = 0.1  # cell [m]
    alpha: float = 1.0  # [m^2 per q^2] what a difference in the feature counts


class ParticleGrid:
    """`maps` maps over one growing rectangle. It owns its arrays: `insert` and `resample` change it in place."""

    def __init__(self, maps: int, cfg: CellConfig) -> None:
        self.cfg = cfg
        self.tile = cfg.size * tiles.CELLS
        self.corner = np.array([-8, -8]) * BLOCK  # tile coordinates of the table's lower left corner
        self.shape = np.array([16, 16]) * BLOCK  # tiles along y, x
        self.table = np.zeros((maps, int(self.shape.prod())), np.int32)
        self.used = np.zeros((maps, 64), np.int32)
        self.n_used = np.zeros(maps, np.int64)
        self._memory = growing_memory(tiles.FLOATS * 4)
        self.pool = NOTHING
        self._more_memory(tiles.FLOATS * 4)
        self.pool[:] = np.tile(np.array([tiles.FAR, tiles.FAR, 0.0, 0.0], np.float32), tiles.CELLS**2)
        self.refs, self.free, self.n_free = np.ones(1, np.int32), np.zeros(1, np.int32), 0
        self.jobs = np.empty((1, 2), np.int32)
        self._allocate(max(64, maps))

    def __len__(self) -> int:
        return len(self.table)

    @property
    def origin(self) -> Float[np.ndarray, "2"]:
        return np.asarray(self.corner * self.tile)

    @property
    def tile_maps(self) -> TileMaps:
        """The maps as kernels take them, until something is inserted or resampled."""
        return TileMaps(self.pool, self.table, int(self.shape[1]), self.origin, self.cfg.size)

    @property
    def _books(self) -> TileBooks:
        return TileBooks(self.used, self.n_used, self.refs, self.free, self.n_free)

    @property
    def tiles_in_use(self) -> int:
        return len(self.refs) - 1 - self.n_free

    @property
    def bytes_of_tiles(self) -> int:
        return self.tiles_in_use * tiles.FLOATS * 4

    @property
    def bytes_unshared(self) -> int:
        """What the same maps would take if each had its own tiles."""
        return int(self.n_used.sum()) * tiles.FLOATS * 4

    def score(self, rows: Rows, poses: Poses, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "p n"]:
        """Least D of each beam in each map, at most `cap`; (P, n) float32."""
        out = np.empty((len(poses), len(points)), np.float32)
        score(self.tile_maps, rows, poses, points, NearestRule(self.cfg.alpha, CELL_CAP), out)
        return out

    def insert(
        self, rows: Rows, poses: Poses, points: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"]
    ) -> None:
        """The scan laid into the maps `rows` (each at most once) at `poses`; points, weights: float32."""
        if not len(points):
            return
        reach = float(np.sqrt((points[:, :2] ** 2).sum(axis=1).max())) + self.cfg.size
        self._cover(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
        places = np.empty((len(rows), len(points)), np.int64)
        jobs, done = 0, False
        while not done:
            self.n_free, jobs, done = tiles.touch(
                self.tile_maps, rows, self._books, poses, points, self.jobs, jobs, places
            )
            if not done and self.n_free == 0:
                self._allocate(len(self.refs) // 2)
            elif not done:
                self.used = np.pad(self.used, ((0, 0), (0, self.used.shape[1])))
        tiles.copy_tiles(self.pool, self.jobs, jobs)
        tiles.insert(self.pool, places, poses, points, weights, MOST_WEIGHT)

    def resample(self, ancestors: Rows) -> None:
        """Map i becomes a copy of map ancestors[i]; who is an ancestor stays in its own place."""
        dead = np.flatnonzero(ancestors != np.arange(len(ancestors)))
        self.n_free = tiles.inherit(self.table, self._books, dead, ancestors[dead])

    def cells(
        self, row: int, centre: Float[np.ndarray, "2"] | None = None, reach: float = 1e9
    ) -> Float[np.ndarray, "n 4"]:
        """Cells (x, y, q, W) of one map, float32, within `reach` [m] of `centre`."""
        keys = self.used[row, : self.n_used[row]]
        if centre is None:
            centre = np.zeros(2)
        else:
            near = np.column_stack([keys % self.shape[1], keys // self.shape[1]]) * self.tile + self.origin
            away = np.maximum(np.abs(near + 0.5 * self.tile - centre) - 0.5 * self.tile, 0.0)
            keys = keys[(away**2).sum(axis=1) < reach * reach]
        return tiles.gather(self.pool, self.table[row], np.ascontiguousarray(keys), centre, reach)

    def check(self) -> None:
        """Raises AssertionError unless every count of references is the number of references."""
        counted = np.bincount(self.table.ravel(), minlength=len(self.refs))
        assert np.array_equal(counted[1:], self.refs[1:])  # noqa: S101
        assert np.count_nonzero(self.refs[1:]) == self.tiles_in_use  # noqa: S101

    def _allocate(self, more: int) -> None:
        """`more` free tiles; what is not written to yet costs no memory."""
        old = len(self.refs)
        total = old + more
        self._more_memory(total * tiles.FLOATS * 4)
        jobs = np.empty((total, 2), np.int32)
        jobs[:old] = self.jobs
        free = np.arange(total - 1, old - 1, -1, dtype=np.int32)  # the lowest is handed out first
        self.free = np.concatenate([free, self.free[: self.n_free], np.zeros(old - self.n_free, np.int32)])
        self.refs = np.concatenate([self.refs, np.zeros(more, np.int32)])
        self.jobs, self.n_free = jobs, self.n_free + more

    def _more_memory(self, size: int) -> None:
        """The pool has `size` bytes, what was in it before among them; those not written to yet take no memory."""
        if self._memory is None:
            pool = np.zeros(size // 4, np.float32)
            pool[: len(self.pool)] = self.pool
            self.pool = pool
            return
        self.pool = NOTHING
        try:
            self._memory.resize(size)
        except BufferError:  # somebody looks at the pool
            memory = growing_memory(size)
            assert memory is not None  # noqa: S101  (there is one already)
            memory[: len(self._memory)] = self._memory[:]
            self._memory = memory
        self.pool = np.frombuffer(self._memory, np.float32)

    def _cover(self, low: np.ndarray, high: np.ndarray) -> None:
        """The table reaches from `low` to `high` [m] with a margin of empty tiles."""
        block = self.tile * BLOCK
        first = np.floor(low / block).astype(int) - MARGIN
        last = np.floor(high / block).astype(int) + MARGIN
        old = self.corner // BLOCK
        end = old + self.shape[::-1] // BLOCK
        if (first >= old).all() and (last < end).all():
            return
        corner = np.where(first < old, first - 8, old) * BLOCK
        shape = (np.where(last >= end, last + 9, end) * BLOCK - corner)[::-1]
        table = np.zeros((len(self.table), int(shape.prod())), np.int32)  # what is not used costs no memory
        y, x = (self.corner - corner)[::-1]
        w = self.shape[1]
        used = ((self.used // w + y) * shape[1] + self.used % w + x).astype(np.int32)
        row, at = np.nonzero(np.arange(used.shape[1]) < self.n_used[:, None])
        table[row, used[row, at]] = self.table[row, self.used[row, at]]
        self.used, self.table, self.corner, self.shape = used, table, corner, shape
