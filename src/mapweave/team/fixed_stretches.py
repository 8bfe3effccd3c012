"""Where a robot without wheels or map of its own is fixed by sightings at all, and where its path must be left out.

Between sightings nothing carries such a robot, and a bearing from one observer fixes no distance: what a least-squares
problem then says is one of several answers, with the covariance of that one alone. A pose is kept only where, within a
few seconds, sightings that agree with it come from enough directions, and where the trajectory leads through it no
faster than such a robot goes: answers of bearings that are met only by a leap are of the wrong place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from .config import MotionNoise
from .relative_frame import Body, Labels, MutualSightings, PlacingConfig, mutual_sightings, residuals
from .team_map import TeamMap

LEAST = 2  # poses that make a trajectory
SHORTEST = 0.2  # [s] over which a speed can be told


class _Seen(NamedTuple):
    """Sightings that tie the robot to one other. by_it: the robot was the observer; ranged: with a distance."""

    t: Float[np.ndarray, " m"]
    agrees: Bool[np.ndarray, " m"]
    by_it: Bool[np.ndarray, " m"]
    ranged: Bool[np.ndarray, " m"]


def fixed_stretches(
    team: TeamMap,
    robots: Sequence[str],
    logs: Mapping[str, LandmarkLog],
    labels: Labels,
    cfg: PlacingConfig,
    motion: MotionNoise,
) -> tuple[TeamMap, tuple[Finding, ...]]:
    """The map with the paths of `robots` cut to the poses that sightings fix, and a finding for each that was cut.

    A pose is fixed where within `cfg.fixed_window` at least `cfg.lost_share` of the sightings agree with it, and those
    come from two others that saw it, or from three others that it saw or that saw it; a distance counts as one more.
    No pose is that lies within `cfg.fixed_window` of a leap. A robot of which less than two poses are fixed is left
    out of the map.
    """
    tracks, gaps, notes = dict(team.tracks), dict(team.left_out), []
    for robot in robots:
        track = team.tracks[robot]
        keep = _fixed(track, _partners(robot, team, logs, labels, cfg), cfg) & ~_near_leaps(track, cfg, motion)
        if keep.all():
            continue
        gone = int((~keep).sum())
        if keep.sum() < LEAST:
            del tracks[robot]
            why = "too few sightings fix where it was"
            notes.append(Finding("unplaced", robot, value=why, action="it is left out"))
            continue
        cov = None if track.cov is None else track.cov[keep]
        tracks[robot] = Track(track.t[keep], track.pose[keep], cov, track.frame)
        gaps[robot] = _between_kept(track.t, keep)
        why = f"too few sightings fix where it was at {gone} of {len(keep)} poses"
        notes.append(Finding("unplaced", robot, value=why, action="they are left out"))
    names = tuple(name for name in team.robots if name in tracks)
    return replace(team, robots=names, tracks=tracks, left_out=gaps), tuple(notes)


def _between_kept(t: Float[np.ndarray, " n"], keep: Bool[np.ndarray, " n"]) -> tuple[tuple[float, float], ...]:
    """The spans between poses that are kept, one after the other, though poses between them are not."""
    kept = np.flatnonzero(keep)
    return tuple((float(t[a]), float(t[b])) for a, b in pairwise(kept) if b > a + 1)


def _partners(
    robot: str, team: TeamMap, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> list[_Seen]:
    """What ties the robot to every other robot and landmark."""
    own = Body({robot: team.tracks[robot]}, {})
    others = [Body({name: track}, {}) for name, track in team.tracks.items() if name != robot]
    others += [Body({}, {name: at}) for name, at in zip(team.landmarks.ids, team.landmarks.mean, strict=True)]
    sightings = [mutual_sightings(other, own, logs, labels) for other in others]
    return [_seen(z, cfg) for z in sightings if len(z)]


def _seen(z: MutualSightings, cfg: PlacingConfig) -> _Seen:
    miss = np.square(residuals(z, np.zeros(3), cfg)).sum(axis=-1)
    return _Seen(z.t, miss < cfg.inlier**2, ~z.forward, np.isfinite(z.range))


def _fixed(track: Track, partners: list[_Seen], cfg: PlacingConfig) -> Bool[np.ndarray, " n"]:
    n = len(track.t)
    all_of_them, agreeing = np.zeros(n, int), np.zeros(n, int)
    saw_it, seen_by_it, distances = np.zeros(n, int), np.zeros(n, int), np.zeros(n, int)
    for s in partners:
        near = np.abs(track.t[:, None] - s.t[None, :]) <= cfg.fixed_window
        good = near & s.agrees
        all_of_them += near.sum(axis=1)
        agreeing += good.sum(axis=1)
        forward = (good & ~s.by_it).any(axis=1)
        saw_it += forward
        seen_by_it += (good & s.by_it).any(axis=1) & ~forward
        distances += (good & s.ranged).any(axis=1)
    directions = (saw_it + distances >= 2) | (saw_it + seen_by_it + distances >= 3)
    return np.asarray(directions & (agreeing >= cfg.lost_share * all_of_them))


def _near_leaps(track: Track, cfg: PlacingConfig, motion: MotionNoise) -> Bool[np.ndarray, " n"]:
    """Which poses lie within `cfg.fixed_window` of two that the robot cannot have gone between."""
    step, dt = se2.between(track.pose[:-1], track.pose[1:]), np.maximum(np.diff(track.t), SHORTEST)
    fast = np.hypot(step[:, 0], step[:, 1]) > cfg.leap * motion.unknown_speed * dt
    leap = np.flatnonzero(fast | (np.abs(step[:, 2]) > cfg.leap * motion.unknown_spin * dt))
    near = (track.t[:, None] >= track.t[leap] - cfg.fixed_window) & (
        track.t[:, None] <= track.t[leap + 1] + cfg.fixed_window
    )
    return np.asarray(near.any(axis=1))
