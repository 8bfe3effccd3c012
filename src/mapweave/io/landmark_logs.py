"""Landmark logs opened, whatever holds them: an MRCLAM data set (folder or zip) or a folder of plain CSV.

The folder holds `odometry.csv` (t,robot,v,w) and `sightings.csv` (t,robot,id,range,bearing). The header line is needed
and may order the columns freely. Robots are whole numbers; an id `robotK` names a robot.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core import landmark_log
from ..core.errors import DataError, ReaderError
from ..core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from ..core.names import robot_key
from .files import Files, open_files
from .mrclam import is_mrclam, read_mrclam
from .table import Columns, Table, csv_rows, is_name, lines, table_of

ODOMETRY, SIGHTINGS = "odometry.csv", "sightings.csv"
DRIVEN, SEEN = ("t", "robot", "v", "w"), ("t", "robot", "id", "range", "bearing")
LARGEST = 10**9  # the number of a robot is less
Rows = tuple[np.ndarray, np.ndarray, list[str]]  # the numeric columns but the robot, the robots' numbers, the ids


def is_csv(files: Files) -> bool:
    return SIGHTINGS in files.names or ODOMETRY in files.names


def read_csv_landmarks(path: Path, robots: Sequence[int] | None = None) -> tuple[LandmarkLog, ...]:
    """The logs of all robots (or of `robots`) in order of number; raises ReaderError with file and line."""
    with open_files(path) as files:
        if SIGHTINGS not in files.names:
            raise ReaderError(path, f"expected {SIGHTINGS}, found none")
        drive = _columns(files, ODOMETRY, DRIVEN) if ODOMETRY in files.names else None
        seen = _columns(files, SIGHTINGS, SEEN)
    return _logs(drive, seen, robots, str(path), (f"{path}/{ODOMETRY}", f"{path}/{SIGHTINGS}"))


def landmark_logs_of(
    odometry: Columns | None, sightings: Columns, robots: Sequence[int] | None = None
) -> tuple[LandmarkLog, ...]:
    """The logs in tables with the same columns as the files, mended in the same way."""
    drive = None if odometry is None else _numbered(table_of(odometry, "odometry"), DRIVEN)
    seen = _numbered(table_of(sightings, "sightings"), SEEN)
    return _logs(drive, seen, robots, "tables in memory", ("odometry", "sightings"))


def _numbered(table: Table, columns: tuple[str, ...]) -> Rows:
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise ReaderError(table.path, f"expected the columns {','.join(columns)}, found {','.join(table.columns)}")
    robot = []
    for row, word in enumerate(table.names("robot"), 1):
        key = robot_key(word)
        if not key.isdecimal() or int(key) >= LARGEST:
            raise ReaderError(table.path, f"expected a whole number for robot, found {word!r}", row)
        robot.append(int(key))
    numeric = [table.numbers(name) for name in columns if name not in {"robot", "id"}]
    ids = list(table.names("id")) if "id" in columns else []
    return np.column_stack(numeric), np.array(robot, dtype=np.int64), ids


def _logs(
    drive: Rows | None, seen: Rows, robots: Sequence[int] | None, path: str, labels: tuple[str, str]
) -> tuple[LandmarkLog, ...]:
    robot_of_drive = np.zeros(0, np.int64) if drive is None else drive[1]
    found = sorted({*robot_of_drive.tolist(), *seen[1].tolist()})
    missing = [k for k in robots or () if k not in found]
    if missing:
        raise DataError(f"{path}: no robot {missing[0]}; there are {', '.join(map(str, found))}")
    names = {f"robot{k}" for k in found}
    logs = []
    for k in found if robots is None else robots:
        mend = landmark_log.Mending()
        odometry = None
        if drive is not None:
            odometry = landmark_log.mended_odometry(drive[0][robot_of_drive == k], labels[0], mend)
        if odometry is None:
            mend.warnings.append("no odometry: mapped with a random walk between sightings")
        table = _sightings(seen, k, names, labels[1], mend)
        if not len(table):
            mend.warnings.append("it saw nothing")
        logs.append(LandmarkLog(f"robot{k}", odometry, table, mend.dropped, tuple(mend.warnings), path))
    if not any(len(log.sightings) for log in logs):
        raise DataError(f"{path}: no robot saw anything")
    landmark_log.check_one_recording({log.robot: log.span for log in logs if len(log)}, path)
    return tuple(logs)


def _sightings(seen: Rows, k: int, robots: set[str], label: str, mend: landmark_log.Mending) -> SightingTable:
    numeric, robot, ids = seen
    rows = np.flatnonzero(robot == k)
    own = f"robot{k}"
    mine = sorted({ids[i] for i in rows})
    index = {name: i for i, name in enumerate(mine)}
    what = np.array([index[ids[i]] for i in rows], dtype=float)
    table = np.column_stack([numeric[rows, 0], what, numeric[rows, 1:]])
    stranger = np.array([ids[i] == own or (ids[i].startswith("robot") and ids[i] not in robots) for i in rows], bool)
    mend.drop("sighting of itself or of no robot", int(stranger.sum()))
    table = landmark_log.mended_sightings(table[~stranger] if len(rows) else table, label, mend)
    if not len(table):
        return NOTHING_SEEN
    return SightingTable(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3], tuple(mine))


def _columns(files: Files, name: str, columns: tuple[str, ...]) -> Rows:
    """The numeric columns but the robot, the robots' numbers, the ids (empty when the file has none)."""
    label = files.label(name)
    rows = csv_rows(lines(files.read(name), label), label)
    header = [h.strip().lower() for h in next(rows, [])]
    if sorted(header) != sorted(columns):
        raise ReaderError(
            label, f"expected the columns {','.join(columns)}, found {','.join(header)[:200] or 'none'}", 1
        )
    where = [header.index(c) for c in columns]
    numeric: list[list[float]] = []
    robot: list[int] = []
    ids: list[str] = []
    for line, row in enumerate(rows, 2):
        if not row or row[0].startswith("#"):
            continue
        if len(row) != len(columns):
            raise ReaderError(label, f"expected {len(columns)} columns, found {len(row)}", line)
        values = []
        for column, i in zip(columns, where, strict=True):
            word = row[i].strip()
            if column == "id":
                if not is_name(word):
                    raise ReaderError(label, f"expected an id, found {word[:40]!r}", line)
                ids.append(word)
                continue
            try:
                if column == "robot":
                    robot.append(_whole(word))
                else:
                    values.append(float(word))
            except ValueError:
                kind = "whole number" if column == "robot" else "number"
                raise ReaderError(label, f"expected a {kind} for {column}, found {word[:40]!r}", line) from None
        numeric.append(values)
    width = len(columns) - 1 - ("id" in columns)
    return np.array(numeric, dtype=np.float64).reshape(-1, width), np.array(robot, dtype=np.int64), ids


def _whole(word: str) -> int:
    """The number of a robot; raises ValueError for what cannot be one."""
    number = int(word)
    if not 0 <= number < LARGEST:
        raise ValueError(word)
    return number


def is_landmark_log(path: Path) -> bool:
    """Whether `path` is a folder or zip that looks like landmark logs; raises ReaderError when it is damaged."""
    with open_files(path) as files:
        return is_csv(files) or is_mrclam(files)


def read_landmark_logs(path: Path, robots: Sequence[int] | None = None) -> tuple[LandmarkLog, ...]:
    """One log a robot (or those of `robots`), in order of number; never reads truth."""
    with open_files(path) as files:
        plain, mrclam = is_csv(files), is_mrclam(files)
    if plain and mrclam:
        raise ReaderError(path, "expected one data set, found MRCLAM files and CSV files mixed")
    if mrclam:
        return read_mrclam(path, robots)
    if plain:
        return read_csv_landmarks(path, robots)
    raise ReaderError(path, "expected an MRCLAM data set or a folder with sightings.csv, found neither")
