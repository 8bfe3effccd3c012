"""Fusing while the logs play: every so often each robot hands over the map it has by then."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..core.landmark_log import LandmarkLog
from ..core.truth import Survey
from ..core.workers import Progress
from ..evaluation.landmarks import GrowthPoint, growth_point
from ..fusion.config import FuseConfig
from ..fusion.online import OnlineFuser
from ..fusion.result import Fusion
from ..landmarks.mapping import Growth
from ..team.online import OnlineMap, OnlineRun


def times_of(logs: Sequence[LandmarkLog], every: float) -> list[float]:
    """When [s] each robot hands over its map: every `every` seconds after the first row of all, before the last."""
    first, last = _span(logs)
    return [float(t) for t in np.arange(first + every, last, every)]


def fuse_online(
    logs: Sequence[LandmarkLog],
    grown: Sequence[Growth],
    cfg: FuseConfig,
    times: Sequence[float],
    on_progress: Progress,
) -> tuple[Fusion, tuple[OnlineMap, ...]]:
    """The fusion of all whole maps, and the global map at `times` [s] until then.

    grown: each log's maps at `times`; a robot's map at a time is its filter's by then, and the last is
    the one that the whole log gives.
    """
    first, last = _span(logs)
    fuser = OnlineFuser(cfg, {log.robot: log.source for log in logs})
    out = []
    for k, t in enumerate(times):
        on_progress("fusing online", k, len(times))
        fresher = [m for m in (g.maps[k] for g in grown) if m is not None]
        if fresher:
            fuser = fuser.update(*fresher)
        if fuser.largest is not None:
            out.append(OnlineMap(float(t - first), fuser.tied_in, fuser.largest.map))
    fuser = OnlineFuser(cfg, fuser.recordings, {g.whole.robot: g.whole for g in grown}).converged()
    if fuser.largest is not None:
        out.append(OnlineMap(float(last - first), fuser.tied_in, fuser.largest.map))
    on_progress("fusing online", len(times), len(times))
    return fuser.fusion, tuple(out)


def _span(logs: Sequence[LandmarkLog]) -> tuple[float, float]:
    spans = [log.span for log in logs if len(log)]
    return min(a for a, _ in spans), max(b for _, b in spans)


def growth(grown: Sequence[OnlineMap], survey: Survey) -> tuple[GrowthPoint, ...]:
    """Trace, log-determinant, error and consistency of every online map."""
    return tuple(growth_point(g.t, g.robots, g.landmarks, survey) for g in grown)


def run_metrics(run: OnlineRun, survey: Survey) -> dict[str, Any]:
    """What `metrics.json` tells of smoothing online, beside timing."""
    points = growth(run.growth, survey)
    return {
        "step": run.step,
        "steps": len(run.seconds),
        "stretches": run.stretches,
        "marginalised": 0,
        "linearised_per_step": round(float(run.linearised.mean()), 3) if len(run.linearised) else None,
        "renewed": run.renewed,
        "laid_out": list(run.laid_out),
        "landmarks_moved_at_the_end": run.landmarks_moved,
        "ways_moved_at_the_end": run.ways_moved,
        "growth": [{"t": p.t, "robots": p.robots, "landmarks": p.landmarks, "landmark_rmse": p.rmse} for p in points],
    }
