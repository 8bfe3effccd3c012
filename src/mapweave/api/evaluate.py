"""Scores against truth: which kind of truth it is decides who judges."""

from collections.abc import Sequence
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

from ..core.errors import DataError, ReaderError, UsageError
from ..core.paths import path_arguments
from ..core.workers import one_blas_thread
from ..report.result import ResultBase
from .evaluate_tracks import evaluate as evaluate_track
from .evaluate_tracks import is_track
from .in_memory import Truths, result_folder, truth_files
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


@path_arguments
@one_blas_thread()
def evaluate(directory: Path | str | ResultBase, truth: Truths) -> Evaluation:
    """Score a result against what is true, by the rules that every table here is made with.

    Parameters
    ----------
    directory
        What `map`, `fuse`, `locate` or `localize` wrote, or gave; or a trajectory alone, as a TUM file.
    truth
        One or more files of one kind: an MRCLAM data set, a survey `id,x,y` (.csv), TUM trajectories (of robot K where
        the name holds `robotK`, else in the order given), relations, or the true positions of a swarm. Or tables in
        memory: a survey or a swarm with the columns id, x, y; trajectories with t, x, y, theta, and robot, or a table
        each in the order of the robots (or `Track`s); relations with t1, t2, x, y, theta. Metres, radians, seconds.

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
    >>> evaluate("out/trajectories/robot1.tum", "out/trajectories/robot1.tum").metrics["ape"]["rmse"]  # as evo_ape
    0.0
    >>> x, y = zip(*team.landmarks.values())
    >>> survey = {"id": list(team.landmarks), "x": x, "y": y}
    >>> evaluate(result, survey).metrics["landmark_n"]
    7
    """
    alone = is_track(directory)
    folders = nullcontext(Path(str(directory))) if alone else result_folder(directory, "directory")
    with folders as folder, truth_files(truth) as paths:
        if not paths:
            raise UsageError("truth: expected paths or tables in memory, found none")
        evaluation: Evaluation = evaluate_track(folder, paths) if alone else judged(folder, paths)
        if evaluation.unscored:
            raise DataError(f"{', '.join(map(str, paths))}: nothing to score: {evaluation.unscored}; {RULE}")
        return evaluation


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
