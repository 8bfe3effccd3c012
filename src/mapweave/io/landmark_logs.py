"""Whatever holds landmark logs, opened: an MRCLAM data set (folder or zip) or a folder of plain CSV."""

from collections.abc import Sequence
from pathlib import Path

from ..core.errors import ReaderError
from ..core.landmark_log import LandmarkLog
from .csv_landmarks import is_csv, read_csv_landmarks
from .files import open_files
from .mrclam import is_mrclam, read_mrclam


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
