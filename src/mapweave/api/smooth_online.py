"""`map --online`: the team's smoothed map while the logs play, and its closing when they end."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from ..core import se2
from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from ..core.workers import Progress
from ..fusion.config import FuseConfig
from ..fusion.online import OnlineFuser
from ..landmarks.landmark_map import LandmarkMap
from ..landmarks.mapping import Growth
from ..solve import SingularError
from ..team.config import OnlineConfig, SmoothingConfig
from ..team.online import OnlineMap, OnlineRun, OnlineStep, OnlineTeam
from ..team.smooth import Smoothed
from ..team.team_map import TeamMap
from .team import carried

NO_STEP = OnlineStep(0, 0, 0, 0.0)
FULL = 3  # landmarks in common by which two maps are laid over each other


def smooth_online(
    logs: Sequence[LandmarkLog],
    grown: Sequence[Growth],
    fusing: FuseConfig,
    smoothing: SmoothingConfig,
    cfg: OnlineConfig,
    calibration: Mapping[str, Mapping[str, tuple[float, float]]],
    looks: Sequence[float],
    on_progress: Progress,
) -> OnlineRun:
    """All rows taken in, a step after the other in order of time.

    grown: each log's maps at `looks` [s] with their poses; the filters' own time is not in that of the steps.
    """
    wheels = [log for log in logs if log.odometry is not None and len(log)]
    first, last = min(log.span[0] for log in logs if len(log)), max(log.span[1] for log in logs if len(log))
    if not wheels:
        nothing = np.zeros(0)
        return OnlineRun(None, cfg.step, nothing, nothing, nothing, 0, (), 0, ())
    own = {log.robot: g.filtered for log, g in zip(logs, grown, strict=True)}
    team = OnlineTeam(wheels, own, smoothing, cfg, calibration)
    fuser = OnlineFuser(fusing, {log.robot: log.source for log in logs})
    seconds, lag, linearised, laid_out, growth = [], [], [], [], list[OnlineMap]()
    renewed, free = 0, first
    steps = np.arange(first + cfg.step, last + cfg.step, cfg.step)
    next_look = 0
    for k, stamp in enumerate(steps):
        t = min(float(stamp), last)
        began = perf_counter()
        looking = next_look < len(looks) and t >= looks[next_look]
        step = NO_STEP
        try:
            if looking:
                fuser = fuser.update(*[m for m in (g.maps[next_look] for g in grown) if m is not None])
                next_look += 1
                if _adopted(team, t, fuser):
                    laid_out.append(round(t - first, 3))
                on_progress("smoothing online", k, len(steps))
            step = team.advance(t)
        except SingularError:  # too little is known yet of something: it is laid out anew at the next look
            team.forget()
        seconds.append(perf_counter() - began)
        free = max(free, t) + seconds[-1]
        lag.append(free - (t - cfg.step))
        linearised.append(step.linearised)
        renewed += step.renewed
        if team.members and looking:
            growth.append(OnlineMap(t - first, len(team.members), team.landmarks))
    team.update_poses()
    on_progress("smoothing online", len(steps), len(steps))
    return OnlineRun(
        team, cfg.step, np.array(seconds), np.array(lag), np.array(linearised, float), renewed, tuple(laid_out),
        len(team.stretches), tuple(growth), waited=tuple(log.robot for log in logs if log.odometry is None),
    )  # fmt: skip


def _adopted(team: OnlineTeam, t: float, fuser: OnlineFuser) -> bool:
    """Whether the filters' fused map held robots, landmarks or labels that were new."""
    fused = fuser.largest
    if fused is None or not len(fused.map):
        return False
    factor = {d.robot: d.variance_factor or 1.0 for d in fuser.fusion.decisions}
    ways = {
        r: carried(fuser.latest[r].track, fused.frames[r], fused.frame_cov[r], fused.scales.get(r, 1.0), factor[r])
        for r in fused.robots
    }
    return team.adopt(t, fused.robots, fused.map, ways, fuser.fusion.labels)


def closing_start(run: OnlineRun, filters: TeamMap, far: float) -> TeamMap:
    """The map as it stood when the logs ended, in the frame of `filters`, which has what was not smoothed yet.

    far: [m] root mean square between the landmarks of both, from which it is `filters`.
    """
    team = run.team
    if team is None or not team.members:
        return filters
    now, start = team.landmarks, filters.landmarks
    both = [name for name in start.ids if name in now.ids]
    if len(both) < FULL:
        return filters
    T = se2.align(now.select(both).mean, start.select(both).mean)
    off = se2.act(T, now.select(both).mean) - start.select(both).mean
    if not np.square(off).sum(axis=1).mean() < far**2:
        return filters
    ways = {r: team.way(r) for r in team.members if r in filters.robots}
    smoothed = {r: _within(filters.tracks[r], Track(way.t, se2.compose(T, way.pose))) for r, way in ways.items()}
    tracks = {**filters.tracks, **smoothed}
    place = dict(zip(now.ids, se2.act(T, now.mean), strict=True))
    mean = np.array([place.get(name, p) for name, p in zip(start.ids, start.mean, strict=True)])
    head = filters.robots[0]
    if head in ways:  # the frame is its first pose
        back = se2.inverse(tracks[head].pose[0])
        tracks = {r: Track(track.t, se2.compose(back, track.pose)) for r, track in tracks.items()}
        mean = se2.act(back, mean)
    return replace(filters, landmarks=LandmarkMap(start.ids, mean, start.cov, start.frame), tracks=tracks)


def _within(whole: Track, way: Track) -> Track:
    """`way`, and `whole` before and after: of a robot that was put down elsewhere one stretch alone is smoothed."""
    before, after = whole.t < way.t[0], whole.t > way.t[-1]
    parts = [(whole.t[before], whole.pose[before]), (way.t, way.pose), (whole.t[after], whole.pose[after])]
    t, pose = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Track(t, pose)


def closed(run: OnlineRun, start: TeamMap, done: Smoothed, seconds: float) -> OnlineRun:
    """`run` with what closing it took and moved: both maps laid over each other by their landmarks."""
    a, b = start.landmarks, done.map.landmarks
    if run.team is None or done.refused or len(a) < FULL:
        return replace(run, closing=seconds)
    T = se2.align(a.mean, b.select(a.ids).mean)
    off = se2.act(T, a.mean) - b.select(a.ids).mean
    ways = []
    for robot in run.team.members:
        if robot in start.tracks and robot in done.map.tracks:
            before, after = start.tracks[robot], done.map.tracks[robot]
            played = run.team.way(robot).t
            there = (after.t >= played[0]) & (after.t <= played[-1])
            was = se2.compose(T, se2.interpolate(after.t[there], before.t, before.pose))
            ways.append(np.square(was[:, :2] - after.pose[there, :2]).sum(axis=1))
    ways_moved = float(np.sqrt(np.concatenate(ways).mean())) if ways else None
    return replace(
        run, closing=seconds, landmarks_moved=float(np.sqrt(np.square(off).sum(axis=1).mean())), ways_moved=ways_moved
    )
