"""The last word on what is one place and what is one map: rows that people edit and give back."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..laser.laser_map import GridMap
from ..laser.robot_graph import RobotGraph

TOGETHER, APART, UNDECIDED = "together", "apart", "undecided"
WORDS = (TOGETHER, APART, UNDECIDED)
CELLS = ("free", "unknown")
SEEN_FREE = 3  # beams that are counted through a wall that is said to be gone: free beyond doubt
MOMENT = 0.05  # [s] from a stamp that is told to that of a keyframe

Key = tuple[str, float, str, float]


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """Whether keyframe at `stamp_b` [s] of robot_b sees the place of keyframe at `stamp_a` of robot_a.

    pose: (3,) of the second in the first's frame, None where nobody tells; decision: what is to be; found: what scans
    decide, empty where they were not asked.
    """

    robot_a: str
    stamp_a: float
    robot_b: str
    stamp_b: float
    decision: str
    found: str = ""
    pose: tuple[float, float, float] | None = None

    @property
    def key(self) -> Key:
        return (self.robot_a, self.stamp_a, self.robot_b, self.stamp_b)

    @property
    def edited(self) -> bool:
        """Whether somebody says otherwise than the scans."""
        return self.decision not in {UNDECIDED, self.found}


@dataclass(frozen=True, slots=True)
class PairRow:
    """Whether the maps of robots a and b are one. pose: (3,) of b's first pose in a's frame, where that is told."""

    a: str
    b: str
    decision: str
    found: str = ""
    pose: tuple[float, float, float] | None = None

    @property
    def edited(self) -> bool:
        """Whether somebody says otherwise than the scans."""
        return self.decision not in {UNDECIDED, self.found}


@dataclass(frozen=True, slots=True)
class MaskRow:
    """What a map shows within a rectangle, whatever scans say. box: x0, y0, x1, y1 [m] in the robot's own map, whose
    origin is its first pose; cells: "free", its walls are gone, or "unknown", nobody looked there.
    """

    robot: str
    box: tuple[float, float, float, float]
    cells: str

    def on(self, grid: GridMap, T_map_robot: Float[np.ndarray, "3"]) -> GridMap:
        """The grid with it, in whose frame the robot's own map lies at `T_map_robot`."""
        rows, cols = np.indices(grid.shape)
        centres = grid.origin + grid.resolution * (np.stack([cols, rows], axis=-1).reshape(-1, 2) + 0.5)
        x, y = se2.act(se2.inverse(T_map_robot), centres).T.reshape(2, *grid.shape)
        x0, y0, x1, y1 = self.box
        there = (x >= min(x0, x1)) & (x <= max(x0, x1)) & (y >= min(y0, y1)) & (y <= max(y0, y1))
        walls = there & (grid.hits > 0)
        passes = np.where(there, 0, grid.passes) if self.cells == "unknown" else grid.passes + SEEN_FREE * walls
        hits, feature, weight = (np.where(there, 0, held) for held in (grid.hits, grid.feature, grid.weight))
        mean = np.where(there[..., None], 0, grid.mean)
        return replace(grid, hits=hits, passes=passes, mean=mean, feature=feature, weight=weight)


@dataclass(frozen=True, slots=True)
class Decisions:
    """All rows of a file. logs: robot -> digest of the scans that the rows are of."""

    logs: Mapping[str, str]
    pairs: tuple[PairRow, ...] = ()
    places: tuple[PlaceRow, ...] = ()
    masks: tuple[MaskRow, ...] = ()

    @property
    def edited(self) -> bool:
        """Whether somebody says anything."""
        return bool(self.masks) or any(row.edited for row in self.pairs) or any(row.edited for row in self.places)

    def renamed(self, names: Mapping[str, str]) -> "Decisions":
        """The rows of the robots in `names` alone, by their new names."""
        return Decisions(
            {names[robot]: of for robot, of in self.logs.items() if robot in names},
            tuple(replace(r, a=names[r.a], b=names[r.b]) for r in self.pairs if {r.a, r.b} <= names.keys()),
            tuple(
                replace(r, robot_a=names[r.robot_a], robot_b=names[r.robot_b])
                for r in self.places
                if {r.robot_a, r.robot_b} <= names.keys()
            ),
            tuple(replace(r, robot=names[r.robot]) for r in self.masks if r.robot in names),
        )

    def pair(self, a: str, b: str) -> PairRow | None:
        """What somebody says of two robots otherwise than their scans, seen from robot a."""
        for row in self.pairs:
            if row.edited and (row.a, row.b) == (a, b):
                return row
            if row.edited and (row.a, row.b) == (b, a):
                pose = None if row.pose is None else _numbers(se2.inverse(np.array(row.pose)))
                return replace(row, a=a, b=b, pose=pose)
        return None

    def within(self, robot: str) -> tuple[PlaceRow, ...]:
        """The edited rows of places of one robot."""
        return tuple(row for row in self.places if row.edited and row.robot_a == row.robot_b == robot)

    def between(self, a: str, b: str) -> tuple[PlaceRow, ...]:
        """The edited rows of places that tie two robots."""
        return tuple(row for row in self.places if row.edited and {row.robot_a, row.robot_b} == {a, b} and a != b)


def keyframe_at(graph: RobotGraph, t: float) -> int | None:
    """The keyframe at a stamp [s]; None where there is none within `MOMENT`."""
    k = int(np.argmin(np.abs(graph.t - t)))
    return k if abs(float(graph.t[k]) - t) <= MOMENT else None


def _numbers(pose: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, theta = np.asarray(pose, dtype=float).tolist()
    return x, y, theta
