"""How much two robots are expected to have seen in common, where both are told to start in one frame."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from ..core import se2
from ..mapping.merge_search import Start
from .driven import DrivenSession

FINE = 0.5  # [m] cells of one robot's walls, so that each is kept once
COARSE = 1.0  # [m] cells of all robots' walls: what a start told and a map's bend are off
ROWS = 1 << 20  # more than there are cells along any axis

Pair = tuple[str, str]


@dataclass(slots=True)
class WallCells:
    """Where one robot saw walls, in its own frame, with keyframes as they stood when they came.

    cells: of `FINE`, as whole numbers that tell both axes; until: keyframes up to this scan are among them.
    """

    cells: Int[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0, np.int64))
    until: int = -1

    def take(self, session: DrivenSession) -> None:
        """The keyframes that came since."""
        graph, ids = session.keyframes, session.ids
        if graph is None or ids[-1] <= self.until:
            return
        fresh = np.flatnonzero(ids > self.until).tolist()
        points = [np.asarray(se2.act(graph.pose[k], graph.nodes[k].beams.s)) for k in fresh]
        self.cells = np.union1d(self.cells, _coded(np.concatenate(points), FINE))
        self.until = int(ids[-1])

    @property
    def centres(self) -> Float[np.ndarray, "n 2"]:
        """Of the cells [m]."""
        return FINE * (np.column_stack(np.divmod(self.cells + ROWS // 2, ROWS)) - [0.0, ROWS // 2] + 0.5)


def in_common(walls: Mapping[str, WallCells], starts: Mapping[int, Start]) -> dict[Pair, int]:
    """Cells of `COARSE` in which both of a pair saw walls, by their names in the order of `walls`.

    starts: by place among them, where robots' frames are said to lie in that of the first. Pairs of which the start of
    either is not told are left out.
    """
    names = list(walls)
    placed = [k for k in range(len(names)) if k in starts or k == 0] if starts else []
    seen = []
    for k in placed:
        frame = starts[k].transform if k in starts else np.zeros(3)
        seen.append(np.unique(_coded(np.asarray(se2.act(frame, walls[names[k]].centres)), COARSE)))
    every, column = np.unique(np.concatenate([np.zeros(0, np.int64), *seen]), return_inverse=True)
    first = np.concatenate([[0], np.cumsum([len(s) for s in seen])]).astype(np.int64)
    holds = csr_array((np.ones(len(column), np.int64), column, first), shape=(len(placed), len(every)))
    both = (holds @ holds.T).toarray()
    return {(names[placed[i]], names[placed[j]]): int(both[i, j]) for i, j in _pairs(len(placed))}


def _coded(points: Float[np.ndarray, "n 2"], side: float) -> Int[np.ndarray, " cells"]:
    """The cells in which the points lie, each once."""
    near = points[(np.abs(points) < side * ROWS // 2).all(axis=1)]  # what is no number, or farther out, is in no cell
    column, row = np.floor(near / side).astype(np.int64).T
    return np.unique(ROWS * column + row)


def _pairs(n: int) -> Iterator[tuple[int, int]]:
    return ((i, j) for j in range(n) for i in range(j))
