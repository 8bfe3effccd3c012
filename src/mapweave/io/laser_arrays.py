"""Laser scans and odometry in memory become a log, mended and counted as those of files are."""

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import DataError
from ..core.laser_log import LaserLog
from .assemble import RawLog, RawScan
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
