"""Where the scene changed at once though the wheels hardly moved: the robot was carried, or logs were joined."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from ..core import se2
from ..core.config import config
from ..core.records import Scan
from .laser_map import ScanRecords


@config
class JumpCheck:
    """When one scan to the next shows another place: far fewer of its returns lie on walls known by then."""

    drop: float = 0.4  # of the share of returns on known walls from one scan to the next, and
    drop_per_m: float = 1.0  # so much more for a metre between the two and
    drop_per_rad: float = 0.3  # for a radian of turn: new places come into view
    least_returns: int = 30  # in either scan
    late: int = 50  # scans, after which the first of a scanner belongs to another drive


def jumps(records: ScanRecords, scans: Sequence[Scan], cfg: JumpCheck) -> tuple[str, ...]:
    """A warning for the first scan that shows little of what the one before it saw, and how many more there are."""
    if len(scans) < 3 or scans[0].odometry is None:
        return ()
    wheels = np.array([scan.odometry for scan in scans], dtype=float)
    share = records.matches / np.maximum(records.beams, 1)
    before, after = _one_to_the_next(scans, cfg.late)
    step = se2.between(wheels[before], wheels[after])
    way = np.hypot(step[:, 0], step[:, 1])
    enough = np.minimum(records.beams[before], records.beams[after]) >= cfg.least_returns
    allowed = cfg.drop + cfg.drop_per_m * way + cfg.drop_per_rad * np.abs(step[:, 2])
    gone = np.flatnonzero(enough & (before > 0) & (share[before] - share[after] >= allowed))  # the first is its own map
    if not len(gone):
        return ()
    row = gone[np.argmin(after[gone])]
    k, last = int(after[row]), int(before[row])
    more = f" (and {len(gone) - 1} times more)" if len(gone) > 1 else ""
    now, then = (f"{100 * s:.0f} %" for s in (share[k], share[last]))
    seen = f"{now} of the returns lie on walls seen before, of the last scan {then}"
    moved = f"while the wheels tell {way[row]:.2f} m"
    why = "the robot was carried, drives were joined to one log, or the view was blocked; the map goes on by the wheels"
    return (f"at {records.t[k]:.1f} s{more} the scene changes at once: {seen}, {moved}: {why}",)


def _one_to_the_next(scans: Sequence[Scan], late: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Each scan after the one before it of the same scanner: before and after.

    The first scan of a scanner that joins late follows the last of any: scanners of one robot begin together.
    """
    latest: dict[bytes, int] = {}
    pairs = []
    for k, scan in enumerate(scans):
        mount = scan.T_robot_sensor.tobytes()
        if mount in latest or k >= late:
            pairs.append((latest.get(mount, k - 1), k))
        latest[mount] = k
    before, after = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return before, after
