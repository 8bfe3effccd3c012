"""Many walls, asked about here: segments in square buckets, so that a beam or a robot meets the few that are near."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of
from .segments import NONE, meet, meet_disc


class WallBuckets(NamedTuple):
    """Which of `segments` (s, 4) touch which square of side `cell` [m], from `corner` (2,) [m], `cols` in a row.

    Those of square `b = row * cols + col` are `items[first[b]:first[b + 1]]`.
    """

    segments: np.ndarray
    corner: np.ndarray
    cell: float
    cols: int
    first: np.ndarray
    items: np.ndarray


SLACK = 1e-9  # [m] by which a bucket reaches beyond its square, so that a wall on a border is in both


@kernel
def fill_buckets(
    segments: np.ndarray, corner: np.ndarray, cell: float, rows: int, cols: int
) -> tuple[np.ndarray, np.ndarray]:
    """Which segments touch which bucket: `items[first[b]:first[b + 1]]` for bucket `b = row * cols + col`.

    segments: (s, 4) as x0 y0 x1 y1, all inside the rectangle of buckets; corner: (2,) its lower left; cell: side.
    """
    first = np.zeros(rows * cols + 1, dtype=np.int64)
    items = np.empty(0, dtype=np.int64)
    for sweep in range(2):
        if sweep == 1:
            for b in range(rows * cols):
                first[b + 1] += first[b]
            items = np.empty(first[-1], dtype=np.int64)
            at = first.copy()
        for k in range(segments.shape[0]):
            x0, y0 = segments[k, 0] - corner[0], segments[k, 1] - corner[1]
            x1, y1 = segments[k, 2] - corner[0], segments[k, 3] - corner[1]
            length = np.hypot(x1 - x0, y1 - y0)
            c0, c1 = _index(min(x0, x1) - SLACK, cell, cols), _index(max(x0, x1) + SLACK, cell, cols)
            r0, r1 = _index(min(y0, y1) - SLACK, cell, rows), _index(max(y0, y1) + SLACK, cell, rows)
            for r in range(r0, r1 + 1):
                for c in range(c0, c1 + 1):
                    if length > 0.0:
                        mx, my = (c + 0.5) * cell - x0, (r + 0.5) * cell - y0
                        ux, uy = (x1 - x0) / length, (y1 - y0) / length
                        if abs(mx * uy - my * ux) > 0.5 * cell * (abs(ux) + abs(uy)) + SLACK:
                            continue
                    b = r * cols + c
                    if sweep == 0:
                        first[b + 1] += 1
                    else:
                        items[at[b]] = k
                        at[b] += 1
    return first, items


@kernel
def cast_in_grid(
    sensor: np.ndarray,
    angles: np.ndarray,
    discs: np.ndarray,
    far: float,
    walls: WallBuckets,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `raycast.cast`, in time that does not grow with the number of walls.

    sensor: (m, 3) poses; angles: (n,) [rad]; discs: (m, d, 3) as x y radius, one set a scan. Returns range
    (m, n) [m] (infinite beyond `far`), what was hit (m, n) (segment k, or s + disc, or -1), and the cosine of incidence
    (m, n).
    """
    segments, corner, cell, cols, first, items = walls
    m, n, s, d = sensor.shape[0], angles.shape[0], segments.shape[0], discs.shape[1]
    rng = np.full((m, n), np.inf)
    what = np.full((m, n), NONE, dtype=np.int64)
    cosine = np.zeros((m, n))
    for i in range(m):
        px, py, heading = sensor[i, 0], sensor[i, 1], sensor[i, 2]
        for j in range(n):
            ux, uy = np.cos(heading + angles[j]), np.sin(heading + angles[j])
            best, hit, across = far, NONE, 0.0
            for k in range(d):
                r, slant = meet_disc(px, py, ux, uy, discs[i, k])
                if r < best:
                    best, hit, across = r, s + k, slant
            r, wall, slant = _first_wall((px, py), (ux, uy), best, segments, corner, cell, cols, first, items)
            if wall != NONE:
                best, hit, across = r, wall, slant
            if hit != NONE:
                rng[i, j], what[i, j], cosine[i, j] = best, hit, across
    return rng, what, cosine


