"""Fusing while the logs play: every so often each robot hands over the map it has by then."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.landmark_log import LandmarkLog
from ..core.truth import Survey
from ..core.workers import Progress
from ..evaluation.landmarks import GrowthPoint, growth_point
from ..fusion.config import FuseConfig
from ..fusion.online import OnlineFuser
from ..fusion.result import Fusion
from ..landmarks.config import EkfSlamConfig
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..landmarks.mapping import growing_maps


@dataclass(frozen=True, slots=True)
class OnlineMap:
    """The largest component `t` [s] after the first row of all logs; robots: how many were tied in."""

    t: float
    robots: int
    landmarks: LandmarkMap


def fuse_online(
    logs: Sequence[LandmarkLog],
    whole: Sequence[LocalMap],
    ekf: EkfSlamConfig,
    cfg: FuseConfig,
    every: float,
    seed: int,
    on_progress: Progress,
) -> tuple[Fusion, tuple[OnlineMap, ...]]:
    """The fusion of all `whole` maps, and the global map every `every` seconds until then.

    A robot's map at a time is its filter's by then; the last is the one that the whole log gives.
    """
    spans = [log.span for log in logs if len(log)]
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    times = np.arange(first + every, last, every).tolist()
    fuser = OnlineFuser(cfg, {log.robot: log.source for log in logs})
    growing = [growing_maps(log, ekf, times, seed) for log in logs]
    grown = []
    for k, t in enumerate(times):
        on_progress("fusing online", k, len(times))
        fresher = [m for m in map(next, growing) if m is not None]
        if fresher:
            fuser = fuser.update(*fresher)
        if fuser.largest is not None:
            grown.append(OnlineMap(float(t - first), fuser.tied_in, fuser.largest.map))
    fuser = fuser.update(*whole)
    if fuser.largest is not None:
        grown.append(OnlineMap(float(last - first), fuser.tied_in, fuser.largest.map))
    on_progress("fusing online", len(times), len(times))
    return fuser.fusion, tuple(grown)


def growth(grown: Sequence[OnlineMap], survey: Survey) -> tuple[GrowthPoint, ...]:
    """Trace, log-determinant, error and consistency of every online map."""
    return tuple(growth_point(g.t, g.robots, g.landmarks, survey) for g in grown)
