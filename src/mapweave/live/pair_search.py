"""Which two laser robots' maps are tried on each other next, and what was decided on those that were."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..laser.map_overlap import KeyframeMap
from ..laser.merge import Merge, merge_maps
from ..laser.merge_search import MergeConfig, Start

GROWN = 1.25  # a pair is tried again when the maps of both together have so many times the keyframes they had
UNTRIED = "not tried on each other yet"

Pair = tuple[str, str]


class PairTrial(NamedTuple):
    """Two maps to be laid on each other. Running it takes seconds and touches nothing but its own numbers."""

    a: str
    b: str
    poses: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"]]
    points: tuple[Sequence[Float[np.ndarray, "_ 2"]], Sequence[Float[np.ndarray, "_ 2"]]]
    cfg: MergeConfig
    start: Start | None

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
    """What was decided on a pair when both had so many keyframes together."""

    merge: Merge
    keyframes: int


@dataclass(slots=True)
class PairSearch:
    """The pairs of a team. tried: by the names of both, the first one first in the alphabet."""

    tried: dict[Pair, Tried] = field(default_factory=dict)

    def next(self, sizes: Mapping[str, int]) -> Pair | None:
        """The pair to be tried now; None when there is none. sizes: robot -> keyframes.

        Robots that hang together already are not tried on each other, but for those whose tie was found when there was
        less of them. Pairs that were never tried go first, of these the largest maps.
        """
        group = {name: name for name in sizes}

        def root(name: str) -> str:
            while group[name] != name:
                name = group[name]
            return name

        for (a, b), known in self.tried.items():
            if known.merge.merged and a in group and b in group:
                first, second = sorted((root(a), root(b)))
                group[second] = first
        roots = {name: root(name) for name in sizes}
        best: tuple[bool, int] | None = None
        chosen = None
        for a, b in _pairs(sorted(sizes)):
            before, size = self.tried.get((a, b)), sizes[a] + sizes[b]
            if before is None:
                wanted = roots[a] != roots[b]
            else:
                wanted = (roots[a] != roots[b] or before.merge.merged) and size >= GROWN * before.keyframes
            worth = (before is None, size)
            if wanted and (best is None or worth > best):
                best, chosen = worth, (a, b)
        return chosen

    def decided(self, trial: PairTrial, merge: Merge) -> None:
        """What the trial came to."""
        self.tried[trial.a, trial.b] = Tried(merge, trial.keyframes)

    def known(self, names: Sequence[str]) -> dict[tuple[int, int], Merge]:
        """What stands on every pair of `names`, which are in order: by their places."""
        number = {name: k for k, name in enumerate(names)}
        return {
            (number[a], number[b]): self.tried[a, b].merge
            if (a, b) in self.tried
            else Merge(a, b, merged=False, reason=UNTRIED)
            for a, b in _pairs(names)
        }


def between(starts: Mapping[int, Start], i: int, j: int) -> Start | None:
    """Where robot j's frame is said to lie in robot i's; None when either is not told (the first one's is zero)."""
    zero = Start(np.zeros(3), np.zeros(3))
    a, b = (starts.get(k, zero if k == 0 else None) for k in (i, j))
    if a is None or b is None or not starts:
        return None
    return Start(se2.between(a.transform, b.transform), np.hypot(a.sd, b.sd))


def _pairs(names: Sequence[str]) -> Iterator[Pair]:
    for j, b in enumerate(names):
        for a in names[:j]:
            yield a, b


def _as_stored(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """As exact as a result's file holds them, of which `map` makes the same decision."""
    return points.astype(np.float32).astype(np.float64)
