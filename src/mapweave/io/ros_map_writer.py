"""Occupancy as ROS navigation tools read it: `map.pgm` and `map.yaml`."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ..laser.grid import GridMap
from ..laser.occupancy import Occupancy
from .rows import open_text

OCCUPIED, FREE = 0.65, 0.196  # the thresholds the yaml names
BLACK, GREY, WHITE = 0, 205, 254


def write_ros_map(folder: Path, grid: GridMap) -> None:
    """`map.pgm` (row 0 at the top, so highest y) and `map.yaml` in `folder`."""
    _write(folder, trinary(grid), grid.resolution, grid.origin)


def write_ros_states(folder: Path, occupancy: Occupancy) -> None:
    """The same of a map whose cells are free, occupied or unknown already."""
    picture = np.full(occupancy.state.shape, GREY, dtype=np.uint8)
    picture[occupancy.free] = WHITE
    picture[occupancy.occupied] = BLACK
    _write(folder, np.ascontiguousarray(picture[::-1]), occupancy.resolution, occupancy.origin)


def _write(
    folder: Path, picture: UInt8[np.ndarray, "rows cols"], resolution: float, origin: Float[np.ndarray, "2"]
) -> None:
    rows, cols = picture.shape
    with (folder / "map.pgm").open("wb") as file:
        file.write(f"P5\n{cols} {rows}\n255\n".encode())
        file.write(picture.tobytes())
    with open_text(folder / "map.yaml") as text:
        text.write(
            f"image: map.pgm\nmode: trinary\nresolution: {resolution:.9g}\n"
            f"origin: [{float(origin[0]):.9g}, {float(origin[1]):.9g}, 0.0]\n"
            f"negate: 0\noccupied_thresh: {OCCUPIED}\nfree_thresh: {FREE}\n"
        )


def trinary(grid: GridMap) -> UInt8[np.ndarray, "rows cols"]:
    """Black where occupied, white where free, grey where not known; top row first."""
    p = grid.occupancy()
    picture = np.full(p.shape, GREY, dtype=np.uint8)
    picture[p < FREE] = WHITE
    picture[p > OCCUPIED] = BLACK
    return np.ascontiguousarray(picture[::-1])
