"""Loops within one log: the last keyframes searched in the submaps of where the robot was before."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.gaussian import mahalanobis2, symmetrise
from .closures import Matched
from .keyframe_graph import KeyframeGraph
from .place_search import Fit, PlaceConfig, PlacesFound, Window
from .submaps import Clouds, LaserSubmap, LaserSubmapConfig, Lights, PlaceMatch, Query, locate, query_at, submap_around

NOTHING = np.zeros((3, 3))
BUILT = 8  # submaps kept as they are searched


@config
class SubmapLoopConfig:
    """When the last keyframes are searched in an old submap, and when what is found is believed."""

    every: int = 8  # keyframes between those that are searched for, and between submaps
    submaps: int = 2  # old submaps each is searched in, at most: the nearest
    far: float = 10.0  # [m] driven since the old place at least
    reach: float = 2.0  # [m] beyond what the estimate may err from which on a submap is not near
    window: float = 1.0  # [m] searched to every side of where the estimate puts the place, or
    window_sd: float = 3.0  # [sd] of the estimate where that is more,
    window_most: float = 6.0  # [m] at most
    window_turn: float = 0.35  # [rad] headings searched to either side
    least_score: float = 0.5  # least share of the likelihood a perfect fit would have
    most_ratio: float = 0.85  # most of the best score that another place may have: more, and it is ambiguous
    most_misfit: float = (
        0.7  # where light takes part: what the best misses of a perfect score over what that place misses
    )
    least_share: float = 0.55  # share of the points that must lie on walls after refining
    most_moved: float = 0.3  # [m] between the pose searched and refined
    least_held: float = 25.0  # [1/m^2] information in the direction least held: less, and it is a bare corridor
    gate: float = 16.27  # chi-square of the innovation, 3 degrees of freedom, 99.9 %
    place: PlaceConfig = PlaceConfig()
    submap: LaserSubmapConfig = LaserSubmapConfig()


class _Laid(NamedTuple):
    """What a submap is made of: keyframes as they lay, the one in the middle, their returns and brightness."""

    poses: Float[np.ndarray, "n 3"]
    points: Clouds
    anchor: int
    q: Lights | None

    def built(self, cfg: SubmapLoopConfig) -> LaserSubmap:
        """The submap, the same whenever it is built."""
        return submap_around(self.poses, self.points, self.anchor, self.q, cfg.submap, cfg.place)


@dataclass(slots=True)
class SubmapLoops:
    """The submaps of one robot's keyframes, each as it lay when it was first asked for. `offer` and `step` change it.

    Only the `BUILT` that were searched last are kept as they are searched, which takes a hundred times the memory of
    what they are made of; building one takes two milliseconds.
    """

    cfg: SubmapLoopConfig
    light: bool = False  # whether brightness takes part
    _laid: dict[int, _Laid] = field(default_factory=dict)
    _built: dict[int, LaserSubmap] = field(default_factory=dict)
    _untried: list[int] = field(default_factory=list)
    _came: int = 0

    def offer(self, i: int) -> bool:
        """Keyframe `i` has come; whether it is to be searched for."""
        asked = self._came > 0 and self._came % self.cfg.every == 0
        self._came += 1
        if asked:
            self._untried.append(i)
        return asked

    def forget(self, first: int) -> None:
        """Keyframes from number `first` on are others now: submaps around them are made anew."""
        self._laid = {k: laid for k, laid in self._laid.items() if k < first}
        self._built = {k: built for k, built in self._built.items() if k < first}

    def step(self, graph: KeyframeGraph) -> None:
        """Keyframes that wait are searched for; what is found stands in `graph`."""
        while self._untried:
            i = self._untried.pop(0)
            query = None
            for k in self.candidates(graph, i):
                cov = graph.relative(k, i)
                if cov is None:
                    continue
                window = self._window(cov)
                if np.hypot(*(graph.pose[k, :2] - graph.pose[i, :2])) > window + self.cfg.reach:
                    continue
                submap = self._submap(graph, k)
                if submap is None:
                    continue
                query = query or self._query(graph, i)
                predicted = se2.between(graph.pose[k], graph.pose[i])
                match = self.match(submap, query, predicted, cov, window)
                graph.close(k, i, match)
                if match.accepted:
                    distance2 = mahalanobis2(match.innovation, cov + 1e-12 * np.eye(3))
                    graph.due |= bool(distance2 > graph.cfg.resolve_innovation**2)

    def candidates(self, graph: KeyframeGraph, i: int) -> list[int]:
        """Anchors of old submaps that may be near keyframe `i`, the nearest first."""
        c = self.cfg
        old = np.arange(0, min(graph.known, i - c.submap.around - c.submap.query_before), c.every)
        old = old[graph.path[old] < graph.path[i] - c.far]
        d = np.hypot(*(graph.pose[old, :2] - graph.pose[i, :2]).T)
        order = np.argsort(d, kind="stable")
        return [int(k) for k in old[order[d[order] < c.window_most + c.reach]][: c.submaps]]

    def match(
        self,
        submap: LaserSubmap,
        query: Query,
        predicted: Float[np.ndarray, "3"],
        cov: Float[np.ndarray, "3 3"],
        window: float,
    ) -> Matched:
        """Where the query lies in the submap. predicted: (3,) in its frame; cov: (3, 3) in the query's frame."""
        c = self.cfg
        searched = Window(predicted, (window, window), c.window_turn)
        place = locate(query, submap.field, searched, least=0.7 * c.least_score, least_ratio=0.9 * c.most_ratio)
        best, fit = place.places.best, place.fit
        refused = Matched(False, "", predicted, NOTHING, np.zeros(3), 0.0, None)
        if best is None or fit is None:
            return refused._replace(reason="nothing like it within the window")
        second = place.places.second
        innovation = se2.between(predicted, fit.pose)
        refused = refused._replace(
            measured=fit.pose,
            innovation=innovation,
            share=fit.share,
            score=best.score,
            runner_up=0.0 if second is None else second.score,
        )
        if reason := self._doubt(place, best.score, fit):
            return refused._replace(reason=reason)
        P = fit.covariance
        if place.places.ratio > c.most_ratio:  # light alone tells where it lies along the walls, to the search's step
            weak = se2.rotation(-float(fit.pose[2])) @ fit.weak
            P = P + np.square(0.5 * c.place.cell) * np.pad(np.outer(weak, weak), (0, 1))
        nis = mahalanobis2(innovation, cov + P)
        apart = f"{np.hypot(*innovation[:2]):.2f} m and {np.degrees(innovation[2]):.1f} degrees"
        sd = f"{np.sqrt(nis):.1f} standard deviations"
        if nis > c.gate:
            return refused._replace(nis=nis, reason=f"it lies {apart} from where the estimate puts it, {sd}")
        return refused._replace(
            accepted=True,
            nis=nis,
            information=symmetrise(np.linalg.inv(P)),
            reason=f"{100 * fit.share:.0f} % of the returns match, {sd} from the estimate",
        )

    def _doubt(self, place: PlaceMatch, score: float, fit: Fit) -> str:
        """Why a match is not believed, whatever was expected; nothing where it is."""
        c = self.cfg
        doubts = (
            (score < c.least_score, f"it fits too little: score {score:.2f}"),
            (self.ambiguous(place.places), f"two places fit alike: {place.places.ratio:.2f} of the best score"),
            (fit.share < c.least_share, f"too few returns match: {100 * fit.share:.0f} %"),
            (place.correction > c.most_moved, f"search and refined match differ by {place.correction:.2f} m"),
            (fit.held[0] < c.least_held, "the place looks alike along one direction"),
        )
        return next((reason for doubtful, reason in doubts if doubtful), "")

    def ambiguous(self, places: PlacesFound) -> bool:
        """Whether another place fits about as well. Light on walls makes one place fit all but perfectly, while others
        still have most of its score: they share the walls.
        """
        c, best, second = self.cfg, places.best, places.second
        if best is None or second is None or places.ratio <= c.most_ratio:
            return best is None
        return not self.light or 1.0 - best.score > c.most_misfit * (1.0 - second.score)

    def _window(self, cov: Float[np.ndarray, "3 3"]) -> float:
        """[m] to search for a place whose relative covariance is `cov`."""
        c = self.cfg
        return float(min(max(c.window, c.window_sd * np.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1])), c.window_most))

    def _query(self, graph: KeyframeGraph, i: int) -> Query:
        first = max(0, i - self.cfg.submap.query_before)
        nodes = graph.nodes[first : i + 1]
        q = [node.beams.q for node in nodes] if self.light else None
        return query_at(graph.pose[first : i + 1], [node.beams.s for node in nodes], i - first, q, self.cfg.submap)

    def _submap(self, graph: KeyframeGraph, k: int) -> LaserSubmap | None:
        """The submap around keyframe `k`, as it lay when it was first asked for; None where no beam came back there."""
        built = self._built.pop(k, None)
        if built is None:
            lying = self._lying(graph, k)
            if not any(len(cloud) for cloud in lying.points):
                return None
            built = lying.built(self.cfg)
        self._built[k] = built
        for oldest in list(self._built)[:-BUILT]:
            del self._built[oldest]
        return built

    def _lying(self, graph: KeyframeGraph, k: int) -> _Laid:
        if k not in self._laid:
            around = self.cfg.submap.around
            first, last = max(0, k - around), min(len(graph) - 1, k + around)
            nodes = graph.nodes[first : last + 1]
            q = tuple(node.beams.q for node in nodes) if self.light else None
            points = tuple(node.beams.s for node in nodes)
            self._laid[k] = _Laid(np.array(graph.pose[first : last + 1]), points, k - first, q)
        return self._laid[k]
