"""Many grid maps in one pool of tiles: shared between particles, copied when written to.

A tile is `CELLS` x `CELLS` cells of float32 (mean x [m], mean y [m], mean q, weight W). `pool` is flat: tile k holds
`pool[FLOATS k : FLOATS (k + 1)]`, row-major cells. Tile 0 is empty and never written: its points lie 1000 km away, so a
search needs no test for emptiness. `table[row, key]` names the tile of one map at tile coordinates
`key = ty * width + tx`; `refs[k]` counts the entries that name tile k. All indices are clamped into the table.
"""

from typing import NamedTuple

import numpy as np

from .._jit import kernel, parallel_kernel, prange

FAR = 1e6  # [m]
SHIFT = 3  # 2 ** SHIFT cells along a tile
CELLS, INSIDE = 1 << SHIFT, (1 << SHIFT) - 1
FLOATS = CELLS * CELLS * 4  # in a tile


class TileMaps(NamedTuple):
    """Rows of `table` (maps, tiles) over `pool`, `width` tiles along x from `origin` (2,) [m]; cell: its side [m]."""

    pool: np.ndarray
    table: np.ndarray
    width: int
    origin: np.ndarray
    cell: float


class TileBooks(NamedTuple):
    """used[r, :n_used[r]]: keys of map r that are not tile 0; refs: of every tile; free[:n_free]: unused tiles."""

    used: np.ndarray
    n_used: np.ndarray
    refs: np.ndarray
    free: np.ndarray
    n_free: int


@parallel_kernel
def copy_tiles(pool: np.ndarray, jobs: np.ndarray, n_jobs: int) -> None:
    """Tile jobs[k, 1] becomes a copy of tile jobs[k, 0], for the first `n_jobs`."""
    for j in prange(n_jobs):
        a, b = np.int64(jobs[j, 0]) * FLOATS, np.int64(jobs[j, 1]) * FLOATS
        for k in range(FLOATS):
            pool[b + k] = pool[a + k]


@kernel
def inherit(table: np.ndarray, books: TileBooks, dead: np.ndarray, parent: np.ndarray) -> int:
    """Map dead[k] becomes a copy of map parent[k] by sharing its tiles; returns the free tiles left.

    No parent may be among the dead.
    """
    used, n_used, refs, free, n_free = books
    for k in range(dead.shape[0]):
        r, a = dead[k], parent[k]
        for j in range(n_used[r]):
            key = used[r, j]
            tile = table[r, key]
            table[r, key] = 0
            refs[tile] -= 1
            if refs[tile] == 0:
                free[n_free] = tile
                n_free += 1
        n_used[r] = n_used[a]
        for j in range(n_used[a]):
            key = used[a, j]
            used[r, j] = key
            tile = table[a, key]
            table[r, key] = tile
            refs[tile] += 1
    return n_free


@kernel
def gather(pool: np.ndarray, row: np.ndarray, keys: np.ndarray, centre: np.ndarray, reach: float) -> np.ndarray:
    """Cells (n, 4) of one map within `reach` [m] of `centre` (2,), among the tiles at `keys`."""
    found = np.empty((keys.shape[0] * CELLS * CELLS, 4), np.float32)
    n = 0
    for j in range(keys.shape[0]):
        base = np.int64(row[keys[j]]) * FLOATS
        for k in range(base, base + FLOATS, 4):
            if pool[k + 3] > 0.0 and (pool[k] - centre[0]) ** 2 + (pool[k + 1] - centre[1]) ** 2 < reach * reach:
                for m in range(4):
                    found[n, m] = pool[k + m]
                n += 1
    return found[:n].copy()
