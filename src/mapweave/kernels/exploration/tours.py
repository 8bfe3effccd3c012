"""Set cover by discs and balanced open tours, bettered: where a team should go to see everything soon."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel


class TourCosts(NamedTuple):
    """first: (M, n) cost from each robot to each node; between: (n, n); last: (M, n) from each to where it ends.

    balance: what the sum of all tours weighs beside the longest.
    """

    first: np.ndarray
    between: np.ndarray
    last: np.ndarray
    balance: float


@kernel
def _add_disc(gain: np.ndarray, cell: np.ndarray, xs: np.ndarray, ys: np.ndarray, radius: float, by: int) -> None:
    """`by` more cells for every disc of the grid `ys` x `xs` that reaches `cell`."""
    for iy in range(len(ys)):
        dy = ys[iy] - cell[1]
        if abs(dy) > radius:
            continue
        half = np.sqrt(radius * radius - dy * dy)
        for ix in range(np.searchsorted(xs, cell[0] - half), np.searchsorted(xs, cell[0] + half, side="right")):
            gain[iy, ix] += by


@kernel
def greedy_cover(cells: np.ndarray, xs: np.ndarray, ys: np.ndarray, radius: float) -> np.ndarray:
    """Centres (k, 2) on the grid `xs` x `ys` (ascending) of discs that cover every coverable cell (n, 2).

    The disc with the largest gain first.
    """
    gain = np.zeros((len(ys), len(xs)), dtype=np.int64)
    for i in range(len(cells)):
        _add_disc(gain, cells[i], xs, ys, radius, 1)
    covered = np.zeros(len(cells), dtype=np.bool_)
    out = np.empty((len(xs) * len(ys), 2))
    count = 0
    while count < len(out):
        best = np.argmax(gain)
        iy, ix = best // len(xs), best % len(xs)
        if gain[iy, ix] <= 0:
            break
        out[count, 0], out[count, 1] = xs[ix], ys[iy]
        count += 1
        for i in range(len(cells)):
            dx, dy = cells[i, 0] - xs[ix], cells[i, 1] - ys[iy]
            if not covered[i] and dx * dx + dy * dy <= radius * radius:
                covered[i] = True
                _add_disc(gain, cells[i], xs, ys, radius, -1)
    return out[:count]


@kernel
def _length(costs: TourCosts, tour: np.ndarray, n: int, robot: int) -> float:
    first, between, last, _ = costs
    if n == 0:
        return 0.0
    total: float = first[robot, tour[0]] + last[robot, tour[n - 1]]
    for k in range(n - 1):
        total += between[tour[k], tour[k + 1]]
    return total


@kernel
def _insertion_cost(costs: TourCosts, tour: np.ndarray, n: int, robot: int, v: int, p: int) -> float:
    """What putting node v at place p of a tour of n nodes adds to its length."""
    first, between, last, _ = costs
    cost: float = 0.0
    if n == 0:
        cost = first[robot, v] + last[robot, v]
    elif p == 0:
        cost = first[robot, v] + between[v, tour[0]] - first[robot, tour[0]]
    elif p < n:
        cost = between[tour[p - 1], v] + between[v, tour[p]] - between[tour[p - 1], tour[p]]
    else:
        cost = between[tour[n - 1], v] + last[robot, v] - last[robot, tour[n - 1]]
    return cost


@kernel
def _insert(tour: np.ndarray, n: int, v: int, p: int) -> None:
    for k in range(n, p, -1):
        tour[k] = tour[k - 1]
    tour[p] = v


@kernel
def _reverse_while_shorter(costs: TourCosts, tour: np.ndarray, n: int, robot: int) -> bool:
    """2-opt on one tour, in place; whether it helped."""
    helped = False
    length = _length(costs, tour, n, robot)
    for a in range(n - 1):
        for b in range(a + 1, n):
            tour[a : b + 1] = tour[a : b + 1][::-1].copy()
            shorter = _length(costs, tour, n, robot)
            if shorter < length - 1e-9:
                length = shorter
                helped = True
            else:
                tour[a : b + 1] = tour[a : b + 1][::-1].copy()
    return helped


@kernel
def _relocate(costs: TourCosts, tours: np.ndarray, counts: np.ndarray, r: int, a: int) -> bool:
    """Node a of robot r's tour moved to where it costs least, another tour or place; whether it moved."""
    v, n = tours[r, a], counts[r]
    before = _length(costs, tours[r], n, r)
    rest = np.empty(n, dtype=np.int64)
    rest[:a], rest[a : n - 1] = tours[r, :a], tours[r, a + 1 : n]
    without = _length(costs, rest, n - 1, r)
    for s in range(len(counts)):
        there = without if s == r else _length(costs, tours[s], counts[s], s)
        size = n - 1 if s == r else counts[s]
        for p in range(size + 1):
            tour = rest if s == r else tours[s]
            length = there + _insertion_cost(costs, tour, size, s, v, p)
            if s == r:
                better = length < before - 1e-9
            else:
                top_now, top_then = max(before, there), max(without, length)
                now, then = top_now + costs.balance * (before + there), top_then + costs.balance * (without + length)
                better = then < now - 1e-9
            if better:
                tours[r, : n - 1] = rest[: n - 1]
                counts[r] = n - 1
                _insert(tours[s], counts[s], v, p)
                counts[s] += 1
                return True
    return False


