"""Columns of numbers as bytes: little-endian float64, one column after the other; or as few as a sensor's need.

Squeezed columns come back to the bit.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

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


THOUSAND = 1000.0  # millimetres in a metre, milliseconds in a second
LARGEST_WHOLE = 2**31 - 1


class Kind(NamedTuple):
    """How numbers become whole ones and come back."""

    whole: Callable[[Float[np.ndarray, " n"]], np.ndarray]
    numbers: Callable[[Int[np.ndarray, " n"]], Float[np.ndarray, " n"]]


def _single(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(np.float64)


def _bits(values: np.ndarray) -> np.ndarray:
    """The bits of float32 as whole numbers in the order of what they mean."""
    bits = values.astype(np.float32).view(np.int32).astype(np.int64)
    return np.where(bits < 0, -(1 << 31) - bits - 1, bits)


def _of_bits(whole: np.ndarray) -> np.ndarray:
    bits = np.where(whole < 0, -(1 << 31) - whole - 1, whole).astype(np.int32)
    return bits.view(np.float32).astype(np.float64)


KINDS: Mapping[str, Kind] = {
    "i": Kind(np.rint, lambda k: k.astype(np.float64)),
    "m": Kind(lambda v: np.rint(v * THOUSAND), lambda k: k / THOUSAND),
    "s": Kind(lambda v: np.rint(v * THOUSAND), lambda k: _single(k / THOUSAND)),
    "f": Kind(_bits, _of_bits),
}
EXACT = "d"


def squeeze(values: Float[np.ndarray, " n"]) -> bytes:
    """The numbers to the bit: a letter for how they are told, then a zlib stream of it.

    i: whole numbers; m: thousandths; s: thousandths that were rounded to float32; f: the bits of float32 as a whole
    number that grows with it. Each as int32, with a capital letter each but the first less the one before it, folded so
    that small ones of either sign have high bytes of 0; then all lowest bytes, all next ones, to the highest.
    d: float64, little-endian.
    """
    for letter, kind in KINDS.items():
        with np.errstate(over="ignore"):
            whole = kind.whole(values)
        if not (np.abs(whole) <= LARGEST_WHOLE).all():
            continue
        whole = whole.astype(np.int64)
        if kind.numbers(whole).tobytes() != values.tobytes():
            continue
        steps = np.diff(whole, prepend=0)
        encodings = [letter.encode() + zlib.compress(_planes(whole), 6)]
        if (np.abs(steps) <= LARGEST_WHOLE).all():
            encodings.append(letter.upper().encode() + zlib.compress(_planes(steps), 6))
        return min(encodings, key=len)
    return EXACT.encode() + zlib.compress(values.astype("<f8").tobytes(), 6)


def stretch(data: bytes, n: int) -> Float[np.ndarray, " n"]:
    """The n numbers of `squeeze`; raises RefusedError when they are not n or not finite."""
    letter = data[:1].decode("ascii", errors="replace")
    if letter != EXACT and letter.lower() not in KINDS:
        raise RefusedError("malformed", "a column of no known kind")
    raw = _inflated(data[1:], n * (8 if letter == EXACT else 4))
    if letter == EXACT:
        values = np.frombuffer(raw, "<f8").astype(np.float64)
    else:
        folded = np.frombuffer(raw, np.uint8).reshape(4, n).T
        whole = np.ascontiguousarray(folded).view("<u4")[:, 0].astype(np.int64) if n else np.zeros(0, np.int64)
        whole = np.where(whole & 1, -(whole >> 1) - 1, whole >> 1)
        whole = np.cumsum(whole) if letter.isupper() else whole
        if not (np.abs(whole) <= LARGEST_WHOLE).all():
            raise RefusedError("malformed", "a whole number of more than 32 bits")
        values = KINDS[letter.lower()].numbers(whole)
    if not np.isfinite(values).all():
        raise RefusedError("malformed", "a number that is not finite")
    return frozen(values)


def _planes(whole: Int[np.ndarray, " n"]) -> bytes:
    """Folded, and all lowest bytes first."""
    folded = np.where(whole < 0, -2 * whole - 1, 2 * whole).astype("<u4")
    return folded.view(np.uint8).reshape(-1, 4).T.tobytes()


def _inflated(stream: bytes, size: int) -> bytes:
    """What the zlib stream holds, of which no more than `size` bytes are unpacked; RefusedError when it is not that."""
    inflater = zlib.decompressobj()
    try:
        raw = inflater.decompress(stream, size + 1)
    except zlib.error as error:
        raise RefusedError("malformed", f"a column that cannot be unpacked: {error}") from None
    if len(raw) != size or inflater.unconsumed_tail or not inflater.eof:
        raise RefusedError("malformed", f"a column that does not hold {size} bytes")
    return raw
