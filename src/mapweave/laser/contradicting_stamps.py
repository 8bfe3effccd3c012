"""Poses whose stamps cannot all be right: a robot is not at two places within two thousandths of a second.

Copies of one recording that were merged, and loggers that were held up and wrote all they had at once, give rows of
nearly one stamp and poses decimetres apart. Which of them was there at that time nobody can say; their middle is least
wrong.
"""

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2

TOGETHER = 0.002  # [s] within which a robot hardly moves: rows nearer in time are of one moment
APART = 0.02  # [m] and
TURNED = 0.05  # [rad]: what differs by more than either contradicts
SCAN_COUNTS = 2  # rows of odometry that a scan's pose, which was matched, outweighs


def of_one_moment(
    t: Float[np.ndarray, " n"], pose: Float[np.ndarray, "n 3"], scan: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The poses, those of one moment that contradict each other at their middle, and which these are.

    t: ascending [s]; scan: which poses are those of scans. The middle is the median over x, y and heading of the rows
    within `TOGETHER`, seen from the row itself.
    """
    first = np.searchsorted(t, t - TOGETHER, side="left")
    end = np.searchsorted(t, t + TOGETHER, side="right")
    out, moved = np.array(pose), np.zeros(len(t), dtype=bool)
    for k in np.flatnonzero(end - first > 1).tolist():
        rows = slice(first[k], end[k])
        seen = se2.between(pose[k], pose[rows])
        if (np.hypot(seen[:, 0], seen[:, 1]) <= APART).all() and (np.abs(seen[:, 2]) <= TURNED).all():
            continue
        middle = np.median(np.repeat(seen, np.where(scan[rows], SCAN_COUNTS, 1), axis=0), axis=0)
        out[k], moved[k] = se2.compose(pose[k], middle), True
    return out, moved
