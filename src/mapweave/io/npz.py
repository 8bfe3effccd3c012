"""Arrays in a zip: written so that the bytes depend on the arrays alone, read without trust in what a file promises."""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..core.errors import EstimateError, ReaderError

LARGEST = 1_000_000_000  # [bytes] of all arrays of a file together
KINDS = {"number": "fiu", "maybe": "fiu", "whole": "iu", "text": "U"}
DAMAGE = (
    *(ValueError, KeyError, EOFError, TypeError, OverflowError, NotImplementedError, RuntimeError, SyntaxError),
    *(zipfile.BadZipFile, zlib.error, tokenize.TokenError, struct.error),
)

Spec = tuple[str, tuple[str | int, ...]]  # kind of `KINDS`, and the shape: equal words stand for equal sizes


def write_npz(path: Path, *, gaps: tuple[str, ...] = (), **arrays: Any) -> None:
    """As `numpy.savez_compressed`, with dates fixed and entries in the order given; packed for speed, not size.

    Raises EstimateError, naming the file and the array, for numbers that are not finite; those in `gaps` may be.
    """
    for name, values in arrays.items():
        held = np.asanyarray(values)
        if held.dtype.kind == "f" and name not in gaps and not np.isfinite(held).all():
            raise EstimateError(f"{path.parent.name}/{path.name}: {name} would hold numbers that are not finite")
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
    try:
        with zipfile.ZipFile(path) as archive:
            there = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            if missing := [name for name in wanted if name not in there]:
                raise ReaderError(
                    path, f"expected {what} with {missing[0]}, found {', '.join(sorted(there)) or 'none'}"
                )
            specs = dict(wanted) | {name: spec for name, spec in (optional or {}).items() if name in there}
            sizes: dict[str, int] = {}
            room = LARGEST
            out = {}
            for name, spec in specs.items():
                with archive.open(there[name]) as stream:
                    out[name] = _array(path, name, stream, spec, sizes, room)
                room -= out[name].nbytes
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except DAMAGE as error:
        raise ReaderError(path, f"expected {what}: {_short(error)}") from None
    return out


def _array(path: Path, name: str, stream: IO[bytes], spec: Spec, sizes: dict[str, int], room: int) -> np.ndarray:
    kind, wanted = spec
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, columns_first, dtype = read[np.lib.format.read_magic(stream)](stream)
    told = "x".join(map(str, wanted)) or "one"
    if dtype.kind not in KINDS[kind] or dtype.itemsize > (8 if kind != "text" else 4096):
        raise ReaderError(path, f"{name}: expected {told} {kind}, found {dtype}")
    fits = len(shape) == len(wanted) and all(n >= 0 for n in shape)
    if not fits or any(sizes.setdefault(w, n) != n if isinstance(w, str) else w != n for w, n in _pairs(wanted, shape)):
        raise ReaderError(path, f"{name}: expected the shape {told}, found {'x'.join(map(str, shape)) or 'one'}")
    size = math.prod(shape) * dtype.itemsize
    if size > room:
        raise ReaderError(path, f"{name}: expected at most {LARGEST / 1e6:.0f} MB in a file, found {size / 1e6:.0f} MB")
    data = stream.read(size)
    if len(data) < size:
        raise ReaderError(path, f"{name}: {size} bytes promised, found {len(data)}")
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if columns_first else "C")
    if kind == "number" and not np.isfinite(values).all():
        raise ReaderError(path, f"{name}: expected finite numbers")
    return values


def _pairs(wanted: tuple[str | int, ...], shape: tuple[int, ...]) -> list[tuple[str | int, int]]:
    return list(zip(wanted, shape, strict=True))


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
