"""Landmark logs opened, whatever holds them: an MRCLAM data set (folder or zip), plain CSV, tags in a recording.

The folder holds `odometry.csv` (t,robot,v,w) and `sightings.csv` (t,robot,id,range,bearing). The header line is needed
and may order the columns freely. Robots are whole numbers; an id `robotK` names a robot, which in the log of several is
one of them. A sighting whose range is empty, or a table without that column, tells bearings alone.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core import landmark_log
from ..core.errors import DataError, ReaderError
from ..core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from ..core.names import robot_key
from .files import Files, open_files, recording_suffix, zip_begins_with
from .mrclam import is_mrclam, read_mrclam
from .table import A_NAME, Columns, Table, csv_rows, is_name, lines, table_of

ODOMETRY, SIGHTINGS = "odometry.csv", "sightings.csv"
DRIVEN, SEEN = ("t", "robot", "v", "w"), ("t", "robot", "id", "range", "bearing")
UNTOLD = {"": np.nan, "nan": np.inf}  # a range that is empty is not told; one that is no number is dropped with its row
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


def read_tables(odometry: Path | None, sightings: Path | None, others: Collection[str] = ()) -> tuple[LandmarkLog, ...]:
    """The logs in an `odometry.csv` and a `sightings.csv`, each on its own; one of them may be missing.

    others: robots (`robotK`) whose logs lie elsewhere, which may be sighted. A robot without a row has no log here.
    """
    drive = seen = None
    if odometry is not None:
        with open_files(odometry.parent) as files:
            drive = _columns(files, odometry.name, DRIVEN)
    if sightings is not None:
        with open_files(sightings.parent) as files:
            seen = _columns(files, sightings.name, SEEN)
    path = str(sightings or odometry)
    nothing: Rows = (np.zeros((0, 3)), np.zeros(0, np.int64), [])
    return _logs(drive, nothing if seen is None else seen, None, path, (str(odometry), str(sightings)), others)


def columns_of(path: Path) -> str:
    """`odometry` or `sightings`, as the first line of the table at `path` says; "" for anything else."""
    try:
        with path.open("rb") as file:
            head = lines(file.readline(), str(path))
    except (OSError, ReaderError):
        return ""
    header = {h.strip().lower() for h in head[0].split(",")} if head else set()
    if header == set(DRIVEN):
        return "odometry"
    return "sightings" if header in (set(SEEN), set(SEEN) - {"range"}) else ""


def landmark_logs_of(
    odometry: Columns | None, sightings: Columns, robots: Sequence[int] | None = None
) -> tuple[LandmarkLog, ...]:
    """The logs in tables with the same columns as the files, mended in the same way."""
    drive = None if odometry is None else _numbered(table_of(odometry, "odometry"), DRIVEN)
    seen = _numbered(table_of(sightings, "sightings"), SEEN)
    return _logs(drive, seen, robots, "tables in memory", ("odometry", "sightings"))


def _is_recording(path: Path) -> bool:
    return (path / "metadata.yaml").is_file() if path.is_dir() else bool(recording_suffix(path))


def _read_tags(path: Path, robots: Sequence[int] | None, place: int, fixes: str | None) -> tuple[LandmarkLog, ...]:
    """The logs of all robots (or of `robots`) of a recording that saw tags."""
    from .tags import read_tags  # noqa: PLC0415  (message types cost a second; only recordings need them)

    told = {log.number: log for log in read_tags(path, place, fixes)}
    numbers = {
        what: np.repeat(list(told), [len(getattr(log, what)) for log in told.values()]) for what in ("drive", "seen")
    }
    drive: Rows = np.concatenate([log.drive for log in told.values()]), numbers["drive"], []
    names = [name for log in told.values() for name in log.names]
    seen: Rows = np.concatenate([log.seen for log in told.values()]), numbers["seen"], names
    logs = _logs(drive, seen, robots, str(path), ("odometry", "tags"))
    return tuple(
        replace(
            log,
            dropped={**log.dropped, **told[log.number].dropped},
            findings=(*log.findings, *told[log.number].findings),
            unused=tuple(told[log.number].unused),
            fixes=told[log.number].fixes,
        )
        for log in logs
    )


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
    drive: Rows | None,
    seen: Rows,
    robots: Sequence[int] | None,
    path: str,
    labels: tuple[str, str],
    others: Collection[str] | None = None,
) -> tuple[LandmarkLog, ...]:
    robot_of_drive = np.zeros(0, np.int64) if drive is None else drive[1]
    numbers = sorted({*robot_of_drive.tolist(), *seen[1].tolist()})
    missing = [k for k in robots or () if k not in numbers]
    if missing:
        raise DataError(f"{path}: no robot {missing[0]}; there are {', '.join(map(str, numbers))}")
    names = {f"robot{k}" for k in numbers} | set(others or ())
    if len(numbers) == 1:  # one robot's own log: whoever it saw has one elsewhere
        names |= {name for name in seen[2] if re.fullmatch(r"robot\d+", name)}
    logs = []
    for k in numbers if robots is None else robots:
        mend = landmark_log.Mending()
        odometry = None
        if drive is not None:
            odometry = landmark_log.mended_odometry(drive[0][robot_of_drive == k], labels[0], mend)
        if odometry is None:
            mend.find("no-wheels")
        table, bearings = _sightings(seen, k, names, labels[1], mend)
        if not len(table) and not len(bearings):
            mend.find("saw-nothing")
        logs.append(
            LandmarkLog(f"robot{k}", odometry, table, mend.dropped, tuple(mend.findings), path, bearings=bearings)
        )
    if others is None and not any(len(log.sightings) for log in logs):
        if any(len(log.bearings) for log in logs):
            raise DataError(
                f"{path}: no sighting has its range, and bearings alone begin no map: add a robot's ranges or laser "
                "log, or place robots that see each other by `mapweave locate`"
            )
        raise DataError(f"{path}: no robot saw anything")
    landmark_log.check_one_recording({log.robot: log.span for log in logs if len(log)}, path)
    return tuple(logs)


def _sightings(
    seen: Rows, k: int, robots: set[str], label: str, mend: landmark_log.Mending
) -> tuple[SightingTable, SightingTable]:
    """What robot `k` saw with a range, and by bearing alone."""
    numeric, robot, ids = seen
    rows = np.flatnonzero(robot == k)
    own = f"robot{k}"
    mine = sorted({ids[i] for i in rows})
    index = {name: i for i, name in enumerate(mine)}
    what = np.array([index[ids[i]] for i in rows], dtype=float)
    table = np.column_stack([numeric[rows, 0], what, numeric[rows, 1:]])
    stranger = np.array([ids[i] == own or (ids[i].startswith("robot") and ids[i] not in robots) for i in rows], bool)
    mend.drop("sighting of itself or of no robot", int(stranger.sum()))
    table = table[~stranger] if len(rows) else table
    has_range = ~np.isnan(table[:, 2])
    ranged = landmark_log.mended_sightings(table[has_range], label, mend)
    directed = table[~has_range]
    directed[:, 2] = 1.0
    directed = landmark_log.mended_sightings(directed, label, mend) if len(directed) else directed
    directed[:, 2] = np.nan
    return _table(ranged, mine), _table(directed, mine)


def _table(rows: np.ndarray, ids: Sequence[str]) -> SightingTable:
    if not len(rows):
        return NOTHING_SEEN
    return SightingTable(rows[:, 0], rows[:, 1].astype(np.int64), rows[:, 2], rows[:, 3], tuple(ids))


def _columns(files: Files, name: str, columns: tuple[str, ...]) -> Rows:
    """The numeric columns but the robot, the robots' numbers, the ids (empty when the file has none)."""
    label = files.label(name)
    rows = csv_rows(lines(files.read(name), label), label)
    header = [h.strip().lower() for h in next(rows, [])]
    where = _places(header, columns, label)
    numeric: list[list[float]] = []
    robot: list[int] = []
    ids: list[str] = []
    for line, row in enumerate(rows, 2):
        if not row or row[0].startswith("#"):
            continue
        if len(row) != len(header):
            raise ReaderError(label, f"expected {len(header)} columns, found {len(row)}", line)
        values = []
        for column, i in zip(columns, where, strict=True):
            word = "" if i < 0 else row[i].strip()
            if column == "range" and word in UNTOLD:
                values.append(UNTOLD[word])
                continue
            if column == "id":
                if not is_name(word):
                    raise ReaderError(label, f"expected {A_NAME}, found {word[:40]!r}", line)
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


