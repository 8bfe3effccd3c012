"""The cells of one tile as bytes."""

import zlib

import numpy as np
from jaxtyping import UInt8

SIDE = 128  # cells of a tile


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
