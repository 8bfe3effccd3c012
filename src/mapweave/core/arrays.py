"""The one door through which arrays enter records: C-contiguous, float64, read-only."""

from typing import Any

import numpy as np


def frozen(values: Any, dtype: Any = np.float64) -> np.ndarray:
    """A C-contiguous read-only array of `dtype`; a copy is made only when the input is writable or differs."""
    a = np.ascontiguousarray(values, dtype=dtype)
    if a.flags.writeable:
        a = a.copy() if a is values or a.base is not None else a
        a.setflags(write=False)
    return a


def owned(a: np.ndarray) -> np.ndarray:
    """`a`, made here and held by nobody else, read-only from now on: `frozen` takes it as it is, without a copy."""
    a.setflags(write=False)
    return a
