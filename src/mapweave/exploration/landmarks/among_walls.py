"""Coverage tours where walls stand: what is unexplored in groups that one place sees, joined by paths round walls."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ...core.se2 import wrap_angle
from ...kernels.exploration.tours import balanced_tours
from ..ground import FAR
from .belief import LandmarkBelief
from .config import ExploreConfig
from .floor_plan import FloorPlan


@dataclass(slots=True)
class Stations:
    """Places (k, 2) all over the ground, its cells at (k, 2), and what each sees within `radius`: cells (n, k).

    Remembers the paths (k,) [m] from the stations asked for to all others.
    """

    places: Float[np.ndarray, "k 2"]
    at: Int[np.ndarray, "k 2"]
    sees: Bool[np.ndarray, "n k"]
    _ways: dict[int, np.ndarray] = field(default_factory=dict)

    def ways(self, floor: FloorPlan, chosen: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m m"]:
        """Length [m] of the shortest path between each two of the `chosen` stations."""
        new = [int(k) for k in chosen if int(k) not in self._ways]
        if new:
            for k, d in zip(new, floor.ground.distances(self.places[new]), strict=True):
                self._ways[k] = np.minimum(d[self.at[:, 0], self.at[:, 1]], FAR)
        return np.stack([self._ways[int(k)][chosen] for k in chosen])


def stations(belief: LandmarkBelief, floor: FloorPlan, radius: float, cfg: ExploreConfig) -> Stations:
    """The stations of this run for discs of `radius`, made once."""
    known: dict[float, Stations] = belief.memory.setdefault("stations", {})
    if radius not in known:
        step = max(1, round(cfg.walls.station_spacing / floor.ground.cell))
        cells = np.argwhere(floor.ground.free)
        middle = np.abs(cells % step - (step - 1) / 2).sum(axis=1)
        order = np.lexsort((middle, *(cells // step).T))
        _, first = np.unique(cells[order] // step, axis=0, return_index=True)
        at = cells[order][first]
        places = floor.ground.centres(at)
        centres = belief.explored.centres(np.argwhere(floor.field))
        sees = np.stack([floor.sees(p, centres, radius) for p in places], axis=1)
        known[radius] = Stations(places, at, sees)
    return known[radius]


def cover(
    belief: LandmarkBelief, floor: FloorPlan, cells: Float[np.ndarray, "n 2"], radius: float, cfg: ExploreConfig
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 2"]]:
    """Few stations (k,) that see all `cells`, the one that sees most first, and where (k, 2) to go for each.

    That is the place from which the middle one of the cells it newly sees is seen best.
    """
    have = stations(belief, floor, radius, cfg)
    row = np.full(floor.field.shape, -1)
    row[floor.field] = np.arange(int(floor.field.sum()))
    at = np.floor((cells - floor.lower) / floor.cell).astype(int)
    sees = have.sees[row[at[:, 1], at[:, 0]]]
    open_ = sees.any(axis=1)
    gain = sees.sum(axis=0)
    groups: list[tuple[int, np.ndarray]] = []
    while open_.any():
        best = int(np.argmax(gain))
        group = np.flatnonzero(open_ & sees[:, best])
        open_[group] = False
        gain = gain - sees[group].sum(axis=0)
        groups.append((best, group))
    far = np.flatnonzero(~sees.any(axis=1))  # seen from farther away alone: grouped by the place they are seen from
    if len(far):
        _, station = cKDTree(have.places).query(floor.view_of(cells[far]))
        groups += [(int(k), far[station == k]) for k in np.unique(station)]
    chosen, goals = [], []
    for best, group in groups:
        middle = cells[group].mean(axis=0)
        nearest = group[int(np.argmin(np.hypot(*(cells[group] - middle).T)))]
        chosen.append(best)
        goals.append(floor.view_of(cells[nearest][None])[0])
    return np.array(chosen), np.array(goals)


def plan(
    belief: LandmarkBelief, floor: FloorPlan, cells: np.ndarray, poses: np.ndarray, live: np.ndarray, cfg: ExploreConfig
) -> dict[int, np.ndarray]:
    """The next place (2,) for each live robot: the first of its tour, or the nearest from which new cells are seen."""
    chosen, goals = cover(belief, floor, cells, cfg.coverage.radius, cfg)
    first = _approach(floor, poses[live], goals, cfg.coverage.turn_cost)
    between = stations(belief, floor, cfg.coverage.radius, cfg).ways(floor, chosen)
    tours, counts = balanced_tours(first, between, np.zeros_like(first), cfg.coverage.balance)
    return {int(j): goals[tours[k, 0] if counts[k] else int(np.argmin(first[k]))] for k, j in enumerate(live)}


def laps(
    belief: LandmarkBelief, floor: FloorPlan, cells: np.ndarray, poses: np.ndarray, live: np.ndarray, cfg: ExploreConfig
) -> dict[int, list[np.ndarray]]:
    """For each live robot the places of its closed tour in order, its home last."""
    chosen, _ = cover(belief, floor, cells, cfg.loop.radius, cfg)
    have = stations(belief, floor, cfg.loop.radius, cfg)
    places = have.places[chosen]
    first = _approach(floor, poses[live], places, cfg.coverage.turn_cost)
    last = _ways(floor, poses[live], places)
    tours, counts = balanced_tours(first, have.ways(floor, chosen), last, cfg.coverage.balance)
    return {int(j): [*(places[i] for i in tours[k, : counts[k]]), poses[j, :2].copy()] for k, j in enumerate(live)}


def _ways(floor: FloorPlan, poses: np.ndarray, places: np.ndarray) -> Float[np.ndarray, "r n"]:
    """Length [m] of the path from each pose to each place; FAR where none leads."""
    at = floor.ground.cells(places)
    return np.ascontiguousarray(np.minimum(floor.from_places(poses[:, :2])[:, at[:, 0], at[:, 1]], FAR))


def _approach(floor: FloorPlan, poses: np.ndarray, places: np.ndarray, turn_cost: float) -> Float[np.ndarray, "r n"]:
    """The same with what turning towards the place costs."""
    d = places[None, :, :] - poses[:, None, :2]
    angle = np.abs(wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - poses[:, None, 2]))
    return np.asarray(_ways(floor, poses, places) + turn_cost * angle)
