"""Numbers made indices: one way for all kernels, so that none ever points where no array is."""

import math

from ._jit import inlined_kernel

FARTHEST = 1 << 40  # cells from the origin that are told apart: any sum or product of a few stays within 63 bits


@inlined_kernel
def cell_of(at: float) -> int:
    """The whole number at or below `at`, held within `FARTHEST` of 0; what is no number lies at the lowest.

    A float beyond 63 bits made an int is anything; this lies outside of every grid, on the side where `at` does.
    """
    if not at > -FARTHEST:
        return -FARTHEST
    return FARTHEST if at >= FARTHEST else math.floor(at)
