"""Surveyed points that an estimator is given: `id,x,y` or `id,x,y,sd` in metres."""

import math
from pathlib import Path

from ..core.errors import ReaderError
from .table import csv_rows, is_name, lines


def read_points(path: Path) -> dict[str, tuple[float, float, float | None]]:
    """Landmark -> its place [m] and the standard deviation of each coordinate [m], None where that is not told.

    Raises ReaderError, with the line, for a table that is something else or tells a point twice.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror}") from None
    rows = csv_rows(lines(data, str(path)), path)
    header = [name.strip().lower() for name in next(rows, [])]
    if header not in (["id", "x", "y"], ["id", "x", "y", "sd"]):
        raise ReaderError(
            path, f"expected the columns id,x,y or id,x,y,sd, found {','.join(header)[:200] or 'none'}", 1
        )
    out: dict[str, tuple[float, float, float | None]] = {}
    for line, row in enumerate(rows, 2):
        if not row or row[0].startswith("#"):
            continue
        name = row[0].strip()
        try:
            x, y, *rest = (float(word) for word in row[1:] if word.strip())
        except ValueError:
            x, y, rest = math.nan, math.nan, []
        good = is_name(name) and all(map(math.isfinite, (x, y, *rest))) and len(rest) <= len(header) - 3
        if not good or any(sd <= 0 for sd in rest):
            expected = f"{','.join(header)} with finite numbers, a sd above 0"
            raise ReaderError(path, f"expected {expected}, found {','.join(row)[:60]!r}", line)
        if name in out:
            raise ReaderError(path, f"{name} is surveyed twice", line)
        out[name] = (x, y, rest[0] if rest else None)
    if not out:
        raise ReaderError(path, "expected surveyed points, found none")
    return out
