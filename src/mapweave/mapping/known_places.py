"""Laps over laps: keyframes made where the map knows the place well leave the graph again.

A graph of every keyframe grows with the distance driven. Where the map holds many keyframes that look the same way, one
more tells nothing new: the robot is found in the map, and the keyframes between two such findings leave. What they told
is given up, never counted elsewhere: the graph knows less than it could and nothing that it should not. How the robot
went stays as poses that hang on keyframes of the map (`Revisits`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.rows import RowBuffer
from ..laser.robot_graph import Revisits
from .keyframe_graph import KeyframeGraph

WAITING = 0.05  # of the keyframes wait to leave, from which on it is decided for their sake which places hold
KNOWN_NEAR = 1.0  # [m] from a keyframe and
KNOWN_TURN = 0.8  # [rad] in heading lie those of the map that know its place, from visits
KNOWN_FAR = 10.0  # [m] of driving before it at least


@config
class KnownPlacesConfig:
    """When a place is known so well that further keyframes there leave the graph."""

    enough: int = 24  # keyframes of the map near one that look the same way, from earlier visits; 0: none ever leaves


Laying = Callable[[int, int], Float[np.ndarray, "c 3"]]
"""The poses of solved keyframes, the first to the last, matched once more against those before them."""


class Left(NamedTuple):
    """Keyframes `first` to `last`, as they were numbered, are in the graph no more."""

    first: int
    last: int


@dataclass(slots=True)
class KnownPlaces:
    """What is known of one robot's graph. `step` changes it and the graph.

    Keyframes up to number `settled` are the map and stay. Those after it up to `checked` lie in places known well
    and wait to leave. closures: how many left with their keyframes.
    """

    cfg: KnownPlacesConfig
    settled: int = -1
    checked: int = -1
    closures: int = 0
    _t: RowBuffer = field(default_factory=RowBuffer)
    _at: RowBuffer = field(default_factory=lambda: RowBuffer(dtype=np.int64))
    _step: RowBuffer = field(default_factory=lambda: RowBuffer(3))
    _cov: RowBuffer = field(default_factory=lambda: RowBuffer(3, 3))

    @property
    def revisits(self) -> Revisits:
        """The poses of the keyframes that left."""
        return Revisits(self._t.array, self._at.array, self._step.array, self._cov.array, self.closures)

    def step(self, graph: KeyframeGraph, i: int, lay: Laying) -> Left | None:
        """Keyframe `i` is the graph's last one, a submap before it was just found in others; which ones left.

        When the map knows the places of all keyframes since the last such step, those between the map and the last of
        them that a place which holds ties to it leave, each as it is laid on the map. They wait until it is decided
        which hold, which it is where many wait, or until the map does not know a place: keyframes that are there then
        stay for good.
        """
        if not self.cfg.enough:
            return None
        known = all(self._known(graph, k) for k in range(self.checked + 1, i + 1))
        if known:
            self.checked = i
        if graph.undecided and self.checked - self.settled > WAITING * len(graph):
            graph.settle(for_now=True)
        left = self._leave(graph, lay)
        if not known:
            self.settled = self.checked = len(graph) - 1
        return left

    def _leave(self, graph: KeyframeGraph, lay: Laying) -> Left | None:
        """Keyframes leave between the map and the last one that a place which holds ties to it, if there are any."""
        late = takewhile(lambda c: c.second > self.settled + 1, reversed(graph.closures))
        tied = (c.second for c in late if c.accepted and c.first <= self.settled and c.second <= self.checked)
        first, last = self.settled + 1, next(tied, 0) - 1
        if first > last:
            return None
        self._keep(graph, first, last, lay(first, last))
        self.closures += graph.leave(first, last)
        self.checked -= last - first + 1
        graph.solve()
        return Left(first, last)

    def _keep(self, graph: KeyframeGraph, first: int, last: int, laid: Float[np.ndarray, "c 3"]) -> None:
        """Keyframes that are to leave hang on the nearest of the map, where they were laid."""
        near = [self._nearest(graph, i) for i in range(first, last + 1)]
        graph.prepare([*near, *range(first, last + 1)])
        for k, i in zip(near, range(first, last + 1), strict=True):
            cov = graph.relative(k, i)
            assert cov is not None  # noqa: S101  (both are solved)
            self._t.append(graph.nodes[i].t)
            self._at.append(k)
            self._step.append(np.asarray(se2.between(graph.pose[k], laid[i - first])))
            self._cov.append(cov)

    def _known(self, graph: KeyframeGraph, i: int) -> bool:
        """Whether the map knows the place of keyframe `i` well."""
        n = self.settled + 1
        d = graph.pose[:n] - graph.pose[i]
        near = (np.hypot(d[:, 0], d[:, 1]) < KNOWN_NEAR) & (np.abs(se2.wrap_angle(d[:, 2])) < KNOWN_TURN)
        near &= graph.path[:n] < graph.path[i] - KNOWN_FAR
        return int(near.sum()) >= self.cfg.enough

    def _nearest(self, graph: KeyframeGraph, i: int) -> int:
        """The keyframe of the map that lies nearest to keyframe `i`, looking about the same way if any does."""
        n = self.settled + 1
        d = graph.pose[:n] - graph.pose[i]
        away = np.hypot(d[:, 0], d[:, 1]) + np.where(np.abs(se2.wrap_angle(d[:, 2])) < KNOWN_TURN, 0.0, 1e3)
        return int(np.argmin(away))
