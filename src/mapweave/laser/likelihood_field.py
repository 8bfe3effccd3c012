"""A finished map as something to score poses against: every cell knows its nearest occupied cell."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from ..core.records import frozen
from ..kernels.laser.scan_laying import score_field
from .laser_map import GridMap

MARGIN = 10  # cells round the map in which a beam still finds its nearest


@dataclass(frozen=True, slots=True)
class NearestField:
    """near: (rows, cols, 3), mean point [m] and feature of the nearest occupied cell; origin, cell: as in GridMap."""

    near: Float[np.ndarray, "rows cols 3"]
    origin: Float[np.ndarray, "2"]
    cell: float

    def nearest(self, points: Float[np.ndarray, "n 2"], outside: float) -> Float[np.ndarray, "n 3"]:
        """The nearest wall point of each point and its feature; `outside` [m] away for points beyond the table."""
        at = np.floor((points - self.origin) / self.cell).astype(int)
        rows, cols = self.near.shape[:2]
        inside = (at[:, 0] >= 0) & (at[:, 0] < cols) & (at[:, 1] >= 0) & (at[:, 1] < rows)
        out = np.column_stack([points + outside, np.zeros(len(points))])
        out[inside] = self.near[at[inside, 1], at[inside, 0]]
        return out

    def score(
        self,
        poses: Float[np.ndarray, "p 3"],
        points: Float[np.ndarray, "n 3"],
        *,
        alpha: float,
        cap: float,
        matched_under: float = 0.0,
    ) -> tuple[Float[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Mean of `min(D, cap)` [m^2] over the beams, and how many beams have a D below `matched_under`, a pose."""
        return score_field(
            self.near,
            self.origin,
            self.cell,
            np.ascontiguousarray(poses, dtype=float),
            np.ascontiguousarray(points, dtype=float),
            alpha,
            cap,
            matched_under,
        )


def wall_cells(grid: GridMap, least_occupancy: float) -> Bool[np.ndarray, "rows cols"]:
    """The cells of `grid` that are walls: occupied with a probability above `least_occupancy`."""
    return np.asarray((grid.weight > 0) & (grid.occupancy() > least_occupancy))


def nearest_field(grid: GridMap, least_occupancy: float) -> NearestField:
    """The table of the walls of `grid`. Raises ValueError when no cell of it is occupied."""
    there = wall_cells(grid, least_occupancy)
    if not there.any():
        raise ValueError("no cell of the map is occupied")
    there = np.pad(there, MARGIN)
    index = distance_transform_edt(~there, return_distances=False, return_indices=True)
    held = np.concatenate([grid.mean, grid.feature[..., None]], axis=-1).astype(float)
    held = np.pad(held, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)))
    near = held[index[0], index[1]]
    return NearestField(frozen(near), frozen(grid.origin - MARGIN * grid.resolution), grid.resolution)
