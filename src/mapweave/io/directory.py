"""Results appear whole or not at all: written beside, then renamed."""

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import ReaderError, UsageError

MARKERS = ("metrics.json", "simulation.json")  # what tells an earlier result from anything else


def check_target(out: Path, *, force: bool = False) -> None:
    """Raises UsageError unless `out` may be (re)placed: absent, empty, an earlier mapweave result, or `force`."""
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out}: exists and is not a directory")
    if force or not out.exists() or not any(out.iterdir()):
        return
    if not _is_result(out):
        raise UsageError(f"{out}: not empty and not a mapweave result; give another --out or --force")


@contextmanager
def result_directory(out: Path, *, force: bool = False) -> Iterator[Path]:
    """A fresh directory to write into; it takes the place of `out` when the block ends without an exception."""
    check_target(out, force=force)
    parent = out.resolve().parent
    parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=parent))
    try:
        work.chmod(0o755)
        yield work
        old = None
        if out.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{out.name}.old.", dir=parent))
            out.replace(old)
        work.replace(out.resolve())
        if old is not None:
            shutil.rmtree(old, ignore_errors=True)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


@contextmanager
def result_file(out: Path) -> Iterator[Path]:
    """A path to write to; it takes the place of the file `out` when the block ends without an exception."""
    out.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{out.name}.", dir=out.parent)
    os.close(handle)
    work = Path(name)
    try:
        yield work
        work.chmod(0o644)
        work.replace(out)
    except BaseException:
        work.unlink(missing_ok=True)
        raise


def write_json(path: Path, value: Any) -> None:
    """`value` as indented JSON with keys in the order given; arrays become lists, NaN and infinity null."""
    path.write_text(json.dumps(plain(value), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in `path`; raises ReaderError when it cannot be read or is none."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"), parse_float=_finite, parse_constant=_finite)
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ReaderError(path, f"expected JSON: {error}") from None
    except RecursionError:
        raise ReaderError(path, "expected JSON, found brackets nested too deep") from None
    if not isinstance(value, dict):
        raise ReaderError(path, f"expected a JSON object, found {type(value).__name__}")
    return value


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(f"{word} is not finite")
    return value


def plain(value: Any) -> Any:
    """`value` in JSON's own types."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def _is_result(out: Path) -> bool:
    return any(_has_version(out / name) for name in MARKERS)


def _has_version(path: Path) -> bool:
    try:
        return "version" in read_json(path)
    except ReaderError:
        return False
