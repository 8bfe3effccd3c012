"""Rows of `O x y theta t` and `L x y theta xl yl thetal r1 .. r180 t` in centimetres and radians, as of Wean Hall."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..core.laser_log import LaserLog
from .assemble import UNSOUND, RawLog, RawScan, is_sound
from .carmen import place_sensors, sensor_place
from .files import TextFormat, TextLog

BEAMS = 180
NUMBERS = {"O": 4, "L": 6 + BEAMS + 1}
STEP = np.pi / BEAMS
FIRST = -np.pi / 2 + STEP / 2  # [rad]: the readings stand in the middle of their degree
NO_RETURN = 81.0  # [m]: the scanner says 8183 cm and more when nothing comes back


def is_wean(log: TextLog) -> bool:
    """Whether half of the first rows or more are `O` or `L` with as many numbers as these have."""
    rows = log.head()
    return 2 * sum(len(w) - 1 == NUMBERS.get(w[0], -1) for w in rows) >= max(1, len(rows))


def read_wean(
    log: TextLog, robot: str, *, sensor_pose: Sequence[float] | None = None, mirrored: bool = False
) -> LaserLog:
    """The log in metres. A last line cut short is dropped and counted.

    The sensor pose is the middle of laser pose against robot pose over the whole log. Raises ReaderError, naming the
    line, for a row that has not the numbers of its kind.
    """
    raw = RawLog(robot, str(log.path), log.log_hash, odometry_from="poses")

    def take(words: list[str]) -> None:
        values = _numbers(words)
        if words[0] == "O":
            x, y, theta, t = values.tolist()
            raw.odometry.append((t, x / 100.0, y / 100.0, theta))
            return
        pose, laser = _metres(values[:3]), _metres(values[3:6])
        ranges, place, t = values[6:-1] / 100.0, sensor_place(pose, laser), float(values[-1])
        scan = RawScan(t, ranges, None, FIRST, STEP, 0.0, NO_RETURN, place, odometry=pose)
        if is_sound(scan):
            raw.scans.append(scan)
        else:
            raw.dropped[UNSOUND] += 1

    raw.read_rows(log, [row for row in log.rows() if row[1][0][0] != "#"], take)
    place_sensors(raw, ["L"] * len(raw.scans))
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _numbers(words: list[str]) -> np.ndarray:
    if words[0] not in NUMBERS:
        raise ValueError(f"expected 'O x y theta t' or 'L x y theta xl yl thetal r1 .. t', found {words[0][:20]!r}")
    if len(words) - 1 != NUMBERS[words[0]]:
        raise ValueError(f"{words[0]} needs {NUMBERS[words[0]]} numbers, found {len(words) - 1}")
    return np.array(words[1:], dtype=float)


def _metres(pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return np.array([pose[0] / 100.0, pose[1] / 100.0, pose[2]])


FORMAT = TextFormat(is_wean, read_wean)
