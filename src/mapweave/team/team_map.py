"""The map of one component: landmarks and the trajectories of the robots tied into it, all in one frame.

And how it is finished: told in the frame of its first robot, with a pose at each stamp of a log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.names import in_order
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from .relative_frame import moved_track


@dataclass(frozen=True, slots=True)
class TeamMap:
    """What `map` and `fuse` write and `evaluate` reads. `members[id]`: who saw it; `sightings[id]`: how often;
    `first_seen[id]`: when first [s], on the tracks' clock, as far as known.

    left_out[robot]: spans (begin, end) [s] between two poses of its track in which nothing says where it was.
    """

    robots: tuple[str, ...]
    landmarks: LandmarkMap
    tracks: Mapping[str, Track] = field(default_factory=dict)
    members: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sightings: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    first_seen: Mapping[str, float] = field(default_factory=dict)


SAME = 1e-6  # [m, rad] from the frame, within which a pose is written as the frame itself


def in_first_frame(team: TeamMap) -> TeamMap:
    """The map in the frame of the first pose of its lowest-numbered robot; as it is where that is its frame already.

    A robot without odometry, or one that was put down elsewhere, is mapped from its longest stretch: what it did before
    is tied to that frame later, and only then the first pose is known. The transform is taken as exact: covariances are
    turned, and say what they said before, how sure the map is as seen from that stretch.
    """
    robot = min((r for r in team.robots if r in team.tracks and len(team.tracks[r].t)), key=in_order, default=None)
    if robot is None or np.abs(team.tracks[robot].pose[0]).max() <= SAME:
        return team
    T = se2.inverse(team.tracks[robot].pose[0])
    tracks = {name: moved_track(track, T) for name, track in team.tracks.items()}
    return replace(team, landmarks=team.landmarks.moved(T, team.landmarks.frame), tracks=tracks)


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
