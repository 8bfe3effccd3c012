"""Loops of one robot: each new submap of its keyframes searched for among all that came before."""

from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from ..core import se2
from ..laser.keyframes import carried
from .keyframe_graph import KeyframeGraph
from .places import PlaceIndex, PlaceMatch, PlaceSearchConfig
from .segments import WHEELED
from .submaps import SUBMAP_AROUND, SUBMAP_EVERY, TURN_WAY, extent, make_submap, middles

# what will do of a submap in the one before it, over a border between segments: correlation of headings, likelihood,
# share of points on walls, points that hold it, another place as likely if it is not where the step over it may lead
BORDER = PlaceSearchConfig(least_heading=0.0, least_score=0.35, least_share=0.45, least_held=12.0)
LED = replace(BORDER, least_score=0.25, least_share=0.25, least_held=5.0)  # and where wheels lead over it
BORDER_SDS = 3.0  # standard deviations from where the step over it puts it, by all three coordinates together
SEARCHED = 400  # older submaps, the nearest, that one is searched for among, at most: some 2 km of way
FOUND = 24  # places of one submap, those nearest to where the estimate has it, at most


class Loop(NamedTuple):
    """Keyframe `first` as seen from keyframe `second`, which is later or of another segment."""

    first: int
    second: int
    match: PlaceMatch


@dataclass(slots=True)
class LoopFinder:
    """The submaps of one robot as its keyframes come. `offer`, `finish` and `forget` change it.

    anchors: keyframe of each submap of the index; way: [m] up to each keyframe, turning counted; segment: the keyframe
    the latest segment begins with; made: how many submaps it has so far.
    """

    index: PlaceIndex
    light: bool = False
    anchors: list[int] = field(default_factory=list)
    way: list[float] = field(default_factory=list)
    segment: int = 0
    made: int = 0

    def copy(self) -> "LoopFinder":
        """The same search, which may go on without this one's knowing."""
        return replace(self, index=self.index.copy(), anchors=list(self.anchors), way=list(self.way))

    def offer(self, graph: KeyframeGraph) -> list[Loop]:
        """The latest keyframe of `graph` has come; what is found of the submaps that are complete now."""
        i = len(graph) - 1
        node = graph.nodes[i]
        found = self.finish(graph) if node.border else []
        step = se2.between(graph.nodes[i - 1].local, node.local) if i else np.zeros(3)
        self.way.append((self.way[-1] if i else 0.0) + float(np.hypot(step[0], step[1]) + TURN_WAY * abs(step[2])))
        if node.border:
            self.segment, self.made = i, 0
        return found + self._complete(graph, self.way[i] - SUBMAP_AROUND)

    def finish(self, graph: KeyframeGraph) -> list[Loop]:
        """The segment has ended with the keyframes there are: what is found of its last submaps."""
        return self._complete(graph, np.inf)

    def _complete(self, graph: KeyframeGraph, until: float) -> list[Loop]:
        """The submaps whose middle lies up to `until` [m] of way, made and searched for."""
        if len(self.way) == self.segment or until < self.way[self.segment] + (self.made + 0.5) * SUBMAP_EVERY:
            return []
        way = np.array(self.way[self.segment :])
        found = []
        for at in middles(way)[self.made :]:
            if way[at] > until:
                break
            self.made += 1
            low, high = extent(way, at)
            first, nodes = self.segment + low, graph.nodes[self.segment + low : self.segment + high + 1]
            q = [node.beams.q for node in nodes] if self.light else None
            poses = np.array([node.local for node in nodes])
            new = make_submap(self.segment + at, first, poses, [node.beams.s for node in nodes], q)
            if new is not None:
                old = self._old(graph, new.anchor, first)
                number = self.index.add(new)
                self.anchors.append(new.anchor)
                matches = self._nearest(graph, number, self.index.search(number, old))
                if number and first == self.segment and all(m.first != number - 1 for m in matches):
                    matches += self._over_border(graph, number)
                found += [Loop(self.anchors[m.first], new.anchor, m) for m in matches]
        return found

    def _old(self, graph: KeyframeGraph, anchor: int, first: int) -> Int[np.ndarray, " k"]:
        """The submaps that one at keyframe `anchor`, which begins with keyframe `first`, is searched for among.

        Work must not grow with the way: of many those nearest by the estimate, once something holds the segment in it.
        """
        old = np.array([k for k, at in enumerate(self.anchors) if self._apart(at, first)], dtype=np.int64)
        if len(old) <= SEARCHED or not self._held(graph):
            return old
        away = np.hypot(*(graph.pose[np.array(self.anchors)[old], :2] - graph.pose[anchor, :2]).T)
        return np.sort(old[np.argsort(away, kind="stable")[:SEARCHED]])

    def _held(self, graph: KeyframeGraph) -> bool:
        """Whether the latest segment is the first one, or places hold it."""
        late = takewhile(lambda c: c.second >= self.segment, reversed(graph.closures))
        return not self.segment or any(c.accepted for c in late)

    def _nearest(self, graph: KeyframeGraph, number: int, found: list[PlaceMatch]) -> list[PlaceMatch]:
        """Of the places found of submap `number` those nearest to where the estimate has it, in their order."""
        if len(found) <= FOUND:
            return found
        anchors = graph.pose[[self.anchors[m.first] for m in found]]
        there = np.asarray(se2.compose(anchors, np.array([m.measured for m in found])))
        away = np.hypot(*(there[:, :2] - graph.pose[self.anchors[number], :2]).T)
        return [found[k] for k in np.sort(np.argsort(away, kind="stable")[:FOUND]).tolist()]

    def _over_border(self, graph: KeyframeGraph, number: int) -> list[PlaceMatch]:
        """The first submap of a segment in the one before it, where less will do if it lies where the step puts it.

        The smaller of the two is looked for in the other: of what a single scan sees most is in the submap before it.
        """
        before, new = self.anchors[number - 1], self.anchors[number]
        last, border = graph.nodes[self.segment - 1], graph.nodes[self.segment]
        ahead = se2.compose(se2.between(graph.nodes[before].local, last.local), border.step)
        step = se2.compose(ahead, se2.between(border.local, graph.nodes[new].local))
        on = se2.between(border.local, graph.nodes[new].local)
        cov, rules = carried(border.cov, on), LED if border.border in WHEELED else BORDER
        reach = BORDER_SDS * np.sqrt(np.diag(cov))
        old, own = (len(self.index.submaps[k].points) for k in (number - 1, number))
        if old <= own:
            match = self.index.lay(number, number - 1, se2.inverse(step), reach, rules)
        else:
            match = self.index.lay(number - 1, number, step, reach, rules)
            match = None if match is None else match.inverse()
        if match is None or not match.clear:
            return []
        off = se2.between(step, match.measured)
        return [match] if off @ np.linalg.solve(cov, off) <= BORDER_SDS**2 else []

    def _apart(self, anchor: int, first: int) -> bool:
        """Whether an old submap shares no way with one that begins with keyframe `first`."""
        return anchor < self.segment or self.way[first] - self.way[anchor] > SUBMAP_AROUND

    def forget(self, first: int, last: int) -> None:
        """Keyframes `first` to `last` left the graph; those after them have other numbers."""
        gone = last + 1 - first
        keep = [k for k, anchor in enumerate(self.anchors) if not first <= anchor <= last]
        self.index = self.index.select(keep)
        self.anchors = [self.anchors[k] - (gone if self.anchors[k] > last else 0) for k in keep]
        del self.way[first : last + 1]
        if self.segment >= first:
            self.segment = max(first, self.segment - gone)
