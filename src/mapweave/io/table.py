"""Numbers and names in rows: text without a header, CSV or Parquet with one, columns in memory; read and written.

Rows without a header are read by position. A row that is none gives one clear error that names its line. Writing takes
many rows at a time: ten times faster than a row at a time, and the same on every machine.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol, cast, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError, EstimateError, ReaderError, UsageError
from ..core.paths import kind_of
from .directory import result_file

BATCH = 2000
ANY_NAME = "backslashreplace"  # how bytes of a file name that are no letters are written


def lines(data: bytes, label: str) -> list[str]:
    """The text's lines; CRLF and a byte-order mark are tolerated; raises ReaderError when it is no text."""
    try:
        return data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise ReaderError(label, "expected text, found bytes that are none", line) from None


def numbers(data: bytes, label: str, columns: tuple[str, ...], *, separator: str | None = None) -> np.ndarray:
    """(n, len(columns)) float64 from text with `#` comments; raises ReaderError with the line that does not parse.

    `columns` names what each row holds, for the message; NaN and infinity parse.
    """
    text = lines(data, label)
    if not any(_body(line) for line in text):
        return np.empty((0, len(columns)), np.float64)
    try:
        table = np.loadtxt(text, dtype=np.float64, comments="#", delimiter=separator, ndmin=2)
    except ValueError:
        table = np.empty((0, 0))
    if table.shape[1] != len(columns):
        table = np.array(
            [_row(line, label, number, columns, separator) for number, line in _rows(text)], dtype=np.float64
        )
    return table


def line_of(data: bytes, label: str, row: int) -> int:
    """The line (from 1) that row `row` of `numbers` was read from."""
    return [number for number, _ in _rows(lines(data, label))][row]


def _body(line: str) -> str:
    return line.partition("#")[0].strip()


def _rows(text: list[str]) -> Iterator[tuple[int, str]]:
    return ((number, _body(line)) for number, line in enumerate(text, 1) if _body(line))


def _row(line: str, label: str, number: int, columns: tuple[str, ...], separator: str | None) -> list[float]:
    words = line.split(separator)
    if len(words) != len(columns):
        expected = f"{len(columns)} columns ({', '.join(columns)})"
        raise ReaderError(label, f"expected {expected}, found {len(words)}", number)
    out = []
    for name, word in zip(columns, words, strict=True):
        try:
            out.append(float(word))
        except ValueError:
            raise ReaderError(label, f"expected a number for {name}, found {word.strip()!r}", number) from None
    return out


def write_rows(file: IO[str], fmt: str, rows: Float[np.ndarray, "n k"]) -> None:
    """Every row through the %-format `fmt` (which ends its line).

    Raises EstimateError, naming the file and the row, for a number that is not finite.
    """
    if not np.isfinite(rows).all():
        k = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
        values = " ".join(f"{v:g}" for v in rows[k].tolist())
        raise EstimateError(
            f"{told_path(Path(file.name))}: row {k + 1} would hold a number that is not finite: {values}"
        )
    file.writelines(row_texts(fmt, rows))


def row_texts(fmt: str, rows: Float[np.ndarray, "n k"]) -> Iterator[str]:
    """The rows through the %-format `fmt`, many rows a piece."""
    whole = fmt * BATCH
    for first in range(0, len(rows), BATCH):
        part = rows[first : first + BATCH]
        yield (whole if len(part) == BATCH else fmt * len(part)) % tuple(part.ravel().tolist())


def told_path(path: Path) -> str:
    """The end of `path` as a message names it: the file, and the folder that says whose it is."""
    parent = path.parent.name
    return path.name if not parent or parent.startswith(".") else f"{parent}/{path.name}"


