"""Rows of numbers that come one by one and are kept in one array: the bytes of the numbers and hardly more."""

from collections.abc import Iterator
from typing import Any

import numpy as np

LEAST = 16  # rows there is room for at first


class Rows:
    """Rows of one shape and dtype. `append` and `clear` change it; what it hands out stays as it was."""

    def __init__(self, *shape: int, dtype: Any = np.float64) -> None:
        self._held = np.zeros((LEAST, *shape), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, row: int) -> Any:
        """One row, a copy of it; `-1` is the last."""
        return self._held[: self._count][row].copy()

    def __iter__(self) -> Iterator[Any]:
        return iter(self.array)

    def append(self, row: Any) -> None:
        """One more; an eighth more room is made when there is none."""
        if self._count == len(self._held):
            more = np.zeros((max(LEAST, self._count // 8), *self._held.shape[1:]), self._held.dtype)
            self._held = np.concatenate([self._held, more])
        self._held[self._count] = row
        self._count += 1

    def keep_last(self) -> None:
        """Only the newest is there any more, and the room for those before it is given back."""
        newest = self._held[max(self._count - 1, 0) : self._count]
        self._held = np.zeros((LEAST, *self._held.shape[1:]), self._held.dtype)
        self._count = len(newest)
        self._held[: self._count] = newest

    def clear(self) -> None:
        """No row is there any more."""
        self._count = 0

    @property
    def array(self) -> np.ndarray:
        """(n, ...) all of them, a copy."""
        return np.array(self._held[: self._count])
