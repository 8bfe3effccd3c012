"""Many grid maps in one pool of tiles: shared between particles, copied when written to, searched around every beam.

A tile is `CELLS` x `CELLS` cells of float32 (mean x [m], mean y [m], mean q, weight W). `pool` is flat: tile k holds
`pool[FLOATS k : FLOATS (k + 1)]`, row-major cells. Tile 0 is empty and never written: its points lie 1000 km away, so a
search needs no test for emptiness. `table[row, key]` names the tile of one map at tile coordinates
`key = ty * width + tx`; `refs[k]` counts the entries that name tile k. All indices are clamped into the table.

A window is the 3x3 cells around a beam, laid out so that a block of `BEAMS` beams is worked on side by side:
`windows[27 b BEAMS + (9 k + m) BEAMS + i]` is, for beam i of block b and cell m (rows from below, cells from the left),
the cell's mean x (k = 0) and y (k = 1) [m], and alpha times its squared difference in the feature (k = 2) [m^2]. A
refined pose moves by less than a cell: most beams stay in the cell they are in, and their windows hold for the next
step. Searching a window reads nothing but memory in a row and takes no branch. Arrays are flat, and no kernel of
windows is given a part of one, so that the compiler may take all of them to be apart.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import inlined_kernel, kernel, parallel_kernel, prange

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


BEAMS = 64  # beams in a block
CHUNKS = 16  # at most, of particles that are worked on in the same memory
Frame = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]


class NearestRule(NamedTuple):
    """What a difference in the feature counts, `alpha` [m^2 per q^2], and the greatest D, `cap` [m^2]."""

    alpha: float
    cap: float


class MapCells(NamedTuple):
    """What a search reads of the maps: `TileMaps`, `frame_of` them, and a `NearestRule` in float32."""

    pool: np.ndarray
    table: np.ndarray
    width: int
    frame: Frame
    alpha: np.float32
    cap: np.float32


class BlockMemory(NamedTuple):
    """Memory for the blocks of one chunk of particles, a part of flat arrays that all chunks have in common.

    Of one block, from `at` on: x, y [m] the beams in the map, cells they are in, ex, ey, least of `nearest`, and moved,
    scratch. Of all blocks of a scan, from `of` on: held, the cells that the windows are of, -1 where there are none;
    from `27 of` on: windows.
    """

    x: np.ndarray
    y: np.ndarray
    cells: np.ndarray
    moved: np.ndarray
    ex: np.ndarray
    ey: np.ndarray
    least: np.ndarray
    held: np.ndarray
    windows: np.ndarray
    at: int
    of: int


@kernel
def frame_of(maps: TileMaps) -> Frame:
    """Corner x, y [m], cells in a metre, and the greatest cell along x and y that has neighbours on both sides."""
    tiles, corner = maps.table.shape[1], maps.origin
    far_x, far_y = np.float32(maps.width * CELLS - 2), np.float32(tiles // maps.width * CELLS - 2)
    return np.float32(corner[0]), np.float32(corner[1]), np.float32(1.0 / maps.cell), far_x, far_y


@inlined_kernel
def cells_of(x: np.ndarray, y: np.ndarray, at: int, frame: Frame, cells: np.ndarray) -> None:
    """cells[at + i] = 2^32 iy + ix of the cell, with neighbours, in or next to which (x, y) [m] of beam i lies.

    What is no number lies in the first one: `max` gives the first of two that do not compare.
    """
    left, low, per_metre, far_x, far_y = frame
    one = np.float32(1.0)
    for i in range(BEAMS):
        ix = np.int32(min(max(one, (x[np.uint64(at + i)] - left) * per_metre), far_x))
        iy = np.int32(min(max(one, (y[np.uint64(at + i)] - low) * per_metre), far_y))
        cells[np.uint64(at + i)] = (np.int64(iy) << 32) + np.int64(ix)


@inlined_kernel
def read_windows(
    maps: MapCells, row: np.uint64, points: np.ndarray, first: int, count: int, memory: BlockMemory
) -> int:
    """Windows of the `count` beams from `first` on are those of map `row` at their cells; how many had to be read."""
    pool, table, width, alpha = maps.pool, maps.table, maps.width, maps.alpha
    cells, moved, held, windows, at, of = (
        memory.cells, memory.moved, memory.held, memory.windows, memory.at, memory.of,
    )  # fmt: skip
    many = 0
    for i in range(count):
        moved[np.uint64(at + many)] = i
        many += cells[np.uint64(at + i)] != held[np.uint64(of + first + i)]
        held[np.uint64(of + first + i)] = cells[np.uint64(at + i)]
    for j in range(many):
        beam = np.int64(moved[np.uint64(at + j)])
        cell = np.int64(cells[np.uint64(at + beam)])
        ix, iy = cell & 0xFFFFFFFF, cell >> 32
        t0, t1, t2 = (ix - 1) >> SHIFT, ix >> SHIFT, (ix + 1) >> SHIFT
        k0, k1, k2 = ((ix - 1) & INSIDE) << 2, (ix & INSIDE) << 2, ((ix + 1) & INSIDE) << 2
        q = points[np.uint64(first + beam), 2]
        w = (of + first) * 27 + beam
        for jy in range(iy - 1, iy + 2):
            tiles, inside = (jy >> SHIFT) * width, (jy & INSIDE) << (SHIFT + 2)
            a = np.int64(table[row, np.uint64(tiles + t0)]) * FLOATS + inside + k0
            b = np.int64(table[row, np.uint64(tiles + t1)]) * FLOATS + inside + k1
            c = np.int64(table[row, np.uint64(tiles + t2)]) * FLOATS + inside + k2
            windows[np.uint64(w)] = pool[np.uint64(a)]
            windows[np.uint64(w + BEAMS)] = pool[np.uint64(b)]
            windows[np.uint64(w + 2 * BEAMS)] = pool[np.uint64(c)]
            windows[np.uint64(w + 9 * BEAMS)] = pool[np.uint64(a + 1)]
            windows[np.uint64(w + 10 * BEAMS)] = pool[np.uint64(b + 1)]
            windows[np.uint64(w + 11 * BEAMS)] = pool[np.uint64(c + 1)]
            if alpha > np.float32(0.0):
                eq = pool[np.uint64(a + 2)] - q
                windows[np.uint64(w + 18 * BEAMS)] = alpha * (eq * eq)
                eq = pool[np.uint64(b + 2)] - q
                windows[np.uint64(w + 19 * BEAMS)] = alpha * (eq * eq)
                eq = pool[np.uint64(c + 2)] - q
                windows[np.uint64(w + 20 * BEAMS)] = alpha * (eq * eq)
            w += 3 * BEAMS
    return many


@inlined_kernel
def nearest(memory: BlockMemory, first: int, cap: np.float32) -> None:
    """least[at + i] = the least D = ex^2 + ey^2 + alpha eq^2 [m^2] in the window of beam `first + i`, `cap` at most.

    (ex, ey) [m] leads from the beam to that cell; it is 0 where no D is below `cap`. Of equals the first counts.
    """
    x, y, ex, ey, least, windows = memory.x, memory.y, memory.ex, memory.ey, memory.least, memory.windows
    at, of = memory.at, (memory.of + first) * 27
    for i in range(BEAMS):
        best, bx, by = cap, np.float32(0.0), np.float32(0.0)
        px, py = x[np.uint64(at + i)], y[np.uint64(at + i)]
        for m in range(9):
            dx = windows[np.uint64(of + m * BEAMS + i)] - px
            dy = windows[np.uint64(of + (9 + m) * BEAMS + i)] - py
            d = dx * dx + dy * dy + windows[np.uint64(of + (18 + m) * BEAMS + i)]
            better = d < best
            bx, by, best = dx if better else bx, dy if better else by, d if better else best
        ex[np.uint64(at + i)], ey[np.uint64(at + i)], least[np.uint64(at + i)] = bx, by, best


@kernel
def blocks_of(points: np.ndarray) -> np.ndarray:
    """The x and y of `points` (n, 3) float32, block by block: `BEAMS` x, then as many y; zeros fill the last."""
    n = points.shape[0]
    out = np.zeros((n + BEAMS - 1) // BEAMS * BEAMS * 2, np.float32)
    for i in range(n):
        at = i // BEAMS * 2 * BEAMS + i % BEAMS
        out[at], out[at + BEAMS] = points[i, 0], points[i, 1]
    return out


@inlined_kernel
def carried(
    own: np.ndarray, of: int, px: np.float32, py: np.float32, c: np.float32, s: np.float32,
    x: np.ndarray, y: np.ndarray, at: int,
) -> None:  # fmt: skip
    """A block of beams at the pose (px, py) turned by (c, s), in float32: so cells are scored and written."""
    for i in range(BEAMS):
        rx, ry = own[np.uint64(of + i)], own[np.uint64(of + BEAMS + i)]
        x[np.uint64(at + i)] = px + (c * rx - s * ry)
        y[np.uint64(at + i)] = py + (s * rx + c * ry)


@inlined_kernel
def scored(
    maps: MapCells, row: np.uint64, points: np.ndarray, own: np.ndarray, pose: tuple[float, float, float],
    memory: BlockMemory, out: np.ndarray, p: int,
) -> None:  # fmt: skip
    """out[p, i] = least D of beam i of a particle at `pose` in map `row`; own: `blocks_of` its beams."""
    x0, y0, th = pose
    x, y, at, least = memory.x, memory.y, memory.at, memory.least
    px, py, c, s = np.float32(x0), np.float32(y0), np.float32(math.cos(th)), np.float32(math.sin(th))
    for first in range(0, points.shape[0], BEAMS):
        count = min(BEAMS, points.shape[0] - first)
        carried(own, 2 * first, px, py, c, s, x, y, at)
        cells_of(x, y, at, maps.frame, memory.cells)
        read_windows(maps, row, points, first, count, memory)
        nearest(memory, first, maps.cap)
        for i in range(count):
            out[p, first + i] = least[np.uint64(at + i)]


@parallel_kernel
def score(
    grid: TileMaps, rows: np.ndarray, poses: np.ndarray, points: np.ndarray, rule: NearestRule, out: np.ndarray
) -> None:
    """out[p, i] = least D of beam i at pose p over the 3x3 cells of map rows[p], at most `cap` [m^2].

    poses: (P, 3) float64; points: (n, 3) float32 (x, y, q) in the robot frame; out: (P, n) float32.
    """
    particles = poses.shape[0]
    pool, table, width, frame = grid.pool, grid.table, grid.width, frame_of(grid)
    alpha, cap = np.float32(rule.alpha), np.float32(rule.cap)
    own = blocks_of(points)
    size = own.shape[0] // 2
    chunks = min(particles, CHUNKS)
    windows, held = np.zeros(chunks * 27 * size, np.float32), np.empty(chunks * size, np.int64)
    x, y = np.empty(chunks * BEAMS, np.float32), np.empty(chunks * BEAMS, np.float32)
    ex, ey = np.empty(chunks * BEAMS, np.float32), np.empty(chunks * BEAMS, np.float32)
    least = np.empty(chunks * BEAMS, np.float32)
    cells, moved = np.empty(chunks * BEAMS, np.int64), np.empty(chunks * BEAMS, np.int32)
    for chunk in prange(chunks):
        at, of = chunk * BEAMS, chunk * size
        maps = MapCells(pool, table, width, frame, alpha, cap)
        memory = BlockMemory(x, y, cells, moved, ex, ey, least, held, windows, at, of)
        for p in range(chunk * particles // chunks, (chunk + 1) * particles // chunks):
            for i in range(size):
                held[np.uint64(of + i)] = -1
            pose = poses[p, 0], poses[p, 1], poses[p, 2]
            scored(maps, np.uint64(rows[p]), points, own, pose, memory, out, p)


@kernel
def touch(
    maps: TileMaps,
    rows: np.ndarray,
    books: TileBooks,
    poses: np.ndarray,
    points: np.ndarray,
    jobs: np.ndarray,
    n_jobs: int,
    places: np.ndarray,
) -> tuple[int, int, bool]:
    """Every tile the scan will write to is owned by its map alone; what must be copied first stands in `jobs`.

    rows: (P,) the maps that the scan is laid into, at `poses` (P, 3); points: (n, 3) float32 (x, y, q) in the robot
    frame; jobs: (tiles, 2) int32 (from, to), of which `n_jobs` are filled; places: (P, n) int64, where in the pool the
    cell of every beam stands then. Returns (free tiles left, jobs filled, whether all is done): when free tiles or room
    in `used` run out, the caller makes more and calls again.
    """
    n = points.shape[0]
    table, width = maps.table, maps.width
    used, n_used, refs, free, n_free = books
    frame = frame_of(maps)
    own = blocks_of(points)
    x, y, cells = np.empty(BEAMS, np.float32), np.empty(BEAMS, np.float32), np.empty(BEAMS, np.int64)
    for p in range(poses.shape[0]):
        r = rows[p]
        px, py = np.float32(poses[p, 0]), np.float32(poses[p, 1])
        c, s = np.float32(math.cos(poses[p, 2])), np.float32(math.sin(poses[p, 2]))
        last, base = np.int64(-1), np.int64(0)
        for first in range(0, n, BEAMS):
            carried(own, 2 * first, px, py, c, s, x, y, 0)
            cells_of(x, y, 0, frame, cells)
            for i in range(min(BEAMS, n - first)):
                ix, iy = cells[i] & 0xFFFFFFFF, cells[i] >> 32
                key = (iy >> SHIFT) * width + (ix >> SHIFT)
                if key != last:
                    last = key
                    tile = table[r, key]
                    if tile == 0 or refs[tile] != 1:
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
                        tile = new
                    base = np.int64(tile) * FLOATS
                places[p, first + i] = base + ((iy & INSIDE) << (SHIFT + 2)) + ((ix & INSIDE) << 2)
    return n_free, n_jobs, True


@parallel_kernel
def insert(
    pool: np.ndarray, places: np.ndarray, poses: np.ndarray, points: np.ndarray, weights: np.ndarray, most: float
) -> None:
    """The scan laid into every map: weighted means move towards the new points, W grows up to `most`.

    `touch`, which gave `places`, and `tiles.copy_tiles` have run for the same poses and points; weights: (n,) float32.
    """
    n, particles = points.shape[0], poses.shape[0]
    own = blocks_of(points)
    cap = np.float32(most)
    chunks = min(particles, CHUNKS)
    x, y = np.empty(chunks * BEAMS, np.float32), np.empty(chunks * BEAMS, np.float32)
    for chunk in prange(chunks):
        at = chunk * BEAMS
        for p in range(chunk * particles // chunks, (chunk + 1) * particles // chunks):
            px, py = np.float32(poses[p, 0]), np.float32(poses[p, 1])
            c, s = np.float32(math.cos(poses[p, 2])), np.float32(math.sin(poses[p, 2]))
            for first in range(0, n, BEAMS):
                carried(own, 2 * first, px, py, c, s, x, y, at)
                for i in range(min(BEAMS, n - first)):
                    k = np.uint64(places[p, first + i])
                    kx, ky, kq, kw = k, k + np.uint64(1), k + np.uint64(2), k + np.uint64(3)
                    w, W = weights[first + i], pool[kw]
                    zx, zy, zq = x[np.uint64(at + i)], y[np.uint64(at + i)], points[first + i, 2]
                    if np.float32(0.0) == W:
                        pool[kx], pool[ky], pool[kq], pool[kw] = zx, zy, zq, w
                    else:
                        g = w / (W + w)
                        pool[kx] += g * (zx - pool[kx])
                        pool[ky] += g * (zy - pool[ky])
                        pool[kq] += g * (zq - pool[kq])
                        pool[kw] = min(cap, W + w)
