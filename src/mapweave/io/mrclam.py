"""The layout of the UTIAS MRCLAM data sets, a folder or a zip: read as one `LandmarkLog` a robot, truth left alone.

Layout: `Barcodes.dat` (subject, barcode), `RobotN_Odometry.dat` (t [s], v [m/s], w [rad/s], commanded),
`RobotN_Measurement.dat` (t [s], barcode, range [m], bearing [rad]).
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core import landmark_log
from ..core.errors import DataError, ReaderError
from ..core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable, TeamRecording
from .files import Files, open_files
from .table import line_of, numbers, open_text, row_texts

ROBOT_FILE = re.compile(r"^Robot([0-9]+)_(Odometry|Measurement)\.dat$")
BARCODES = "Barcodes.dat"
WHOLE = 2**53  # beyond it numbers as files hold them are not whole
SUBJECTS, BARE = 0.98, 0.7  # shares of a robot's numbers, subjects at least and barcodes at most, that tell subjects
ENOUGH = 20  # sightings that make an unlisted barcode a landmark (its place is the estimator's to judge)


def read_mrclam(path: Path, robots: Sequence[int] | None = None) -> tuple[LandmarkLog, ...]:
    """The logs of all robots (or of `robots`) in order of number; raises ReaderError on a damaged data set."""
    with open_files(path) as files:
        robot_files = _robot_files(files)
        folder = files.folder_of(
            [*(n for kinds in robot_files.values() for n in kinds.values()), *_barcode_files(files)]
        )
        table = _barcodes(files, folder)
        wanted = sorted(robot_files) if robots is None else list(robots)
        missing = [k for k in wanted if k not in robot_files]
        if missing:
            raise DataError(f"{path}: no robot {missing[0]}; there are {', '.join(map(str, sorted(robot_files)))}")
        logs = tuple(_robot(files, k, robot_files, table) for k in wanted)
    landmark_log.check_one_recording({f"{log.robot}": log.span for log in logs if len(log)}, path)
    if not any(len(log.sightings) for log in logs):
        raise DataError(f"{path}: no robot saw anything")
    return logs


def is_mrclam(files: Files) -> bool:
    return bool(_barcode_files(files)) or any(ROBOT_FILE.match(n.rpartition("/")[2]) for n in files.names)


def _barcode_files(files: Files) -> list[str]:
    return [n for n in files.names if n.rpartition("/")[2] == BARCODES]


def _robot_files(files: Files) -> dict[int, dict[str, str]]:
    by_robot: dict[int, dict[str, str]] = {}
    for name in files.names:
        match = ROBOT_FILE.match(name.rpartition("/")[2])
        if match:
            kinds = by_robot.setdefault(int(match[1]), {})
            if match[2] in kinds:
                files.folder_of([kinds[match[2]], name])
            kinds[match[2]] = name
    if not by_robot:
        raise ReaderError(files.where, "expected RobotN_Odometry.dat or RobotN_Measurement.dat, found none")
    return by_robot


def _barcodes(files: Files, folder: str) -> dict[int, int]:
    """Barcode -> subject."""
    name = f"{folder}{BARCODES}"
    if name not in files.names:
        raise ReaderError(files.where, f"expected {BARCODES} beside the robots' files, found none")
    data, label = files.read(name), files.label(name)
    table = numbers(data, label, ("subject", "barcode"))
    if not len(table):
        raise ReaderError(label, "expected rows of subject and barcode, found none")
    seen: dict[int, int] = {}
    for row, (subject, code) in enumerate(table):
        if not (float(subject).is_integer() and float(code).is_integer()):
            raise ReaderError(label, f"expected whole numbers, found {subject:g} {code:g}", line_of(data, label, row))
        if int(code) in seen or int(subject) in seen.values():
            raise ReaderError(
                label, f"expected every number once, found {subject:g} {code:g} again", line_of(data, label, row)
            )
        seen[int(code)] = int(subject)
    return seen


def _robot(files: Files, k: int, robot_files: dict[int, dict[str, str]], codes: dict[int, int]) -> LandmarkLog:
    mend = landmark_log.Mending()
    kinds = robot_files[k]
    odometry = None
    if "Odometry" in kinds:
        name = kinds["Odometry"]
        label = files.label(name)
        odometry = landmark_log.mended_odometry(numbers(files.read(name), label, ("t", "v", "w")), label, mend)
    if odometry is None:
        mend.find("no-wheels")
    seen, misread = NOTHING_SEEN, np.zeros(0)
    if "Measurement" in kinds:
        name = kinds["Measurement"]
        data, label = files.read(name), files.label(name)
        table = numbers(data, label, ("t", "barcode", "range", "bearing"))
        code = table[:, 1]
        wrong = np.flatnonzero(np.isfinite(code) & ((code != np.round(code)) | (np.abs(code) > WHOLE)))
        if len(wrong):
            line = line_of(data, label, int(wrong[0]))
            raise ReaderError(label, f"expected a whole number for barcode, found {table[wrong[0], 1]:g}", line)
        seen, misread = _named(landmark_log.mended_sightings(table, label, mend), codes, set(robot_files), k, mend)
    if not len(seen):
        mend.find("saw-nothing")
    spans = {"its sightings": seen.t} if odometry is None else {"its odometry": odometry.t, "its sightings": seen.t}
    ends = {w: (float(t[0]), float(t[-1])) for w, t in spans.items() if len(t)}
    landmark_log.check_one_recording(ends, files.label(f"Robot{k}_*"))
    return LandmarkLog(
        f"robot{k}", odometry, seen, mend.dropped, tuple(mend.findings), str(files.where), misread=misread
    )


def _are_subjects(values: np.ndarray, count: np.ndarray, codes: dict[int, int]) -> bool:
    """Whether a log tells subjects where barcodes are due: nearly all its numbers are subjects, few are barcodes."""
    listed, subjects = (float(count[np.isin(values, list(x))].sum()) for x in (codes.keys(), codes.values()))
    total = float(count.sum())
    return total >= ENOUGH and subjects >= SUBJECTS * total and listed < BARE * total


def _named(
    table: np.ndarray, codes: dict[int, int], robots: set[int], own: int, mend: landmark_log.Mending
) -> tuple[SightingTable, np.ndarray]:
    """Barcodes become names; unlisted ones seldom seen, and the robot's own, are misreads: their stamps (m,) [s]."""
    values, what, count = np.unique(table[:, 1].astype(np.int64), return_inverse=True, return_counts=True)
    if _are_subjects(values, count, codes):
        mend.find("subjects-told")
        codes = {subject: subject for subject in codes.values()}
    names: list[str] = []
    keep = np.ones(len(values), bool)
    for i, (code, n) in enumerate(zip(values.tolist(), count.tolist(), strict=True)):
        subject = codes.get(code)
        if subject is None:
            names.append(f"barcode:{code}")
            keep[i] = n >= ENOUGH
        else:
            names.append(f"robot{subject}" if subject in robots else str(subject))
            keep[i] = subject != own
    mend.drop("misread barcode", int(count[~keep].sum()))
    rows = keep[what]
    ids = tuple(name for name, k in zip(names, keep, strict=True) if k)
    index = (np.cumsum(keep) - 1)[what[rows]]
    return SightingTable(table[rows, 0], index, table[rows, 2], table[rows, 3], ids), np.unique(table[~rows, 0])


