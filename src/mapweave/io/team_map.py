"""A result on disk, read back: what `map` and `fuse` wrote, for scoring and for viewing."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError
from ..core.names import in_order, robot_name
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .tum import read_tum


def read_metrics(folder: Path) -> dict[str, Any]:
    """`metrics.json` of a result; raises ReaderError when `folder` holds none."""
    path = folder / "metrics.json"
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
    except OSError:
        raise ReaderError(folder, "expected a mapweave result with metrics.json, found none") from None
    except ValueError as error:
        raise ReaderError(path, f"expected JSON: {error}") from None
    if not isinstance(metrics, dict) or "version" not in metrics:
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


def _component(folder: Path) -> TeamMap:
    tracks = folder / "trajectories"
    found = sorted(tracks.rglob("*.tum"), key=lambda p: in_order(p.as_posix()))
    members, sightings = _table(folder / "landmarks.csv")
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


def _table(path: Path) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
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
