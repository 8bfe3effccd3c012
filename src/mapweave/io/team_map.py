"""A team's result on disk, written and read back: landmarks, trajectories, calibration.

Landmarks are a table for people and arrays with the joint covariance for programs; `calibration.json` is what is known
of every robot's wheels and camera, as found or as given.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from ..core.errors import ReaderError
from ..core.gaussian import is_positive_definite
from ..core.names import in_order, robot_key, robot_name
from ..landmarks.landmark_map import LandmarkMap
from ..team.robot_part import PARAMETERS
from ..team.smooth import Calibration, is_observed
from ..team.team_map import TeamMap
from .directory import no_result, read_json, write_json
from .npz import read_npz, write_npz
from .table import read_table, write_table
from .tum import read_result_track, write_track_covariance, write_tum

WRITTEN = 1e-6  # [m] that places in two files may be apart
ROUNDED = 1e-9  # of the greatest variance that a covariance may be off one
HEAD = "id,x,y,var_x,cov_xy,var_y,robots,sightings"


def read_landmarks(path: Path, frame: str = "map") -> LandmarkMap:
    """The map in a `landmarks.npz`; raises ReaderError when it is damaged."""
    held = read_npz(path, {"ids": ("text", ("n",)), "mean": ("number", ("n", 2)), "cov": ("number", ("2n", "2n"))})
    try:
        made = LandmarkMap(tuple(str(name) for name in held["ids"]), held["mean"], held["cov"], frame)
    except ValueError as error:
        raise ReaderError(path, f"expected ids, mean and cov of landmarks: {error}") from None
    slack = ROUNDED * float(np.abs(made.cov).max(initial=0.0))
    if np.abs(made.cov - made.cov.T).max(initial=0.0) > slack:
        raise ReaderError(path, "cov: expected a symmetric matrix, found another")
    if slack > 0 and not is_positive_definite(made.cov + slack * np.eye(len(made.cov))):
        raise ReaderError(path, "cov: expected a covariance, found a matrix with negative eigenvalues")
    return made


def read_members(path: Path) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
    """Of every landmark in a `landmarks.csv`, the robots that know it and how often it was sighted."""
    table = read_table(path)
    if missing := [name for name in ("id", "robots", "sightings") if name not in table.columns]:
        raise ReaderError(path, f"expected a column {missing[0]}, found {','.join(table.columns)}", 1)
    ids, sightings = table.names("id"), table.whole("sightings")
    robots = [tuple(map(robot_name, _split(str(text)))) for text in table.columns["robots"]]
    return dict(zip(ids, robots, strict=True)), dict(zip(ids, sightings, strict=True))


def write_landmarks(folder: Path, team: TeamMap) -> None:
    """`landmarks.csv` and `landmarks.npz` in `folder`, ordered by id."""
    ids = sorted(team.landmarks.ids, key=in_order)
    held = team.landmarks.select(ids)
    rows = []
    for i, name in enumerate(ids):
        P = held.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        robots = _joined(sorted(map(robot_key, team.members.get(name, ())), key=in_order))
        rows.append(
            [name, *held.mean[i].tolist(), *P[np.triu_indices(2)].tolist(), robots, team.sightings.get(name, 0)]
        )
    number = ["{:.9f}".format] * 3 + ["{:.9e}".format] * 5
    write_table(folder / "landmarks.csv", HEAD.split(","), rows, number)
    write_landmark_arrays(folder, held)


def _joined(keys: Iterable[str]) -> str:
    """`keys` between semicolons; one within a key, as of a folder's name, and a backslash have a backslash before."""
    return ";".join(key.replace("\\", "\\\\").replace(";", "\\;") for key in keys)


def _split(text: str) -> list[str]:
    """What `_joined` joined, empty keys left out."""
    return [re.sub(r"\\(.)", r"\1", key) for key in re.findall(r"(?:[^;\\]|\\.)+", text)]


def write_landmark_arrays(folder: Path, landmarks: LandmarkMap) -> None:
    """`landmarks.npz`: `ids (n,) str, mean (n, 2), cov (2n, 2n)`, in the order given."""
    ids = np.array(landmarks.ids, dtype=np.str_)
    write_npz(folder / "landmarks.npz", ids=ids, mean=landmarks.mean, cov=landmarks.cov)


SCALES = ("speed_scale", "turn_scale", "range_scale")


def write_calibration(path: Path, robots: Mapping[str, Calibration], prior: Calibration) -> None:
    """`{robot: {parameter: {value, sd, observed}}}`; observed: whether the data told more than was known before."""
    write_json(
        path,
        {
            robot_key(robot): {
                name: {"value": value, "sd": sd, "observed": is_observed(name, sd, prior)}
                for name, (value, sd) in calibration.items()
            }
            for robot, calibration in robots.items()
        },
    )