def write_mrclam(folder: Path, team: TeamRecording) -> None:
    """`folder` holds barcodes, survey and three files a robot; the bytes depend on `team` alone."""
    folder.mkdir(parents=True, exist_ok=True)
    codes = np.array(list(team.barcodes.items()), dtype=float).reshape(-1, 2)
    _write(folder / BARCODES, "Subject #    Barcode #", "%3d\t%4d\n", codes)
    survey = np.array([(s, x, y, 1e-4, 1e-4) for s, (x, y) in team.landmarks.items()]).reshape(-1, 5)
    head = "Subject #    x [m]    y [m]    x std-dev [m]    y std-dev [m]"
    _write(folder / "Landmark_Groundtruth.dat", head, "%3d" + "\t%.8f" * 4 + "\n", survey)
    for robot in team.robots:
        name = f"Robot{robot.number}"
        head = "Time [s]    forward velocity [m/s]    angular velocity [rad/s]"
        _write(folder / f"{name}_Odometry.dat", head, "%.3f\t%.3f\t%.3f\n", robot.odometry)
        head = "Time [s]    Barcode #    range [m]    bearing [rad]"
        seen = np.column_stack([robot.stamps, robot.barcodes, robot.sightings])
        _write(folder / f"{name}_Measurement.dat", head, "%.3f\t%4d\t%.3f\t%.3f\n", seen)
        head = "Time [s]    x [m]    y [m]    orientation [rad]"
        _write(folder / f"{name}_Groundtruth.dat", head, "%.3f\t%.8f\t%.8f\t%.8f\n", robot.truth)


def _write(path: Path, head: str, fmt: str, rows: np.ndarray) -> None:
    """A table under one comment line, without a minus before a zero between two others."""
    with open_text(path) as file:
        file.write(f"# {head}\n")
        file.writelines(text.replace("\t-0.000\t", "\t0.000\t") for text in row_texts(fmt, rows))
