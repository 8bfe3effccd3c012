"""CARMEN text logs: FLASER, RLASER, ODOM and ROBOTLASER with remission; and what GMapping writes of them (`.gfs`)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..core import se2
from ..core.findings import Unused
from ..core.laser_log import LaserLog
from .assemble import UNSOUND, RawLog, RawScan, is_sound, median_pose
from .files import TextFormat, TextLog, is_number

READING = "LASER_READING"  # of GMapping
SCANS = ("FLASER", "RLASER", "ROBOTLASER1", "ROBOTLASER2", READING)
KEYWORDS = (*SCANS, "ODOM")
OTHER = (  # what robots of this kind write beside, in any number before the first scan
    *("PARAM", "SYNC", "NEFF", "TRUEPOS", "MARKER", "MESSAGE_NAME", "BUMPER", "SONAR", "IMU", "NMEAGGA", "NMEARMC"),
    *(f"RAWLASER{k}" for k in range(1, 6)),
    *("LASER3", "LASER4", "LASER5", "ROBOTLASER3", "ROBOTLASER4", "ROBOTLASER5", "REMISSIONFLASER", "REMISSIONRLASER"),
    *("PANTILT", "SCANMARK", "POSITIONLASER", "LASERGLASS"),
)
LARGEST_COUNT = 1e9  # of beams: a row says less
NO_RETURN = 81.0  # [m]: what SICK scanners say when nothing comes back is 81.83 or 81.91
WRONG_OFFSET = 0.05  # [m or rad]: a sensor whose place on the robot varies more has been corrected by another program


def is_carmen(log: TextLog) -> bool:
    return any(words[0] in KEYWORDS for words in log.head(passed=OTHER))


def read_carmen(
    log: TextLog, robot: str, *, sensor_pose: Sequence[float] | None = None, mirrored: bool = False
) -> LaserLog:
    """The log. Stamps are the `ipc` ones; a last line cut short is dropped and counted.

    Sensor poses are the middle of laser pose against robot pose over the whole log. Raises ReaderError, naming the
    line, for a row that does not have the fields it announces.
    """
    raw = RawLog(robot, str(log.path), log.log_hash, odometry_from="poses")
    kinds: list[str] = []
    other: Counter[str] = Counter()
    rows = log.rows()
    # GMapping's rows of odometry bear the stamp of the reading after the one whose pose they tell
    late = next((words[0] for _, words in rows if words[0] in SCANS), "") == READING

    def take(words: list[str]) -> None:
        if words[0] == "ODOM" and not late:
            raw.odometry.append(_odometry(words))
        elif words[0] in SCANS:
            scan = _READ[words[0]](words)
            if is_sound(scan):
                raw.scans.append(scan)
                kinds.append(words[0])
            else:
                raw.dropped[UNSOUND] += 1
        elif words[0].isupper():
            other[words[0]] += 1

    raw.read_rows(log, rows, take)
    raw.unused = [
        Unused(raw.source, kind, kind, n, "rows of no kind that is read") for kind, n in sorted(other.items())
    ]
    place_sensors(raw, kinds)
    _find_no_return(raw)
    return raw.finish(mirrored=mirrored, sensor_pose=sensor_pose)


def _numbers(words: list[str]) -> np.ndarray:
    try:
        return np.array(words, dtype=float)
    except ValueError:
        bad = next(word for word in words if not is_number(word))
        raise ValueError(f"expected a number, found {bad!r}") from None


def _odometry(words: list[str]) -> tuple[float, float, float, float]:
    if len(words) < 8:
        raise ValueError(f"ODOM needs 7 numbers, found {len(words) - 1}")
    x, y, theta = _numbers(words[1:4])
    return float(_numbers(words[7:8])[0]), float(x), float(y), float(theta)


def _announced(words: list[str], at: int, what: str) -> int:
    count = _numbers(words[at : at + 1])
    if len(count) != 1 or not 0 <= count[0] < LARGEST_COUNT or count[0] != np.round(count[0]):
        raise ValueError(f"{words[0]} must say how many {what} follow, found {' '.join(words[at : at + 1])!r}")
    return int(count[0])


def _flaser(words: list[str]) -> RawScan:
    """`FLASER n r.. laser_x laser_y laser_th odom_x odom_y odom_th ipc host logger`."""
    n = _announced(words, 1, "ranges")
    tail = words[2 + n :]
    if n < 2 or not 7 <= len(tail) <= 9 or not all(map(is_number, tail[:7])):
        raise ValueError(f"{words[0]} says {n} ranges, found {max(0, len(words) - 11)}")
    ranges, numbers = _numbers(words[2 : 2 + n]), _numbers(tail[:7])
    host = tail[7] if len(tail) > 7 else ""
    return _front(ranges, numbers[3:6], sensor_place(numbers[3:6], numbers[0:3]), float(numbers[6]), host)


def _reading(words: list[str]) -> RawScan:
    """`LASER_READING n r.. odom_x odom_y odom_th stamp`, which does not tell where the laser stands."""
    n = _announced(words, 1, "ranges")
    if n < 2 or len(words) != 6 + n:
        raise ValueError(f"{words[0]} says {n} ranges, found {max(0, len(words) - 6)}")
    numbers = _numbers(words[2:])
    return _front(numbers[:n], numbers[n : n + 3], np.zeros(3), float(numbers[n + 3]), "")


def _front(ranges: np.ndarray, odometry: np.ndarray, T_robot_sensor: np.ndarray, t: float, host: str) -> RawScan:
    """A scan of the half plane ahead."""
    n = len(ranges)
    step = np.pi / n if n % 2 == 0 else np.pi / (n - 1)
    return RawScan(t, ranges, None, -np.pi / 2, step, 0.0, NO_RETURN, T_robot_sensor, host, odometry)


def _robotlaser(words: list[str]) -> RawScan:
    """`ROBOTLASER1 type start fov step max accuracy remission_mode n r.. m i.. laser robot .. ipc host logger`."""
    head = _numbers(words[2:6])
    n = _announced(words, 8, "ranges")
    if len(words) < 10 + n:
        raise ValueError(f"{words[0]} says {n} ranges, found {len(words) - 9}")
    m = _announced(words, 9 + n, "remissions")
    tail = words[10 + n + m :]
    if len(head) < 4 or len(tail) < 12:
        raise ValueError(f"{words[0]} says {n} ranges and {m} remissions, found {len(words) - 9} fields after them")
    start, fov, step, far = head
    numbers = _numbers(tail[:12])
    if step <= 0:
        step = fov / max(1, n - 1)
    return RawScan(
        float(numbers[11]),
        _numbers(words[9 : 9 + n]),
        _numbers(words[10 + n : 10 + n + m]) if m == n and m > 0 else None,
        float(start),
        float(step),
        0.0,
        float(far) if far > 0 else NO_RETURN,
        sensor_place(numbers[3:6], numbers[0:3]),
        tail[12] if len(tail) > 12 else "",
        numbers[3:6],
    )


_READ = {
    "FLASER": _flaser,
    "RLASER": _flaser,
    "ROBOTLASER1": _robotlaser,
    "ROBOTLASER2": _robotlaser,
    READING: _reading,
}


@np.errstate(over="ignore", invalid="ignore")
def sensor_place(robot: np.ndarray, laser: np.ndarray) -> np.ndarray:
    """`T_robot_sensor` of robot and laser pose, NaN where they are not finite."""
    return np.asarray(se2.between(robot, laser))


def place_sensors(raw: RawLog, kinds: list[str]) -> None:
    """Gives all scans of one kind one sensor pose."""
    for kind in sorted(set(kinds)):
        mine = [k for k, other in enumerate(kinds) if other == kind]
        pose, spread = median_pose(raw.scans[k].T_robot_sensor for k in mine)
        if spread > WRONG_OFFSET:
            raw.find("sensor-unplaced", f"{kind}: the laser pose moves against the robot pose by {spread:.2f}")
            pose = np.zeros(3)
        for k in mine:
            raw.scans[k] = replace(raw.scans[k], T_robot_sensor=np.round(pose, 6) + 0.0)


def _find_no_return(raw: RawLog) -> None:
    """Lowers `range_max` under the value that stands for "nothing came back", where a log shows one."""
    if not raw.scans:
        return
    limit = no_return_limit(np.concatenate([scan.ranges for scan in raw.scans]))
    raw.scans = [replace(scan, range_max=min(scan.range_max, limit)) for scan in raw.scans]


def no_return_limit(ranges: np.ndarray) -> float:
    """The range [m] from which on values mean no return: under a pile at the very top, else infinite.

    A pile: the top 1 % of the range axis holds a thousandth of all values at least and three times as many as the
    4 % below it.
    """
    values = ranges[np.isfinite(ranges) & (ranges > 0)]
    if not len(values):
        return np.inf
    top = float(values.max())
    pile = int((values >= 0.99 * top).sum())
    below = int(((values >= 0.95 * top) & (values < 0.99 * top)).sum())
    return 0.99 * top if pile >= max(0.001 * len(values), 3 * below, 10) else np.inf


FORMAT = TextFormat(is_carmen, read_carmen)
