"""An occupancy map in square tiles of three levels, as a map process tells them and a browser draws them."""

import zlib
from collections.abc import Mapping
from functools import reduce

import numpy as np
from jaxtyping import Int, UInt8

SIDE = 128  # cells of a tile
LEVELS = 3  # of tiles
COARSER = 4  # from level to level
UNSEEN = 0  # a cell of which nobody told
TileKey = tuple[int, int, int, int]  # component, level, column and row of the tile, counted from the origin
Cells = UInt8[np.ndarray, "side side"]


def pack(tile: UInt8[np.ndarray, "side side"]) -> bytes:
    """A zlib stream of the bytes, row by row from below."""
    return zlib.compress(np.ascontiguousarray(tile).tobytes(), 6)


def is_tile(data: bytes) -> bool:
    """Whether `data` is what `pack` gives, of the right size."""
    stream = zlib.decompressobj()
    try:
        cells = stream.decompress(data, SIDE * SIDE + 1)
    except zlib.error:
        return False
    return len(cells) == SIDE * SIDE and stream.eof and not stream.unused_data


def cells_of(hits: Int[np.ndarray, "side side"], passes: Int[np.ndarray, "side side"]) -> Cells:
    """A byte a cell: 0 unseen, else 1 (free) to 255 (occupied), the mean of a beta prior (1/2, 1/2) after its beams."""
    beams = hits + passes
    return np.where(beams > 0, 1 + np.rint(254 * (hits + 0.5) / (beams + 1.0)), UNSEEN).astype(np.uint8)


def coarser(column: int, row: int, finer: Mapping[tuple[int, int], Cells]) -> Cells:
    """The tile at `column` and `row` of the level above that of `finer`, whose tiles are by column and row.

    A cell is the most occupied of the `COARSER` times `COARSER` in it; its side is `COARSER` times as long.
    """
    out = np.zeros((SIDE, SIDE), np.uint8)
    part = SIDE // COARSER
    for j in range(COARSER):
        for i in range(COARSER):
            tile = finer.get((COARSER * column + i, COARSER * row + j))
            if tile is not None:
                rows = reduce(np.maximum, (tile[k::COARSER] for k in range(COARSER)))
                most = reduce(np.maximum, (rows[:, k::COARSER] for k in range(COARSER)))
                out[part * j : part * (j + 1), part * i : part * (i + 1)] = most
    return out
