"""Columns of numbers as bytes: little-endian float64, one column after the other."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..core.records import frozen
from .messages import RefusedError

TRIANGLE = np.triu_indices(3)


def pack(*columns: Sequence[float] | np.ndarray) -> bytes:
    """Equal-length columns (n,), or the rows of one array."""
    return np.ascontiguousarray(columns, dtype="<f8").tobytes()


def unpack(data: bytes, columns: int) -> Float[np.ndarray, "c n"]:
    """The columns; raises RefusedError when they are not of equal length or a number is not finite."""
    if len(data) % (8 * columns):
        raise RefusedError("malformed", f"expected {columns} columns of equal length, found {len(data)} bytes")
    values = np.frombuffer(data, dtype="<f8").reshape(columns, -1)
    if not np.isfinite(values).all():
        raise RefusedError("malformed", "a number that is not finite")
    return frozen(values)


def pack_triangle(P: Float[np.ndarray, "m m"]) -> bytes:
    """The upper triangle of a symmetric matrix, row by row."""
    return pack(P[np.triu_indices(len(P))])


def unpack_triangle(data: bytes, size: int) -> Float[np.ndarray, "m m"]:
    """The symmetric matrix; raises RefusedError when its diagonal holds a negative number."""
    values = unpack(data, 1)[0]
    if len(values) != size * (size + 1) // 2:
        raise RefusedError("malformed", f"expected the triangle of {size} x {size} numbers, found {len(values)}")
    P = np.zeros((size, size))
    P[np.triu_indices(size)] = values
    P = P + np.triu(P, 1).T
    if (np.diag(P) < 0).any():
        raise RefusedError("malformed", "a variance below 0")
    return P


def listed(pose: Float[np.ndarray, "3"]) -> tuple[float, ...]:
    return tuple(float(x) for x in pose)


def triangle(P: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    """xx, xy, xt, yy, yt, tt."""
    return tuple(float(x) for x in P[TRIANGLE])


def square(numbers: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The symmetric matrix of which `triangle` gives the numbers; zero of none."""
    P = np.zeros((3, 3))
    P[TRIANGLE] = numbers or 0.0
    return P + np.triu(P, 1).T
