"""A team's result on disk: its trajectories written, and the whole read back for scoring and for viewing."""

from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError
from ..core.names import in_order, robot_name
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .directory import read_json
from .landmarks import read_landmarks, read_members
from .tum import read_tum, write_track_covariance, write_tum


def read_metrics(folder: Path) -> dict[str, Any]:
    """`metrics.json` of a result; raises ReaderError when `folder` holds none."""
    path = folder / "metrics.json"
    if not path.is_file():
        raise ReaderError(folder, "expected a mapweave result with metrics.json, found none")
    metrics = read_json(path)
    if "version" not in metrics:
        raise ReaderError(path, "expected the metrics of a mapweave result, found something else")
    return metrics


def read_team_maps(folder: Path) -> tuple[TeamMap, ...]:
    """The components of a result, the largest first."""
    parts = [folder, *sorted(folder.glob("components/[0-9]*"), key=lambda p: in_order(p.name))]
    return tuple(_component(part) for part in parts)


def read_single_maps(folder: Path) -> dict[str, LandmarkMap]:
    """Robot -> the landmarks of its own map, as far as the result holds them."""
    local = folder / "local"
    found = sorted(local.rglob("landmarks.npz"), key=lambda p: in_order(p.as_posix()))
    return {p.parent.relative_to(local).as_posix(): read_landmarks(p, "local") for p in found}


def _component(folder: Path) -> TeamMap:
    tracks = folder / "trajectories"
    found = sorted(tracks.rglob("*.tum"), key=lambda p: in_order(p.as_posix()))
    told = folder / "landmarks.csv"
    members, sightings = read_members(told) if told.exists() else ({}, {})
    held = folder / "landmarks.npz"
    empty = LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))
    by_robot = {p.relative_to(tracks).with_suffix("").as_posix(): read_tum(p) for p in found}
    return TeamMap(
        robots=tuple(by_robot),
        landmarks=read_landmarks(held) if held.exists() else empty,
        tracks=by_robot,
        members=members,
        sightings=sightings,
    )


def write_tracks(folder: Path, team: TeamMap) -> None:
    """`trajectories/robotK.tum`, and `.cov.csv` where the method gives covariances."""
    for robot, track in team.tracks.items():
        stem = folder / "trajectories" / robot_name(robot)
        write_tum(stem.with_name(stem.name + ".tum"), track)
        write_track_covariance(stem.with_name(stem.name + ".cov.csv"), track)
