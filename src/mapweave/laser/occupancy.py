"""What is free, occupied and unknown: the map a planner drives on."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ..core.records import frozen
from .laser_map import GridMap

UNKNOWN, FREE, OCCUPIED = -1, 0, 1  # what a cell is


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Square cells over one rectangle, row 0 lowest y, column 0 lowest x.

    resolution: cell side [m]; origin: (2,) lower-left corner [m]; state: (rows, cols) int8, UNKNOWN, FREE or OCCUPIED.
    """

    resolution: float
    origin: Float[np.ndarray, "2"]
    state: Int[np.ndarray, "rows cols"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", frozen(self.origin))
        object.__setattr__(self, "state", frozen(self.state, np.int8))

    @property
    def free(self) -> Bool[np.ndarray, "rows cols"]:
        return np.asarray(self.state == FREE)

    @property
    def occupied(self) -> Bool[np.ndarray, "rows cols"]:
        return np.asarray(self.state == OCCUPIED)

    @property
    def unknown(self) -> Bool[np.ndarray, "rows cols"]:
        return np.asarray(self.state == UNKNOWN)

    def cells(self, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """Rows (iy, ix) of the cells that hold `points` [m]; points outside come to the nearest cell of the border."""
        at = np.floor((np.asarray(points, float) - self.origin) / self.resolution).astype(np.int64)[..., ::-1]
        return np.asarray(np.clip(at, 0, np.array(self.state.shape) - 1))

    def centres(self, cells: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Middles [m] of `cells` given as rows (iy, ix)."""
        return np.asarray(self.origin + (cells[..., ::-1] + 0.5) * self.resolution)


def from_counts(
    resolution: float,
    origin: Float[np.ndarray, "2"],
    hits: Int[np.ndarray, "rows cols"],
    passes: Int[np.ndarray, "rows cols"],
    share: float,
) -> Occupancy:
    """Occupied where at least `share` of a cell's beams ended, free where others went through, unknown elsewhere.

    A wall that is seen along its face lets most beams through its cells, so `share` is well below one half.
    """
    beams = hits.astype(np.int64) + passes
    state = np.full(hits.shape, UNKNOWN, dtype=np.int8)
    state[beams > 0] = FREE
    state[(hits > 0) & (hits >= share * beams)] = OCCUPIED
    return Occupancy(resolution, origin, state)


def of_grid(grid: GridMap, share: float) -> Occupancy:
    """The occupancy of a grid map, cell by cell; see `from_counts`."""
    return from_counts(grid.resolution, grid.origin, grid.hits, grid.passes, share)


def without_gaps(map_: Occupancy) -> Occupancy:
    """The same map with gaps of up to two unknown cells between free ones known to be free.

    Beams a degree apart are 9 cm apart at 5 m: a fine map has gaps between them where nothing stands.
    """
    closed = ndimage.binary_closing(np.pad(map_.free, 2), np.ones((3, 3), dtype=bool))[2:-2, 2:-2]
    state = np.array(map_.state)
    state[map_.unknown & closed] = FREE
    return Occupancy(map_.resolution, map_.origin, state)
