"""Better open tours for a team: ends exchanged between two tours, short stretches moved."""

from typing import NamedTuple

import numpy as np

from .._jit import kernel


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
