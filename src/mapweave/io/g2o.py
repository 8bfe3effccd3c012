"""Pose graphs as g2o text: `VERTEX_SE2 i x y theta`, `EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33`."""

from pathlib import Path

import numpy as np

from ..core import se2
from ..core.errors import ReaderError
from ..laser.pose_graph import PoseGraph
from .rows import open_text, write_rows
from .text import TextLog

SIZES = {"VERTEX_SE2": 5, "EDGE_SE2": 12}


def read_g2o(path: Path) -> PoseGraph:
    """The graph in `path`, plain or gzipped. Vertices are numbered anew in the order of their ids.

    A graph without vertices (or with some missing) gets poses by walking the edges from the first, those from one id
    to the next before others. Raises ReaderError naming the line for a row that does not parse, and for a graph that
    does not hang together.
    """
    log = TextLog(path)
    poses: dict[int, list[float]] = {}
    edges: list[tuple[int, int, list[float]]] = []
    for number, line in log.lines():
        words = line.split()
        if not words or words[0] not in SIZES:
            continue
        try:
            values = [float(word) for word in words[1:]]
            if len(words) != SIZES[words[0]] or not np.isfinite(values).all():
                raise ValueError  # noqa: TRY301
        except ValueError:
            want = SIZES[words[0]] - 1
            raise ReaderError(path, f"{words[0]} needs {want} finite numbers, found {line[:60]!r}", number) from None
        if words[0] == "VERTEX_SE2":
            poses[int(values[0])] = values[1:]
        else:
            edges.append((int(values[0]), int(values[1]), values[2:]))
    if log.truncated:
        raise ReaderError(path, log.truncated)
    if not edges and not poses:
        raise ReaderError(path, "expected VERTEX_SE2 and EDGE_SE2 rows, found none")
    names = sorted({*poses, *(i for i, _, _ in edges), *(j for _, j, _ in edges)})
    index = {name: k for k, name in enumerate(names)}
    first = np.array([index[i] for i, _, _ in edges], dtype=np.int64)
    second = np.array([index[j] for _, j, _ in edges], dtype=np.int64)
    known = np.array([v for _, _, v in edges]).reshape(-1, 9)
    start = np.full((len(names), 3), np.nan)
    for name, pose in poses.items():
        start[index[name]] = pose
    whole = _walked(path, start, first, second, known[:, :3])
    return PoseGraph(whole, first, second, known[:, :3], _information(known[:, 3:]))


def _information(upper: np.ndarray) -> np.ndarray:
    out = np.empty((len(upper), 3, 3))
    rows, cols = np.triu_indices(3)
    out[:, rows, cols] = upper
    out[:, cols, rows] = upper
    return out


def _walked(path: Path, pose: np.ndarray, first: np.ndarray, second: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """`pose` with its missing rows (NaN) reached along edges: from each to its next, then breadth first."""
    pose = pose.copy()
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
    for i in queue:
        for k in at.get(i, ()):
            a, b = int(first[k]), int(second[k])
            other = b if a == i else a
            if np.isnan(pose[other, 0]):
                step = measured[k] if a == i else se2.inverse(measured[k])
                pose[other] = se2.compose(pose[i], step)
                queue.append(other)
    if np.isnan(pose).any():
        raise ReaderError(path, f"{int(np.isnan(pose[:, 0]).sum())} poses have no vertex and no edge leads to them")
    return pose


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """`path` holds the graph; its first vertex is fixed."""
    vertices = np.column_stack([np.arange(len(graph)), graph.pose])
    I = graph.information
    upper = np.column_stack([I[:, 0, 0], I[:, 0, 1], I[:, 0, 2], I[:, 1, 1], I[:, 1, 2], I[:, 2, 2]])
    with open_text(path) as file:
        write_rows(file, "VERTEX_SE2 %d %.9g %.9g %.9g\n", vertices)
        if len(graph):
            file.write("FIX 0\n")
        edges = np.column_stack([graph.first, graph.second, graph.measured, upper])
        write_rows(file, "EDGE_SE2 %d %d" + " %.9g" * 9 + "\n", edges)
