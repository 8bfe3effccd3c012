"""Scores against truth: which kind of truth it is decides who judges."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

from ..core.errors import DataError, ReaderError, UsageError
from ..core.workers import one_blas_thread
from .map_options import path_of, paths_of
from .result import Result


@runtime_checkable
class Evaluation(Result, Protocol):
    """The score of a result against truth: `as_json` has the documented keys, `lines` are for people."""

    @property
    def unscored(self) -> str: ...
    def add_to(self, folder: Path, truth: Sequence[Path]) -> None: ...
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


RULE = (
    "truth is an MRCLAM data set, a survey id,x,y (.csv), trajectories t x y z qx qy qz qw (.tum, of robot K where the "
    "name holds robotK, else in the order given), relations between poses (.relations), or id,x,y of a swarm's robots"
)


@one_blas_thread()
def evaluate(directory: Path | str, truth: Path | str | Sequence[Path | str]) -> Evaluation:
    """Score the result in `directory` against what is true, by the rules that every table here is made with.

    Parameters
    ----------
    directory
        What `map`, `fuse`, `locate` or `localize` wrote.
    truth
        One or more files of one kind: an MRCLAM data set, a survey `id,x,y` (.csv), TUM trajectories (of robot K where
        the name holds `robotK`, else in the order given), relations, or the true positions of a swarm. Lengths in
        metres, angles in radians.

    Raises
    ------
    ReaderError
        Where either is missing or damaged.
    DataError
        Where nothing of the result could be scored, with the reason.
    UsageError
        Where nobody knows that kind of truth.

    Examples
    --------
    >>> team = simulate_landmarks("team", robots=2, landmarks=8, minutes=0.5, seed=1)
    >>> result = map("team", "out")
    >>> evaluate("out", "team").metrics["landmark_n"]
    7
    """
    paths = paths_of(truth, "truth")
    found = judged(path_of(directory, "directory"), paths)
    if found.unscored:
        raise DataError(f"{', '.join(map(str, paths))}: nothing to score: {found.unscored}; {RULE}")
    return found


def judged(folder: Path, truth: Sequence[Path]) -> Evaluation:
    """The score as its judge gives it, also where nothing could be scored."""
    if not (folder / "metrics.json").is_file():
        raise ReaderError(folder, "expected a mapweave result with metrics.json, found none")
    if not truth:
        raise UsageError("--truth: expected a path, found none")
    for path in truth:
        if not path.exists():
            raise ReaderError(path, "no such file or folder")
    for where in JUDGES:
        judge = cast("Judge", import_module(where))
        if judge.applies(folder, truth[0]):
            return judge.evaluate(folder, truth)
    raise UsageError(f"{truth[0]}: no kind of truth that is known for {folder}; {RULE}")
