"""Any log read once: who is in it, what they say in order of time, as columns or data frames."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import ReaderError, UsageError
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from ..core.names import robot_key, robot_name
from ..core.paths import checked_arguments, path_of
from ..core.records import Event
from ..io.landmark_logs import is_landmark_log, read_landmark_logs
from ..io.laser_logs import read_laser, recordings_in
from ..io.mixed_logs import is_mixed, read_mixed_landmarks, sorted_logs
from .in_memory import each_of
from .map_laser import next_robots, source_of, sources_of
from .map_options import LaserOptions, expect_there

if TYPE_CHECKING:
    from pandas import DataFrame

Columns = dict[str, np.ndarray]


@dataclass(frozen=True, slots=True, repr=False)
class Log:
    """What was recorded, of every robot its own: mended where that is safe, which `findings` tell.

    parts: `LaserLog`s and `LandmarkLog`s, robot after robot; a robot of a mixed team may have one of each.
    """

    sources: tuple[Path, ...]
    parts: tuple[LaserLog | LandmarkLog, ...]

    @property
    def robots(self) -> tuple[str, ...]:
        """The keys of its robots: `"2"` is robot 2."""
        return tuple(dict.fromkeys(robot_key(part.robot) for part in self.parts))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was repaired, left out or is in doubt."""
        return tuple(found for part in self.parts for found in part.findings)

    def events(self) -> Iterator[Event]:
        """What all robots say, in order of time; a robot's landmarks come in one packet."""
        return heapq.merge(*(part.events() for part in self.parts), key=attrgetter("t"))

    def tables(self) -> dict[str, Columns]:
        """Columns by table, those that there are rows of: `poses`, `velocities`, `sightings`, `scans`.

        poses: robot, t [s], x, y [m], theta [rad] of the odometry; velocities: robot, t, v [m/s], w [rad/s];
        sightings: robot, t, id, range [m], bearing [rad]; scans: robot, t, angle_min, angle_increment [rad],
        range_max [m] and ranges, an array a row, NaN where nothing came back.
        """
        rows: dict[str, list[Columns]] = {}
        for part in self.parts:
            for name, columns in _tables(part).items():
                length = len(columns["t"])
                if length:
                    rows.setdefault(name, []).append({"robot": np.full(length, robot_key(part.robot)), **columns})
        return {name: {key: np.concatenate([c[key] for c in some]) for key in some[0]} for name, some in rows.items()}

    def to_pandas(self) -> "dict[str, DataFrame]":
        """`tables` as data frames. Needs the extra `[pandas]`."""
        try:
            from pandas import DataFrame  # noqa: PLC0415  (only who asks for it needs it)
        except ModuleNotFoundError:
            raise UsageError("to_pandas needs pandas: install mapweave with the extra [pandas]") from None
        return {name: DataFrame(columns) for name, columns in self.tables().items()}

    def __repr__(self) -> str:
        robots = f"{len(self.robots)} robots" if len(self.robots) > 1 else "1 robot"
        return f"<Log: {robots}, {', '.join(map(str, self.sources))[:200]}>"


def _tables(part: LaserLog | LandmarkLog) -> dict[str, Columns]:
    if isinstance(part, LandmarkLog):
        o, s = part.odometry, part.sightings
        ids = np.array([*s.ids, ""], dtype=np.str_)
        seen = {"t": s.t, "id": ids[s.what], "range": s.range, "bearing": s.bearing}
        return {"sightings": seen} if o is None else {"velocities": {"t": o.t, "v": o.v, "w": o.w}, "sightings": seen}
    ranges = np.empty(len(part.scans), dtype=object)
    for k, scan in enumerate(part.scans):
        ranges[k] = np.where(scan.hit, scan.ranges, np.nan)
    numbers = {
        name: np.array([getattr(scan, name) for scan in part.scans], dtype=float)
        for name in ("angle_min", "angle_increment", "range_max")
    }
    scans = {"t": part.scan_t, **numbers, "ranges": ranges}
    if part.odometry is None:
        return {"scans": scans}
    x, y, theta = part.odometry.pose.T
    return {"poses": {"t": part.odometry.t, "x": x, "y": y, "theta": theta}, "scans": scans}


@checked_arguments
def read(logs: Path | str | Sequence[Path | str], *, laser: LaserOptions | None = None) -> Log:
    """What `logs` hold, of one robot or of a team, in whatever format `map` takes.

    `map` takes it in place of the files.

    Parameters
    ----------
    logs
        One or more logs as for `map`: recordings (.bag, .db3, .mcap), CARMEN, MRCLAM, tables and others, or folders.
    laser
        Which topics or columns are read, and where the scanner stands, as for `map`.

    Raises
    ------
    ReaderError
        For a log that is missing, damaged or of no format that is known, with file and line.
    DataError
        For logs that contradict each other.

    Examples
    --------
    >>> drive = simulate_laser("drive.mcap", CorridorConfig(distance=4.0), seed=1)
    >>> log = read("drive.mcap")
    >>> log.robots, len(log.tables()["scans"]["t"]) == len(drive.log.scans)
    (('1',), True)
    >>> map(log).maps[0].robot
    '1'
    """
    paths = [path_of(one, "logs", "paths") for one in each_of(logs)]
    if not paths:
        raise UsageError("logs: expected a log, found none")
    expect_there(paths)
    source = source_of(laser or LaserOptions())
    parts: list[LaserLog | LandmarkLog] = []
    if is_mixed(paths):
        by_kind = sorted_logs(paths, source)
        parts = [one for one in read_mixed_landmarks(by_kind) if len(one)]
        parts += [read_laser(of.path, robot_key(robot), of.source) for robot, of in by_kind.lasers.items()]
        return Log(tuple(paths), tuple(parts))
    paths = [recording for path in paths for recording in recordings_in(path)]
    lasers = [path for path in paths if not is_landmark_log(path)]
    parts += [one for path in paths if path not in lasers for one in read_landmark_logs(path)]
    held = [(path, of) for path in lasers for of in sources_of(path, source)]
    for robot, (path, of) in zip(next_robots((), len(held)), held, strict=True):
        parts.append(read_laser(path, robot, of))
    if twice := [p.robot for k, p in enumerate(parts) if p.robot in {other.robot for other in parts[:k]}]:
        raise ReaderError(paths[-1], f"expected every robot once, found {robot_name(twice[0])} twice")
    return Log(tuple(paths), tuple(parts))


def parts_of(logs: Sequence[Any]) -> list[Any]:
    """`logs` with the parts of those that were read in their place."""
    return [part for log in logs for part in (log.parts if isinstance(log, Log) else (log,))]
