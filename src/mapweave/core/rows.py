"""Rows of numbers: buffers for those that come one by one, and which of many are asked."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Int

PIECE = 128  # rows of one array


def spread(n: int, most: int) -> Int[np.ndarray, " k"]:
    """Which of n rows stand for all: `most` of them, evenly spread from the first to the last, or all n."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).round().astype(np.int64)


class RowBuffer:
    """Rows of one shape and dtype, in arrays that are never copied. `append` and `clear` change it.

    What it hands out stays as it was.
    """

    def __init__(self, *shape: int, dtype: Any = np.float64) -> None:
        self._shape, self._dtype = shape, np.dtype(dtype)
        self._pieces: list[np.ndarray] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, row: int) -> Any:
        """One row, a copy of it; `-1` is the last."""
        at = range(self._count)[row]
        return self._pieces[at // PIECE][at % PIECE].copy()

    def __iter__(self) -> Iterator[Any]:
        return iter(self.array)

    def append(self, row: Any) -> None:
        """Add a row at the end."""
        if self._count == PIECE * len(self._pieces):
            self._pieces.append(np.zeros((PIECE, *self._shape), self._dtype))
        self._pieces[-1][self._count % PIECE] = row
        self._count += 1

    def keep_last(self) -> None:
        """Remove all rows but the newest; the memory of the others is given back, but for one array."""
        if self._count:
            self._pieces[0][0] = self[-1]
            del self._pieces[1:]
            self._count = 1

    def clear(self) -> None:
        """Remove all rows."""
        del self._pieces[1:]
        self._count = 0

    @property
    def array(self) -> np.ndarray:
        """(n, ...) all of them, a copy."""
        if not self._pieces:
            return np.zeros((0, *self._shape), self._dtype)
        return np.concatenate(self._pieces)[: self._count].copy()
