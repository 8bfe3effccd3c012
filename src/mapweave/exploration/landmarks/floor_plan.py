"""What a floor plan tells a team that knows it: where robots can stand, what can be seen, how to get there."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, label

from ...core.errors import DataError
from ...core.records import frozen
from ...core.walls import Walls
from ...kernels.walls.segments import Raster, sight_on_raster
from ...kernels.walls.sight import nearest_views, points_in_sight
from ...sim.landmarks import Field
from ..ground import CostToGo, Ground
from .config import WALLS_COMFORT, ExploreConfig

WALLS_VIEW_MARGIN = 1.0  # [m] a cell must be nearer than the reach to count as one that can be seen
WALLS_VIEW_NEIGHBOURS = 5  # places around a place that must see it too: no robot stands quite where it meant to
WALLS_SEARCH_RADIUS = 5.0  # [m] around an estimated pose in which it finds ground to stand on
WALLS_LEAST_POCKET = 1.0  # [m^2] of unseen ground that is worth telling of

KEPT = 64  # goals whose distances are remembered
WALLS_STRIDE = 3  # [cells] of its path that a robot looks ahead where room is scarce


@dataclass(slots=True)
class FloorPlan:
    """The plan as the robots use it; remembers distances to the goals asked for last.

    ground: where robots can stand, a metre near a wall counting more; roomy: its cells with comfortable room around;
    field: (ny, nx) cells of the explored raster that can be seen from ground a robot reaches; views: (ny, nx, 2) the
    nearest cell of `ground` to see each from (-1 outside the field); pockets: area [m^2] of each part between walls
    that no robot sees, though it would have room there; hidden: landmarks no robot can ever see.
    """

    walls: Walls
    lower: Float[np.ndarray, "2"]
    cell: float
    ground: Ground
    roomy: Bool[np.ndarray, "rows cols"]
    field: Bool[np.ndarray, "ny nx"]
    views: Int[np.ndarray, "ny nx 2"]
    pockets: tuple[float, ...]
    hidden: tuple[int, ...]
    _to: dict[tuple[int, int], CostToGo]

    @property
    def area(self) -> float:
        """Area [m^2] of the field: all that can be seen."""
        return float(self.field.sum()) * self.cell**2

    def stand(self, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """For each point the ground (row, col) to stand on: its own, the nearest in sight, or else the nearest."""
        r = self.ground
        out = nearest_views(
            frozen(points), r.free, Raster(r.lower, r.cell), WALLS_SEARCH_RADIUS, self.walls.segments, 0
        )
        lost = np.flatnonzero(out[:, 0] < 0)
        if len(lost):
            free = np.argwhere(r.free)
            for i in lost:
                d = r.centres(free) - points[i]
                out[i] = free[int(np.argmin(np.einsum("ij,ij->i", d, d)))]
        return np.asarray(out)

    def view_of(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where (n, 2) [m] to stand to see each point of the field; for others, the nearest ground."""
        ny, nx = self.field.shape
        at = np.clip(np.floor((points - self.lower) / self.cell).astype(int), 0, [nx - 1, ny - 1])
        cells = self.views[at[:, 1], at[:, 0]].copy()
        none = cells[:, 0] < 0
        if none.any():
            cells[none] = self.stand(points[none])
        return self.ground.centres(cells)

    def goal_cell(self, goal: Float[np.ndarray, "2"]) -> tuple[int, int]:
        """The ground (row, col) to go to for `goal`: the goal itself if it is ground, else where it is seen from."""
        cell = self.ground.cells(goal[None])[0]
        if cell[0] < 0:
            cell = self.ground.cells(self.view_of(goal[None]))[0]
        return int(cell[0]), int(cell[1])

    def from_places(self, places: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k rows cols"]:
        """Length [m] of the shortest path from each place to every piece of ground; infinite where none leads."""
        return self.ground.distances(self.ground.centres(self.stand(places)))

    def to_cell(self, row: int, col: int) -> CostToGo:
        """The shortest paths from every piece of ground to the one given; remembered."""
        if (row, col) not in self._to:
            while len(self._to) >= KEPT:
                del self._to[next(iter(self._to))]
            self._to[row, col] = self.ground.cost_to_go(np.array([[row, col]]))
        return self._to[row, col]

    def waypoint(
        self, place: Float[np.ndarray, "2"], goal: Float[np.ndarray, "2"], shut: Float[np.ndarray, "k 2"], room: float
    ) -> Float[np.ndarray, "2"]:
        """Where (2,) to head for now to get from `place` to `goal`: as far along the path as roomy ground is in sight.

        Where that is not far, `WALLS_STRIDE` cells along the path. The path keeps `room` [m] from the points `shut`, if
        any such path leads there.
        """
        mine, its = self.stand(place[None])[0], self.goal_cell(goal)
        ways = self._detour(its, shut, room) if len(shut) else None
        if ways is None or ways.cost[mine[0], mine[1]] < 0:
            ways = self.to_cell(*its)
        way = ways.descend(mine)
        if not len(way):
            return goal
        last = len(way) - 1
        k = min(WALLS_STRIDE, last)
        while k < last and sight_on_raster(self.roomy, way[0, ::-1] + 0.5, way[k + 1, ::-1] + 0.5):
            k += 1
        return goal if k == last else self.ground.centres(way[k][None])[0]

    def _detour(self, to: tuple[int, int], shut: np.ndarray, room: float) -> CostToGo:
        """Like `to_cell`, for ground without what is nearer than `room` to a point of `shut`; not remembered."""
        r = self.ground
        d = np.linalg.norm(r.centres(np.argwhere(r.free))[:, None] - shut[None], axis=-1)
        free = r.free.copy()
        free[r.free] = d.min(axis=1) >= room
        without = Ground(np.where(free, r.weight, np.uint8(0)), r.lower, r.cell, WALLS_SEARCH_RADIUS)
        return without.cost_to_go(without.cells(r.centres(np.array([to]))))

    def sees(self, place: Float[np.ndarray, "2"], points: Float[np.ndarray, "n 2"], far: float) -> np.ndarray:
        """Which points lie within `far` [m] of `place` with no wall between."""
        return np.asarray(
            points_in_sight(np.ascontiguousarray(place), np.ascontiguousarray(points), far, self.walls.segments)
        )


def survey_floor(world: Field, walls: Walls, cfg: ExploreConfig) -> FloorPlan:
    """The plan of `world` for robots of the configured size.

    Raises DataError when a robot starts in a wall, nearer to one than its radius, or where it cannot leave.
    """
    _check_starts(world, walls, cfg)
    room = cfg.walls.robot_radius + cfg.walls.margin
    lower, cell = np.asarray(world.lower), cfg.walls.path_cell
    raster = Raster(lower, cell)
    free = ~walls.blocked(lower, world.upper, cell, room)
    starts = frozen(world.starts[:, :2])
    at = nearest_views(starts, free, raster, WALLS_SEARCH_RADIUS, walls.segments, 0)
    for j in np.flatnonzero(at[:, 0] < 0):
        x, y = starts[j]
        raise DataError(f"robot {j + 1} at ({x:g}, {y:g}) has nowhere to go: no ground with {room:g} m of room is near")
    regions = Ground.of(free, lower, cell).regions()
    free = np.isin(regions, regions[at[:, 0], at[:, 1]])
    weight = np.ones(free.shape)
    for share in (0.75, 1.0):
        weight += walls.blocked(lower, world.upper, cell, cfg.walls.robot_radius + share * WALLS_COMFORT)
    ground = Ground.of(free, lower, cell, weight=weight)
    nx, ny = (int(np.ceil((world.upper[k] - lower[k]) / cfg.mission.cell - 1e-9)) for k in (0, 1))
    x, y = (lower[k] + (np.arange(n) + 0.5) * cfg.mission.cell for k, n in ((0, nx), (1, ny)))
    centres = frozen(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    far = cfg.submap.reach - WALLS_VIEW_MARGIN
    views = nearest_views(centres, ground.free, raster, far, walls.segments, WALLS_VIEW_NEIGHBOURS)
    views[walls.inside(centres)] = -1
    marks = nearest_views(frozen(world.landmarks), ground.free, raster, far, walls.segments, WALLS_VIEW_NEIGHBOURS)
    seen = (views[:, 0] >= 0).reshape(ny, nx)
    return FloorPlan(
        walls,
        lower,
        cfg.mission.cell,
        ground,
        free & (weight == 1.0),
        seen,
        views.reshape(ny, nx, 2),
        _pockets(world, walls, 0.25 * cell, seen, cfg, room),
        tuple(int(k) for k in np.flatnonzero(marks[:, 0] < 0)),
        {},
    )


def _check_starts(world: Field, walls: Walls, cfg: ExploreConfig) -> None:
    clear = walls.clearance(world.starts[:, :2])
    for j in np.flatnonzero(clear < cfg.walls.robot_radius):
        x, y = world.starts[j, :2]
        inside = walls.inside(world.starts[j : j + 1, :2])[0]
        where = (
            "inside a wall" if inside else f"{clear[j]:.2g} m from a wall; its radius is {cfg.walls.robot_radius:g} m"
        )
        raise DataError(f"robot {j + 1} at ({x:g}, {y:g}) starts {where}: give it another of `starts`")


def _pockets(
    world: Field, walls: Walls, cell: float, seen: Bool[np.ndarray, "ny nx"], cfg: ExploreConfig, room: float
) -> tuple[float, ...]:
    """Areas [m^2], largest first, of what nobody sees between the walls, where a robot would have room to stand."""
    outside = walls.blocked(world.lower, world.upper, cell, 0.0)
    parts, _ = label(~walls.blocked(world.lower, world.upper, cell, 0.51 * cell))
    nearest = distance_transform_edt(parts == 0, return_distances=False, return_indices=True)
    parts = np.where(outside, 0, parts[tuple(nearest)])
    rows, cols = np.indices(parts.shape)
    shape = seen.shape
    row, col = (
        np.minimum(((k + 0.5) * cell / cfg.mission.cell).astype(int), n - 1)
        for k, n in ((rows, shape[0]), (cols, shape[1]))
    )
    unseen = np.where(seen[row, col], 0, parts)
    roomy = ~walls.blocked(world.lower, world.upper, cell, room)
    areas = []
    for part in np.unique(unseen[unseen > 0]):
        pieces, count = label(unseen == part)
        area = np.bincount(pieces.ravel(), minlength=count + 1) * cell**2
        stands = set(np.unique(pieces[roomy]))
        areas += [float(area[k]) for k in range(1, count + 1) if k in stands and area[k] >= WALLS_LEAST_POCKET]
    return tuple(sorted(areas, reverse=True))
