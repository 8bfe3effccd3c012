"""Occupancy as ROS navigation tools read it: `map.pgm` and `map.yaml`."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..maps.grid import GridMap
from .rows import open_text

OCCUPIED, FREE = 0.65, 0.196  # the thresholds the yaml names
BLACK, GREY, WHITE = 0, 205, 254


def write_ros_map(folder: Path, grid: GridMap) -> None:
    """`map.pgm` (row 0 at the top, so highest y) and `map.yaml` in `folder`."""
    picture = trinary(grid)
    rows, cols = picture.shape
    with (folder / "map.pgm").open("wb") as file:
        file.write(f"P5\n{cols} {rows}\n255\n".encode())
        file.write(picture.tobytes())
    with open_text(folder / "map.yaml") as text:
        text.write(
            f"image: map.pgm\nmode: trinary\nresolution: {grid.resolution:.9g}\n"
            f"origin: [{float(grid.origin[0]):.9g}, {float(grid.origin[1]):.9g}, 0.0]\n"
            f"negate: 0\noccupied_thresh: {OCCUPIED}\nfree_thresh: {FREE}\n"
        )


def trinary(grid: GridMap) -> UInt8[np.ndarray, "rows cols"]:
    """Black where occupied, white where free, grey where not known; top row first."""
    p = grid.occupancy()
    picture = np.full(p.shape, GREY, dtype=np.uint8)
    picture[p < FREE] = WHITE
    picture[p > OCCUPIED] = BLACK
    return np.ascontiguousarray(picture[::-1])