@kernel
def _cheapest(
    costs: TourCosts,
    tours: np.ndarray,
    counts: np.ndarray,
    lengths: np.ndarray,
    done: np.ndarray,
) -> tuple[int, int, int]:
    """The node left, robot and place whose insertion keeps the tours shortest."""
    best, node, robot, place = np.inf, 0, 0, 0
    longest = lengths.max()
    for v in range(len(done)):
        for r in range(len(counts)):
            for p in range(counts[r] + 1):
                extra = _insertion_cost(costs, tours[r], counts[r], r, v, p)
                cost = max(longest, lengths[r] + extra) + costs.balance * extra
                if not done[v] and cost < best:
                    best, node, robot, place = cost, v, r, p
    return node, robot, place


@kernel
def balanced_tours(
    first: np.ndarray, between: np.ndarray, last: np.ndarray, balance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tours of all nodes, one a robot, short in the longest and then in the sum.

    first: (M, n) cost from each robot to each node; between: (n, n); last: (M, n) cost from each node to where the
    robot should end, zeros for open tours; balance: what the sum of all tours weighs beside the longest. Returns (tours
    (M, n), counts (M,)): cheapest insertion, then reversals and relocations while they help.
    """
    M, n = first.shape
    costs = TourCosts(first, between, last, balance)
    tours = np.zeros((M, n + 1), dtype=np.int64)
    counts = np.zeros(M, dtype=np.int64)
    lengths = np.zeros(M)
    done = np.zeros(n, dtype=np.bool_)
    for _ in range(n):
        node, robot, place = _cheapest(costs, tours, counts, lengths, done)
        lengths[robot] += _insertion_cost(costs, tours[robot], counts[robot], robot, node, place)
        _insert(tours[robot], counts[robot], node, place)
        counts[robot] += 1
        done[node] = True
    for _ in range(50):
        helped = False
        for r in range(M):
            helped |= _reverse_while_shorter(costs, tours[r], counts[r], r)
            a = 0
            while a < counts[r]:
                if _relocate(costs, tours, counts, r, a):
                    helped = True
                else:
                    a += 1
        if not helped:
            break
    return tours[:, :n].copy(), counts


class OpenTours(NamedTuple):
    """Tours being tried better, in place. first: (M, n) cost from each robot to each node; between: (n, n).

    tours: (M, n) nodes, of which each robot passes the first counts (M,); lengths: (M,).
    """

    first: np.ndarray
    between: np.ndarray
    tours: np.ndarray
    counts: np.ndarray
    lengths: np.ndarray


@kernel
def open_length(first: np.ndarray, between: np.ndarray, robot: int, tour: np.ndarray, count: int) -> float:
    """Length of robot's tour over the first `count` nodes of `tour`."""
    if count == 0:
        return 0.0
    total: float = first[robot, tour[0]]
    for k in range(count - 1):
        total += between[tour[k], tour[k + 1]]
    return total


@kernel
def tours_cost(lengths: np.ndarray) -> float:
    """What a set of tours costs: the root of the sum of their squares, between the longest and the sum."""
    return float(np.sqrt((lengths * lengths).sum()))


@kernel
def _exchange_ends(plan: OpenTours, r: int, s: int) -> bool:
    """Tours r and s cut in two and joined crosswise where that costs less; whether it did."""
    first, between, tours, counts, lengths = plan
    n = tours.shape[1]
    one, two = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    before = tours_cost(lengths)
    old_r, old_s = lengths[r], lengths[s]
    for a in range(counts[r] + 1):
        for b in range(counts[s] + 1):
            size_r, size_s = a + counts[s] - b, b + counts[r] - a
            one[:a], one[a:size_r] = tours[r, :a], tours[s, b : counts[s]]
            two[:b], two[b:size_s] = tours[s, :b], tours[r, a : counts[r]]
            lengths[r] = open_length(first, between, r, one, size_r)
            lengths[s] = open_length(first, between, s, two, size_s)
            if tours_cost(lengths) < before - 1e-9:
                tours[r, :size_r], tours[s, :size_s] = one[:size_r], two[:size_s]
                counts[r], counts[s] = size_r, size_s
                return True
    lengths[r], lengths[s] = old_r, old_s
    return False


@kernel
def _without(tour: np.ndarray, count: int, a: int, size: int, out: np.ndarray) -> None:
    out[:a], out[a : count - size] = tour[:a], tour[a + size : count]


@kernel
def _with(tour: np.ndarray, count: int, p: int, part: np.ndarray, out: np.ndarray) -> None:
    size = len(part)
    out[:p], out[p : p + size], out[p + size : count + size] = tour[:p], part, tour[p:count]


@kernel
def _move_stretch(plan: OpenTours, r: int, a: int, stretch: int) -> bool:
    """Up to `stretch` nodes from place a of tour r put elsewhere, either way round, where that costs less."""
    first, between, tours, counts, lengths = plan
    n = tours.shape[1]
    rest, tried = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    before = tours_cost(lengths)
    for size in range(1, min(stretch, counts[r] - a) + 1):
        part = tours[r, a : a + size].copy()
        _without(tours[r], counts[r], a, size, rest)
        for s in range(len(counts)):
            base = rest if s == r else tours[s]
            count = counts[r] - size if s == r else counts[s]
            old_r, old_s = lengths[r], lengths[s]
            for p in range(count + 1):
                for turned in range(2):
                    _with(base, count, p, part[::-1].copy() if turned else part, tried)
                    lengths[r] = open_length(first, between, r, rest, counts[r] - size)
                    lengths[s] = open_length(first, between, s, tried, count + size)
                    if tours_cost(lengths) < before - 1e-9:
                        if s != r:
                            tours[r, : counts[r] - size] = rest[: counts[r] - size]
                            counts[r] -= size
                        tours[s, : count + size] = tried[: count + size]
                        counts[s] = count + size
                        return True
            lengths[r], lengths[s] = old_r, old_s
    return False


@kernel
def improve_tours(first: np.ndarray, between: np.ndarray, tours: np.ndarray, counts: np.ndarray, stretch: int) -> None:
    """`tours` (M, n) and `counts` (M,) of open tours, in place, as `tours.balanced_tours` gives them: never dearer.

    first: (M, n) cost from each robot to each node; between: (n, n); stretch: most nodes moved together.
    """
    M = len(counts)
    lengths = np.zeros(M)
    for r in range(M):
        lengths[r] = open_length(first, between, r, tours[r], counts[r])
    plan = OpenTours(first, between, tours, counts, lengths)
    for _ in range(200):
        helped = False
        for r in range(M):
            for s in range(r):
                helped |= _exchange_ends(plan, r, s)
            a = 0
            while a < counts[r]:
                if _move_stretch(plan, r, a, stretch):
                    helped = True
                else:
                    a += 1
        if not helped:
            break