def read_calibration(path: Path) -> dict[str, dict[str, tuple[float, float]]]:
    """Robot name -> parameter -> (value, sd), as `map` writes it or by hand; no sd, or 0, holds a value.

    Raises ReaderError naming the robot and the parameter for anything else than `{robot: {parameter: {value, sd}}}`
    with finite numbers, scales above 0 and standard deviations of 0 or more.
    """
    out: dict[str, dict[str, tuple[float, float]]] = {}
    for key, given in read_json(path).items():
        if not isinstance(given, dict):
            raise ReaderError(path, f"robot {key}: expected parameters, found {str(given)[:40]!r}")
        known: dict[str, tuple[float, float]] = {}
        for name, entry in given.items():
            if name not in PARAMETERS:
                raise ReaderError(path, f"robot {key}: expected {', '.join(PARAMETERS)}, found {name[:40]!r}")
            known[name] = _entry(path, f"robot {key}, {name}", name, entry)
        out[robot_name(key)] = known
    return out


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _entry(path: Path, where: str, name: str, entry: object) -> tuple[float, float]:
    given = entry if isinstance(entry, dict) else {"value": entry}
    value, sd = given.get("value"), given.get("sd", 0.0)
    if not _is_number(value) or not _is_number(sd):
        raise ReaderError(path, f"{where}: expected a value and its sd as finite numbers")
    if name in SCALES and not value > 0:
        raise ReaderError(path, f"{where}: expected a scale above 0, found {value}")
    if sd < 0:
        raise ReaderError(path, f"{where}: expected an sd of 0 or more, found {sd}")
    return float(value), float(sd)


def read_metrics(folder: Path) -> dict[str, Any]:
    """`metrics.json` of a result; raises ReaderError when `folder` holds none."""
    path = folder / "metrics.json"
    if not path.is_file():
        raise no_result(folder)
    metrics = read_json(path)
    if "version" not in metrics:
        raise ReaderError(path, "expected the metrics of a mapweave result, found something else")
    return metrics


def read_team_maps(folder: Path) -> tuple[TeamMap, ...]:
    """The components of a result, the largest first."""
    parts = [folder, *sorted(folder.glob("components/[0-9]*"), key=lambda p: in_order(p.name))]
    gaps = _left_out(folder / "metrics.json")
    return tuple(_component(part, gaps) for part in parts)


def _left_out(path: Path) -> dict[str, tuple[tuple[float, float], ...]]:
    """Robot -> the spans of its track in which nothing says where it was, as the metrics tell them."""
    left_out = read_json(path).get("left_out", {}) if path.is_file() else {}
    try:
        return {robot_name(robot): tuple((float(a), float(b)) for a, b in spans) for robot, spans in left_out.items()}
    except (AttributeError, TypeError, ValueError):
        raise ReaderError(path, "left_out: expected lists of [begin, end] in seconds, found something else") from None


def told_gaps(maps: Sequence[TeamMap]) -> dict[str, list[list[float]]]:
    """What `metrics.json` tells of spans in which nothing says where a robot was."""
    return {robot_key(r): [[a, b] for a, b in spans] for m in maps for r, spans in m.left_out.items() if spans}


def read_single_maps(folder: Path) -> dict[str, LandmarkMap]:
    """Robot -> the landmarks of its own map, as far as the result holds them."""
    local = folder / "local"
    paths = sorted(local.rglob("landmarks.npz"), key=lambda p: in_order(p.as_posix()))
    return {p.parent.relative_to(local).as_posix(): read_landmarks(p, "local") for p in paths}


def _component(folder: Path, gaps: Mapping[str, tuple[tuple[float, float], ...]]) -> TeamMap:
    tracks = folder / "trajectories"
    paths = sorted(tracks.rglob("*.tum"), key=lambda p: in_order(p.as_posix()))
    table = folder / "landmarks.csv"
    members, sightings = read_members(table) if table.exists() else ({}, {})
    held = folder / "landmarks.npz"
    landmarks = read_landmarks(held) if held.exists() else LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))
    if table.exists() and held.exists():
        _expect_same(table, landmarks)
    by_robot = {p.relative_to(tracks).with_suffix("").as_posix(): read_result_track(p) for p in paths}
    return TeamMap(
        robots=tuple(by_robot),
        landmarks=landmarks,
        tracks=by_robot,
        members=members,
        sightings=sightings,
        left_out={robot: spans for robot, spans in gaps.items() if robot in by_robot},
    )


def _expect_same(path: Path, landmarks: LandmarkMap) -> None:
    """Raises ReaderError unless the table's landmarks lie where those of the arrays do."""
    table = read_table(path)
    mean = dict(zip(landmarks.ids, landmarks.mean, strict=True))
    if not {"x", "y"} <= set(table.columns):
        return
    for k, (name, x, y) in enumerate(zip(table.names("id"), table.finite("x"), table.finite("y"), strict=True)):
        if name not in mean or np.abs(mean[name] - (x, y)).max() > WRITTEN * max(1.0, np.abs(mean[name]).max()):
            raise ReaderError(path, f"landmark {name} does not lie where landmarks.npz has it", k + 2)


def write_tracks(folder: Path, team: TeamMap) -> None:
    """`trajectories/robotK.tum`, and `.cov.csv` where the method gives covariances."""
    for robot, track in team.tracks.items():
        stem = folder / "trajectories" / robot_name(robot)
        write_tum(stem.with_name(stem.name + ".tum"), track)
        write_track_covariance(stem.with_name(stem.name + ".cov.csv"), track)
