"""Truth for scoring alone: surveyed landmarks, the robots' true poses, relations. No estimator imports this file.

A file of relations has rows `t1 t2 x y z roll pitch yaw`, plain or gzipped, with `#` comments.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError
from ..core.records import Track
from ..core.se2 import wrap_angle
from ..core.truth import Relations, Survey
from .files import Files, TextLog, open_files
from .table import csv_rows, is_name, line_of, lines, numbers, open_text, write_rows

SURVEY = "Landmark_Groundtruth.dat"
TABLE = "surveyed_landmarks.csv"  # what a simulated team's truth calls its survey
TRUTH_FILE = re.compile(r"^Robot([0-9]+)_(Groundtruth|GroundtruthInstants|GroundtruthKeyframes)\.dat$")
LARGEST = 10**9  # the number of a subject is less
KINDS = ("Groundtruth", "GroundtruthInstants", "GroundtruthKeyframes")  # the first there is is used
LABELS = {"Groundtruth": "groundtruth", "GroundtruthInstants": "instants", "GroundtruthKeyframes": "keyframes"}
EXTRA = {"Groundtruth": 0, "GroundtruthInstants": 2, "GroundtruthKeyframes": 0}  # columns after t, x, y, theta


def read_survey(path: Path) -> Survey:
    """Surveyed landmarks: of an MRCLAM data set (folder or zip), an `id,x,y` CSV file, or a folder with that one."""
    if (path / TABLE).is_file():
        path = path / TABLE
    if path.is_file() and path.suffix.lower() == ".csv":
        return _survey_csv(path)
    with open_files(path) as files:
        names = [n for n in files.names if n.rpartition("/")[2] == SURVEY]
        if not names:
            raise ReaderError(path, f"expected {SURVEY}, found none")
        files.folder_of(names)
        label = files.label(names[0])
        data = files.read(names[0])
        table = numbers(data, label, ("subject", "x", "y", "x std", "y std"))
        wrong = np.flatnonzero(~(np.isfinite(table[:, :3]).all(axis=1) & (np.abs(table[:, 0]) < LARGEST)))
        if len(wrong):
            line = line_of(data, label, int(wrong[0]))
            raise ReaderError(label, "expected the number of a subject and finite coordinates", line)
    return Survey(tuple(str(int(s)) for s in table[:, 0]), table[:, 1:3])


def read_robot_truth(path: Path) -> dict[str, tuple[Track, str]]:
    """Robot -> its true poses in the survey's frame and which kind of truth that is; empty when there is none.

    `groundtruth`, else `instants`, else `keyframes`.
    """
    out: dict[str, tuple[Track, str]] = {}
    if not path.is_dir() and path.suffix.lower() != ".zip":
        return out
    with open_files(path) as files:
        by_robot: dict[int, dict[str, str]] = {}
        for name in files.names:
            match = TRUTH_FILE.match(name.rpartition("/")[2])
            if match:
                by_robot.setdefault(int(match[1]), {})[match[2]] = name
        for k in sorted(by_robot):
            kind = next(kind for kind in KINDS if kind in by_robot[k])
            out[f"robot{k}"] = (_poses(files, by_robot[k][kind], EXTRA[kind]), LABELS[kind])
    return out


def _poses(files: Files, name: str, extra: int) -> Track:
    columns = ("t", "x", "y", "theta", *(f"column {5 + k}" for k in range(extra)))
    table = numbers(files.read(name), files.label(name), columns)[:, :4]
    table = table[np.isfinite(table).all(axis=1)]
    t, first = np.unique(table[:, 0], return_index=True)
    pose = table[first, 1:]
    pose[:, 2] = wrap_angle(pose[:, 2])
    return Track(t, pose, frame="survey")


def _survey_csv(path: Path) -> Survey:
    rows = csv_rows(lines(path.read_bytes(), str(path)), path)
    header = [h.strip().lower() for h in next(rows, [])]
    if header[:3] != ["id", "x", "y"]:
        raise ReaderError(path, f"expected the columns id,x,y, found {','.join(header)[:200] or 'none'}", 1)
    ids, xy = [], []
    for line, row in enumerate(rows, 2):
        if not row or row[0].startswith("#"):
            continue
        try:
            ids.append(row[0].strip())
            xy.append([float(row[1]), float(row[2])])
        except (ValueError, IndexError):
            xy.append([np.nan])
        if not is_name(ids[-1]) or not np.isfinite(xy[-1]).all():
            raise ReaderError(path, f"expected id,x,y with numbers, found {','.join(row)[:60]!r}", line)
    return Survey(tuple(ids), np.array(xy, dtype=np.float64).reshape(-1, 2))


def is_relations(path: Path) -> bool:
    """By name (`.relations`, `.relations.gz`, `relations.gz`, ...)."""
    return path.is_file() and any(part == "relations" for part in path.name.lower().split("."))


def read_relations(path: Path) -> Relations:
    """All rows, in the file's order. Raises ReaderError naming the first line that is not eight finite numbers."""
    log = TextLog(path)
    if log.truncated:
        raise ReaderError(path, log.truncated)
    rows = []
    for number, line in log.lines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise ReaderError(
                path, f"expected numbers `t1 t2 x y z roll pitch yaw`, found {line[:60]!r}", number
            ) from None
        if len(row) != 8 or not np.isfinite(row).all():
            raise ReaderError(path, f"expected 8 finite numbers `t1 t2 x y z roll pitch yaw`, found {len(row)}", number)
        rows.append(row)
    if not rows:
        raise ReaderError(path, "expected relations, found none")
    a = np.array(rows)
    return Relations(a[:, 0], a[:, 1], a[:, [2, 3, 7]], str(path))


def write_relations(
    path: Path, t1: Float[np.ndarray, " n"], t2: Float[np.ndarray, " n"], motion: Float[np.ndarray, "n 3"]
) -> None:
    """`path` holds a line for each motion [x, y, theta] from `t1` to `t2`, with as many digits as the numbers have."""
    with open_text(path) as file:
        write_rows(file, "%.17g %.17g %.17g %.17g 0 0 0 %.17g\n", np.column_stack([t1, t2, motion]))
