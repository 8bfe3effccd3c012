"""What a mixed call is given, sorted: landmark data sets, tables of commands and sightings, laser logs by robot.

A simulated team is written as such files, with the truth beside.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError
from ..core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from ..core.laser_log import LaserLog
from ..core.names import in_order
from ..core.records import Track
from .directory import write_json
from .landmark_logs import ODOMETRY, SIGHTINGS, columns_of, is_landmark_log, read_landmark_logs, read_tables
from .landmark_truth import TABLE
from .laser_logs import BAGS, LaserSource, is_laser_log, robots_of
from .mcap import write_mcap
from .table import write_table
from .tum import write_tum
from .unknown import not_known

IN_NAME = re.compile(r"robot[_-]?([0-9]+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class LaserOf:
    """One robot's laser log: where it lies and which of its robots it is."""

    path: Path
    source: LaserSource


@dataclass(frozen=True, slots=True)
class MixedLogs:
    """sets: landmark data sets; odometry, sightings: tables; lasers: by robot (`robotK`)."""

    sets: tuple[Path, ...]
    odometry: tuple[Path, ...]
    sightings: tuple[Path, ...]
    lasers: dict[str, LaserOf]


def is_mixed(paths: Sequence[Path]) -> bool:
    """Whether `paths` hold more than one kind of log, or tables that belong to other logs."""
    kinds = {_kind(path) for path in _opened(paths)}
    return bool(kinds & {"odometry", "sightings"}) or {"landmarks", "laser"} <= kinds


def sorted_logs(paths: Sequence[Path], source: LaserSource) -> MixedLogs:
    """The logs by kind; robot K of a laser log is the number in its name (`robot6.mcap`), else the next that is free.

    Raises ReaderError for a path of no kind that is known, DataError for two laser logs of one robot.
    """
    by_kind: dict[str, list[Path]] = {"landmarks": [], "odometry": [], "sightings": [], "laser": []}
    for path in _opened(paths):
        kind = _kind(path)
        if not kind:
            raise not_known(path)
        by_kind[kind].append(path)
    lasers: dict[str, LaserOf] = {}
    nameless: list[LaserOf] = []
    for path in by_kind["laser"]:
        number = IN_NAME.search(path.name)
        for name in robots_of(path, source):
            log = LaserOf(path, replace(source, name=name))
            own = number if name is None else IN_NAME.search(name)
            if own is None:
                nameless.append(log)
                continue
            robot = f"robot{int(own[1])}"
            if robot in lasers:
                raise DataError(f"{path}: {robot} has the laser log {lasers[robot].path} too")
            lasers[robot] = log
    used = {*lasers, *(log.robot for path in by_kind["landmarks"] for log in read_landmark_logs(path))}
    free = (f"robot{k}" for k in range(1, 10**6) if f"robot{k}" not in used)
    lasers.update(zip(free, nameless, strict=False))
    return MixedLogs(tuple(by_kind["landmarks"]), tuple(by_kind["odometry"]), tuple(by_kind["sightings"]), lasers)


def read_mixed_landmarks(logs: MixedLogs, fixes: str | None = None) -> list[LandmarkLog]:
    """One log a robot, what several files say of it together; an empty one for a laser robot nobody else tells of.

    fixes: topics of recordings that tell where a robot was, by default satellites alone.
    """
    read: dict[str, LandmarkLog] = {}
    for path in logs.sets:
        for log in read_landmark_logs(path, fixes=fixes):
            if log.robot in read:
                raise DataError(f"{path}: {log.robot} is in {read[log.robot].source} too: two data sets are mixed")
            read[log.robot] = log
    known = {*read, *logs.lasers, *_named_in(logs.odometry), *_named_in(logs.sightings)}
    tables = [(path, None) for path in logs.odometry] + [(None, path) for path in logs.sightings]
    for odometry, sightings in tables:
        for log in read_tables(odometry, sightings, known):
            read[log.robot] = _together(read[log.robot], log) if log.robot in read else log
    for robot, laser in logs.lasers.items():
        read.setdefault(robot, LandmarkLog(robot, None, NOTHING_SEEN, source=str(laser.path)))
    return [_with_current_findings(read[robot]) for robot in sorted(read, key=in_order)]


def _named_in(paths: Sequence[Path]) -> set[str]:
    return {log.robot for path in paths for log in _rows_of(path)}


def _rows_of(path: Path) -> Sequence[LandmarkLog]:
    is_odometry = columns_of(path) == "odometry"
    return read_tables(path, None) if is_odometry else read_tables(None, path)


