"""A pose graph in memory becomes what a g2o file of it holds, checked by the same rules."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard, cast

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError, ReaderError, UsageError
from ..core.paths import kind_of
from ..laser.pose_graph import PoseGraph
from .g2o import UPPER, G2oFile, GraphRows, file_of
from .table import Columns, Table, array_of, column_names, is_table, table_of

ENTRIES = ("edges", "poses", "fixed")
POSE = ("x", "y", "theta")
SKEW = 1e-9  # relative, by which the two halves of an information may differ: they were computed in two ways


def is_graph(given: object) -> TypeGuard[PoseGraph | Mapping[str, Any]]:
    """Whether `given` is meant as a pose graph."""
    return isinstance(given, PoseGraph | Mapping)


def graph_of(given: PoseGraph | Mapping[str, Any], label: str) -> G2oFile:
    """What a g2o file of this graph holds, every number to the last digit; errors call it `label`.

    As a mapping: `edges`, a table of from, to, x, y, theta and information (m, 3, 3); `poses` (optional), a table of
    id, x, y, theta or (n, 3) numbered from 0; `fixed` (optional), ids of poses that are held. Raises UsageError where
    entries are missing or unknown, DataError for arrays that do not fit, ReaderError naming the row for an edge that
    cannot be.
    """
    if isinstance(given, PoseGraph):
        if not (np.isfinite(given.pose).all() and np.isfinite(given.measured).all()):
            raise DataError(f"{label}: expected finite poses and edges")
        poses, ends = dict(enumerate(given.pose.tolist())), (given.first.tolist(), given.second.tolist())
        return _held(label, poses, *ends, given.measured, given.information, ())
    odd = [name for name in given if name not in ENTRIES]
    if "edges" not in given or odd:
        told = ", ".join(map(str, given)) or "nothing"
        raise UsageError(f"{label}: expected a pose graph of edges, and poses and fixed where known, found {told}")
    edges, where = given["edges"], f"{label}, edges"
    names = [name for name in column_names(edges, where) if name != "information"]
    table = table_of({name: edges[name] for name in names}, where)
    if missing := [name for name in ("from", "to", *POSE) if name not in table.columns]:
        raise DataError(f"{where}: expected a column {missing[0]}, found {', '.join(map(str, names)) or 'none'}")
    measured = np.column_stack([table.finite(name) for name in POSE])
    information = array_of(edges, "information", where, 3)
    poses, fixed = _poses(given.get("poses"), f"{label}, poses"), _ids(given.get("fixed", ()), f"{label}, fixed")
    return _held(label, poses, _whole(table, "from"), _whole(table, "to"), measured, information, fixed)


def _held(
    label: str,
    poses: Mapping[int, list[float]],
    first: Sequence[int],
    second: Sequence[int],
    measured: Float[np.ndarray, "m 3"],
    information: Float[np.ndarray, "..."],
    fixed: Sequence[int],
) -> G2oFile:
    where = f"{label}, edges"
    if information.shape != (len(first), 3, 3) or not np.isfinite(information).all():
        raise DataError(f"{where}: expected finite information of {len(first)} by 3 by 3, found {information.shape}")
    size = np.abs(information).max(initial=0.0)
    if np.abs(information - information.swapaxes(1, 2)).max(initial=0.0) > SKEW * size:
        raise DataError(f"{where}: expected symmetric matrices of information")
    if same := [k for k, (i, j) in enumerate(zip(first, second, strict=True), 1) if i == j]:
        told = f"expected an edge between two poses, found one from {first[same[0] - 1]} to itself"
        raise ReaderError(where, told, same[0])
    known = np.column_stack([measured, information[:, *UPPER]]).tolist()
    ends, lines = list(zip(first, second, strict=True)), list(range(1, len(first) + 1))
    rows = GraphRows(dict(poses), ends, known, lines, dict.fromkeys(fixed, 0), [], Counter())
    return file_of(where, rows, parts=True)


def _poses(given: object, label: str) -> dict[int, list[float]]:
    """Id -> x, y, theta, as far as they are given."""
    if given is None:
        return {}
    if is_table(given):
        table = table_of(cast("Columns", given), label)
        if missing := [name for name in ("id", *POSE) if name not in table.columns]:
            raise DataError(f"{label}: expected a column {missing[0]}, found {', '.join(table.columns) or 'none'}")
        ids, rows = _whole(table, "id"), np.column_stack([table.finite(name) for name in POSE])
        if len(set(ids)) < len(ids):
            raise DataError(f"{label}: id {Counter(ids).most_common(1)[0][0]} is told twice")
        return dict(zip(ids, rows.tolist(), strict=True))
    try:
        rows = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.zeros(())
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        expected = "id, x, y, theta by name or finite rows of x, y, theta"
        raise UsageError(f"{label}: expected {expected}, found {_told(given)}")
    return {k: row.tolist() for k, row in enumerate(rows)}


def _ids(given: object, label: str) -> list[int]:
    ids = np.asarray(given if given is not None else [], dtype=object).ravel().tolist()
    if not all(isinstance(name, int | np.integer) for name in ids):
        raise UsageError(f"{label}: expected ids of poses, found {_told(given)}")
    return [int(name) for name in ids]


def _whole(table: Table, name: str) -> list[int]:
    """A column of ids; raises ReaderError naming the first row that is none."""
    ids = table.whole(name)
    for name_of_pose, row in zip(ids, table.lines, strict=True):
        if name_of_pose < 0:
            raise ReaderError(table.path, f"expected an id from 0 on for {name}, found {name_of_pose}", row)
    return ids


def _told(given: object) -> str:
    return f"the shape {given.shape}" if isinstance(given, np.ndarray) else kind_of(given)
