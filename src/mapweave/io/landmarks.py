"""Landmarks as a table for people and as arrays with the joint covariance for programs."""

from pathlib import Path

import numpy as np

from ..core.errors import ReaderError
from ..core.names import in_order, robot_key, robot_name
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .npz import read_npz, write_npz
from .table import read_table, write_table

HEAD = "id,x,y,var_x,cov_xy,var_y,robots,sightings"


def read_landmarks(path: Path, frame: str = "map") -> LandmarkMap:
    """The map in a `landmarks.npz`; raises ReaderError when it is damaged."""
    held = read_npz(path, {"ids": ("text", ("n",)), "mean": ("number", ("n", 2)), "cov": ("number", ("2n", "2n"))})
    try:
        return LandmarkMap(tuple(str(name) for name in held["ids"]), held["mean"], held["cov"], frame)
    except ValueError as error:
        raise ReaderError(path, f"expected ids, mean and cov of landmarks: {error}") from None


def read_members(path: Path) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
    """Of every landmark in a `landmarks.csv`, the robots that know it and how often it was sighted."""
    table = read_table(path)
    if missing := [name for name in ("id", "robots", "sightings") if name not in table.columns]:
        raise ReaderError(path, f"expected a column {missing[0]}, found {','.join(table.columns)}", 1)
    ids, sightings = table.names("id"), table.whole("sightings")
    robots = [tuple(robot_name(key) for key in text.split(";") if key) for text in table.columns["robots"]]
    return dict(zip(ids, robots, strict=True)), dict(zip(ids, sightings, strict=True))


def write_landmarks(folder: Path, team: TeamMap) -> None:
    """`landmarks.csv` and `landmarks.npz` in `folder`, ordered by id."""
    ids = sorted(team.landmarks.ids, key=in_order)
    held = team.landmarks.select(ids)
    rows = []
    for i, name in enumerate(ids):
        P = held.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        robots = ";".join(sorted(map(robot_key, team.members.get(name, ())), key=in_order))
        rows.append(
            [name, *held.mean[i].tolist(), *P[np.triu_indices(2)].tolist(), robots, team.sightings.get(name, 0)]
        )
    number = ["{:.9f}".format] * 3 + ["{:.9e}".format] * 5
    write_table(folder / "landmarks.csv", HEAD.split(","), rows, number)
    write_landmark_arrays(folder, held)


def write_landmark_arrays(folder: Path, landmarks: LandmarkMap) -> None:
    """`landmarks.npz`: `ids (n,) str, mean (n, 2), cov (2n, 2n)`, in the order given."""
    ids = np.array(landmarks.ids, dtype=np.str_)
    write_npz(folder / "landmarks.npz", ids=ids, mean=landmarks.mean, cov=landmarks.cov)
