"""Ways through a grid: path lengths from a place to everywhere, the way down them, and straight lines of sight."""

import numpy as np

from ._jit import kernel

UNREACHED = -1
STRAIGHT, DIAGONAL = 70, 99  # what a move costs; 99 / 70 is sqrt 2 but for 5e-5


@kernel
def _unlink(head: np.ndarray, after: np.ndarray, before: np.ndarray, bucket: int, cell: int) -> None:
    if before[cell] >= 0:
        after[before[cell]] = after[cell]
    else:
        head[bucket] = after[cell]
    if after[cell] >= 0:
        before[after[cell]] = before[cell]


@kernel
def _link(head: np.ndarray, after: np.ndarray, before: np.ndarray, bucket: int, cell: int) -> None:
    after[cell], before[cell] = head[bucket], -1
    if head[bucket] >= 0:
        before[head[bucket]] = cell
    head[bucket] = cell


@kernel
def _price(weight: np.ndarray, y: int, x: int, dy: int, dx: int) -> int:
    """What the move (dy, dx) from cell y, x costs; 0 where it may not be made."""
    v, u = y + dy, x + dx
    if (dy == 0 and dx == 0) or v < 0 or u < 0 or v >= weight.shape[0] or u >= weight.shape[1]:
        return 0
    if dy == 0 or dx == 0:
        return STRAIGHT * int(weight[v, u])
    if weight[y, u] == 0 or weight[v, x] == 0:
        return 0
    return DIAGONAL * int(weight[v, u])


@kernel
def spread(weight: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """Cost (rows, cols) int32 of the cheapest way from the nearest of `sources` to every cell, or UNREACHED.

    weight: (rows, cols) uint8, what entering a cell multiplies the move's cost by, 0 for a cell that is blocked;
    sources: (k, 2) rows (iy, ix), blocked ones do not count. A move along an axis costs 70, a diagonal one 99;
    diagonals never pass a blocked corner. Dijkstra with one bucket a cost.
    """
    rows, cols = weight.shape
    size = rows * cols
    w = weight.ravel()
    buckets = DIAGONAL * int(w.max()) + 1
    cost = np.full(size, UNREACHED, dtype=np.int32)
    done = np.zeros(size, dtype=np.bool_)
    head = np.full(buckets, -1, dtype=np.int32)
    after, before = np.full(size, -1, dtype=np.int32), np.full(size, -1, dtype=np.int32)
    for k in range(sources.shape[0]):
        c = sources[k, 0] * cols + sources[k, 1]
        if w[c] > 0 and cost[c] < 0:
            cost[c] = 0
            _link(head, after, before, 0, c)
    now, empty = 0, 0
    while empty < buckets:
        bucket = now % buckets
        c = int(head[bucket])
        if c < 0:
            now += 1
            empty += 1
            continue
        empty = 0
        _unlink(head, after, before, bucket, c)
        done[c] = True
        y, x = c // cols, c % cols
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                price = _price(weight, y, x, dy, dx)
                n = (y + dy) * cols + x + dx
                if price > 0 and not done[n] and (cost[n] < 0 or now + price < cost[n]):
                    if cost[n] >= 0:
                        _unlink(head, after, before, cost[n] % buckets, n)
                    cost[n] = now + price
                    _link(head, after, before, (now + price) % buckets, n)
    return cost.reshape(rows, cols)


@kernel
def descend(cost: np.ndarray, start: np.ndarray, most: int) -> np.ndarray:
    """Cells (k, 2) from `start` (iy, ix) down `cost` to a source, at most `most`; none from an unreached one."""
    rows, cols = cost.shape
    out = np.empty((most, 2), dtype=np.int64)
    y, x = np.int64(start[0]), np.int64(start[1])
    count = 0
    while count < most and cost[y, x] >= 0:
        out[count, 0], out[count, 1] = y, x
        count += 1
        best, by, bx = np.int64(cost[y, x]), y, x
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                v, u = y + dy, x + dx
                if v < 0 or u < 0 or v >= rows or u >= cols or cost[v, u] < 0 or cost[v, u] >= best:
                    continue
                if dy != 0 and dx != 0 and (cost[y, u] < 0 or cost[v, x] < 0):
                    continue
                best, by, bx = np.int64(cost[v, u]), v, u
        if by == y and bx == x:
            break
        y, x = by, bx
    return out[:count]


@kernel
def in_sight(clear: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the straight line from a to b, (x, y) in cells from the grid's corner, crosses clear cells alone."""
    rows, cols = clear.shape
    length = np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)
    steps = np.int64(np.ceil(4.0 * length)) + 1
    for k in range(steps + 1):
        x = np.int64(np.floor(a[0] + (b[0] - a[0]) * k / steps))
        y = np.int64(np.floor(a[1] + (b[1] - a[1]) * k / steps))
        if x < 0 or y < 0 or x >= cols or y >= rows or not clear[y, x]:
            return False
    return True
