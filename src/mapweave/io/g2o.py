"""Pose graphs as g2o text: `VERTEX_SE2 i x y theta`, `EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33`.

TORO's are read too: `VERTEX2 i x y theta`, `EDGE2 i j dx dy dtheta I11 I12 I22 I33 I13 I23`.
A graph in memory is checked by the same rules.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard, cast

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.errors import DataError, ReaderError, UsageError
from ..core.gaussian import chi2_quantile, mahalanobis2
from ..core.paths import kind_of
from ..laser.pose_graph import PoseGraph
from ..laser.robust_graph import Prior
from .files import TextLog
from .table import Columns, Table, array_of, column_names, is_table, open_text, table_of, write_rows

VERTEX, EDGE, PRIOR, FIX = "VERTEX_SE2", "EDGE_SE2", "EDGE_PRIOR_SE2", "FIX"
NUMBERS = {VERTEX: (1, 3), EDGE: (2, 9), PRIOR: (1, 9)}  # ids, then numbers, in a row of each kind
TORO = {"VERTEX2": VERTEX, "EDGE2": EDGE}
TORO_UPPER = [0, 1, 2, 3, 4, 7, 5, 8, 6]  # its numbers of an edge in the order of ours
AGREE = chi2_quantile(1.0 - 1e-6, 3.0)  # squared sd by which two priors of one vertex may differ
UPPER = np.triu_indices(3)
LARGEST = 2**63  # an id is less
TOLD_KINDS, TOLD_LETTERS = 5, 30  # of rows passed over, in a sentence


@dataclass(frozen=True, slots=True)
class G2oFile:
    """What a g2o file holds.

    ids: the file's name of each pose of `graph`, ascending; fixed: poses that FIX rows name, as indices into `graph`;
    started: (n,), which poses the file itself gives, the others being reached along edges; priors: poses that are
    known; unread: how many rows of each kind were passed over.
    """

    graph: PoseGraph
    ids: tuple[int, ...]
    fixed: tuple[int, ...]
    started: Bool[np.ndarray, " n"]
    priors: tuple[Prior, ...]
    unread: dict[str, int]

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence where rows of unknown kinds were passed over."""
        unread = _kinds(self.unread)
        kinds = f"{VERTEX}, {EDGE}, {PRIOR} and {FIX}"
        return (f"rows of other kinds than {kinds} are passed over: {unread}",) if unread else ()


@dataclass(slots=True)
class GraphRows:
    """Rows as they are given: poses by id, and edges, each with the numbers of its row and the line it stands on."""

    poses: dict[int, list[float]]
    ends: list[tuple[int, int]]
    known: list[list[float]]
    lines: list[int]
    fixed: dict[int, int]  # id -> line
    priors: list[tuple[int, list[float], int]]  # id, numbers, line
    unread: Counter[str]


def read_g2o(path: Path) -> PoseGraph:
    """The graph in `path` alone; see `read_g2o_file`."""
    return read_g2o_file(path).graph


def read_g2o_file(path: Path, *, parts: bool = False) -> G2oFile:
    """The graph in `path`, plain or gzipped. Vertices are numbered anew in the order of their ids.

    A graph without vertices (or with some missing) gets poses by walking the edges from the first, those from one id
    to the next before others. Raises ReaderError naming the line for a row that does not parse, a vertex told twice,
    an edge from a pose to itself or whose information is not positive definite, priors that contradict each other;
    and for a graph that is not connected. With `parts` it need not, each part begins at zero, and an edge to a
    vertex that a file with vertices lacks is an error.
    """
    return file_of(path, _rows(path), parts=parts)


