"""The URG-04LX log with wheel ticks: one row a scan, microseconds, ticks, ranges in millimetres."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan, odometry_row
from .files import TextFormat, TextLog

FIRST_RANGE = 24  # token at which ranges start; the last token is no range
RADIUS, HALF_AXLE, TICKS_A_TURN = 0.077, 0.165, 2000.0  # [m], [m]
AHEAD = np.array([0.145, 0.0, 0.0])
NEAR, FAR = 0.02, 5.6  # [m]; the scanner's smaller values are error codes
LARGEST = 1e18  # microseconds and ticks are less
OPENING = np.radians(240.0)


def is_wheel_ticks(log: TextLog) -> bool:
    rows = log.head(3)
    return bool(rows) and all(len(w) > FIRST_RANGE + 100 and all(x.lstrip("-").isdigit() for x in w[:4]) for w in rows)


def read_wheel_ticks(
    log: TextLog, robot: str, *, sensor_pose: Sequence[float] | None = None, mirrored: bool = False
) -> LaserLog:
    """The log; odometry is integrated from the ticks and starts at the origin.

    Raises ReaderError, naming the line, for a row whose number of tokens differs from the first one's.
    """
    raw = RawLog(robot, str(log.path), log.log_hash, odometry_from="ticks")
    ticks: list[tuple[float, float]] = []
    rows = log.rows()

    def take(words: list[str]) -> None:
        if len(words) != len(rows[0][1]):
            raise ValueError(f"expected {len(rows[0][1])} tokens, found {len(words)}")
        values = np.array(words[FIRST_RANGE:-1], dtype=float) / 1000.0
        head = np.array(words[:4], dtype=float)
        if not np.abs(head).max() < LARGEST:
            raise ValueError(f"expected stamps and ticks under {LARGEST:g}")
        ticks.append((float(head[2]), float(head[3])))
        step = OPENING / (len(values) - 1)
        raw.scans.append(RawScan(float(head[0]) * 1e-6, values, None, -OPENING / 2, step, NEAR, FAR, AHEAD))

    raw.read_rows(log, rows, take)
    poses = dead_reckoning(np.array(ticks).reshape(-1, 2))
    raw.odometry = [odometry_row(scan.t, pose) for scan, pose in zip(raw.scans, poses, strict=True)]
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def dead_reckoning(ticks: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Poses (n, 3) from left and right wheel counts (n, 2), each step on an arc, from the origin."""
    poses = np.zeros((len(ticks), 3))
    if len(ticks) < 2:
        return poses
    wheel = np.diff(ticks, axis=0) * (2 * np.pi * RADIUS / TICKS_A_TURN)
    twist = np.zeros((len(wheel), 3))
    twist[:, 0] = wheel.mean(axis=1)
    twist[:, 2] = (wheel[:, 1] - wheel[:, 0]) / (2 * HALF_AXLE)
    for k, step in enumerate(se2.exp(twist)):
        poses[k + 1] = se2.compose(poses[k], step)
    return poses


FORMAT = TextFormat(is_wheel_ticks, read_wheel_ticks)
