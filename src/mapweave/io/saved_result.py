"""Any result as one file, and back: every object, number and word in it, to the last digit.

`result.npz` holds a tree as JSON and, one array a type, the numbers that its leaves point into. An object in the tree
is a dataclass or named tuple of this package, told by its name with its fields: nothing else is ever made of what a
file says. What a run took is left out, so that equal runs write equal bytes. A setting that
became a constant since is passed over.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csc_matrix

from ..core.config import fixed_keys
from ..core.errors import ReaderError
from ..core.version import __version__
from .npz import read_arrays, write_arrays
from .team_map import read_metrics

NAME = "result.npz"
FORMAT = 1  # of the tree; a class whose fields changed is noticed by itself
TIMING = "timing"  # the name of fields and keys that tell what a run took
FREE = (
    "report.html",
    "metrics.json",
    "simulation.json",
    "decisions.toml",
    NAME,
)  # files that change with a score, or are there to edit
SPARSE = {"csc_matrix": csc_matrix, "csc_array": csc_array}
AGAIN = "make the result again"
Made = tuple[Any, list[str]] | ReaderError  # what an object of a file is made of


def write_result(folder: Path, result: object) -> None:
    """`folder`, which holds all other files of the result, holds the result itself."""
    tree = _Tree()
    top = tree.node(result)
    held = {"format": FORMAT, "version": __version__, "classes": tree.classes, "files": _hashes(folder), "result": top}
    text = np.frombuffer(json.dumps(held).encode(), np.uint8)
    numbers = {name: np.concatenate(parts) for name, parts in tree.parts.items()}
    write_arrays(folder / NAME, {"tree": text, **numbers}, gaps=numbers.keys())


def read_result(folder: Path) -> Any:
    """The result that `folder` holds, as it was written.

    Raises ReaderError for a file that is missing, damaged or of another version of mapweave, and for a folder that
    lacks a file of the result or holds one that was changed.
    """
    path = folder / NAME
    arrays, held = _read(path)
    try:
        version = held["version"]
        if held["format"] != FORMAT:
            raise ReaderError(path, f"expected format {FORMAT}, found {held['format']}, of mapweave {version}: {AGAIN}")
        classes = [_class(name, names, path, version) for name, names in held["classes"]]
        files = dict(held["files"])
        result = _made(held["result"], classes, arrays)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise ReaderError(path, f"expected a result, found it damaged: {error!r:.120}") from None
    _expect_files(folder, files)
    return result


def expect_whole(folder: Path) -> None:
    """Raises ReaderError where files of a result are missing or changed, whatever version wrote it.

    A folder with neither page nor `result.npz`, as other programs write, tells nothing of that and is taken as it is.
    """
    path = folder / NAME
    if not (path.is_file() or (folder / "report.html").is_file()):
        return
    read_metrics(folder)
    _, held = _read(path)
    try:
        files = dict(held["files"])
    except (KeyError, TypeError, ValueError) as error:
        raise ReaderError(path, f"expected a result, found it damaged: {error!r:.120}") from None
    _expect_files(folder, files)


def _read(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    """The numbers of a result, and the tree that points into them."""
    if not path.is_file():
        raise ReaderError(path, f"no such file: the result is not whole, or of an earlier version: {AGAIN}")
    arrays = read_arrays(path, "a result")
    try:
        return arrays, json.loads(arrays.pop("tree").tobytes())
    except (KeyError, ValueError) as error:
        raise ReaderError(path, f"expected a result, found it damaged: {error!r:.120}") from None


def _expect_files(folder: Path, files: Mapping[str, str]) -> None:
    """Raises ReaderError where a file of the result is missing, or another than its digest in `files`."""
    there = _hashes(folder)
    if missing := [name for name in files if name not in there]:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ReaderError(folder / missing[0], f"no such file{more}: the result is not whole, copy all of it")
    if changed := [name for name, digest in files.items() if there[name] != digest]:
        raise ReaderError(folder / changed[0], f"it is not as the result wrote it, but damaged or edited: {AGAIN}")


def _hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of the result but pictures and those that may change."""
    paths = sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix != ".png")
    names = {p.relative_to(folder).as_posix(): p for p in paths}
    return {name: hashlib.sha256(p.read_bytes()).hexdigest() for name, p in names.items() if name not in FREE}


