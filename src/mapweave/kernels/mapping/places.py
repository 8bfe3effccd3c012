"""Many submaps searched for in one: peaks of heading correlations, and for each heading every shift, exactly.

Scores are whole numbers, as in `kernels/laser/place_search.py`, whose tables and blocks these kernels read.
"""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel, parallel_kernel, prange
from ..laser.place_search import COARSE, FULL, Brightness, branch_and_bound, square_bounds, turned_cells


@kernel
def heading_peaks(
    correlation: np.ndarray, most: int, apart: int, share: float, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """(turns (K, most) [rad], how many of each row): the greatest peaks of circular correlations (K, bins).

    A peak stands between bins where the parabola through it and its neighbours has its top. Further peaks are `apart`
    bins from those found, and `share` of the first at least; a row whose first is under `least` has none.
    """
    rows, bins = correlation.shape
    turns, count = np.zeros((rows, most)), np.zeros(rows, np.int64)
    for k in range(rows):
        free = correlation[k].copy()
        first = 0.0
        for p in range(most):
            at = int(np.argmax(free))
            top = free[at]
            if p == 0:
                first = top
            if not top >= (least if p == 0 else share * first):
                break
            before, after = correlation[k, at - 1], correlation[k, (at + 1) % bins]
            bend = before - 2.0 * top + after
            shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
            turns[k, p] = (at + min(max(shift, -0.5), 0.5)) * 2.0 * math.pi / bins
            count[k] = p + 1
            for b in range(at - apart, at + apart + 1):
                free[b % bins] = -np.inf
    return turns, count


@kernel
def _best(
    tables: np.ndarray,
    brightness: Brightness,
    cells: np.ndarray,
    reach: int,
    tiles: int,
    bounds: np.ndarray,
    scale: int,
    least: int,
    barred: np.ndarray,
) -> tuple[int, int, int, int]:
    """(score, heading, ox, oy) of the best shift not barred, heading -1 where none scores `least`.

    The squares that promise most are looked into first: once a pose beats what all others promise it is the best.
    """
    low, high = np.full(2, -reach, np.int64), np.full(2, reach, np.int64)
    square = np.full(2, tiles, np.int64)
    promised = scale * int(bounds.max())
    while True:
        promised = max(least, int(0.92 * promised))
        asked = np.flatnonzero(bounds * np.int64(scale) >= promised)
        values = bounds[asked].astype(np.int64) * scale
        order = np.argsort(-values, kind="mergesort")
        hit = branch_and_bound(tables, brightness, cells, low, high, square, asked[order], values[order], least, barred)
        if promised == least or (hit[1] >= 0 and hit[0] >= promised):
            return hit[0], hit[1], hit[2], hit[3]
        least = max(least, hit[0])


class SearchedField(NamedTuple):
    """A likelihood field as `laser/place_search.py` makes it: tables (levels, rows, cols), blocks (size, size, n) and
    how `wide` their rows are; dark, bright, light: see `Brightness`; origin (2,) and cell [m].
    """

    tables: np.ndarray
    blocks: np.ndarray
    wide: int
    dark: np.ndarray
    bright: np.ndarray
    light: np.ndarray
    origin: np.ndarray
    cell: float


class Clouds(NamedTuple):
    """Points (m, 2) [m] of K submaps, each in its frame, their levels of brightness q (m,), start (K + 1,)."""

    points: np.ndarray
    q: np.ndarray
    start: np.ndarray


class SearchRules(NamedTuple):
    """reach: [cells] of shifts; least: score looked for; apart [cells], apart_turn [rad]: another place."""

    reach: int
    least: float
    apart: int
    apart_turn: float


@parallel_kernel
def search_submaps(
    field: SearchedField, clouds: Clouds, turns: np.ndarray, count: np.ndarray, rules: SearchRules
) -> np.ndarray:
    """(K, 8) for each submap: x, y [m], heading [rad] and score of the best place and of the next best.

    A submap's points are the rows start[k]:start[k + 1] of points (m, 2) [m] in its frame, q (m,) their levels of
    brightness. Searched are its first `count` headings of turns (K, most) and every shift up to `reach` cells. The next
    best place lies `apart` cells or `apart_turn` [rad] from the best. Scores are shares of what a perfect fit has, 0
    where nothing has `least`; of the next best 0.7 of the best's is looked for at least.
    """
    tables, blocks, wide, dark, bright, light, origin, cell = field
    points, q, start = clouds
    reach, least, apart, apart_turn = rules
    featured = dark.shape[1] > 0
    size = blocks.shape[0]
    tiles = (2 * reach + size) // size
    scale = COARSE * (FULL if featured else 1)
    low, square = np.full(2, -reach, np.int64), np.full(2, tiles, np.int64)
    out = np.zeros((start.shape[0] - 1, 8))
    for k in prange(start.shape[0] - 1):
        n, m = count[k], start[k + 1] - start[k]
        if n == 0 or m == 0:
            continue
        cells = turned_cells(points[start[k] : start[k + 1]], np.zeros(2), turns[k, :n], origin, cell)
        squares = np.empty((n, tiles, tiles), np.uint16)
        for a in range(n):
            square_bounds(blocks, wide, cells[a], low, square, squares[a])
        bounds = squares.ravel()
        most = m * 255 * (FULL if featured else 1)
        lowest = max(1, math.ceil(least * most))
        if scale * np.int64(bounds.max()) < lowest:
            continue
        b = Brightness(dark, bright, light, q[start[k] : start[k + 1]])
        none = np.zeros(0, np.int64)
        score, a, ox, oy = _best(tables, b, cells, reach, tiles, bounds, scale, lowest, none)
        if a < 0:
            continue
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = ox * cell, oy * cell, turns[k, a], score / most
        barred = np.zeros(4 + n, np.int64)
        barred[0], barred[1], barred[2], barred[3] = a, ox, oy, apart * apart
        for h in range(n):
            away = turns[k, h] - turns[k, a]
            away -= 2.0 * math.pi * math.floor(away / (2.0 * math.pi) + 0.5)
            barred[4 + h] = 1 if abs(away) <= apart_turn else 0
        second = max(lowest, math.ceil(0.7 * score))
        score, a, ox, oy = _best(tables, b, cells, reach, tiles, bounds, scale, second, barred)
        if a >= 0:
            out[k, 4], out[k, 5], out[k, 6], out[k, 7] = ox * cell, oy * cell, turns[k, a], score / most
    return out


class LitWalls(NamedTuple):
    """Points (m, 2) [m] of walls, their brightness q (m,); nearest: of `stamp`, cells of `cell` [m] from origin on."""

    points: np.ndarray
    q: np.ndarray
    nearest: np.ndarray
    origin: np.ndarray
    cell: float


@kernel
def light_along(
    points: np.ndarray, q: np.ndarray, along: np.ndarray, shifts: np.ndarray, walls: LitWalls, near: float, least: int
) -> np.ndarray:
    """(S,) how the brightness of points correlates with that of the walls they lie on, at each shift along a line.

    points: (n, 2) [m] where they lie at no shift, q (n,); along: (2,) unit; shifts: (S,) [m]. A point lies on a wall
    that has a point `near` [m] it; -1 where fewer than `least` do, 0 where either side is of one brightness.
    """
    rows, cols = walls.nearest.shape
    out = np.full(shifts.shape[0], -1.0)
    for s in range(shifts.shape[0]):
        n, a, b, aa, bb, ab = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(points.shape[0]):
            x, y = points[i, 0] + shifts[s] * along[0], points[i, 1] + shifts[s] * along[1]
            c = math.floor((x - walls.origin[0]) / walls.cell)
            r = math.floor((y - walls.origin[1]) / walls.cell)
            if not (0 <= r < rows and 0 <= c < cols) or walls.nearest[r, c] < 0:
                continue
            k = walls.nearest[r, c]
            if (walls.points[k, 0] - x) ** 2 + (walls.points[k, 1] - y) ** 2 > near * near:
                continue
            u, v = q[i], walls.q[k]
            n += 1
            a, b, aa, bb, ab = a + u, b + v, aa + u * u, bb + v * v, ab + u * v
        if n < least:
            continue
        spread = (aa - a * a / n) * (bb - b * b / n)
        out[s] = (ab - a * b / n) / math.sqrt(spread) if spread > 1e-12 * n * n else 0.0
    return out