def file_of(path: Path | str, rows: GraphRows, *, parts: bool) -> G2oFile:
    """What a file of these rows holds, checked and with its missing poses found; `path` as errors shall call it."""
    if not rows.ends and not rows.poses:
        raise ReaderError(path, f"expected {VERTEX} and {EDGE} rows, found {_kinds(rows.unread) or 'none'}")
    names = tuple(sorted({*rows.poses, *(i for pair in rows.ends for i in pair)}))
    index = {name: k for k, name in enumerate(names)}
    for name, line in rows.fixed.items():
        if name not in index:
            raise ReaderError(path, f"{FIX} {name}: there is no such vertex", line)
    ends = np.array([(index[i], index[j]) for i, j in rows.ends], dtype=np.int64).reshape(-1, 2)
    known = np.array(rows.known, dtype=float).reshape(-1, 9)
    information = _information(known[:, 3:])
    if (wrong := _not_positive(information)) is not None:
        i, j = rows.ends[wrong]
        raise ReaderError(path, f"expected a positive definite information of {EDGE} {i} {j}", rows.lines[wrong])
    if parts and rows.poses:
        for pair, line in zip(rows.ends, rows.lines, strict=True):
            if missing := [name for name in pair if name not in rows.poses]:
                raise ReaderError(path, f"{EDGE} {pair[0]} {pair[1]}: there is no vertex {missing[0]}", line)
    start = np.full((len(names), 3), np.nan)
    for name, pose in rows.poses.items():
        start[index[name]] = pose
    whole = _walked(path, start, ends, known[:, :3], names, parts=parts)
    graph = PoseGraph(whole, ends[:, 0], ends[:, 1], known[:, :3], information)
    fixed = tuple(index[name] for name in rows.fixed)
    started = ~np.isnan(start[:, 0])
    return G2oFile(graph, names, fixed, started, _priors(path, rows, index), dict(sorted(rows.unread.items())))


def _kinds(unread: Mapping[str, int]) -> str:
    """How many rows there are of the first few kinds, long names cut, and how many kinds more."""
    counts = [f"{n} {kind[:TOLD_LETTERS]}" for kind, n in list(unread.items())[:TOLD_KINDS]]
    more = len(unread) - len(counts)
    return ", ".join([*counts, *([f"{more} kinds more"] if more else [])])


def _priors(path: Path | str, rows: GraphRows, index: dict[int, int]) -> tuple[Prior, ...]:
    out: dict[int, tuple[Prior, int]] = {}
    priors: list[Prior] = []
    for name, values, line in rows.priors:
        if name not in index:
            raise ReaderError(path, f"{PRIOR} {name}: there is no such vertex", line)
        information = _information(np.array([values[3:]]))
        if _not_positive(information) is not None:
            raise ReaderError(path, f"expected a positive definite information of {PRIOR} {name}", line)
        prior = Prior(index[name], np.array(values[:3]), information[0])
        other, at = out.setdefault(name, (prior, line))
        d = se2.between(other.pose, prior.pose)
        if mahalanobis2(d, np.linalg.inv(other.information) + np.linalg.inv(prior.information)) > AGREE:
            apart = f"{np.hypot(*d[:2]):.3g} m and {np.degrees(abs(d[2])):.3g} degrees apart"
            raise ReaderError(path, f"{PRIOR} {name} contradicts that of line {at}: they lie {apart}", line)
        priors.append(prior)
    return tuple(priors)


def _rows(path: Path) -> GraphRows:
    log = TextLog(path)
    out = GraphRows({}, [], [], [], {}, [], Counter())
    for line, text in log.lines():
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        kind = TORO.get(words[0], words[0])
        if kind == FIX:
            out.fixed |= dict.fromkeys(_ids(path, kind, words[1:], line), line)
            continue
        if kind not in NUMBERS:
            out.unread[kind[:40]] += 1
            continue
        n, m = NUMBERS[kind]
        ids = _ids(path, kind, words[1 : 1 + n], line)
        values = _finite(words[1 + n :])
        if len(ids) != n or len(values) != m:
            raise ReaderError(path, f"{words[0]} needs {n + m} finite numbers, found {text[:60]!r}", line)
        if kind == EDGE and words[0] in TORO:
            values = [values[k] for k in TORO_UPPER]
        _take(path, out, kind, ids, values, line)
    if log.truncated:
        raise ReaderError(path, log.truncated)
    return out


def _take(path: Path, out: GraphRows, kind: str, ids: list[int], values: list[float], line: int) -> None:
    if kind == VERTEX:
        if ids[0] in out.poses:
            raise ReaderError(path, f"vertex {ids[0]} is told twice", line)
        out.poses[ids[0]] = values
    elif kind == PRIOR:
        out.priors.append((ids[0], values, line))
    elif ids[0] == ids[1]:
        raise ReaderError(path, f"expected an edge between two poses, found one from {ids[0]} to itself", line)
    else:
        out.ends.append((ids[0], ids[1]))
        out.known.append(values)
        out.lines.append(line)


def _ids(path: Path, kind: str, words: Sequence[str], line: int) -> list[int]:
    try:
        ids = [int(word) for word in words]
    except ValueError:
        ids = [-1]
    if min(ids, default=0) < 0 or max(ids, default=0) >= LARGEST:
        raise ReaderError(path, f"{kind} needs whole numbers for ids, found {' '.join(words)[:60]!r}", line)
    return ids


