"""Landmarks as a table for people and as arrays with the joint covariance for programs."""

import csv
from pathlib import Path

import numpy as np

from ..core.errors import ReaderError
from ..core.names import in_order, robot_key, robot_name
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .npz import write_npz
from .table import write_table

HEAD = "id,x,y,var_x,cov_xy,var_y,robots,sightings"


def read_landmarks(path: Path, frame: str = "map") -> LandmarkMap:
    """The map in a `landmarks.npz`; raises ReaderError when it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as held:
            ids = tuple(str(name) for name in held["ids"])
            return LandmarkMap(ids, held["mean"].reshape(-1, 2), held["cov"], frame)
    except FileNotFoundError:
        raise ReaderError(path, "no such file") from None
    except Exception as error:  # noqa: BLE001  (numpy and zipfile raise a dozen kinds for a damaged file)
        raise ReaderError(path, f"expected ids, mean and cov of landmarks: {error}") from None


def read_members(path: Path) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
    """Of every landmark in a `landmarks.csv`, the robots that know it and how often it was sighted."""
    if not path.exists():
        return {}, {}
    members: dict[str, tuple[str, ...]] = {}
    sightings: dict[str, int] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for number, row in enumerate(csv.DictReader(file), 2):
            try:
                members[row["id"]] = tuple(robot_name(k) for k in row["robots"].split(";") if k)
                sightings[row["id"]] = int(row["sightings"])
            except (KeyError, ValueError, AttributeError) as error:
                raise ReaderError(path, f"expected id, robots and sightings: {error}", number) from None
    return members, sightings


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
