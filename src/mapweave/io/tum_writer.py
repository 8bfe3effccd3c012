"""Trajectories: TUM lines `t x y z qx qy qz qw`, and the covariance of every pose beside them."""

from pathlib import Path

import numpy as np

from ..core.errors import DataError
from ..core.names import robot_name
from ..core.records import Track
from ..team.team_map import TeamMap
from .rows import open_text, write_rows

COVARIANCE_HEAD = "t,xx,xy,yy,xt,yt,tt"


def write_tum(path: Path, track: Track) -> None:
    """`path` holds one line a stamp, ascending; z and roll and pitch are zero."""
    if len(track.t) > 1 and not (np.diff(track.t) > 0).all():
        raise DataError(f"{path.name}: stamps of a trajectory must ascend strictly")
    half = 0.5 * track.pose[:, 2]
    rows = np.column_stack([track.t, track.pose[:, :2], np.sin(half), np.cos(half)])
    with open_text(path) as file:
        write_rows(file, "%.6f %.6f %.6f 0 0 0 %.9f %.9f\n", rows + 0.0)


def write_track_covariance(path: Path, track: Track) -> None:
    """`path` holds `t,xx,xy,yy,xt,yt,tt` [m^2, m rad, rad^2], a line for each line of the trajectory."""
    if track.cov is None:
        return
    P = track.cov
    rows = np.column_stack([track.t, P[:, 0, 0], P[:, 0, 1], P[:, 1, 1], P[:, 0, 2], P[:, 1, 2], P[:, 2, 2]])
    with open_text(path) as file:
        file.write(COVARIANCE_HEAD + "\n")
        write_rows(file, "%.6f" + ",%.6e" * 6 + "\n", rows)


def write_tracks(folder: Path, team: TeamMap) -> None:
    """`trajectories/robotK.tum`, and `.cov.csv` where the method gives covariances."""
    for robot, track in team.tracks.items():
        stem = folder / "trajectories" / robot_name(robot)
        write_tum(stem.with_name(stem.name + ".tum"), track)
        write_track_covariance(stem.with_name(stem.name + ".cov.csv"), track)
