"""Does the scene turn the way odometry says? If not, the beam angles have the wrong sign."""

from collections.abc import Sequence

import numpy as np

from ..core import se2
from ..core.records import Scan

PAIRS = 400  # scan pairs looked at, at most
VOTES = 10  # pairs that must speak before anything is said
SHARE = 0.75  # of them against the odometry


def looks_mirrored(scans: Sequence[Scan]) -> bool:
    """True when consecutive scans agree clearly better under the turn opposite to the odometry's.

    Pairs with a turn of 0.05 to 0.6 rad and little travel are compared beam by beam; needs `Scan.odometry`.
    """
    votes = [vote for a, b in _turns(scans) if (vote := _vote(*a, b)) != 0]
    return len(votes) >= VOTES and votes.count(-1) > SHARE * len(votes)


def _turns(scans: Sequence[Scan]) -> list[tuple[tuple[Scan, float], Scan]]:
    """((scan, turn until the next), next) of the pairs worth asking, spread over the log."""
    poses = np.array([scan.odometry for scan in scans], dtype=float)
    step = se2.between(poses[:-1], poses[1:])
    turn, travel = step[:, 2], np.hypot(step[:, 0], step[:, 1])
    good = np.flatnonzero((np.abs(turn) > 0.05) & (np.abs(turn) < 0.6) & (travel < 0.3))
    good = good[:: max(1, len(good) // PAIRS)]
    return [((scans[k], float(turn[k])), scans[k + 1]) for k in good.tolist()]


def _vote(a: Scan, turn: float, b: Scan) -> int:
    """1: the beams turn with the odometry, -1: against it, 0: cannot say."""
    shift = round(turn / a.angle_increment)
    n = len(a.ranges)
    if len(b.ranges) != n or abs(shift) < 2 or abs(shift) > n // 2:
        return 0
    right, wrong = _difference(a, b, shift), _difference(a, b, -shift)
    if right is None or wrong is None or max(right, wrong) < 1.2 * min(right, wrong):
        return 0
    return 1 if right < wrong else -1


def _difference(a: Scan, b: Scan, shift: int) -> float | None:
    """Mean range difference of beam i of `b` and beam i + shift of `a`, each capped at half a metre."""
    n = len(a.ranges)
    low, high = max(0, -shift), min(n, n - shift)
    both = a.hit[low + shift : high + shift] & b.hit[low:high]
    if both.sum() < 20:
        return None
    d = np.abs(a.ranges[low + shift : high + shift] - b.ranges[low:high])[both]
    return float(np.minimum(d, 0.5).mean())
