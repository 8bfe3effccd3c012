"""A table whose header names its columns, CSV or Parquet: text as read, one clear error for a row that is none."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError


@dataclass(frozen=True, slots=True)
class Table:
    """Columns by lower-case name; `lines[k]` is the line of the file (or row of the Parquet table) of row k."""

    path: Path
    columns: dict[str, Sequence[str]]
    lines: Sequence[int]

    def __len__(self) -> int:
        return len(self.lines)

    def numbers(self, name: str) -> Float[np.ndarray, " n"]:
        """A column as floats, NaN where it says nothing; raises ReaderError naming the first line that is no number."""
        column = self.columns[name]
        if isinstance(column, np.ndarray):
            return np.asarray(column, dtype=np.float64)
        try:
            return np.fromiter(map(float, column), dtype=np.float64, count=len(column))
        except ValueError:
            return np.array([self._number(name, k, word) for k, word in enumerate(column)], dtype=np.float64)

    def _number(self, name: str, row: int, word: str) -> float:
        if not word.strip() or word.strip().lower() == "na":
            return float("nan")
        try:
            return float(word)
        except ValueError:
            raise ReaderError(self.path, f"expected a number for {name}, found {word!r}", self.lines[row]) from None

    def names(self, name: str) -> Sequence[str]:
        """A column as identifiers without surrounding blanks; raises ReaderError where one is empty."""
        column = [word.strip() for word in self.columns[name]]
        if "" in column:
            raise ReaderError(self.path, f"expected an id for {name}, found nothing", self.lines[column.index("")])
        return column


def read_table(path: Path) -> Table:
    """The table in `path` (`.parquet`, else CSV with a header; blank lines and # lines do not count)."""
    if not path.is_file():
        raise ReaderError(path, "no such file")
    if path.suffix.lower() in (".parquet", ".pq"):
        return _read_parquet(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ReaderError(path, f"expected a CSV table in UTF-8: {error}") from None
    lines = text.splitlines()
    if "#" not in text and all(map(str.strip, lines)):
        kept: Sequence[int] = range(1, len(lines) + 1)
    else:
        kept = [k for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
        lines = [lines[k - 1] for k in kept]
    if not lines:
        raise ReaderError(path, "expected a header line, found an empty file", 1)
    rows = list(csv.reader(lines))
    head = [name.strip().lower() for name in rows[0]]
    width = len(head)
    if len(set(head)) != width:
        raise ReaderError(path, f"a column is named twice: {','.join(head)}", kept[0])
    for k, row in enumerate(rows):
        if len(row) != width:
            raise ReaderError(path, f"expected {width} fields ({','.join(head)}), found {len(row)}", kept[k])
    body = zip(*rows[1:], strict=True) if len(rows) > 1 else ((),) * width
    return Table(path, dict(zip(head, body, strict=True)), kept[1:])


def _read_parquet(path: Path) -> Table:
    try:
        from pyarrow import parquet  # noqa: PLC0415  (an extra: only Parquet files need it)
    except ImportError:
        raise ReaderError(path, "Parquet needs pyarrow: pip install 'mapweave[parquet]'") from None
    try:
        table = parquet.read_table(path)
    except (OSError, ValueError) as error:
        raise ReaderError(path, f"expected a Parquet table: {error}") from None
    columns: dict[str, Sequence[str]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = column.to_numpy(zero_copy_only=False)
        numeric = values.dtype.kind in "fiu" and name.lower() not in ("observer", "target", "robot", "id")
        columns[name.lower()] = values if numeric else ["" if v is None else str(v) for v in values.tolist()]
    return Table(path, columns, range(1, table.num_rows + 1))
