"""Grid maps: what a laser leaves behind, as cells that hold their mean point and mean feature."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.records import frozen
from .intensity import IntensityCalibration

__all__ = ["GridMap", "IntensityCalibration"]


@dataclass(frozen=True, slots=True)
class GridMap:
    """Occupancy and intensity over one rectangle of square cells, row 0 lowest y, column 0 lowest x.

    resolution: cell side [m]; origin: (2,) lower-left corner [m] in `frame`; hits, passes: (rows, cols), returns in a
    cell and beams through it; mean: (rows, cols, 2), mean point of the returns [m]; feature: (rows, cols), their mean
    q; weight: (rows, cols), summed insertion weight, 0 where nothing was ever returned.
    """

    resolution: float
    origin: Float[np.ndarray, "2"]
    hits: Int[np.ndarray, "rows cols"]
    passes: Int[np.ndarray, "rows cols"]
    mean: Float[np.ndarray, "rows cols 2"]
    feature: Float[np.ndarray, "rows cols"]
    weight: Float[np.ndarray, "rows cols"]
    frame: str = "map"

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", frozen(self.origin))
        for name in ("hits", "passes"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int32))
        for name in ("mean", "feature", "weight"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float32))

    @property
    def shape(self) -> tuple[int, int]:
        rows, cols = self.hits.shape
        return int(rows), int(cols)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """(x min, x max, y min, y max) [m], as a plotter wants it with row 0 lowest."""
        rows, cols = self.shape
        x, y = float(self.origin[0]), float(self.origin[1])
        return x, x + cols * self.resolution, y, y + rows * self.resolution

    def occupancy(self) -> Float[np.ndarray, "rows cols"]:
        """Probability that a cell is occupied: the mean of a beta prior (1/2, 1/2) after its beams; unseen: 0.5."""
        hits, passes = self.hits.astype(float), self.passes.astype(float)
        return np.asarray((hits + 0.5) / (hits + passes + 1.0))

    def cells(self) -> Float[np.ndarray, "n 4"]:
        """Every cell with a return as (x, y, q, W), in row order."""
        rows, cols = np.nonzero(self.weight > 0)
        return np.column_stack(
            [self.mean[rows, cols].astype(float), self.feature[rows, cols], self.weight[rows, cols]]
        ).astype(float)

    def free_cells(self, least_passes: int = 2) -> Float[np.ndarray, "n 2"]:
        """Centres [m] of the cells that beams went through and (nearly) none ended in."""
        rows, cols = np.nonzero((self.passes >= least_passes) & (self.passes > 5 * self.hits))
        return np.asarray(self.origin + self.resolution * (np.column_stack([cols, rows]) + 0.5))
