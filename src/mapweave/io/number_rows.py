"""Rows of numbers from text without a header, by position; a word in a line is an error that names the line."""

from collections.abc import Iterator

import numpy as np

from ..core.errors import ReaderError

FLOAT = np.float64


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
        return np.empty((0, len(columns)), FLOAT)
    try:
        table = np.loadtxt(text, dtype=FLOAT, comments="#", delimiter=separator, ndmin=2)
    except ValueError:
        table = np.empty((0, 0))
    if table.shape[1] != len(columns):
        table = np.array([_row(line, label, number, columns, separator) for number, line in _rows(text)], dtype=FLOAT)
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
