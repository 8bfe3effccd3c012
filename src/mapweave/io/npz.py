"""Arrays in a zip: written so that the bytes depend on the arrays alone, read without trust in what a file promises."""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import EstimateError, ReaderError
from .table import told_path

LARGEST = 1_000_000_000  # [bytes] of all arrays of a file together
KINDS = {"any": "fiubU", "number": "fiu", "maybe": "fiu", "whole": "iu", "text": "U"}
# What a damaged archive makes the libraries say: NotImplementedError is a flipped compression method, and so on.
DAMAGE = (
    *(ValueError, KeyError, EOFError, TypeError, OverflowError, NotImplementedError, RuntimeError, SyntaxError),
    *(zipfile.BadZipFile, zlib.error, tokenize.TokenError, struct.error),
)

Spec = tuple[str, tuple[str | int, ...]]  # kind of `KINDS`, and the shape: equal words stand for equal sizes


def write_npz(path: Path, **arrays: Any) -> None:
    """As `numpy.savez_compressed`, with dates fixed and entries in the order given; packed for speed, not size.

    Raises EstimateError, naming the file and the array, for numbers that are not finite.
    """
    write_arrays(path, arrays)


def write_arrays(path: Path, arrays: Mapping[str, Any], gaps: Collection[str] = ()) -> None:
    """As `write_npz`; the arrays named in `gaps` may hold NaN where there is nothing to tell."""
    for name, values in arrays.items():
        held = np.asanyarray(values)
        if held.dtype.kind == "f" and name not in gaps and not np.isfinite(held).all():
            raise EstimateError(f"{told_path(path)}: {name} would hold numbers that are not finite")
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, values in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asanyarray(values), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, buffer.getvalue(), zipfile.ZIP_DEFLATED, 1)


def read_npz(
    path: Path, wanted: Mapping[str, Spec], optional: Mapping[str, Spec] | None = None, what: str = "saved arrays"
) -> dict[str, Any]:
    """The arrays `wanted`, and those of `optional` that are there, with the kinds and shapes asked for.

    Numbers are finite ("maybe" ones may not be). Raises ReaderError, naming file and array, for a file that is missing,
    damaged or something else; no more memory is taken than the arrays asked for need.
    """

    def specs(there: Collection[str]) -> dict[str, Spec | None]:
        if missing := [name for name in wanted if name not in there]:
            listing = ", ".join(sorted(there))[:200] or "none"
            raise ReaderError(path, f"expected {what} with {missing[0]}, found {listing}")
        return {**wanted, **{name: spec for name, spec in (optional or {}).items() if name in there}}

    return _read(path, specs, what)


def read_arrays(path: Path, what: str) -> dict[str, Any]:
    """All arrays in `path`, of whatever kind and shape they are; raises ReaderError as `read_npz` does."""
    return _read(path, dict.fromkeys, what)


def _read(path: Path, specs: Callable[[Collection[str]], Mapping[str, Spec | None]], what: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    sizes: dict[str, int] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            there = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            for name, spec in specs(there.keys()).items():
                room = LARGEST - sum(values.nbytes for values in out.values())
                try:
                    out[name] = _array(archive, there[name], spec, sizes, room)
                except _WrongError as error:
                    raise ReaderError(path, f"{name}: {error}") from None
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except DAMAGE as error:
        raise ReaderError(path, f"expected {what}: {_short(error)}") from None
    return out


class _WrongError(Exception):
    """An array that is not what was asked for."""


def _array(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo, spec: Spec | None, sizes: dict[str, int], room: int
) -> np.ndarray:
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with archive.open(entry) as stream:
        shape, columns_first, dtype = read[np.lib.format.read_magic(stream)](stream)
        _check_type(dtype, shape, spec, sizes)
        size = math.prod(shape) * dtype.itemsize
        if size > room:
            raise _WrongError(f"expected at most {LARGEST / 1e6:.0f} MB in a file, found {size / 1e6:.0f} MB")
        data = stream.read(size)
    if len(data) < size:
        raise _WrongError(f"{size} bytes promised, found {len(data)}")
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if columns_first else "C")
    if dtype.kind == "U" and not _is_text(values):
        raise _WrongError("expected text, found what is no letter")
    if spec is not None and spec[0] == "number" and not np.isfinite(values).all():
        raise _WrongError("expected finite numbers")
    return values


def _is_text(values: np.ndarray) -> bool:
    """Whether every letter of `values` is one that a file can be written with."""
    letters = np.ascontiguousarray(values).view(f"{values.dtype.byteorder}u4")
    return bool(((letters < 0xD800) | ((letters > 0xDFFF) & (letters <= 0x10FFFF))).all())


def _check_type(dtype: np.dtype[Any], shape: tuple[int, ...], spec: Spec | None, sizes: dict[str, int]) -> None:
    kind, wanted = spec or ("any", shape)
    expected = "x".join(map(str, wanted)) or "one"
    if dtype.kind not in KINDS[kind] or dtype.itemsize > (4096 if dtype.kind == "U" else 8):
        raise _WrongError(f"expected {expected} {kind}, found {dtype}")
    fits = len(shape) == len(wanted) and all(n >= 0 for n in shape)
    if not fits or any(sizes.setdefault(w, n) != n if isinstance(w, str) else w != n for w, n in _pairs(wanted, shape)):
        raise _WrongError(f"expected the shape {expected}, found {'x'.join(map(str, shape)) or 'one'}")


def _pairs(wanted: tuple[str | int, ...], shape: tuple[int, ...]) -> list[tuple[str | int, int]]:
    return list(zip(wanted, shape, strict=True))


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
