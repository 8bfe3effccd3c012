"""Many grid maps in one pool of tiles: shared between particles, copied when written to.

A tile is `CELLS` x `CELLS` cells of float32 (mean x [m], mean y [m], mean q, weight W). `pool` is flat: tile k holds
`pool[FLOATS k : FLOATS (k + 1)]`, row-major cells. Tile 0 is empty and never written: its points lie 1000 km away, so a
search needs no test for emptiness. `table[row, key]` names the tile of one map at tile coordinates
`key = ty * width + tx`; `refs[k]` counts the entries that name tile k. All indices are clamped into the table.
"""

import math

import numpy as np

from .._jit import kernel, parallel_kernel, prange

FAR = 1e6  # [m]
SHIFT = 3  # 2 ** SHIFT cells along a tile
CELLS, INSIDE = 1 << SHIFT, (1 << SHIFT) - 1
FLOATS = CELLS * CELLS * 4  # in a tile


@kernel
def world_points(pose: np.ndarray, points: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """`points` (n, 2+) float32 carried by `pose` (3,) into x, y (n,) float32; every kernel rounds through here."""
    c, s = np.float32(math.cos(pose[2])), np.float32(math.sin(pose[2]))
    tx, ty = np.float32(pose[0]), np.float32(pose[1])
    for i in range(points.shape[0]):
        x[i] = tx + (c * points[i, 0] - s * points[i, 1])
        y[i] = ty + (s * points[i, 0] + c * points[i, 1])


@kernel
def cell_index(value: np.float32, origin: np.float32, per_metre: np.float32, cells: int) -> int:
    """The cell along one axis, clamped so that its neighbours exist too."""
    k = int((value - origin) * per_metre)
    return min(max(k, 1), cells - 2)


@kernel
def touch(
    table: np.ndarray,
    width: int,
    origin: np.ndarray,
    cell: float,
    rows: np.ndarray,
    used: np.ndarray,
    n_used: np.ndarray,
    refs: np.ndarray,
    free: np.ndarray,
    n_free: int,
    poses: np.ndarray,
    points: np.ndarray,
    jobs: np.ndarray,
    n_jobs: int,
) -> tuple[int, int, bool]:
    """Every tile the scan will write to is owned by its map alone; what must be copied first stands in `jobs`.

    used[r, :n_used[r]]: keys of map r that are not tile 0; free[:n_free]: unused tiles; jobs: (tiles, 2) int32
    (from, to), of which `n_jobs` are filled. Returns (free tiles left, jobs filled, whether all is done): when free
    tiles or room in `used` run out, the caller makes more and calls again.
    """
    n = points.shape[0]
    per_metre = np.float32(1.0 / cell)
    ox, oy = np.float32(origin[0]), np.float32(origin[1])
    cx, cy = width * CELLS, table.shape[1] // width * CELLS
    x, y = np.empty(n, np.float32), np.empty(n, np.float32)
    for p in range(poses.shape[0]):
        r = rows[p]
        world_points(poses[p], points, x, y)
        last = -1
        for i in range(n):
            ix, iy = cell_index(x[i], ox, per_metre, cx), cell_index(y[i], oy, per_metre, cy)
            key = (iy >> SHIFT) * width + (ix >> SHIFT)
            if key == last:
                continue
            last = key
            tile = table[r, key]
            if tile != 0 and refs[tile] == 1:
                continue
            if n_free == 0 or n_used[r] == used.shape[1]:
                return n_free, n_jobs, False
            n_free -= 1
            new = free[n_free]
            if tile == 0:
                used[r, n_used[r]] = key
                n_used[r] += 1
            else:
                refs[tile] -= 1
            refs[new] = 1
            table[r, key] = new
            jobs[n_jobs, 0] = tile
            jobs[n_jobs, 1] = new
            n_jobs += 1
    return n_free, n_jobs, True


@parallel_kernel
def copy_tiles(pool: np.ndarray, jobs: np.ndarray, n_jobs: int) -> None:
    """Tile jobs[k, 1] becomes a copy of tile jobs[k, 0], for the first `n_jobs`."""
    for j in prange(n_jobs):
        a, b = np.int64(jobs[j, 0]) * FLOATS, np.int64(jobs[j, 1]) * FLOATS
        for k in range(FLOATS):
            pool[b + k] = pool[a + k]


@parallel_kernel
def insert(
    pool: np.ndarray,
    table: np.ndarray,
    width: int,
    origin: np.ndarray,
    cell: float,
    rows: np.ndarray,
    poses: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
    most: float,
) -> None:
    """The scan laid into every map: weighted means move towards the new points, W grows up to `most`.

    `touch` and `copy_tiles` have run for the same poses and points; weights: (n,) float32.
    """
    n = points.shape[0]
    per_metre = np.float32(1.0 / cell)
    ox, oy = np.float32(origin[0]), np.float32(origin[1])
    cx, cy = width * CELLS, table.shape[1] // width * CELLS
    cap = np.float32(most)
    for p in prange(poses.shape[0]):
        r = rows[p]
        x, y = np.empty(n, np.float32), np.empty(n, np.float32)
        world_points(poses[p], points, x, y)
        for i in range(n):
            ix, iy = cell_index(x[i], ox, per_metre, cx), cell_index(y[i], oy, per_metre, cy)
            tile = np.int64(table[r, (iy >> SHIFT) * width + (ix >> SHIFT)])
            k = tile * FLOATS + ((iy & INSIDE) * CELLS + (ix & INSIDE)) * 4
            W, w = pool[k + 3], weights[i]
            if W == 0.0:
                pool[k], pool[k + 1], pool[k + 2], pool[k + 3] = x[i], y[i], points[i, 2], w
            else:
                g = w / (W + w)
                pool[k] += g * (x[i] - pool[k])
                pool[k + 1] += g * (y[i] - pool[k + 1])
                pool[k + 2] += g * (points[i, 2] - pool[k + 2])
                pool[k + 3] = min(cap, W + w)


@kernel
def inherit(
    table: np.ndarray,
    used: np.ndarray,
    n_used: np.ndarray,
    refs: np.ndarray,
    free: np.ndarray,
    n_free: int,
    dead: np.ndarray,
    parent: np.ndarray,
) -> int:
    """Map dead[k] becomes a copy of map parent[k] by sharing its tiles; returns the free tiles left.

    No parent may be among the dead.
    """
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
