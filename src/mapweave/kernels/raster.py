"""What kernels over rasters take whole: where the cells lie, and what a sensor has in view."""

from typing import NamedTuple

import numpy as np


class Raster(NamedTuple):
    """Square cells of side `cell` [m]; corner: (2,) [m], the lower left one of cell (0, 0); row 0 lowest y."""

    corner: np.ndarray
    cell: float


class Sector(NamedTuple):
    """What a sensor has in view: up to `reach` [m] away and `half_angle` [rad] to either side of straight ahead."""

    reach: float
    half_angle: float
