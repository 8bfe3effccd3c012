"""What a planner knows of a landmark world, and the planners by name: `choose(maps, poses, cfg) -> commands`.

Which cells of a rectangle a team has seen, by whom, and whether that knowledge is safe in the global map.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import se2
from ...kernels.walls.segments import Raster
from ...landmarks.landmark_map import GlobalMap, Submap
from ..planner_interface import TeamBelief
from .config import ExploreConfig
from .floor_plan import FloorPlan


@dataclass(slots=True)
class Explored:
    """Seen cells of one run; the only mutable object of exploration, owned by its loop.

    fused: (ny, nx) cells whose sightings are in the global map; pending: (M, ny, nx) delivered to the team, in a submap
    still; backlog: (M, ny, nx) not delivered yet. Lost with a robot: its pending and backlog cells.
    sweeps counts passes over the rectangle. outside: (ny, nx) cells that are no part of the field, None without any.
    """

    lower: Float[np.ndarray, "2"]
    cell: float
    fused: Bool[np.ndarray, "ny nx"]
    pending: Bool[np.ndarray, "r ny nx"]
    backlog: Bool[np.ndarray, "r ny nx"]
    sweeps: int = 1
    outside: Bool[np.ndarray, "ny nx"] | None = None

    @classmethod
    def over(
        cls, lower: np.ndarray, upper: np.ndarray, robots: int, cell: float = 1.0, outside: np.ndarray | None = None
    ) -> "Explored":
        """Nothing seen yet; cells `outside` (ny, nx) the field need not be: they count as seen from the start."""
        nx, ny = (int(np.ceil((upper[k] - lower[k]) / cell - 1e-9)) for k in (0, 1))
        shape = (robots, ny, nx)
        none = np.zeros(shape, dtype=bool)
        fused = np.zeros((ny, nx), dtype=bool) if outside is None else outside.copy()
        return cls(np.asarray(lower, float), cell, fused, none, none.copy(), outside=outside)

    @property
    def raster(self) -> Raster:
        """Where the cells lie."""
        return Raster(self.lower, self.cell)

    def team(self) -> Bool[np.ndarray, "ny nx"]:
        """What the whole team knows to be seen."""
        return np.asarray(self.fused | self.pending.any(axis=0))

    def known_to(self, j: int) -> Bool[np.ndarray, "ny nx"]:
        """What robot j knows to be seen: the team's cells and its own that were not delivered yet."""
        return np.asarray(self.team() | self.backlog[j])

    def seen_share(self) -> float:
        """What share of the field the team has seen."""
        if self.outside is None:
            return float(self.team().mean())
        return float(self.team()[~self.outside].mean())

    def sees(self, j: int, point: Float[np.ndarray, "2"]) -> bool:
        """Whether robot j knows the cell around `point` [m] to be seen."""
        ix, iy = ((point - self.lower) / self.cell).astype(int)
        ny, nx = self.fused.shape
        iy, ix = min(max(int(iy), 0), ny - 1), min(max(int(ix), 0), nx - 1)
        return bool(self.fused[iy, ix] or self.pending[:, iy, ix].any() or self.backlog[j, iy, ix])

    def deliver(self, j: int) -> None:
        """Robot j's message came through: its backlog is the team's knowledge."""
        self.pending[j] |= self.backlog[j]
        self.backlog[j] = False

    def fuse(self, j: int) -> None:
        """Robot j's submap is in the global map: its cells are safe."""
        self.fused |= self.pending[j] | self.backlog[j]
        self.pending[j] = False
        self.backlog[j] = False

    def lose(self, j: int) -> None:
        """Robot j died with its submap: cells only it had seen are unexplored again."""
        self.pending[j] = False
        self.backlog[j] = False

    def again(self) -> None:
        """Everything counts as unexplored: something was missed, look once more."""
        for cells in (self.fused, self.pending, self.backlog):
            cells[:] = False
        if self.outside is not None:
            self.fused |= self.outside
        self.sweeps += 1

    def add(self, other: "Explored") -> None:
        """What another crew has seen of the same raster is known here too."""
        self.fused |= other.fused
        self.pending |= other.pending
        self.backlog |= other.backlog

    def joined(self, other: "Explored", T: Float[np.ndarray, "3"]) -> "Explored":
        """What this crew and another one know together. T: `T_self_other`, of the other's raster in this one."""
        ny, nx = self.fused.shape
        centres = self.centres(np.argwhere(np.ones((ny, nx), dtype=bool)))
        at = np.floor((se2.act(se2.inverse(T), centres) - other.lower) / other.cell).astype(np.int64)
        inside = np.all((at >= 0) & (at < other.fused.shape[::-1]), axis=1)
        x, y = np.where(inside[:, None], at, 0).T

        def seen(cells: np.ndarray) -> np.ndarray:
            return np.asarray((cells[..., y, x] & inside).reshape(*cells.shape[:-2], ny, nx))

        pending, backlog = (
            np.concatenate([mine, seen(its)])
            for mine, its in ((self.pending, other.pending), (self.backlog, other.backlog))
        )
        return replace(self, fused=self.fused | seen(other.fused), pending=pending, backlog=backlog)

    def centres(self, cells: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Centres [m] of `cells` given as rows (iy, ix)."""
        return self.lower + (cells[:, ::-1] + 0.5) * self.cell


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkBelief(TeamBelief):
    """explored: cells by who knows of them; submaps and the global map with their covariances; floor: what the plan of
    the walls tells, None in an open field; contacts: (k, 2) places in the map where a robot lately met a wall that it
    thought farther away; lower, upper: (2,) corners [m] of the field; away: (M,) robots beyond the radio's range, which
    are not alive here but may be at work: the plan made together holds for them.
    """

    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    explored: Explored
    submaps: tuple[Submap, ...]
    global_map: GlobalMap
    floor: FloorPlan | None = None
    contacts: Float[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    away: Bool[np.ndarray, " r"]


Planner = Callable[[LandmarkBelief, Float[np.ndarray, "r 3"], ExploreConfig], Float[np.ndarray, "r 2"]]
