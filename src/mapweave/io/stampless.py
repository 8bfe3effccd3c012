"""The stampless log: `Odometry x y theta`, then `Laser n r..`, over and over."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan
from .carmen import no_return_limit
from .files import TextFormat, TextLog

STEP = 1.0  # [s] between scans, for want of stamps
AHEAD = np.array([0.40, 0.0, 0.0])  # the laser on the robot these logs were made with
FAR = 8.1  # [m]: the scanner says about 8.19 when nothing comes back


def is_stampless(log: TextLog) -> bool:
    kinds = {words[0] for words in log.head()}
    return bool(kinds) and kinds <= {"Odometry", "Laser"}


def read_stampless(
    log: TextLog, robot: str, *, sensor_pose: Sequence[float] | None = None, mirrored: bool = False
) -> LaserLog:
    """The log, its scans numbered one second apart from zero; the laser is 0.40 m ahead unless `sensor_pose`."""
    raw = RawLog(robot, str(log.path), log.log_hash, odometry_from="poses")
    raw.find("stamps-none", STEP)
    pose = None

    def take(words: list[str]) -> None:
        nonlocal pose
        values = np.array(words[1:], dtype=float)
        if words[0] == "Odometry" and len(values) == 3:
            pose = values
        elif words[0] == "Laser" and len(values) > 2 and values[0] == len(values) - 1:
            raw.scans.append(_scan(len(raw.scans) * STEP, values[1:], pose))
        else:
            raise ValueError(_expected(words))

    raw.read_rows(log, log.rows(), take)
    if raw.scans:
        limit = min(FAR, no_return_limit(np.concatenate([scan.ranges for scan in raw.scans])))
        raw.scans = [replace(scan, range_max=limit) for scan in raw.scans]
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _scan(t: float, ranges: np.ndarray, pose: np.ndarray | None) -> RawScan:
    n = len(ranges)
    return RawScan(t, ranges, None, -np.pi / 2, np.pi / (n - 1), 0.0, FAR, AHEAD, "", pose)


def _expected(words: list[str]) -> str:
    if words[0] == "Laser":
        said = words[1] if len(words) > 1 else "nothing"
        return f"Laser says {said} ranges, found {max(0, len(words) - 2)}"
    return f"expected 'Odometry x y theta' or 'Laser n r..', found {' '.join(words[:5])!r}"


FORMAT = TextFormat(is_stampless, read_stampless)
