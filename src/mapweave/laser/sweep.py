"""Scanners that turn take their beams one after the other, while the robot drives: a room seen from a robot that turns
comes out wider or narrower than it is, by 3 % at 1 rad/s and five revolutions a second.

How long a scan takes drivers state, if often for one beam alone; which way round hardly any: those whose scanner turns
clockwise give the beams in reverse and the time as if they had not. So it is asked of the log: put right the right way,
scans that were taken while the robot turned match better than put right the wrong way.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.laser_log import LEAST_RETURNS, LaserLog
from ..core.records import Scan, frozen
from .beam import BeamConfig, beams
from .scan_matching import BARE_TANGENT, FrontEnd, FrontEndConfig, allowed_sd
from .scan_odometry import ALONE_SD

LONGEST_PAUSE = 0.5  # [s] between scans, up to which the motion from one to the next is that while either was taken
ALL_ROUND = np.radians(350.0)  # of scanners that spin, whose beams may be given in reverse
FASTEST = 0.02  # [s] of a revolution: drivers that state less, as of an LDS-01, state another time
LONGEST_SHARE = 2.0  # of the time from scan to scan, that a scan may take by its driver: more is another time
SLOWEST = 0.25  # [s] of a revolution of theirs: what comes less often was left out in part
ASKED = 600  # scans that tell which way round, at most
TURNS = 0.02  # [rad] that the robot turns in a sweep which tells
LEAST_TURNS = 30  # of them
ON_LINE = 0.02  # [m] from its line, that a return is on it
BLOCK = 10  # scans, whose matches depend on each other
SURE = 1.5  # standard errors by which more returns must be on their lines one way round


def swept(scan: Scan, step: Float[np.ndarray, "3"], since: float, sweep: float) -> Scan:
    """`scan` with the robot's motion while it was taken, after a `step` in the `since` [s] before it.

    sweep: [s] from the first beam to the last, negative where they are given in reverse. Nothing is known of a motion
    after a pause.
    """
    if sweep == 0.0 or not 0.0 < since <= LONGEST_PAUSE:
        return scan
    return replace(scan, motion=frozen(se2.exp(se2.log(step) * (sweep / since))))


def sweep_of(log: LaserLog, beam: BeamConfig, front_end: FrontEndConfig) -> float:
    """[s] from a scan's first beam to its last, negative where beams are given in reverse; 0 where it is not told.

    What a driver states of a part of a circle is so. Of scanners that see all round it is asked which way, in the
    stretch in which most changes, and whether at all: of what is simulated all beams are of one moment, whatever is
    stated. Where nothing is stated, beams must surely take the time from scan to scan.
    """
    period = float(np.median(np.diff(log.scan_t))) if len(log.scans) > 1 else 0.0
    one = len({scan.T_robot_sensor.tobytes() for scan in log.scans}) == 1
    if not one or not 0.0 < period <= LONGEST_PAUSE or not 0.0 <= log.sweep <= LONGEST_SHARE * period:
        return 0.0
    opening = float(np.median([abs(scan.angle_increment) * (len(scan.ranges) - 1) for scan in log.scans]))
    if opening < ALL_ROUND:
        return log.sweep
    sweep = log.sweep if log.sweep >= FASTEST else period if period <= SLOWEST else 0.0
    if sweep == 0.0:
        return 0.0
    rows = _turning(log)
    tried = [_on_lines(log, rows, time, beam, front_end) for time in (sweep, -sweep, 0.0)]
    turns = np.min([rate for _, rate in tried], axis=0) * sweep >= TURNS
    if int(turns.sum()) < LEAST_TURNS:
        return 0.0
    one_way, other, moment = (np.where(turns, share, 0.0) for share, _ in tried)
    sure = _sureness(one_way - other)
    found, better = (sweep, one_way) if sure > 0 else (-sweep, other)
    least = -SURE if log.sweep > 0.0 else SURE
    return found if abs(sure) > SURE and _sureness(better - moment) > least else 0.0


def _sureness(more: Float[np.ndarray, " n"]) -> float:
    """The sum of these in its standard errors; some depend on their neighbours."""
    sd = float(np.sqrt((np.add.reduceat(more, np.arange(0, len(more), BLOCK)) ** 2).sum()))
    return float(more.sum()) / sd if sd > 0 else 0.0


def swept_by_wheels(log: LaserLog, beam: BeamConfig, front_end: FrontEndConfig) -> LaserLog:
    """The log with each scan's motion as its wheels have it, which is told; as it is where none takes its time."""
    sweep = sweep_of(log, beam, front_end)
    wheels = [scan.odometry for scan in log.scans]
    if sweep == 0.0 or any(pose is None for pose in wheels):
        return log
    at = np.array(wheels, dtype=float)
    step, since = se2.between(at[:-1], at[1:]), np.diff(log.scan_t)
    rest = (swept(*row, sweep) for row in zip(log.scans[1:], step, since.tolist(), strict=True))
    told = Finding("scans-swept", log.robot, value=sweep)
    return replace(log, scans=(log.scans[0], *rest), findings=(*log.findings, told))


def _turning(log: LaserLog) -> range:
    """The stretch of scans in which what is seen changes most: there the robot turns."""
    n = len(log.scans)
    if n <= ASKED:
        return range(n)
    changes = [0.0, *(_change(a, b) for a, b in pairwise(log.scans))]
    total = np.concatenate([[0.0], np.cumsum(changes)])
    first = int(np.argmax(total[ASKED:] - total[:-ASKED]))
    return range(first, first + ASKED)


def _change(a: Scan, b: Scan) -> float:
    """[m] by which the ranges of two scans differ on the median."""
    if len(a.ranges) != len(b.ranges) or not (both := a.hit & b.hit).any():
        return 0.0
    return float(np.median(np.abs(a.ranges[both] - b.ranges[both])))


def _on_lines(
    log: LaserLog, rows: Sequence[int], sweep: float, beam: BeamConfig, cfg: FrontEndConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The share of each scan's returns that lie on their lines, and how fast the robot turned [rad/s]."""
    local, pose, step = FrontEnd(replace(cfg, alpha=0.0), BARE_TANGENT), np.zeros(3), np.zeros(3)
    share, rate = np.zeros(len(rows)), np.zeros(len(rows))
    before: Scan | None = None
    for k, row in enumerate(rows):
        scan = log.scans[row]
        since = float(log.scan_t[row] - log.scan_t[row - 1]) if k else np.inf
        sd = ALONE_SD
        if before is not None and before.odometry is not None and scan.odometry is not None:
            step = np.asarray(se2.between(before.odometry, scan.odometry))
            sd = allowed_sd(step, cfg)
        b = beams(swept(scan, step, since, sweep), "none", None, beam)
        if len(b.q) < LEAST_RETURNS:
            continue
        rate[k] = abs(float(step[2])) / since if 0.0 < since <= LONGEST_PAUSE else 0.0
        matched = pose if before is None else local.match(b, np.asarray(se2.compose(pose, step)), sd).pose
        share[k] = local.near(b, matched, ON_LINE) / len(b.q)
        local.insert(b, matched)
        pose, step, before = matched, np.asarray(se2.between(pose, matched)), scan
    return share, rate
