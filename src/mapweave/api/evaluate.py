"""Scores against truth: which kind of truth it is decides who judges."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

from ..core.errors import ReaderError, UsageError
from ..core.threads import one_blas_thread
from .result import Result


@runtime_checkable
class Evaluation(Result, Protocol):
    """A score: a result; `as_json` has the documented keys, `lines` are for people."""

    def as_json(self) -> dict[str, Any]: ...
    def lines(self) -> list[str]: ...


@runtime_checkable
class Judge(Protocol):
    """A module that knows one kind of truth. `applies` looks at names and first lines only."""

    def applies(self, directory: Path, truth: Path) -> bool: ...
    def evaluate(self, directory: Path, truth: Sequence[Path]) -> Evaluation: ...


JUDGES: tuple[str, ...] = (
    # asked in this order; the first that applies judges
    "mapweave.api.evaluate_relations",
    "mapweave.api.evaluate_swarm",
    "mapweave.api.evaluate_team",
)


@one_blas_thread()
def evaluate(directory: Path | str, truth: Path | str | Sequence[Path | str]) -> Evaluation:
    """The score of the result in `directory` against `truth` (one or more files of one kind).

    Raises ReaderError where either is missing or damaged, UsageError where nobody knows that kind of truth.
    """
    folder = Path(directory)
    paths = [Path(truth)] if isinstance(truth, Path | str) else [Path(p) for p in truth]
    if not (folder / "metrics.json").is_file():
        raise ReaderError(folder, "expected a mapweave result with metrics.json, found none")
    if not paths:
        raise UsageError("--truth: expected a path, found none")
    for path in paths:
        if not path.exists():
            raise ReaderError(path, "no such file or folder")
    for where in JUDGES:
        judge = cast("Judge", import_module(where))
        if judge.applies(folder, paths[0]):
            return judge.evaluate(folder, paths)
    raise UsageError(f"{paths[0]}: no kind of truth that is known for {folder}")
