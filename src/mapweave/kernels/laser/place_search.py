"""Where a scan fits in a likelihood field: exhaustive search over x, y and heading by branch and bound.

All scores are whole numbers, so that a bound is never under what it bounds and equal scores are equal to the last bit.
A field is uint8 (rows, cols), 255 at a wall; a table is (levels + 1, rows + pad, cols + pad) with pad = 2^levels - 1:
entry [h, r, c] is the greatest of the 2^h x 2^h field cells whose lowest is (r - pad, c - pad).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from .._jit import kernel, parallel_kernel, prange
from ..cells import cell_of
from .icp import column_of, sort_into_cells
from .local_map import solve3

FULL = 256  # what `light` holds where brightness agrees
BEYOND = 1 << 28  # cells that no shift brings back into a field; sums of a few stay within 32 bits
COARSE = 4  # what a unit of `root_bounds` counts
MOST_POINTS = 1023  # a quarter of 255 each, rounded up, of which the sum fits 16 bits


@kernel
def stamp(
    points: np.ndarray, origin: np.ndarray, cell: float, rows: int, cols: int, sigma: float, reach: int
) -> tuple[np.ndarray, np.ndarray]:
    """(field (rows, cols) uint8, nearest (rows, cols) int32): 255 exp(-d^2 / 2 sigma^2) and the point d away, or -1.

    points: (n, 2) [m]; d: from a cell's middle to the nearest point within `reach` cells. The first of equals wins.
    """
    least = np.full((rows, cols), np.inf)
    nearest = np.full((rows, cols), -1, np.int32)
    for i in range(points.shape[0]):
        x, y = (points[i, 0] - origin[0]) / cell, (points[i, 1] - origin[1]) / cell
        cx, cy = cell_of(x), cell_of(y)
        for r in range(max(cy - reach, 0), min(cy + reach + 1, rows)):
            ey = r + 0.5 - y
            for c in range(max(cx - reach, 0), min(cx + reach + 1, cols)):
                ex = c + 0.5 - x
                d = ex * ex + ey * ey
                if d < least[r, c]:
                    least[r, c] = d
                    nearest[r, c] = i
    field = np.zeros((rows, cols), np.uint8)
    k = -0.5 * (cell / sigma) ** 2
    for r in range(rows):
        for c in range(cols):
            if nearest[r, c] >= 0:
                field[r, c] = np.uint8(255.0 * math.exp(k * least[r, c]) + 0.5)
    return field, nearest


@kernel
def turned_cells(points: np.ndarray, at: np.ndarray, turns: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """(A, n, 2) int32, column and row of the field each point falls into, for every heading.

    points: (n, 2) in the scan's frame; at: (2,) where the scan stands [m]; turns: (A,) its headings [rad].
    """
    out = np.empty((turns.shape[0], points.shape[0], 2), np.int32)
    for a in range(turns.shape[0]):
        c, s = math.cos(turns[a]), math.sin(turns[a])
        for i in range(points.shape[0]):
            x = at[0] + c * points[i, 0] - s * points[i, 1]
            y = at[1] + s * points[i, 0] + c * points[i, 1]
            out[a, i, 0] = min(max(cell_of((x - origin[0]) / cell), -BEYOND), BEYOND)
            out[a, i, 1] = min(max(cell_of((y - origin[1]) / cell), -BEYOND), BEYOND)
    return out


@kernel
def bound(
    table: np.ndarray,
    dark: np.ndarray,
    bright: np.ndarray,
    light: np.ndarray,
    cells: np.ndarray,
    q: np.ndarray,
    ox: int,
    oy: int,
    pad: int,
    enough: int,
) -> int:
    """The most any shift in the square of `table`'s level from (ox, oy) on can score; exact on level 0.

    dark, bright: as `table`, least and greatest feature there (empty: geometry alone, `light` unused); light: (256,)
    what a difference in the feature leaves of a point. Ends early with a number under `enough` once that is certain.
    """
    rows, cols = table.shape
    n = cells.shape[0]
    featured = dark.shape[0] > 0
    most = 255 * FULL if featured else 255
    total: Any = 0
    for i in range(n):
        if i & 31 == 31 and total + (n - i) * most < enough:
            return int(total + (n - i) * most)
        c, r = cells[i, 0] + ox + pad, cells[i, 1] + oy + pad
        if 0 <= r < rows and 0 <= c < cols:
            v: Any = np.int64(table[r, c])
            if featured and v > 0:
                low, high = np.int64(dark[r, c]), np.int64(bright[r, c])
                v *= light[max(low - q[i], q[i] - high, 0)]
            total += v
    return int(total)


@parallel_kernel
def root_bounds(blocks: np.ndarray, wide: int, cells: np.ndarray, low: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """(A, tiles y, tiles x) uint16: a quarter of the most any shift in each square of the coarsest level can score.

    By geometry alone, for at most 1,023 points; the first square begins at shift `low`. blocks: (size, size, Y * X)
    uint8, a quarter of the coarsest table, rounded up, its entries sorted by row and column modulo size, X = `wide`
    columns of which the last `tiles x` are zero: so all a point adds is one run of memory, and what runs over a row's
    end is zero.
    """
    out = np.empty((cells.shape[0], tiles[1], tiles[0]), np.uint16)
    for a in prange(cells.shape[0]):
        square_bounds(blocks, wide, cells[a], low, tiles, out[a])
    return out


@kernel
def square_bounds(
    blocks: np.ndarray, wide: int, cells: np.ndarray, low: np.ndarray, tiles: np.ndarray, out: np.ndarray
) -> None:
    """`root_bounds` of one heading, into `out` (tiles y, tiles x)."""
    size, rows = blocks.shape[0], blocks.shape[2] // wide
    nx, ny = tiles[0], tiles[1]
    total = np.zeros(ny * wide, np.uint16)
    for i in range(cells.shape[0]):
        c, r = cells[i, 0] + low[0] + size - 1, cells[i, 1] + low[1] + size - 1
        bc, br = c // size, r // size
        if bc <= -nx or bc >= wide - nx or br <= -ny or br >= rows:
            continue
        s = br * wide + bc
        first, last = max(0, -s), min(ny * wide, rows * wide - s)
        _add(total[first:last], blocks[r - br * size, c - bc * size, s + first : s + last])
    for ty in range(ny):
        for tx in range(nx):
            out[ty, tx] = total[ty * wide + tx]


@kernel
def _add(to: np.ndarray, new: np.ndarray) -> None:
    """`to += new`, both contiguous: a loop that becomes vector instructions."""
    for k in range(to.shape[0]):
        to[k] += new[k]


class Brightness(NamedTuple):
    """dark, bright: as the tables, least and greatest feature there (empty: geometry alone); light, q: see `bound`."""

    dark: np.ndarray
    bright: np.ndarray
    light: np.ndarray
    q: np.ndarray


@kernel
def branch_and_bound(  # noqa: C901, PLR0912  (one loop over a stack)
    tables: np.ndarray,
    brightness: Brightness,
    cells: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    tiles: np.ndarray,
    roots: np.ndarray,
    bounds: np.ndarray,
    least: int,
    barred: np.ndarray,
) -> tuple[Any, Any, Any, Any]:
    """(score, heading number, ox, oy) of the best shift in [low, high] over all headings; heading -1 under `least`.

    tiles: (2,) squares of the coarsest level in x and y; roots: (k,) the flat numbers of those to look into, of all
    (A, tiles y, tiles x), and their bounds, greatest first. barred: (4,) heading number, ox, oy and squared
    radius [cells^2], with (A,) marks in the rest: 1 for headings in which shifts this near are left out; empty: none.
    Of equal scores the one of the lowest heading number, then oy, then ox is the best, as a scan of all would find.
    """
    dark, bright, light, q = brightness
    level = tables.shape[0] - 1
    pad = 2**level - 1
    nx, ny = tiles[0], tiles[1]
    best, ba, bx, by = least, np.int64(-1), np.int64(0), np.int64(0)
    stack = np.empty((4 * level + 8, 4), np.int64)  # level, ox, oy, bound
    four = np.empty((4, 3), np.int64)
    for root, most in zip(roots, bounds):  # noqa: B905  (compiled code knows no `strict`)
        if most < best:
            break
        a = root // (ny * nx)
        near = barred.shape[0] > 0 and barred[4 + a] == 1
        top = 1
        stack[0, 0], stack[0, 3] = level, most
        stack[0, 1] = low[0] + (root % nx) * (pad + 1)
        stack[0, 2] = low[1] + (root // nx % ny) * (pad + 1)
        while top > 0:
            top -= 1
            h, ox, oy, b = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            if b < best or ox > high[0] or oy > high[1]:
                continue
            if near:  # the farthest corner of the square inside the barred disc: all of it is left out
                side = 2**h - 1
                fx = max(abs(ox - barred[1]), abs(ox + side - barred[1]))
                fy = max(abs(oy - barred[2]), abs(oy + side - barred[2]))
                if fx * fx + fy * fy <= barred[3]:
                    continue
            if h == 0:
                if b > best or ba < 0 or (a, oy, ox) < (ba, by, bx):
                    best, ba, bx, by = b, a, ox, oy
                continue
            half = 2 ** (h - 1)
            for k in range(4):
                x, y = ox + (k & 1) * half, oy + (k >> 1) * half
                four[k, 0], four[k, 1], four[k, 2] = x, y, -1
                if x <= high[0] and y <= high[1]:
                    four[k, 2] = bound(tables[h - 1], dark[h - 1], bright[h - 1], light, cells[a], q, x, y, pad, best)
            for _ in range(4):  # the most promising comes last on the stack
                worst = 0
                for k in range(1, 4):
                    if four[k, 2] < four[worst, 2]:
                        worst = k
                if best <= four[worst, 2] < 2**62:
                    stack[top, 0], stack[top, 1], stack[top, 2] = h - 1, four[worst, 0], four[worst, 1]
                    stack[top, 3] = four[worst, 2]
                    top += 1
                four[worst, 2] = 2**62
    return best, ba, bx, by


@kernel
def fit_normals(points: np.ndarray, reach: float) -> np.ndarray:
    """(n, 3) for points (n, 2) [m]: unit normal of the line through all within `reach`, and how wide that line is.

    The width is the ratio of scatter across to scatter along, 0 for a wall, 1 for a blob or a point alone.
    """
    n = points.shape[0]
    out = np.zeros((n, 3))
    if n == 0:
        return out
    numbered = np.empty((n, 3))
    for i in range(n):
        numbered[i, 0], numbered[i, 1], numbered[i, 2] = points[i, 0], points[i, 1], i
    ordered, starts, corner, cols = sort_into_cells(numbered, reach)
    rows = (starts.shape[0] - 1) // cols
    for j in range(n):
        x, y, i = ordered[j, 0], ordered[j, 1], int(ordered[j, 2])
        cx, cy = column_of(x - corner[0], reach, cols), column_of(y - corner[1], reach, rows)
        m, sx, sy, xx, xy, yy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for r in range(max(cy - 1, 0), min(cy + 2, rows)):
            for k in range(starts[r * cols + max(cx - 1, 0)], starts[r * cols + min(cx + 1, cols - 1) + 1]):
                dx, dy = ordered[k, 0] - x, ordered[k, 1] - y
                if dx * dx + dy * dy <= reach * reach:
                    m += 1
                    sx += dx
                    sy += dy
                    xx += dx * dx
                    xy += dx * dy
                    yy += dy * dy
        if m == 0:  # what is no number has nothing within reach, not even itself
            out[i, 1], out[i, 2] = 1.0, 1.0
            continue
        xx, xy, yy = xx - sx * sx / m, xy - sx * sy / m, yy - sy * sy / m
        half, gap = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
        along = 0.5 * math.atan2(2.0 * xy, xx - yy)
        out[i, 0], out[i, 1] = -math.sin(along), math.cos(along)
        out[i, 2] = max(half - gap, 0.0) / (half + gap) if m > 2 and half + gap > 0.0 else 1.0
    return out


@kernel
def lay_onto_lines(
    points: np.ndarray,
    start: np.ndarray,
    walls: np.ndarray,
    lines: np.ndarray,
    nearest: np.ndarray,
    origin: np.ndarray,
    cell: float,
    gate: float,
    widths: np.ndarray,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray, int, float]:
    """(pose (3,), H (3, 3), matches, mean squared distance [m^2]) of a scan laid onto the lines of a submap.

    Gauss-Newton on Geman-McClure costs of the distance to the nearest wall point's line, and, as far as that line is
    wide, of the distance along it; `widths` (k,) [m]: of the cost, one an iteration, the last of them until the step is
    under `tolerance`. H: sum of weighted squared Jacobians [unit variance], by a step in the scan's own frame.
    Matches lie within `gate` [m] of their point. walls: (m, 2); lines: (m, 3) of `fit_normals`; nearest: of `stamp`.
    """
    rows, cols = nearest.shape
    pose = start.copy()
    H = np.zeros((3, 3))
    count, squares = 0, 0.0
    last = widths.shape[0] + 20
    for step in range(last + 1):
        width = widths[min(step, widths.shape[0] - 1)]
        k2 = width * width
        c, s = math.cos(pose[2]), math.sin(pose[2])
        g = np.zeros(3)
        H[:] = 0.0
        count, squares = 0, 0.0
        for i in range(points.shape[0]):
            px, py = points[i, 0], points[i, 1]
            x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
            col, row = cell_of((x - origin[0]) / cell), cell_of((y - origin[1]) / cell)
            if not (0 <= row < rows and 0 <= col < cols):
                continue
            k = nearest[row, col]
            if k < 0:
                continue
            dx, dy = x - walls[k, 0], y - walls[k, 1]
            if dx * dx + dy * dy > gate * gate:
                continue
            nx, ny, wide = lines[k, 0], lines[k, 1], lines[k, 2]
            count += 1
            e, f = nx * dx + ny * dy, ny * dx - nx * dy
            squares += e * e + wide * f * f
            for axis in range(2):  # across the line, then along it
                ax, ay, d = (nx, ny, e) if axis == 0 else (ny, -nx, f)
                w = (k2 / (k2 + d * d)) ** 2 * (1.0 if axis == 0 else wide)
                jx, jy = c * ax + s * ay, c * ay - s * ax
                jt = jy * px - jx * py
                g[0] += w * jx * d
                g[1] += w * jy * d
                g[2] += w * jt * d
                H[0, 0] += w * jx * jx
                H[0, 1] += w * jx * jy
                H[0, 2] += w * jx * jt
                H[1, 1] += w * jy * jy
                H[1, 2] += w * jy * jt
                H[2, 2] += w * jt * jt
        if step == last:
            break
        ridge = 1e-3 * (H[0, 0] + H[1, 1]) + 1e-9
        u, v, t = solve3(H[0, 0] + ridge, H[0, 1], H[0, 2], H[1, 1] + ridge, H[1, 2], H[2, 2] + ridge, g[0], g[1], g[2])
        pose[0] -= c * u - s * v
        pose[1] -= s * u + c * v
        pose[2] -= t
        if step >= widths.shape[0] and max(abs(u), abs(v), abs(t)) < tolerance:
            last = step + 1  # H and counts once more, where the scan has come to lie
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    return pose, H, count, squares / max(count, 1)
