"""Rows of numbers as text without a header: read by position, a word an error that names the line, and written.

Writing takes many rows at a time: ten times faster than a row at a time, and the same on every machine.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float

from ..core.errors import EstimateError, ReaderError

BATCH = 2000


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
        found = " ".join(f"{v:g}" for v in rows[k].tolist())
        raise EstimateError(
            f"{told_path(Path(file.name))}: row {k + 1} would hold a number that is not finite: {found}"
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
    return path.open("w", encoding="utf-8", newline="\n")
