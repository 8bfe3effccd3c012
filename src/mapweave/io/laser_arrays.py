"""Laser scans and odometry in memory become a log, mended and counted as those of files are: at once, or one by one."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError
from ..core.laser_log import LaserLog, ScanDigest
from ..core.records import Event, Scan, frozen
from ..core.rows import RowBuffer
from .assemble import RawLog, RawScan, is_sound, scan_of
from .laser_logs import LaserSource
from .table import Columns, array_of

UNEVEN = 1e-6  # [rad] by which steps between beams may differ
REACH = 1.001  # of the largest return: the reach of a scanner that does not say


def laser_log_of(
    scans: Mapping[str, Any], odometry: Columns | None, robot: str = "1", source: LaserSource | None = None
) -> LaserLog:
    """The log of `scans` (`t` (m,) [s], `ranges` (m, n) [m], `angles` (n,) [rad]) and `odometry` (t, x, y, theta).

    `scans` may also hold `intensities` (m, n) and `range_max` [m]; ranges that are NaN, infinite, 0 or reach
    `range_max` are no returns. Raises DataError for shapes that do not fit and beams that are not evenly spaced.
    """
    source = source or LaserSource()
    t = array_of(scans, "t", "scans", 1)
    ranges = array_of(scans, "ranges", "scans", 2)
    angles = array_of(scans, "angles", "scans", 1)
    light = array_of(scans, "intensities", "scans", 2) if "intensities" in scans else None
    if ranges.shape != (len(t), len(angles)) or len(angles) < 2:
        raise DataError(f"scans: expected ranges of {len(t)} scans by {len(angles)} beams, found {ranges.shape}")
    if light is not None and light.shape != ranges.shape:
        raise DataError(f"scans: expected intensities of the shape {ranges.shape}, found {light.shape}")
    first, step = beam_spacing(angles, "scans")
    reach = _reach(scans, ranges)
    raw = RawLog(robot, "scans in memory", _hash(t, ranges, angles, light), odometry_from="poses")
    for k, stamp in enumerate(t.tolist()):
        seen = None if light is None else light[k]
        raw.scans.append(RawScan(stamp, ranges[k], seen, first, step, 0.0, reach))
    if odometry is not None:
        columns = [array_of(odometry, name, "odometry", 1) for name in ("t", "x", "y", "theta")]
        if len({len(column) for column in columns}) > 1:
            raise DataError("odometry: expected t, x, y and theta of one length")
        rows = np.column_stack(columns)
        raw.odometry = [(a, b, c, d) for a, b, c, d in rows.tolist()]
    return raw.finish(mirrored=source.mirrored, sensor_pose=source.sensor_pose)


def beam_spacing(angles: Float[np.ndarray, " n"], where: str) -> tuple[float, float]:
    """The first of at least two beam angles and the step between them [rad]; raises DataError for uneven ones."""
    steps = np.diff(angles)
    if not np.isfinite(angles).all() or np.ptp(steps) > UNEVEN or steps[0] == 0.0:
        raise DataError(f"{where}: expected angles [rad] evenly spaced, found steps that differ")
    return float(angles[0]), float(steps.mean())


def _reach(scans: Mapping[str, Any], ranges: np.ndarray) -> float:
    if "range_max" in scans:
        reach = float(array_of(scans, "range_max", "scans", 0))
        if not (np.isfinite(reach) and reach > 0):
            raise DataError(f"scans: expected a range_max above 0 [m], found {reach:g}")
        return reach
    finite = ranges[np.isfinite(ranges)]
    return float(finite.max()) * REACH if len(finite) else 1.0


def _hash(*parts: np.ndarray | None) -> str:
    digest = hashlib.sha256()
    for part in parts:
        if part is not None:
            digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


Numbers = np.ndarray | Sequence[object]  # what becomes an array of numbers, or is refused
NOWHERE = (0.0, 0.0, 0.0)  # [m], [m], [rad]: the sensor stands on the robot
NO_RANGES = frozen(np.zeros(0))


class LaserStream:
    """The scans of one robot so far. `add` changes it.

    A scan is refused with DataError, and the stream is as before, when it is older than the one before it, when its
    arrays do not fit each other, when a pose or angle is not finite, and when it brings odometry or intensities though
    those before did not, or lacks what they had.
    """

    def __init__(self, robot: str = "1") -> None:
        self.robot, self.source = robot, "scans as they came"
        self._raw: list[RawScan] = []  # of those forgotten: one for all that were alike but for stamp and odometry
        self._t, self._odometry = RowBuffer(), RowBuffer(3)
        self._alike: dict[tuple[float, float, float, bytes], RawScan] = {}
        self._digest = hashlib.sha256()
        self._scans = ScanDigest()

    def __len__(self) -> int:
        return len(self._raw)

    def add(
        self,
        t: float,
        ranges: Numbers,
        angles: Numbers,
        *,
        odometry: Numbers | None = None,
        intensities: Numbers | None = None,
        range_max: float = np.inf,
        sensor_pose: Numbers = NOWHERE,
    ) -> Event:
        """The scan as an event for an estimator.

        t [s]; ranges (n,) [m], of which those that are NaN, infinite, 0 or reach `range_max` are no returns; angles
        (n,) [rad] evenly spaced, counter-clockwise from the sensor's x; odometry (3,) `T_odom_robot` at `t`;
        intensities (n,); sensor_pose `T_robot_sensor` [m, m, rad].
        """
        where = f"scan at {t} s"
        r, direction = _array(ranges, "ranges", where), _array(angles, "angles", where)
        light = None if intensities is None else _array(intensities, "intensities", where)
        pose = None if odometry is None else frozen(_array(odometry, "odometry", where))
        mount = self._mounted(_array(sensor_pose, "sensor_pose", where))
        if len(direction) < 2 or r.shape != direction.shape:
            raise DataError(
                f"{where}: expected as many ranges as angles, 2 or more, found {len(r)} and {len(direction)}"
            )
        if light is not None and light.shape != r.shape:
            raise DataError(f"{where}: expected {len(r)} intensities, found {len(light)}")
        for name, given in (("odometry", pose), ("sensor_pose", mount)):
            if given is not None and given.shape != (3,):
                raise DataError(f"{where}: expected {name} as x, y, theta, found {len(given)} numbers")
        if not range_max > 0:
            raise DataError(f"{where}: expected a range_max above 0 [m], found {range_max:g}")
        first, step = beam_spacing(direction, where)
        raw = RawScan(float(t), r, light, first, step, 0.0, range_max, mount, odometry=pose)
        if not is_sound(raw):
            raise DataError(f"{where}: expected a stamp and poses that are finite, found others")
        self._check_order(raw, where)
        self._raw.append(raw)
        self._t.append(raw.t)
        self._odometry.append(np.nan if pose is None else pose)
        for part in (np.array([t, first, step]), r, light, pose):
            self._digest.update(b"-" if part is None else part.tobytes())
        scan = _with_odometry(raw)
        self._scans.add(raw.t, scan)
        return Event(raw.t, self.robot, scan)

    def forget(self, rows: range) -> None:
        """The ranges of these scans are not kept: the log has the scans without them and says of which it was made."""
        for row in rows:
            raw = self._raw[row]
            alike = (raw.angle_min, raw.angle_increment, raw.range_max, raw.T_robot_sensor.tobytes())
            if alike not in self._alike:
                self._alike[alike] = replace(raw, ranges=NO_RANGES, intensities=None, odometry=None, kept=False)
            self._raw[row] = self._alike[alike]

    def log(self) -> LaserLog:
        """Everything so far as a log; raises DataError when nothing came."""
        scans = [raw if raw.kept else self._remembered(row) for row, raw in enumerate(self._raw)]
        raw = RawLog(self.robot, self.source, self._digest.hexdigest(), scans, odometry_from="poses")
        return replace(raw.finish(used=True), told_hash=self._scans.hexdigest)

    def _remembered(self, row: int) -> RawScan:
        """What is left of a scan that was forgotten."""
        odometry = self._odometry[row]
        own = None if np.isnan(odometry).any() else frozen(odometry)
        return replace(self._raw[row], t=float(self._t[row]), odometry=own)

    def _mounted(self, pose: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The same array as of the scan before where it is the same pose: most scanners stay where they are."""
        last = self._raw[-1].T_robot_sensor if self._raw else None
        return last if last is not None and last.tobytes() == pose.tobytes() else frozen(pose)

    def _check_order(self, raw: RawScan, where: str) -> None:
        if not self._raw:
            return
        last = self._raw[-1] if self._raw[-1].kept else self._remembered(len(self._raw) - 1)
        near = range(max(0, len(self._raw) - 8), len(self._raw))
        same = last.t == raw.t and any(
            np.array_equal(self._raw[k].T_robot_sensor, raw.T_robot_sensor) for k in near if self._t[k] == raw.t
        )
        if raw.t < last.t or same:
            raise DataError(f"{where}: expected a stamp after the last scan's, {last.t!r} s")
        for name, now, before in (
            ("odometry", raw.odometry, last.odometry),
            ("intensities", raw.intensities, last.intensities),
        ):
            if (now is None) != (before is None):
                said = "none, though the scans before had" if now is None else "some, though the scans before had none"
                raise DataError(f"{where}: {name}: found {said}")


def _array(values: Numbers, name: str, where: str) -> Float[np.ndarray, " n"]:
    """A copy of one's own, of one dimension."""
    try:
        out = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise DataError(f"{where}: {name}: expected numbers, found something else") from None
    if out.ndim != 1:
        raise DataError(f"{where}: {name}: expected an array of one dimension, found {out.ndim}")
    return out


def _with_odometry(raw: RawScan) -> Scan:
    scan = scan_of(raw)
    return scan if raw.odometry is None else replace(scan, odometry=frozen(raw.odometry))
