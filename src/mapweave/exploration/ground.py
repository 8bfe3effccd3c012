"""Ground that robots drive on: a raster of free cells, and the cheapest paths over it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Int32, UInt8
from scipy import ndimage

from ..kernels.exploration.wavefront import NO_LIMIT, STRAIGHT, UNREACHED, descend, spread
from ..kernels.walls.segments import sight_on_raster

FAR = 1e4  # [m], stands for a place that no path leads to where a cost must be finite


@dataclass(frozen=True, slots=True)
class Ground:
    """Square cells (rows, cols) of side `cell` [m] from the corner `lower` (2,) [m], row 0 lowest y.

    weight: what a metre in each cell counts as, 0 where no robot may be. A step goes to one of eight neighbours; a
    diagonal one only where both cells beside it are free. A place in a cell that is not free counts as its nearest free
    cell, if one has its centre within `snap` [m] (else it is unreachable). Lengths are weighed lengths.
    """

    weight: UInt8[np.ndarray, "rows cols"]
    lower: Float[np.ndarray, "2"]
    cell: float
    snap: float = 0.0

    @classmethod
    def of(
        cls,
        free: Bool[np.ndarray, "rows cols"],
        lower: Float[np.ndarray, "2"],
        cell: float,
        snap: float = 0.0,
        weight: Float[np.ndarray, "rows cols"] | UInt8[np.ndarray, "rows cols"] | None = None,
    ) -> "Ground":
        """The ground of the `free` cells; `weight` rounded to whole numbers from 1 to 255, 1 everywhere without one."""
        prices = free if weight is None else np.where(free, np.rint(weight), 0)
        return cls(np.ascontiguousarray(prices, dtype=np.uint8), np.asarray(lower), cell, snap)

    @property
    def free(self) -> Bool[np.ndarray, "rows cols"]:
        """Cells that a robot may be in."""
        return np.asarray(self.weight > 0)

    def cells(self, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """The free cell (row, col) each point counts as; (-1, -1) where there is none."""
        return nearest_cells(self.free, self.lower, self.cell, points, self.snap)

    def centres(self, cells: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Centres [m] of `cells` given as (row, col)."""
        return np.asarray(self.lower + (cells[..., ::-1] + 0.5) * self.cell)

    def cost_to_go(self, cells: Int[np.ndarray, "k 2"], limit: float = np.inf) -> "CostToGo":
        """How far the nearest of `cells` (row, col) is from everywhere that is at most `limit` [m] away.

        Compiled: 5 ms over 125,000 cells, where `scipy.sparse.csgraph.dijkstra` takes 25 ms.
        """
        most = int(min(limit / self.cell * STRAIGHT, NO_LIMIT))
        return CostToGo(self, spread(self.weight, np.ascontiguousarray(cells), most))

    def distances(self, sources: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k rows cols"]:
        """Length [m] of the shortest path from each source to every cell, right to 5e-5; infinite where none leads."""
        out = np.full((len(sources), *self.weight.shape), np.inf)
        for k, start in enumerate(self.cells(sources)):
            if start[0] >= 0:
                out[k] = self.cost_to_go(start[None]).metres
        return out

    def regions(self) -> Int[np.ndarray, "rows cols"]:
        """Which connected region each free cell belongs to, from 0; -1 where it is not free."""
        return np.asarray(ndimage.label(self.free)[0], dtype=np.int64) - 1


@dataclass(frozen=True, slots=True)
class CostToGo:
    """How far every cell of `ground` is from a goal. cost: (rows, cols) as `kernels.exploration.wavefront.spread` tells
    it, UNREACHED where no path leads.
    """

    ground: Ground
    cost: Int32[np.ndarray, "rows cols"]

    @property
    def metres(self) -> Float[np.ndarray, "rows cols"]:
        """Length [m] of the path from every cell; infinite where none leads."""
        return np.where(self.cost >= 0, self.cost * (self.ground.cell / STRAIGHT), np.inf)

    def metres_from(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Length (n,) [m] of the path from each place, or from the nearest reached cell within `snap` of it."""
        cells = self.cells(places)
        cost = np.where(cells[:, 0] >= 0, self.cost[cells[:, 0], cells[:, 1]], UNREACHED)
        return np.asarray(np.where(cost >= 0, cost * self.ground.cell / STRAIGHT, np.inf))

    def cells(self, places: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """The reached cell (row, col) each place counts as; (-1, -1) where there is none."""
        g = self.ground
        return nearest_cells(self.cost >= 0, g.lower, g.cell, places, g.snap)

    def descend(self, cell: Int[np.ndarray, "2"], most: int | None = None) -> Int[np.ndarray, "n 2"]:
        """Neighbouring cells (row, col) from the given one towards the goal, at most so many; none where none leads."""
        limit = self.cost.size if most is None else most
        return np.asarray(descend(self.cost, self.ground.weight, np.asarray(cell, np.int64), limit))

    def path(self, start: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 2"] | None:
        """Waypoints (n, 2) [m] from the cell of `start` to the goal, as few as sight over free cells allows.

        None where no path leads.
        """
        cell = self.cells(start[None])[0]
        if cell[0] < 0:
            return None
        chain = self.descend(cell)
        middle, free = chain[:, ::-1] + 0.5, self.ground.free
        kept, at = [0], 0
        while at < len(chain) - 1:
            ahead = at + 1
            while ahead + 1 < len(chain) and sight_on_raster(free, middle[at], middle[ahead + 1]):
                ahead += 1
            kept.append(ahead)
            at = ahead
        return self.ground.centres(chain[kept])


def nearest_cells(
    among: Bool[np.ndarray, "rows cols"],
    lower: Float[np.ndarray, "2"],
    cell: float,
    places: Float[np.ndarray, "n 2"],
    within: float,
) -> Int[np.ndarray, "n 2"]:
    """For each place its own cell (row, col) if it is one of `among`, else the nearest whose centre is `within` [m].

    (-1, -1) where there is none. lower: (2,) [m], corner of the raster; cell: [m].
    """
    out = np.full((len(places), 2), -1, dtype=np.int64)
    (rows, cols), span = among.shape, int(np.ceil(within / cell))
    at = np.floor((np.asarray(places) - lower) / cell)
    for k, (place, (x, y)) in enumerate(zip(places, at, strict=True)):
        if not (-span <= y < rows + span and -span <= x < cols + span):
            continue
        row, col = int(y), int(x)
        if 0 <= row < rows and 0 <= col < cols and among[row, col]:
            out[k] = row, col
            continue
        low = np.array([max(row - span, 0), max(col - span, 0)])
        near = np.argwhere(among[low[0] : row + span + 1, low[1] : col + span + 1]) + low
        if len(near):
            d = np.hypot(*(lower + (near[:, ::-1] + 0.5) * cell - place).T)
            if d.min() <= within:
                out[k] = near[np.argmin(d)]
    return out
