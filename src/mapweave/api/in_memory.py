"""What is handed to a verb in memory, laid down as the files that the one way to its answer reads.

A result becomes the folder that it would write, without pages and pictures; a table of what is true becomes a file of
its kind, every number to the last digit. An error tells the argument in place of the file laid down.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from ..core.errors import MapweaveError, ReaderError, UsageError
from ..core.names import in_order, robot_key, robot_name
from ..core.paths import is_path, kind_of, path_of
from ..core.records import Track
from ..io.landmark_truth import write_relations
from ..io.table import Columns, Framed, is_table, table_of, write_table
from ..io.tum import write_exact_tum
from ..report.result import ResultBase

Truth = Path | str | Columns | Track
Truths = Truth | Sequence[Path | str | Framed | Track]  # a mapping is Framed, too
POSE, PLACE, RELATION = ("t", "x", "y", "theta"), ("id", "x", "y"), ("t1", "t2", "x", "y", "theta")
BESIDE = ("z", "t", "heading")  # of places, where the robots are in space or move
EXPECTED_TRUTH = "paths or tables in memory"


def each_of(given: object) -> list[object]:
    """What was given, one or several, as a list; a table, a track and text are one."""
    one = is_path(given) or is_table(given) or not isinstance(given, Iterable)
    return [given] if one or isinstance(given, Track | ResultBase) else list(given)  # type: ignore[call-overload]


@contextmanager
def result_folder(given: object, name: str) -> Iterator[Path]:
    """The folder of the result that was given, as a path or in memory; raises UsageError for what is neither."""
    with _laid_down() as (home, called):
        yield _folder(given, name, home / "result", called)


@contextmanager
def result_folders(given: object, name: str) -> Iterator[list[Path]]:
    """As `result_folder`, of one result or several; the k-th of them in memory is a folder called `resultk`."""
    with _laid_down() as (home, called):
        yield [_folder(one, name, home / "in memory" / f"result{k}", called) for k, one in enumerate(each_of(given), 1)]


@contextmanager
def truth_files(given: object, name: str = "truth") -> Iterator[tuple[Path, ...]]:
    """The files of what is true, given as paths, as tables in memory or as tracks, one or several; none of None.

    Raises UsageError for anything else, ReaderError for a table that lacks columns or numbers.
    """
    with _laid_down() as (home, called):
        out: list[Path] = []
        for k, one in enumerate([] if given is None else each_of(given)):
            if is_table(one) or isinstance(one, Track):
                laid = _truth(one, name, home / str(k))
                called.update(dict.fromkeys(laid, name))
                out += laid
            else:
                out.append(path_of(one, name, EXPECTED_TRUTH))
        yield tuple(out)


@contextmanager
def _laid_down() -> Iterator[tuple[Path, dict[Path, str]]]:
    """A folder that is gone afterwards, and what errors call the paths in it."""
    called: dict[Path, str] = {}
    with TemporaryDirectory(prefix="mapweave-") as folder:
        try:
            yield Path(folder), called
        except MapweaveError as error:
            for path, name in called.items():
                error.args = tuple(str(text).replace(str(path), name) for text in error.args)
                if isinstance(error, ReaderError):
                    error.file = error.file.replace(str(path), name)
            raise


def _folder(given: object, name: str, at: Path, called: dict[Path, str]) -> Path:
    if is_path(given):
        return path_of(given, name)
    if not isinstance(given, ResultBase):
        hint = ", whose result() is one" if callable(getattr(given, "result", None)) else ""
        raise UsageError(f"{name}: expected a folder or a result in memory, found {kind_of(given)}{hint}")
    called[at] = f"{name} ({kind_of(given)})"
    at.mkdir(parents=True)
    given.write_data(at)
    return at


def _truth(given: object, name: str, folder: Path) -> list[Path]:
    """What is true, as files of its kind in `folder`: places `id,x,y`, poses `t,x,y,theta`, or relations."""
    folder.mkdir()
    if isinstance(given, Track):
        return [_poses(folder / "track.tum", given.t, given.pose)]
    table = table_of(cast("Columns", given), name)
    has = table.columns.keys()
    if has >= set(PLACE):
        wanted = [*PLACE, *(column for column in BESIDE if column in has)]
        numbers = [
            (table.numbers(column) if column == "heading" else table.finite(column)).tolist() for column in wanted[1:]
        ]
        write_table(folder / "places.csv", wanted, zip(table.names("id"), *numbers, strict=True), repr)
        return [folder / "places.csv"]
    if has >= set(RELATION):
        t1, t2, *motion = (table.finite(column) for column in RELATION)
        write_relations(folder / "truth.relations", t1, t2, np.column_stack(motion))
        return [folder / "truth.relations"]
    if has >= set(POSE):
        t, *pose = (table.finite(column) for column in POSE)
        rows = np.column_stack(pose)
        if "robot" not in has:
            return [_poses(folder / "track.tum", t, rows)]
        whose = np.array([robot_key(robot) for robot in table.names("robot")])
        if odd := [robot for robot in whose.tolist() if not robot.isdecimal()]:
            raise ReaderError(name, f"expected a robot's number, as 2 or robot2, found {odd[0]!r}")
        robots = sorted(set(whose.tolist()), key=in_order)
        return [_poses(folder / f"{robot_name(r)}.tum", t[whose == r], rows[whose == r]) for r in robots]
    kinds = f"{','.join(PLACE)} or {','.join(POSE)}[,robot] or {','.join(RELATION)}"
    raise ReaderError(name, f"expected the columns {kinds}, found {','.join(has) or 'none'}")


def _poses(path: Path, t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"]) -> Path:
    """The poses as a file at `path`, which is returned."""
    write_exact_tum(path, t, pose)
    return path


def decisions_of_argument(given: object) -> Path | Mapping[str, Any] | None:
    """The file of decisions, or what it holds; raises UsageError for anything else, ReaderError for wrong tables."""
    if given is None:
        return None
    from ..io.decisions import decisions_of, read_decisions  # noqa: PLC0415  (only who gives some waits for it)

    if isinstance(given, Mapping):
        decisions_of(given)
        return given
    if not is_path(given):
        raise UsageError(f"decisions: expected a path or the tables of a file, found {kind_of(given)}")
    path = path_of(given, "decisions", "a path")
    read_decisions(path)
    return path
