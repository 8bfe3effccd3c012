"""Landmarks as a table for people and as arrays with the joint covariance for programs."""

from pathlib import Path

import numpy as np

from ..core.names import in_order, robot_key
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .npz import write_npz
from .rows import open_text

HEAD = "id,x,y,var_x,cov_xy,var_y,robots,sightings"


def write_landmarks(folder: Path, team: TeamMap) -> None:
    """`landmarks.csv` and `landmarks.npz` in `folder`, ordered by id."""
    ids = sorted(team.landmarks.ids, key=in_order)
    held = team.landmarks.select(ids)
    with open_text(folder / "landmarks.csv") as file:
        file.write(HEAD + "\n")
        for i, name in enumerate(ids):
            x, y = held.mean[i]
            P = held.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            robots = ";".join(sorted(map(robot_key, team.members.get(name, ())), key=in_order))
            seen = team.sightings.get(name, 0)
            file.write(f"{name},{x:.9f},{y:.9f},{P[0, 0]:.9e},{P[0, 1]:.9e},{P[1, 1]:.9e},{robots},{seen}\n")
    write_landmark_arrays(folder, held)


def write_landmark_arrays(folder: Path, landmarks: LandmarkMap) -> None:
    """`landmarks.npz`: `ids (n,) str, mean (n, 2), cov (2n, 2n)`, in the order given."""
    ids = np.array(landmarks.ids, dtype=np.str_)
    write_npz(folder / "landmarks.npz", ids=ids, mean=landmarks.mean, cov=landmarks.cov)
