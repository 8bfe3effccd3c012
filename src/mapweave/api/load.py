"""A result read back from its folder: the object that the verb returned."""

import json
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast, overload

from ..core.errors import ReaderError, UsageError
from ..core.paths import path_arguments
from ..io.directory import MARKERS, plain, read_json
from ..io.saved_result import read_result
from ..report.result import ResultBase
from .result import Result

R = TypeVar("R", bound=ResultBase)
LATER = ("timing", "evaluation")  # what a metrics.json says of a run and of a score made since, not of the result


@overload
def load(folder: Path | str) -> Result: ...
@overload
def load(folder: Path | str, kind: type[R]) -> R: ...
@path_arguments
def load(folder: Path | str, kind: type[R] | None = None) -> Result | R:
    """The result that a verb wrote into `folder`, as the verb returned it: to be drawn, scored, fused or written again.

    Parameters
    ----------
    folder
        What a verb wrote.
    kind
        The type that is expected, as `TeamResult`: for type checkers, and checked (any).

    Raises
    ------
    ReaderError
        For a folder that holds no result, not all of one or one of another version, and where a file was edited.
    UsageError
        For a result of another kind.

    Examples
    --------
    >>> drive = simulate_laser("drive.mcap", CorridorConfig(distance=4.0), seed=1)
    >>> made = map("drive.mcap", "out")
    >>> load("out", LaserResult).maps[0].grid.shape == made.maps[0].grid.shape
    True
    """
    home = Path(folder)
    path = next((path for path in (home / name for name in MARKERS) if path.is_file()), None)
    if path is None:
        raise ReaderError(home, "expected a mapweave result with metrics.json, found none")
    metrics = read_json(path)
    result = read_result(home)
    if kind is not None and not isinstance(result, kind):
        raise UsageError(f"{folder}: expected a {kind.__name__}, found a {type(result).__name__}")
    made = json.loads(json.dumps(plain(result.metrics)))
    if changed := [key for key in made | metrics if key not in LATER and made.get(key) != metrics.get(key)]:
        raise ReaderError(path, f"{changed[0]}: it is not as the result wrote it, but damaged or edited")
    known: dict[str, Any] = {"metrics": metrics, "timing": metrics.get("timing", {})}
    there = {f.name for f in fields(result)} if is_dataclass(result) else set()
    return cast("Result", replace(cast("Any", result), **{name: known[name] for name in known.keys() & there}))