def open_text(path: Path) -> IO[str]:
    """`path` opened to write, its folder made; line ends are the same everywhere."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.open("w", encoding="utf-8", errors=ANY_NAME, newline="\n")


Number = Callable[[float], str]
NAMED = ("observer", "target", "robot", "id")  # columns of names, whatever they look like
LONGEST_NAME = 200  # letters of an id: names become names of files
A_NAME = f"an id of at most {LONGEST_NAME} letters that can be printed"  # what an id is, in words


@dataclass(frozen=True, slots=True)
class Table:
    """Columns by lower-case name; `lines[k]` is the line of the file (or row of the Parquet table) of row k."""

    path: Path | str
    columns: dict[str, Sequence[str] | np.ndarray]
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
            problem = f"expected a number for {name}, found {word[:40]!r}"
            raise ReaderError(self.path, problem, self.lines[row]) from None

    def finite(self, name: str) -> Float[np.ndarray, " n"]:
        """A column as floats; raises ReaderError naming the first line that holds none or one that is not finite."""
        values = self.numbers(name)
        for k in np.flatnonzero(~np.isfinite(values))[:1].tolist():
            raise ReaderError(self.path, f"expected a finite {name}, found {values[k]:g}", self.lines[k])
        return values

    def names(self, name: str) -> Sequence[str]:
        """A column as identifiers without surrounding blanks; raises ReaderError where one is empty."""
        column = [word.strip() for word in self.columns[name]]
        if "" in column:
            raise ReaderError(self.path, f"expected an id for {name}, found nothing", self.lines[column.index("")])
        for k, word in enumerate(column):
            if not is_name(word):
                raise ReaderError(self.path, f"expected {A_NAME} for {name}, found {word[:40]!r}", self.lines[k])
        return column

    def whole(self, name: str) -> list[int]:
        """A column as whole numbers; raises ReaderError naming the first line that holds none."""
        values = self.numbers(name)
        wrong = np.flatnonzero(~((np.abs(values) < 2.0**53) & (values == np.round(values))))
        if len(wrong):
            word = self.columns[name][int(wrong[0])]
            raise ReaderError(
                self.path, f"expected a whole number for {name}, found {word!r:.40}", self.lines[int(wrong[0])]
            )
        return [int(v) for v in values]


def is_name(word: str) -> bool:
    """Whether `word` can be an id: neither empty nor endless, nothing in it that cannot be printed."""
    return 0 < len(word) <= LONGEST_NAME and word.isprintable()


def csv_rows(lines: Sequence[str], label: object, numbers: Sequence[int] | None = None) -> Iterator[list[str]]:
    """The fields of every line; raises ReaderError naming the line for a field that is too long or goes over lines.

    `numbers`: of the lines in the file, from 1 where none are given.
    """
    rows = csv.reader(lines, skipinitialspace=True)
    for k in range(len(lines)):
        line = numbers[k] if numbers is not None else k + 1
        try:
            row = next(rows)
        except csv.Error as error:
            raise ReaderError(label, f"expected fields with commas between: {error}", line) from None
        if rows.line_num != k + 1:
            raise ReaderError(label, "expected a row a line, found a field in quotes that is not closed", line)
        yield row


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
    rows = list(csv_rows(lines, path, kept))
    head = [name.strip().lower() for name in rows[0]]
    listing = ",".join(head)[:200]
    if len(set(head)) != len(head):
        raise ReaderError(path, f"a column is named twice: {listing}", kept[0])
    for k, row in enumerate(rows):
        if len(row) != len(head):
            raise ReaderError(path, f"expected {len(head)} fields ({listing}), found {len(row)}", kept[k])
    body = zip(*rows[1:], strict=True) if len(rows) > 1 else ((),) * len(head)
    return Table(path, dict(zip(head, body, strict=True)), kept[1:])


def _read_parquet(path: Path) -> Table:
    try:
        from pyarrow import ArrowException, parquet  # noqa: PLC0415  (an extra: only Parquet files need it)
    except ImportError:
        raise ReaderError(path, "Parquet needs pyarrow: install mapweave with the extra [parquet]") from None
    try:
        table = parquet.read_table(path)
        return _columns(path, table)
    except (
        OSError,
        ValueError,
        ArrowException,
    ) as error:  # a name or a word that is no text shows only when it is looked at
        raise ReaderError(path, f"expected a Parquet table: {error}") from None


def _columns(path: Path, table: Any) -> Table:
    columns: dict[str, Sequence[str] | np.ndarray] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = column.to_numpy(zero_copy_only=False)
        numeric = values.dtype.kind in "fiu" and name.lower() not in NAMED
        columns[name.lower()] = values if numeric else ["" if v is None else str(v) for v in values.tolist()]
    return Table(path, columns, range(1, table.num_rows + 1))


def nine_digits(value: float) -> str:
    """Nine digits after the point; of numbers under 1 or from a thousand million on, twelve digits that count."""
    return f"{value:.9f}" if 1.0 <= abs(value) < 1e9 or value == 0.0 else f"{value:.12g}"


def write_table(
    path: Path,
    head: Sequence[str],
    rows: Iterable[Iterable[object]],
    number: Number | Sequence[Number] = nine_digits,
) -> None:
    """A CSV table, whole or not at all; `number` writes the floats of all columns, or of each column its own.

    Raises EstimateError, naming the file and the column, for a number that is infinite.
    """
    each = [number] * len(head) if callable(number) else number
    with result_file(path) as work, work.open("w", encoding="utf-8", errors=ANY_NAME, newline="\n") as out:
        out.write(",".join(head) + "\n")
        for row in rows:
            try:
                fields = [cell(value, as_text) for value, as_text in zip(row, each, strict=True)]
            except OverflowError as error:
                raise EstimateError(f"{told_path(path)}: {error}, where {','.join(head)} stand") from None
            out.write(",".join(fields) + "\n")


def cell(value: object, number: Number = "{:.6g}".format) -> str:
    """One field of a CSV line: floats by `number`, None and NaN as nothing, words quoted where they must be.

    Raises OverflowError for a number that is infinite.
    """
    if isinstance(value, float):
        if math.isnan(value):
            return ""
        if math.isinf(value):
            raise OverflowError("a number is infinite")
        return number(value)
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    text = str(value)
    return quoted(text) if any(c in text for c in ',"\r\n') else text


def quoted(text: str) -> str:
    """`text` as a CSV field in quotes, line ends as blanks: a row is a line."""
    return '"' + " ".join(text.split("\n")).replace("\r", " ").replace('"', '""') + '"'


@runtime_checkable
class Framed(Protocol):
    """Columns by name, as a data frame or a structured array gives them."""

    def __getitem__(self, name: Any, /) -> Any: ...


Columns = Mapping[str, Any] | Framed


def table_of(given: Columns, label: str) -> Table:
    """The columns of `given` as a table that errors call `label`; its lines are its rows, counted from 1.

    Numbers stay arrays, anything else becomes text. Raises UsageError for what has no columns, DataError for columns of
    unequal length and for one of several dimensions.
    """
    columns: dict[str, Sequence[str] | np.ndarray] = {}
    for name in column_names(given, label):
        values = np.asarray(given[name])
        if values.ndim != 1:
            raise DataError(f"{label}: expected one value a row for {name}, found the shape {values.shape}")
        key = str(name).strip().lower()
        numeric = values.dtype.kind in "fiub" and key not in NAMED
        columns[key] = values if numeric else [_as_text(v) for v in values.tolist()]
    sizes = {name: len(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1:
        lengths = ", ".join(f"{name} {n}" for name, n in sizes.items())
        raise DataError(f"{label}: expected columns of one length, found {lengths}")
    return Table(label, columns, range(1, next(iter(sizes.values()), 0) + 1))


def array_of(given: Columns, name: str, label: str, dims: int) -> Float[np.ndarray, "..."]:
    """The entry `name` as floats of `dims` dimensions; raises DataError where it is missing or of another shape."""
    if name not in column_names(given, label):
        raise DataError(f"{label}: expected {name}, found {', '.join(map(str, column_names(given, label)))}")
    try:
        values = np.asarray(given[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(f"{label}: expected numbers for {name}, all rows of one length") from None
    if values.ndim != dims:
        raise DataError(f"{label}: expected {dims} dimensions for {name}, found the shape {values.shape}")
    return values


def is_table(given: object) -> bool:
    """Whether `given` has columns by name: a mapping, a structured array or a data frame."""
    return _names_in(given) is not None


def columns_of(given: object, name: str, expected: str = "columns by name") -> Columns:
    """The table that was given; raises UsageError for what is none. name: of the argument; expected: in its message."""
    if is_table(given):
        return cast("Columns", given)
    raise UsageError(f"{name}: expected {expected}, found {kind_of(given)}")


def column_names(given: Columns, label: str) -> list[Any]:
    """The names of the columns of `given`; raises UsageError where it has none."""
    names = _names_in(given)
    if names is None:
        raise UsageError(f"{label}: expected columns by name, found {kind_of(given)}")
    return names


def _names_in(given: object) -> list[Any] | None:
    names = given.keys() if isinstance(given, Mapping) else getattr(given, "columns", None)
    if names is None:
        names = getattr(getattr(given, "dtype", None), "names", None)
    return list(names) if isinstance(names, Iterable) else None


def _as_text(value: object) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
