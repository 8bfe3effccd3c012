"""A scan laid into many grid maps: tiles made their own before they are written to, cells moved towards new points."""

import math

import numpy as np

from .._jit import kernel, parallel_kernel, prange
from .tiles import FLOATS, INSIDE, SHIFT, TileBooks, TileMaps
from .windows import BEAMS, CHUNKS, blocks_of, carried, cells_of, frame_of


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