def _with_current_findings(log: LandmarkLog) -> LandmarkLog:
    """With the findings that are still true once all files are together, each once."""
    idle = {"saw-nothing"} if len(log.sightings) + len(log.bearings) else set()
    if log.odometry is not None:
        idle.add("no-wheels")
    return replace(log, findings=tuple(dict.fromkeys(f for f in log.findings if f.code not in idle)))


def _together(a: LandmarkLog, b: LandmarkLog) -> LandmarkLog:
    """What two files say of one robot; raises DataError when both tell its commands."""
    if a.odometry is not None and b.odometry is not None:
        raise DataError(f"{b.source}: the commands of {b.robot} are in {a.source} too")
    dropped = dict(a.dropped)
    for reason, n in b.dropped.items():
        dropped[reason] = dropped.get(reason, 0) + n
    return LandmarkLog(
        a.robot,
        a.odometry if a.odometry is not None else b.odometry,
        _joined(a.sightings, b.sightings),
        dropped,
        (*a.findings, *b.findings),
        a.source,
        bearings=_joined(a.bearings, b.bearings),
        fixes=a.fixes if a.fixes is not None else b.fixes,
    )


def _joined(a: SightingTable, b: SightingTable) -> SightingTable:
    if not len(a) or not len(b):
        return a if len(a) else b
    ids = tuple(dict.fromkeys((*a.ids, *b.ids)))
    place = {name: k for k, name in enumerate(ids)}
    what = np.array([place[t.ids[k]] for t in (a, b) for k in t.what.tolist()])
    t, z, bearing = (np.concatenate([getattr(a, n), getattr(b, n)]) for n in ("t", "range", "bearing"))
    order = np.argsort(t, kind="stable")
    return SightingTable(t[order], what[order], z[order], bearing[order], ids)


def _opened(paths: Sequence[Path]) -> list[Path]:
    """The paths, a folder of tables beside laser logs as its files."""
    out: list[Path] = []
    for path in paths:
        bags = (
            sorted((p for p in path.iterdir() if p.suffix in BAGS), key=lambda p: in_order(p.name))
            if path.is_dir()
            else []
        )
        tables = [path / name for name in (ODOMETRY, SIGHTINGS) if (path / name).is_file()]
        out += [*tables, *bags] if bags and tables else [path]
    return out


def _kind(path: Path) -> str:
    if path.is_file() and path.suffix.lower() == ".csv" and (kind := columns_of(path)):
        return kind
    if is_landmark_log(path):
        return "landmarks"
    return "laser" if is_laser_log(path) else ""


WALLS, CALIBRATION = "walls.csv", "calibration.json"
Row = tuple[float, str, str, float, float]  # t [s], robot, id, range [m] or NaN, bearing [rad]


@dataclass(frozen=True, slots=True)
class TrueTeam:
    """What is true of a team: landmarks by id [m], walls (s, 4) [m], trajectories and calibrations by robot."""

    landmarks: Mapping[str, tuple[float, float]]
    walls: Float[np.ndarray, "s 4"]
    tracks: Mapping[str, Track]
    calibration: Mapping[str, Mapping[str, float]]


def write_mixed_team(
    folder: Path,
    commands: Mapping[str, Float[np.ndarray, "n 3"]],
    sightings: Iterable[Row],
    lasers: Sequence[LaserLog],
    truth: TrueTeam,
) -> None:
    """`folder` holds odometry.csv, sightings.csv (no range where there is none), robotK.mcap and truth/."""
    folder.mkdir(parents=True, exist_ok=True)
    if commands:
        driven = sorted((t, k, v, w) for k, rows in commands.items() for t, v, w in rows.tolist())
        number = ["{:.6f}".format, "{:.6g}".format, "{:.6g}".format, "{:.6g}".format]
        write_table(folder / "odometry.csv", ("t", "robot", "v", "w"), driven, number)
    rows = sorted(sightings, key=lambda row: row[:3])
    number = ["{:.6f}".format] + ["{:.6f}".format] * 4
    write_table(folder / "sightings.csv", ("t", "robot", "id", "range", "bearing"), rows, number)
    for log in lasers:
        write_mcap(folder / f"robot{log.robot}.mcap", log)
    write_truth(folder / "truth", truth)


def write_truth(home: Path, truth: TrueTeam) -> None:
    """`home` holds surveyed landmarks, walls, trajectories and calibrations."""
    home.mkdir()
    write_table(home / TABLE, ("id", "x", "y"), [(name, x, y) for name, (x, y) in truth.landmarks.items()])
    write_table(home / WALLS, ("x0", "y0", "x1", "y1"), truth.walls.tolist())
    for robot, track in truth.tracks.items():
        write_tum(home / f"{robot}.tum", track)
    write_json(
        home / CALIBRATION, {k: {p: {"value": v} for p, v in known.items()} for k, known in truth.calibration.items()}
    )
