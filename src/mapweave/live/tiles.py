"""An occupancy map in square tiles of three levels, as a map process tells them and a browser draws them."""

import numpy as np
from jaxtyping import UInt8

from ..laser.laser_map import GridMap
from .tile_bytes import SIDE, pack

LEVELS = 3
COARSER = 4  # from level to level
UNSEEN = 0
TileKey = tuple[int, int, int, int]  # component, level, column and row of the tile, counted from the origin


def tiles_of(grid: GridMap, component: int) -> dict[TileKey, bytes]:
    """The tiles of `grid` in which anything was seen, on every level, packed by `pack`.

    A cell is a byte: 0 unseen, else 1 (free) to 255 (occupied); a coarser one is the most occupied of those in it. Cell
    (0, 0) of level l has its lower left corner at the origin and a side of `resolution * COARSER**l`.
    """
    seen = grid.hits + grid.passes > 0
    cells = np.where(seen, 1 + np.rint(254 * grid.occupancy()), UNSEEN).astype(np.uint8)
    column, row = np.rint(grid.origin / grid.resolution).astype(int).tolist()
    out: dict[TileKey, bytes] = {}
    for level in range(LEVELS):
        if level:
            cells, row, column = _coarser(cells, row, column)
        out |= {(component, level, i, j): pack(tile) for (i, j), tile in _cut(cells, row, column).items()}
    return out


def _coarser(cells: UInt8[np.ndarray, "rows cols"], row: int, column: int) -> tuple[UInt8[np.ndarray, "r c"], int, int]:
    """Cells of `COARSER` times the side, and where they begin."""
    below, left = row % COARSER, column % COARSER
    above, right = -(below + cells.shape[0]) % COARSER, -(left + cells.shape[1]) % COARSER
    whole = np.pad(cells, ((below, above), (left, right)))
    blocks = whole.reshape(whole.shape[0] // COARSER, COARSER, -1, COARSER)
    return blocks.max(axis=(1, 3)), row // COARSER, column // COARSER


def _cut(
    cells: UInt8[np.ndarray, "rows cols"], row: int, column: int
) -> dict[tuple[int, int], UInt8[np.ndarray, "side side"]]:
    """Column and row of each tile that holds anything -> its cells."""
    below, left = row % SIDE, column % SIDE
    above, right = -(below + cells.shape[0]) % SIDE, -(left + cells.shape[1]) % SIDE
    whole = np.pad(cells, ((below, above), (left, right)))
    out = {}
    for j in range(whole.shape[0] // SIDE):
        for i in range(whole.shape[1] // SIDE):
            tile = whole[SIDE * j : SIDE * (j + 1), SIDE * i : SIDE * (i + 1)]
            if tile.any():
                out[column // SIDE + i, row // SIDE + j] = tile
    return out