def _finite(words: Sequence[str]) -> list[float]:
    """The words as numbers; none where one of them is not finite."""
    try:
        values = [float(word) for word in words]
    except ValueError:
        return []
    return values if np.isfinite(values).all() else []


def _not_positive(information: Float[np.ndarray, "m 3 3"]) -> int | None:
    """The first matrix that is not positive definite."""
    largest = np.abs(information).max(axis=(1, 2), initial=0.0)
    scaled = information / np.where(largest > 0, largest, 1.0)[:, None, None]
    wrong = np.flatnonzero(np.linalg.eigvalsh(scaled)[:, 0] <= 0.0)
    return int(wrong[0]) if len(wrong) else None


def _information(upper: Float[np.ndarray, "m 6"]) -> Float[np.ndarray, "m 3 3"]:
    out = np.empty((len(upper), 3, 3))
    out[:, UPPER[0], UPPER[1]] = upper
    out[:, UPPER[1], UPPER[0]] = upper
    return out


@np.errstate(over="ignore", invalid="ignore")
def _walked(
    path: Path | str,
    start: Float[np.ndarray, "n 3"],
    ends: Int[np.ndarray, "m 2"],
    measured: Float[np.ndarray, "m 3"],
    names: Sequence[int],
    *,
    parts: bool,
) -> Float[np.ndarray, "n 3"]:
    """`start` with its missing rows (NaN) reached along edges: from each to its next, then breadth first.

    A pose that cannot be reached is an error, or, with `parts`, begins at zero and is where the rest is reached from.
    """
    pose, (first, second) = start.copy(), ends.T
    if np.isnan(pose[:, 0]).all():
        pose[0] = 0.0
    for k in np.argsort(first, kind="stable").tolist():
        a, b = int(first[k]), int(second[k])
        if b == a + 1 and np.isnan(pose[b, 0]) and not np.isnan(pose[a, 0]):
            pose[b] = se2.compose(pose[a], measured[k])
    at: dict[int, list[int]] = {}
    for k, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        at.setdefault(i, []).append(k)
        at.setdefault(j, []).append(k)
    queue = np.flatnonzero(~np.isnan(pose[:, 0])).tolist()
    while True:
        _reach(pose, queue, at, first, second, measured)
        left = np.flatnonzero(np.isnan(pose[:, 0]))
        if not parts or not len(left):
            break
        pose[left[0]] = 0.0
        queue = [int(left[0])]
    lost = np.flatnonzero(~np.isfinite(pose).all(axis=1))
    if len(lost):
        listing = ", ".join(str(names[k]) for k in lost[:3].tolist()) + (", ..." if len(lost) > 3 else "")
        raise ReaderError(path, f"{len(lost)} poses have no vertex and no edge leads to them: {listing}")
    return pose


def _reach(
    pose: np.ndarray,
    queue: list[int],
    at: dict[int, list[int]],
    first: np.ndarray,
    second: np.ndarray,
    measured: np.ndarray,
) -> None:
    """Missing rows of `pose` follow along the edges `at` each pose from those in `queue`, breadth first."""
    for i in queue:
        for k in at.get(i, ()):
            a, b = int(first[k]), int(second[k])
            other = b if a == i else a
            if np.isnan(pose[other, 0]):
                pose[other] = se2.compose(pose[i], measured[k] if a == i else se2.inverse(measured[k]))
                queue.append(other)


def write_g2o(path: Path, graph: PoseGraph, ids: Sequence[int] | None = None, fixed: Sequence[int] = (0,)) -> None:
    """`path` holds vertices (called `ids`, else 0, 1, ...), then edges, then FIX rows for the poses `fixed`.

    GTSAM stops reading at a FIX row, so that no edge may come after it.
    """
    name = np.arange(len(graph)) if ids is None else np.asarray(ids, dtype=np.int64)
    vertices = np.column_stack([name, graph.pose])
    edges = np.column_stack([name[graph.first], name[graph.second], graph.measured, graph.information[:, *UPPER]])
    with open_text(path) as file:
        write_rows(file, f"{VERTEX} %d %.9g %.9g %.9g\n", vertices)
        write_rows(file, f"{EDGE} %d %d" + " %.9g" * 9 + "\n", edges)
        file.writelines(f"{FIX} {name[k]}\n" for k in fixed if k < len(graph))


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
    poses, fixed = _poses(given.get("poses"), f"{label}, poses"), _node_ids(given.get("fixed", ()), f"{label}, fixed")
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


def _node_ids(given: object, label: str) -> list[int]:
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
