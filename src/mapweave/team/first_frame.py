"""The frame of a finished map: the first pose of its lowest-numbered robot, whichever stretch of a log it grew from."""

from dataclasses import replace

import numpy as np

from ..core import se2
from ..core.names import in_order
from .relative_frame import moved_track
from .team_map import TeamMap

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
