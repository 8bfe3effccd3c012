"""Which two laser robots' maps are tried on each other next, and what was decided on those that were."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..mapping.map_overlap import KeyframeMap
from ..mapping.merge import MapClosure, Merge, merge_maps
from ..mapping.merge_search import MergeConfig, Start

GROWN = 1.25  # a pair is tried again when so many times as much speaks for it, or both have so many times the keyframes
LIKELY = 25  # cells in common from which on a pair is likely to be tied
UNTRIED = "not tried on each other yet"

Pair = tuple[str, str]
Ids = tuple[Int[np.ndarray, " n"], Int[np.ndarray, " m"]]


class PairTrial(NamedTuple):
    """Two maps to be laid on each other. Running it takes seconds and touches nothing but its own numbers.

    ids: what the keyframes of either are known by; common: what they are expected to have in common, 0 where that is
    not known.
    """

    a: str
    b: str
    poses: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"]]
    points: tuple[Sequence[Float[np.ndarray, "_ 2"]], Sequence[Float[np.ndarray, "_ 2"]]]
    ids: Ids
    cfg: MergeConfig
    start: Start | None
    common: int = 0

    @property
    def keyframes(self) -> int:
        """Of both together."""
        return len(self.poses[0]) + len(self.poses[1])

    def run(self) -> Merge:
        """What the maps say of each other."""
        maps = [
            KeyframeMap(name, pose, [_as_stored(p) for p in points])
            for name, pose, points in zip((self.a, self.b), self.poses, self.points, strict=True)
        ]
        return merge_maps(maps[0], maps[1], self.cfg, self.start)


class Tried(NamedTuple):
    """The decision on a pair when both had so many keyframes together, known by `ids`.

    common: what they were expected to have in common, 0 where that was not known; refused: how often the pair was,
    both maps being ripe.
    """

    merge: Merge
    keyframes: int
    ids: Ids
    common: int = 0
    refused: int = 0


@dataclass(slots=True)
class PairSearch:
    """The pairs of a team. ripe: so many keyframes a map needs before it is likely to be tied.

    tried: by the names of both, the first one first in the alphabet.
    """

    ripe: int = 0
    tried: dict[Pair, Tried] = field(default_factory=dict)

    def next(self, sizes: Mapping[str, int], common: Mapping[Pair, int] | None = None) -> Pair | None:
        """The pair to be tried now; None when there is none.

        sizes: robot -> keyframes. common: cells in which both are expected to have seen walls, of pairs whose starts
        are told. Of robots not connected yet those go first that are likely to have seen the same, the most likely ones
        before others; then pairs of ripe maps: those whose parts refused each other least, of these the ones that
        connect most robots, then the largest maps; the unripe last. A pair is tried again when there is more of it, a
        tie too, which holds better with more of both: before parts that refused each other twice.
        """
        roots = self._roots(sizes)
        members, refused = Counter(roots.values()), self._refused(roots)
        best: tuple[int, ...] | None = None
        chosen, worth = None, tuple[int, ...]()
        for pair in _pairs(sorted(sizes)):
            size, parts = sizes[pair[0]] + sizes[pair[1]], frozenset((roots[pair[0]], roots[pair[1]]))
            shared, apart = (common or {}).get(pair, 0), len(parts) > 1
            if apart and self._likely(pair, shared):
                worth = (2, shared)
            elif not self._fresh(pair, size, apart=apart):
                continue
            elif apart:
                early = min(sizes[pair[0]], sizes[pair[1]]) < self.ripe
                worth = (0 if early else 1, -refused[parts], sum(members[root] for root in parts), size)
            else:
                worth = (1, -1, 0, size)
            if best is None or worth > best:
                best, chosen = worth, pair
        return chosen

    def _likely(self, pair: Pair, common: int) -> bool:
        """Whether what both are expected to have seen asks for a trial."""
        before = self.tried.get(pair)
        return common >= LIKELY and (before is None or common >= GROWN * before.common)

    def _fresh(self, pair: Pair, size: int, *, apart: bool) -> bool:
        """Whether a trial may tell more than is known."""
        before = self.tried.get(pair)
        if before is None:
            return apart
        return (apart or before.merge.merged) and size >= GROWN * before.keyframes

    def _refused(self, roots: Mapping[str, str]) -> Counter[frozenset[str]]:
        """By two parts how often a map of one was refused by one of the other."""
        out: Counter[frozenset[str]] = Counter()
        for (a, b), known in self.tried.items():
            if known.refused and a in roots and b in roots:
                out[frozenset((roots[a], roots[b]))] += known.refused
        return out

    def apart(self, names: Iterable[str]) -> bool:
        """Whether they are not all connected."""
        return len(set(self._roots(names).values())) > 1

    def _roots(self, names: Iterable[str]) -> dict[str, str]:
        """Of each robot one of those that it is connected with, the same for all of them."""
        group = {name: name for name in names}

        def root(name: str) -> str:
            while group[name] != name:
                name = group[name]
            return name

        for (a, b), known in self.tried.items():
            if known.merge.merged and a in group and b in group:
                first, second = sorted((root(a), root(b)))
                group[second] = first
        return {name: root(name) for name in group}

    def decided(self, trial: PairTrial, merge: Merge) -> None:
        """What the trial came to."""
        before = self.tried.get((trial.a, trial.b))
        refused = 0 if before is None else before.refused
        refused += not merge.merged and min(map(len, trial.poses)) >= self.ripe
        self.tried[trial.a, trial.b] = Tried(merge, trial.keyframes, trial.ids, trial.common, refused)

    def forget(self, name: str) -> None:
        """Nothing is decided on pairs of this robot."""
        self.tried = {pair: known for pair, known in self.tried.items() if name not in pair}

    def known(self, ids: Mapping[str, Int[np.ndarray, " _"]]) -> dict[tuple[int, int], Merge]:
        """What stands on every pair of these robots, by their places; closures count keyframes as they are now.

        ids: robot -> what its keyframes are known by now. A tie of which every keyframe has left is forgotten.
        """
        out = {}
        number = {name: k for k, name in enumerate(ids)}
        for a, b in _pairs(list(ids)):
            merge = None
            if (before := self.tried.get((a, b))) is not None:
                merge = _renumbered(before, (ids[a], ids[b]))
                if merge is None:
                    del self.tried[a, b]
            out[number[a], number[b]] = merge or Merge(a, b, merged=False, reason=UNTRIED)
        return out


def _renumbered(tried: Tried, ids: Ids) -> Merge | None:
    """The decision with closures of the keyframes that are still there; None when that leaves a tie without any."""
    merge, held = tried.merge, list[MapClosure]()
    for closure in merge.closures:
        ends = [
            _place(then, now, k) for then, now, k in zip(tried.ids, ids, (closure.first, closure.second), strict=True)
        ]
        if ends[0] is not None and ends[1] is not None:
            held.append(replace(closure, first=ends[0], second=ends[1]))
    if any(c.accepted for c in merge.closures) and not any(c.accepted for c in held):
        return None
    return replace(merge, closures=tuple(held))


def _place(then: Int[np.ndarray, " n"], now: Int[np.ndarray, " m"], k: int) -> int | None:
    """Which of the keyframes `now` number `k` of `then` is; None when it has left."""
    at = int(np.searchsorted(now, then[k]))
    return at if at < len(now) and now[at] == then[k] else None


def _pairs(names: Sequence[str]) -> Iterator[Pair]:
    for j, b in enumerate(names):
        for a in names[:j]:
            yield a, b


def _as_stored(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """As exact as a result's file holds them, of which `map` makes the same decision."""
    return points.astype(np.float32).astype(np.float64)