class _Tree:
    """What is written. classes: [module:name, fields] of each; parts: the numbers of each type, in the order met."""

    def __init__(self) -> None:
        self.classes: list[tuple[str, list[str]]] = []
        self.parts: dict[str, list[np.ndarray]] = {}
        self._number: dict[type, int] = {}
        self._ends: dict[str, int] = {}
        self._there: dict[tuple[str, bytes], int] = {}

    def node(self, value: Any) -> Any:  # noqa: PLR0911  (a line a kind of value)
        """`value` as JSON: itself, a list for a tuple, else an object whose only key says what it is."""
        if value is None or isinstance(value, bool | int | str):
            return value if type(value) in {bool, int, str, type(None)} else self._enum(value)
        if isinstance(value, np.ndarray | np.generic):
            return {"array" if isinstance(value, np.ndarray) else "scalar": self._array(np.asarray(value))}
        if isinstance(value, float):
            return value if math.isfinite(value) else {"float": repr(value)}
        if _is_object(type(value)):
            values = [{} if name == TIMING else getattr(value, name) for name in _names(type(value))]
            return {"is": [self._class(type(value)), *map(self.node, values)]}
        if isinstance(value, tuple):
            return [self.node(one) for one in value]
        if isinstance(value, Mapping):
            return {"dict": [[self.node(k), self.node(v)] for k, v in value.items() if k != TIMING]}
        if isinstance(value, list | set | frozenset):
            one = sorted(value) if isinstance(value, set | frozenset) else value
            return {type(value).__name__: [self.node(inner) for inner in one]}
        if isinstance(value, Path):
            return {"path": str(value)}
        if isinstance(value, csc_matrix | csc_array):
            parts = (value.data, value.indices, value.indptr, value.shape)
            return {type(value).__name__: [self.node(part) for part in parts]}
        return self._enum(value)

    def _enum(self, value: Any) -> Any:
        if isinstance(value, Enum):
            return {"enum": [self._class(type(value)), value.name]}
        raise TypeError(f"a result cannot hold {type(value)}")

    def _class(self, kind: type) -> int:
        if kind not in self._number:
            self._number[kind] = len(self.classes)
            self.classes.append((f"{kind.__module__}:{kind.__qualname__}", _names(kind)))
        return self._number[kind]

    def _array(self, value: np.ndarray) -> tuple[str, int, list[int]]:
        """Type, first number and shape; equal arrays are held once, whoever shares them."""
        flat = np.ascontiguousarray(value).ravel()
        name = flat.dtype.str.lstrip("<>|=")
        key = (name, hashlib.sha256(flat.tobytes()).digest())
        if key not in self._there:
            self._there[key] = self._ends.get(name, 0)
            self._ends[name] = self._there[key] + flat.size
            self.parts.setdefault(name, []).append(flat)
        return name, self._there[key], list(value.shape)


def _is_object(kind: type) -> bool:
    ours = kind.__module__.partition(".")[0] == __name__.partition(".")[0]
    return ours and (is_dataclass(kind) or (issubclass(kind, tuple) and hasattr(kind, "_fields")))


def _names(kind: type) -> list[str]:
    """The fields of a class; none of an enumeration."""
    return [f.name for f in fields(kind)] if is_dataclass(kind) else list(getattr(kind, "_fields", ()))


def _class(name: str, names: list[str], path: Path, version: str) -> Made:
    """The class with the fields that a file gives it; of a class that is no more the error for who would make one."""
    module, _, inner = name.partition(":")
    other = ReaderError(path, f"mapweave {version} wrote it, whose {inner} is not this one's: {AGAIN}")
    if module.partition(".")[0] != __name__.partition(".")[0]:
        raise other
    try:
        kind = import_module(module)
        for part in inner.split("."):
            kind = getattr(kind, part)
    except (ImportError, AttributeError):
        return other
    known = isinstance(kind, type) and (_is_object(kind) or issubclass(kind, Enum))
    if not isinstance(kind, type) or not known or [n for n in names if n not in fixed_keys(kind)] != _names(kind):
        raise other
    return kind, names


def _made(node: Any, classes: list[Made], arrays: Mapping[str, np.ndarray]) -> Any:  # noqa: PLR0911
    if isinstance(node, list):
        return tuple(_each(node, classes, arrays))
    if not isinstance(node, dict):
        return node
    ((what, held),) = node.items()
    if what in {"array", "scalar"}:
        name, first, shape = held
        flat = arrays[name][first : first + math.prod(shape)]
        return flat.reshape(shape) if what == "array" else flat[0]
    if what == "float":
        return float(held)
    if what == "is":
        kind, names = _known(classes[held[0]])
        values = dict(zip(names, held[1:], strict=True))
        return kind(**{name: _made(values[name], classes, arrays) for name in _names(kind)})
    if what == "enum":
        return _known(classes[held[0]])[0][held[1]]
    if what == "path":
        return Path(held)
    if what in SPARSE:
        data, indices, indptr, shape = _each(held, classes, arrays)
        return SPARSE[what]((data, indices, indptr), shape=shape)
    made = {"dict": dict, "list": list, "set": set, "frozenset": frozenset}[what]
    return made(_each(held, classes, arrays))


def _known(made: Made) -> tuple[Any, list[str]]:
    if isinstance(made, ReaderError):
        raise made
    return made


def _each(nodes: list[Any], classes: list[Made], arrays: Mapping[str, np.ndarray]) -> Iterator[Any]:
    return (_made(one, classes, arrays) for one in nodes)