@kernel
def _first_wall(
    eye: tuple[float, float],
    ray: tuple[float, float],
    far: float,
    segments: np.ndarray,
    corner: np.ndarray,
    cell: float,
    cols: int,
    first: np.ndarray,
    items: np.ndarray,
) -> tuple[float, int, float]:
    """Range, number and cosine of incidence of the first wall along a beam, bucket by bucket; -1 without one.

    eye: where the beam begins [m]; ray: its direction, a unit vector.
    """
    (px, py), (ux, uy) = eye, ray
    rows = (first.shape[0] - 1) // cols
    best, hit, across = far, NONE, 0.0
    gone, until = _inside(px - corner[0], py - corner[1], ux, uy, cols * cell, rows * cell)
    col = _index(px - corner[0] + gone * ux, cell, cols)
    row = _index(py - corner[1] + gone * uy, cell, rows)
    step_c, step_r = (1 if ux > 0 else -1), (1 if uy > 0 else -1)
    next_c = ((col + (ux > 0)) * cell - (px - corner[0])) / ux if ux != 0.0 else np.inf
    next_r = ((row + (uy > 0)) * cell - (py - corner[1])) / uy if uy != 0.0 else np.inf
    each_c = cell / abs(ux) if ux != 0.0 else np.inf
    each_r = cell / abs(uy) if uy != 0.0 else np.inf
    while gone < until and gone < best and 0 <= col < cols and 0 <= row < rows:
        b = row * cols + col
        for at in range(first[b], first[b + 1]):
            a = items[at]
            r, cosine = meet(px, py, ux, uy, segments, a)
            if r < best:
                best, hit, across = r, a, cosine
        if next_c < next_r:
            gone, col, next_c = next_c, col + step_c, next_c + each_c
        else:
            gone, row, next_r = next_r, row + step_r, next_r + each_r
    return best, hit, across


@kernel
def touches_wall(points: np.ndarray, radius: float, walls: WallBuckets) -> np.ndarray:
    """Whether a disc (n,) around each of `points` (n, 2) touches a segment."""
    segments, corner, cell, cols, first, items = walls
    out = np.zeros(points.shape[0], dtype=np.bool_)
    for k in range(points.shape[0]):
        out[k] = _touches(points[k, 0], points[k, 1], radius, segments, corner, cell, cols, first, items)
    return out


@kernel
def _touches(
    x: float,
    y: float,
    radius: float,
    segments: np.ndarray,
    corner: np.ndarray,
    cell: float,
    cols: int,
    first: np.ndarray,
    items: np.ndarray,
) -> bool:
    """Whether a disc around x, y touches a segment. Unpacked: a record here would cost more than the loop itself."""
    rows = (first.shape[0] - 1) // cols
    c0, c1 = _index(x - radius - corner[0], cell, cols), _index(x + radius - corner[0], cell, cols)
    r0, r1 = _index(y - radius - corner[1], cell, rows), _index(y + radius - corner[1], cell, rows)
    for row in range(r0, r1 + 1):
        for col in range(c0, c1 + 1):
            b = row * cols + col
            for at in range(first[b], first[b + 1]):
                a = items[at]
                ex, ey = segments[a, 2] - segments[a, 0], segments[a, 3] - segments[a, 1]
                square = ex * ex + ey * ey
                along = 0.0
                if square > 0.0:
                    along = ((x - segments[a, 0]) * ex + (y - segments[a, 1]) * ey) / square
                    along = min(1.0, max(0.0, along))
                dx, dy = segments[a, 0] + along * ex - x, segments[a, 1] + along * ey - y
                if dx * dx + dy * dy < radius * radius:
                    return True
    return False


@kernel
def drive_discs(
    poses: np.ndarray,
    commands: np.ndarray,
    period: float,
    parts: int,
    radius: float,
    walls: WallBuckets,
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (m, 3) after all robots drove their arcs `commands` (m, 2) as v, w side by side, and who was stopped (m,).

    The period is cut into `parts`; a robot whose next part would touch a wall or another robot turns on the spot for
    the rest of the period.
    """
    segments, corner, cell, cols, first, items = walls
    m = poses.shape[0]
    now = poses.copy()
    stopped = np.zeros(m, dtype=np.bool_)
    dt = period / parts
    for _ in range(parts):
        for j in range(m):
            v, w = commands[j, 0], commands[j, 1]
            half = 0.5 * w * dt
            chord = v * dt * (1.0 - half * half / 6.0 if abs(half) < 1e-4 else np.sin(half) / half)
            x = now[j, 0] + chord * np.cos(now[j, 2] + half)
            y = now[j, 1] + chord * np.sin(now[j, 2] + half)
            now[j, 2] += w * dt
            if stopped[j] or v == 0.0:
                continue
            blocked = _touches(x, y, radius, segments, corner, cell, cols, first, items)
            for k in range(m):
                if k != j and np.hypot(now[k, 0] - x, now[k, 1] - y) < 2.0 * radius:
                    blocked = True
            if blocked:
                stopped[j] = True
            else:
                now[j, 0], now[j, 1] = x, y
    return now, stopped


@kernel
def _inside(x: float, y: float, ux: float, uy: float, wide: float, high: float) -> tuple[float, float]:
    """Where a beam from x, y enters and leaves the rectangle from the origin; nothing lies between when it misses."""
    enter, leave = 0.0, np.inf
    for at, u, size in ((x, ux, wide), (y, uy, high)):
        if u == 0.0:
            if at < 0.0 or at > size:
                leave = -1.0
            continue
        a, b = -at / u, (size - at) / u
        enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    return enter, leave


@kernel
def _index(at: float, cell: float, count: int) -> int:
    return min(count - 1, max(0, cell_of(at / cell)))
