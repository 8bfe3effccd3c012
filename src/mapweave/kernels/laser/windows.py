"""The nearest cell of a map to every beam, over the 3x3 cells around it, which are read once while the pose is refined.

A window is the 3x3 cells around a beam, laid out so that a block of `BEAMS` beams is worked on side by side:
`windows[27 b BEAMS + (9 k + m) BEAMS + i]` is, for beam i of block b and cell m (rows from below, cells from the left),
the cell's mean x (k = 0) and y (k = 1) [m], and alpha times its squared difference in the feature (k = 2) [m^2]. A
refined pose moves by less than a cell: most beams stay in the cell they are in, and their windows hold for the next
step. Searching a window reads nothing but memory in a row and takes no branch. Arrays are flat, and no kernel here is
given a part of one, so that the compiler may take all of them to be apart.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import inlined_kernel, kernel, parallel_kernel, prange
from .tiles import CELLS, FLOATS, INSIDE, SHIFT, TileMaps

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