def _places(header: list[str], columns: tuple[str, ...], label: str) -> list[int]:
    """Where each of `columns` stands, -1 for a range that the table does not tell."""
    directed = columns == SEEN and "range" not in header
    if sorted([*header, *(["range"] if directed else [])]) != sorted(columns):
        raise ReaderError(
            label, f"expected the columns {','.join(columns)}, found {','.join(header)[:200] or 'none'}", 1
        )
    return [-1 if directed and c == "range" else header.index(c) for c in columns]


def _whole(word: str) -> int:
    """The number of a robot; raises ValueError for what cannot be one."""
    number = int(word)
    if not 0 <= number < LARGEST:
        raise ValueError(word)
    return number


def is_landmark_log(path: Path) -> bool:
    """Whether `path` is a folder or zip file that looks like landmark logs, or a recording of tags without scans.

    Raises ReaderError for a damaged folder or zip file.

    A zip file whose list of contents is lost is one when its first file has such a name.
    """
    if _is_recording(path):
        from .tags import has_tags  # noqa: PLC0415  (message types cost a second; only recordings need them)

        return has_tags(path)
    first = None if path.is_dir() else zip_begins_with(path)
    if not path.is_dir() and first is None:
        return False
    try:
        with open_files(path) as files:
            return is_csv(files) or is_mrclam(files)
    except ReaderError:
        if first is not None and not first.lower().endswith((".dat", ".csv")):
            return False
        raise


def read_landmark_logs(
    path: Path, robots: Sequence[int] | None = None, place: int = 1, fixes: str | None = None
) -> tuple[LandmarkLog, ...]:
    """One log a robot (or those of `robots`), in order of number; never reads truth.

    place: the number of a recording's only robot where neither it nor the file is numbered; fixes: its topics that tell
    where a robot was, by default satellites alone.
    """
    if _is_recording(path):
        return _read_tags(path, robots, place, fixes)
    with open_files(path) as files:
        plain, mrclam = is_csv(files), is_mrclam(files)
    if plain and mrclam:
        raise ReaderError(path, "expected one data set, found MRCLAM files and CSV files mixed")
    if mrclam:
        return read_mrclam(path, robots)
    if plain:
        return read_csv_landmarks(path, robots)
    raise ReaderError(path, "expected an MRCLAM data set or a folder with sightings.csv, found neither")
