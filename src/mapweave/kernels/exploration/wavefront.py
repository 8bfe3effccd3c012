"""Paths through a grid: what it costs from a place to everywhere, and the cheapest path back; and along arcs."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of

UNREACHED = -1  # cost of a cell that no path leads to
NO_LIMIT = 2**31 - 1  # the largest cost an int32 holds
STRAIGHT, DIAGONAL = 140, 198  # what a move between cells of weight 1 costs; 198 / 140 is sqrt 2 but for 5e-5


class BucketQueue(NamedTuple):
    """Cells waiting, a list a cost. head: the first cell of each list; after, before: each cell's neighbours in it."""

    head: np.ndarray
    after: np.ndarray
    before: np.ndarray


@kernel
def _unlink(queue: BucketQueue, bucket: int, cell: int) -> None:
    head, after, before = queue
    if before[cell] >= 0:
        after[before[cell]] = after[cell]
    else:
        head[bucket] = after[cell]
    if after[cell] >= 0:
        before[after[cell]] = before[cell]


@kernel
def _link(queue: BucketQueue, bucket: int, cell: int) -> None:
    head, after, before = queue
    after[cell], before[cell] = head[bucket], -1
    if head[bucket] >= 0:
        before[head[bucket]] = cell
    head[bucket] = cell


@kernel
def _price(weight: np.ndarray, y: int, x: int, dy: int, dx: int) -> int:
    """What the move (dy, dx) from cell y, x costs, and the move back; 0 where it may not be made."""
    v, u = y + dy, x + dx
    if (dy == 0 and dx == 0) or v < 0 or u < 0 or v >= weight.shape[0] or u >= weight.shape[1] or weight[v, u] == 0:
        return 0
    both = int(weight[y, x]) + int(weight[v, u])
    if dy == 0 or dx == 0:
        return (STRAIGHT // 2) * both
    if weight[y, u] == 0 or weight[v, x] == 0:
        return 0
    return (DIAGONAL // 2) * both


@kernel
def spread(weight: np.ndarray, sources: np.ndarray, limit: int) -> np.ndarray:
    """Cost (rows, cols) int32 of the cheapest path from the nearest of `sources` to every cell, or UNREACHED.

    weight: (rows, cols) uint8, what the length within a cell is multiplied by, 0 for a cell that is blocked; sources:
    (k, 2) rows (iy, ix), blocked and negative ones do not count. A move along an axis costs 140, a diagonal one 198,
    times the mean of the two cells' weights; diagonals never pass a blocked corner. Cells dearer than `limit` stay
    unreached or are dearer than they need be. Dijkstra with one bucket a cost.
    """
    rows, cols = weight.shape
    size = rows * cols
    w = weight.ravel()
    buckets = DIAGONAL * int(w.max()) + 1
    cost = np.full(size, UNREACHED, dtype=np.int32)
    done = np.zeros(size, dtype=np.bool_)
    head = np.full(buckets, -1, dtype=np.int32)
    after, before = np.full(size, -1, dtype=np.int32), np.full(size, -1, dtype=np.int32)
    queue = BucketQueue(head, after, before)
    for k in range(sources.shape[0]):
        c = sources[k, 0] * cols + sources[k, 1]
        if sources[k, 0] >= 0 and w[c] > 0 and cost[c] < 0:
            cost[c] = 0
            _link(queue, 0, c)
    now, empty = 0, 0
    while empty < buckets and now <= limit:
        bucket = now % buckets
        c = int(head[bucket])
        if c < 0:
            now += 1
            empty += 1
            continue
        empty = 0
        _unlink(queue, bucket, c)
        done[c] = True
        y, x = c // cols, c % cols
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                price = _price(weight, y, x, dy, dx)
                n = (y + dy) * cols + x + dx
                if price > 0 and not done[n] and (cost[n] < 0 or now + price < cost[n]):
                    if cost[n] >= 0:
                        _unlink(queue, cost[n] % buckets, n)
                    cost[n] = now + price
                    _link(queue, (now + price) % buckets, n)
    return cost.reshape(rows, cols)


@kernel
def descend(cost: np.ndarray, weight: np.ndarray, start: np.ndarray, most: int) -> np.ndarray:
    """Cells (k, 2) of a cheapest path from `start` (iy, ix) to a source, at most `most`; none from an unreached one.

    cost: what `spread` made of `weight`.
    """
    out = np.empty((most, 2), dtype=np.int64)
    y, x = int(start[0]), int(start[1])
    count = 0
    while count < most and cost[y, x] >= 0:
        out[count, 0], out[count, 1] = y, x
        count += 1
        least, to_y, to_x = np.inf, y, x
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                v, u = y + dy, x + dx
                if _price(weight, y, x, dy, dx) == 0 or cost[v, u] < 0 or cost[v, u] >= cost[y, x]:
                    continue
                through = cost[v, u] + _price(weight, y, x, dy, dx)
                if through < least:
                    least, to_y, to_x = float(through), v, u
        if to_y == y and to_x == x:
            break
        y, x = to_y, to_x
    return out[:count]


@kernel
def arc_points(v: float, w: float, period: float, samples: int) -> np.ndarray:
    """Poses (samples + 1, 3) along the circle arc that (v, w) drives in `period`, from the pose 0, evenly in time."""
    out = np.zeros((samples + 1, 3))
    for k in range(1, samples + 1):
        t = period * k / samples
        turn = w * t
        if abs(turn) < 1e-6:
            out[k, 0], out[k, 1] = v * t, 0.5 * v * t * turn
        else:
            out[k, 0], out[k, 1] = v / w * np.sin(turn), v / w * (1.0 - np.cos(turn))
        out[k, 2] = turn
    return out


@kernel
def arc_clearance(commands: np.ndarray, period: float, points: np.ndarray, step: float) -> np.ndarray:
    """Least distance (m,) [m] between each arc and any of `points`, infinite without points.

    commands: (m, 2) v [m/s], w [rad/s]; points: (k, 2) in the robot's frame; arcs are sampled every `step` [m] or
    finer, start and end among the samples.
    """
    out = np.full(commands.shape[0], np.inf)
    for m in range(commands.shape[0]):
        v, w = commands[m, 0], commands[m, 1]
        samples = cell_of(np.ceil(abs(v) * period / step)) + 1
        arc = arc_points(v, w, period, samples)
        least = np.inf
        for k in range(points.shape[0]):
            for a in range(arc.shape[0]):
                dx, dy = points[k, 0] - arc[a, 0], points[k, 1] - arc[a, 1]
                least = min(least, dx * dx + dy * dy)
        out[m] = np.sqrt(least)
    return out
