"""What of a building robots can reach and see, and how well a map of it agrees with its walls."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import cKDTree

from ..core.errors import DataError
from ..core.records import frozen
from ..core.walls import WallIndex, Walls

CELL = 0.1  # [m], the raster on which a disc is driven everywhere
VANTAGE = 0.8  # [m] between the places from which walls are looked at
BEAMS = 360  # cast from each of those places, a degree apart
FURNITURE = 2.0  # [m^2] of ground inside walls up to which they are taken for a piece of furniture
ROUND = 1.0  # [m] of ground round the walls that is looked at too
PIECE = 0.1  # [m], walls are counted in pieces at most this long


@dataclass(frozen=True, slots=True)
class Building:
    """reached: (rows, cols), row 0 lowest y, cells of `cell` [m] from `lower` on which a robot's centre can stand, by a
    way from a start; seen: (p, 2) middles of the pieces of wall that a scanner there can see; shut: (s, 3) ground that
    no robot gets to, as the middle x, y [m] and its area [m^2], the largest first.
    """

    lower: Float[np.ndarray, "2"]
    cell: float
    reached: Bool[np.ndarray, "rows cols"]
    seen: Float[np.ndarray, "p 2"]
    shut: Float[np.ndarray, "s 3"]

    def places(self) -> Float[np.ndarray, "n 2"]:
        """Centres [m] of the reached cells."""
        return np.asarray(self.lower + (np.argwhere(self.reached)[:, ::-1] + 0.5) * self.cell)

    @property
    def area(self) -> float:
        """Reached area [m^2]."""
        return float(self.reached.sum() * self.cell**2)


def survey_building(
    walls: Walls,
    lower: Float[np.ndarray, "2"],
    upper: Float[np.ndarray, "2"],
    starts: Float[np.ndarray, "r 3"],
    radius: float,
    reach: float,
) -> Building:
    """What discs of `radius` [m] reach from `starts` between `lower` and `upper`, and see within `reach` [m].

    Raises DataError when the walls do not close round the robots: such a world has no end.
    """
    lower, upper = np.asarray(lower) - ROUND, np.asarray(upper) + ROUND
    free = ~walls.blocked(lower, upper, CELL, radius)
    regions, _ = ndimage.label(free)
    at = np.clip(((starts[:, :2] - lower) / CELL).astype(int), 0, np.array(free.shape[::-1]) - 1)
    homes = np.unique(regions[at[:, 1], at[:, 0]])
    reached = np.isin(regions, homes[homes > 0])
    _check_closed(reached, lower)
    shut = frozen(_shut(regions, set(homes.tolist()), lower))
    building = Building(frozen(lower), CELL, frozen(reached, dtype=bool), np.zeros((0, 2)), shut)
    return replace(building, seen=frozen(_seen_pieces(walls, building.places(), reach)))


def _check_closed(reached: Bool[np.ndarray, "rows cols"], lower: Float[np.ndarray, "2"]) -> None:
    out = np.argwhere(reached & _edge(reached.shape))
    if len(out):
        x, y = lower + (out[0][::-1] + 0.5) * CELL
        raise DataError(f"the walls do not close round the robots: they can leave by ({x:.1f}, {y:.1f})")


def _shut(regions: np.ndarray, homes: set[int], lower: Float[np.ndarray, "2"]) -> Float[np.ndarray, "s 3"]:
    """Regions within the walls, too large to be furniture, that are nobody's home."""
    homes = homes | set(regions[_edge(regions.shape)].tolist())
    area = np.bincount(regions.ravel()) * CELL**2
    names = [k for k in np.argsort(-area).tolist() if k and k not in homes and area[k] >= FURNITURE]
    middles = np.array(ndimage.center_of_mass(regions > 0, regions, names)).reshape(-1, 2)
    return np.column_stack([lower + (middles[:, ::-1] + 0.5) * CELL, area[names]])


def _edge(shape: tuple[int, ...]) -> Bool[np.ndarray, "rows cols"]:
    out = np.ones(shape, dtype=bool)
    out[1:-1, 1:-1] = False
    return out


def _seen_pieces(walls: Walls, places: Float[np.ndarray, "n 2"], reach: float) -> Float[np.ndarray, "p 2"]:
    """Middles of the pieces of wall that beams from a grid over `places` end on."""
    if not len(places) or not len(walls.segments):
        return np.zeros((0, 2))
    first = np.unique(np.floor(places / VANTAGE).astype(np.int64), axis=0, return_index=True)[1]
    a, e = walls.segments[:, :2], walls.segments[:, 2:] - walls.segments[:, :2]
    length = np.hypot(e[:, 0], e[:, 1])
    pieces = np.maximum(np.ceil(length / PIECE - 1e-9).astype(np.int64), 1)
    offset = np.concatenate([[0], np.cumsum(pieces)])
    hit = np.zeros(offset[-1], dtype=bool)
    angles = 2 * np.pi * np.arange(BEAMS) / BEAMS
    index = WallIndex.of(walls.segments)
    for place in places[first]:
        r, what, _ = index.cast(np.array([[*place, 0.0]]), angles, np.zeros((1, 0, 3)), reach)
        on = what[0] >= 0
        k, p = what[0][on], place + r[0][on, None] * np.column_stack([np.cos(angles[on]), np.sin(angles[on])])
        along = ((p - a[k]) * e[k]).sum(axis=1) / np.maximum(length[k] ** 2, 1e-12)
        hit[offset[k] + np.clip((along * pieces[k]).astype(np.int64), 0, pieces[k] - 1)] = True
    at = np.flatnonzero(hit)
    k = np.searchsorted(offset, at, side="right") - 1
    return np.asarray(a[k] + ((at - offset[k] + 0.5) / pieces[k])[:, None] * e[k])


def wall_scores(
    occupied: Float[np.ndarray, "n 2"], walls: Walls, building: Building, tolerance: float
) -> tuple[float | None, float | None, float | None]:
    """How the map's `occupied` cell centres agree with the walls, in the same frame.

    Mean distance [m] of a cell to the nearest wall line; share of the cells within `tolerance` [m] of one; share of the
    pieces of wall that can be seen which have a cell within `tolerance`. None where there is nothing to count.
    """
    if not len(occupied):
        return None, None, None
    off = Walls(walls.segments, walls.reflectance).clearance(occupied)
    recall = None
    if len(building.seen):
        away = np.asarray(cKDTree(occupied).query(building.seen)[0])
        recall = float((away <= tolerance).mean())
    return float(off.mean()), float((off <= tolerance).mean()), recall


def share_free(
    building: Building, free: Bool[np.ndarray, "rows cols"], origin: Float[np.ndarray, "2"], resolution: float
) -> float:
    """Share of the reached area that a map knows to be free, in the same frame. free: its cells, row 0 lowest y."""
    places = building.places()
    return float(known_at(places, free, origin, resolution).mean()) if len(places) else 0.0


def known_at(
    places: Float[np.ndarray, "n 2"],
    cells: Bool[np.ndarray, "rows cols"],
    origin: Float[np.ndarray, "2"],
    resolution: float,
) -> Bool[np.ndarray, " n"]:
    """Whether the cell that holds each place is set; outside nothing is."""
    at = np.floor((places - origin) / resolution).astype(np.int64)
    inside = ((at >= 0) & (at < cells.shape[::-1])).all(axis=1)
    out = np.zeros(len(places), dtype=bool)
    out[inside] = cells[at[inside, 1], at[inside, 0]]
    return out
