"""A plain table of scans, a scan a row, whose columns the caller names."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..core.config import config
from ..core.errors import UsageError
from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan, odometry_row
from .carmen import no_return_limit
from .files import TextLog, is_number
from .stampless import STEP

ONE, MANY, SKIPPED = ("t", "x", "y", "theta"), ("ranges", "intensities"), "-"
POSE = ("x", "y", "theta")
MOST = 100_000  # columns
SPELLING = "columns as t,x,y,theta,ranges (also ranges:N, intensities:N, and - or -:N for what is left out)"


@config
class ScanTable:
    """columns: name and how many, in the order of a row, None for all that are left; angles of the beams [rad]."""

    columns: tuple[tuple[str, int | None], ...]
    angle_min: float
    angle_increment: float


def scan_table(columns: str, beams: Sequence[float]) -> ScanTable:
    """The table of rows `columns` (`t,x,y,theta,ranges`), beams (first, step) [rad]. Raises UsageError for others."""
    found = tuple(_column(word.strip()) for word in columns.split(","))
    names = [name for name, _ in found if name != SKIPPED]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise UsageError(f"--columns: expected each column once, found {twice!r} twice")
    if "ranges" not in names or len({*POSE} & {*names}) not in {0, 3}:
        raise UsageError(f"--columns: expected ranges, and x,y,theta together or none of them, found {columns!r}")
    if any(n is None for _, n in found[:-1]):
        raise UsageError(f"--columns: only the last may have no number (ranges:N), found {columns!r}")
    if len(beams) != 2 or not np.isfinite(beams).all() or not beams[1]:
        raise UsageError(f"--beams: expected the first beam's angle and the step to the next, found {tuple(beams)}")
    return ScanTable(columns=found, angle_min=float(beams[0]), angle_increment=float(beams[1]))


def _column(word: str) -> tuple[str, int | None]:
    name, colon, count = word.partition(":")
    if name in ONE and not colon:
        return name, 1
    if name in {*MANY, SKIPPED} and not colon:
        return name, 1 if name == SKIPPED else None
    if name not in {*MANY, SKIPPED} or not (count.isdecimal() and 0 < int(count[:9]) <= MOST):
        raise UsageError(f"--columns: expected {SPELLING}, found {word!r}")
    return name, int(count)


def read_scan_table(
    log: TextLog, robot: str, table: ScanTable, *, sensor_pose: Sequence[float] | None = None, mirrored: bool = False
) -> LaserLog:
    """The log, in metres, radians and seconds; scans without a column `t` are taken to be one second apart.

    Words are divided by commas, semicolons or white space; an empty one is NaN. A first row without any number is a
    header. Raises ReaderError, naming the line, for a row of another number of words than the first, or a word that is
    no number.
    """
    raw = RawLog(robot, str(log.path), log.log_hash)
    rows = [(number, _words(line)) for number, line in log.lines() if line.strip() and line.lstrip()[0] != "#"]
    if rows and not any(map(is_number, rows[0][1])):
        del rows[0]
    places: dict[str, slice] = {}

    def take(words: list[str]) -> None:
        if not places:
            places.update(_places(table, len(words)))
        if len(words) != len(rows[0][1]):
            raise ValueError(f"expected {len(rows[0][1])} words, found {len(words)}")
        values = {name: np.array(words[at], dtype=float) for name, at in places.items()}
        raw.scans.append(_scan(values, len(raw.scans), table))

    raw.read_rows(log, rows, take)
    if "t" not in places:
        raw.find("stamps-none", STEP)
    if "x" in places:
        raw.odometry_from = "poses"
        raw.odometry = [odometry_row(scan.t, scan.odometry) for scan in raw.scans if scan.odometry is not None]
    if raw.scans:
        limit = no_return_limit(np.concatenate([scan.ranges for scan in raw.scans]))
        raw.scans = [replace(scan, range_max=limit) for scan in raw.scans]
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _words(line: str) -> list[str]:
    mark = next((mark for mark in ",;" if mark in line), None)
    return [word.strip() or "nan" for word in line.strip().split(mark)]


def _places(table: ScanTable, words: int) -> dict[str, slice]:
    """Where in a row of so many words each column stands."""
    out, at = {}, 0
    for name, count in table.columns:
        end = max(at + 1, words) if count is None else at + count
        if name != SKIPPED:
            out[name] = slice(at, end)
        at = end
    if at > words:
        raise ValueError(f"expected {at} words or more, found {words}")
    return out


def _scan(values: dict[str, np.ndarray], k: int, table: ScanTable) -> RawScan:
    t = float(values["t"][0]) if "t" in values else k * STEP
    pose = np.concatenate([values[name] for name in POSE]) if "x" in values else None
    light, first, step = values.get("intensities"), table.angle_min, table.angle_increment
    return RawScan(t, values["ranges"], light, first, step, 0.0, np.inf, odometry=pose)
