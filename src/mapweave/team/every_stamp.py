"""Poses at stamps whose rows no estimate was made from: sightings misread, contradicted or impossible.

A trajectory has a pose wherever its log has a row, used or not, so that nobody who joins the two by time misses one.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Track
from .team_map import TeamMap


def at_every_stamp(team: TeamMap, stamps: Mapping[str, Float[np.ndarray, " n"]], ahead: Mapping[str, float]) -> TeamMap:
    """The map with a pose of every robot at each of its `stamps` [s], all that it has already as it was.

    Poses in between are interpolated; none is put into a span in which nothing says where the robot was, nor before the
    first pose or after the last. ahead: by how much [s] the stamps of a robot are ahead of its track's clock.
    """
    tracks = {
        robot: _with_poses_at(track, stamps[robot] - ahead.get(robot, 0.0), team.left_out.get(robot, ()))
        if robot in stamps
        else track
        for robot, track in team.tracks.items()
    }
    return replace(team, tracks=tracks)


def _with_poses_at(track: Track, t: Float[np.ndarray, " n"], gaps: tuple[tuple[float, float], ...]) -> Track:
    if not len(track.t):
        return track
    new = np.setdiff1d(t, track.t)
    new = new[(new > track.t[0]) & (new < track.t[-1])]
    for begin, end in gaps:
        new = new[(new <= begin) | (new >= end)]
    if not len(new):
        return track
    after = np.searchsorted(track.t, new)
    cov = None
    if track.cov is not None:
        share = ((new - track.t[after - 1]) / (track.t[after] - track.t[after - 1]))[:, None, None]
        cov = np.insert(track.cov, after, (1.0 - share) * track.cov[after - 1] + share * track.cov[after], axis=0)
    pose = np.insert(track.pose, after, se2.interpolate(new, track.t, track.pose), axis=0)
    return Track(np.insert(track.t, after, new), pose, cov, track.frame)
