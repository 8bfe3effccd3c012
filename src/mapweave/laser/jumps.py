"""Where the scene changed at once though the wheels hardly moved: the robot was carried, or logs were joined."""

from collections.abc import Sequence

import numpy as np

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


def jumps(records: ScanRecords, scans: Sequence[Scan], cfg: JumpCheck) -> tuple[str, ...]:
    """A warning for the first scan that shows little of what the one before it saw, and how many more there are."""
    if len(scans) < 3 or scans[0].odometry is None:
        return ()
    wheels = np.array([scan.odometry for scan in scans], dtype=float)
    step = se2.between(wheels[:-1], wheels[1:])
    way = np.hypot(step[:, 0], step[:, 1])
    share = records.matches / np.maximum(records.beams, 1)
    enough = records.beams >= cfg.least_returns
    allowed = cfg.drop + cfg.drop_per_m * way + cfg.drop_per_rad * np.abs(step[:, 2])
    gone = enough[:-1] & enough[1:] & (share[:-1] - share[1:] >= allowed)
    gone[0] = False  # the first scan is its own map
    at = np.flatnonzero(gone) + 1
    if not len(at):
        return ()
    k = int(at[0])
    more = f" (and {len(at) - 1} times more)" if len(at) > 1 else ""
    now, last = (f"{100 * s:.0f} %" for s in (share[k], share[k - 1]))
    seen = f"{now} of the returns lie on walls seen before, of the last scan {last}"
    moved = f"while the wheels tell {way[k - 1]:.2f} m"
    why = "the robot was carried, drives were joined to one log, or the view was blocked; the map goes on by the wheels"
    return (f"at {records.t[k]:.1f} s{more} the scene changes at once: {seen}, {moved}: {why}",)
