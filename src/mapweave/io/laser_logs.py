"""Any laser log, told apart by what is in it."""

import re
from pathlib import Path

from ..core.config import config
from ..core.errors import ReaderError
from ..core.laser_log import LaserLog
from ..core.names import in_order
from ..core.plugins import Reader, load, plugged
from .files import NotTextError, TextLog, recording_suffix
from .rawlog import is_rawlog, read_rawlog_scans
from .scan_table import ScanTable, read_scan_table
from .unknown import not_known

BAGS = (".bag", ".db3", ".mcap")
PART = re.compile(r"(.*)_(\d+)")  # the name of a part of a recording that was split


@config
class LaserSource:
    """Which robot and topics of a bag are read, and where the sensor stands when the log does not say or is wrong."""

    name: str | None = None  # of the robot, as `robots_of` gives it
    scan_topic: str | None = None
    odom_topic: str | None = None
    sensor_pose: tuple[float, float, float] | None = None  # T_robot_sensor [m, m, rad]
    mirrored: bool = False  # beam angles run clockwise
    height: tuple[float, float] | None = None  # of point clouds what is a scan [m] above the floor
    fixes: str | None = None  # topics that tell where the robot was
    table: ScanTable | None = None  # how text is read, whatever its rows are like


def is_laser_log(path: Path) -> bool:
    """Whether `read_laser` would try: a bag, a rawlog, or a text whose first rows are of a known format."""
    if is_bag(path):
        return True
    if not path.is_file():
        return False
    if is_rawlog(path):
        return True
    try:
        log = TextLog(path)
    except ReaderError:
        return False
    return any(reader.reads(log) for reader in _readers())


def is_bag(path: Path) -> bool:
    """Whether `path` is a recording: a file that begins as one, whatever it is called, or a ROS 2 folder."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(p.suffix in BAGS[1:] for p in path.iterdir())
    return bool(recording_suffix(path))


def recordings_in(path: Path) -> list[Path]:
    """The recordings of a folder without metadata that holds several, one a robot, in natural order; else `path` alone.

    Those that are named as parts of one recording, NAME_0, NAME_1 .., are not taken for robots. Raises ReaderError for
    logs of another kind beside them: which are other robots' and which are copies nobody knows.
    """
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return [path]
    inside = sorted((p for p in path.iterdir() if p.suffix in BAGS), key=lambda p: in_order(p.name))
    if inside and (
        others := sorted(p.name for p in path.iterdir() if p not in inside and p.is_file() and is_laser_log(p))
    ):
        raise ReaderError(
            path, f"expected recordings alone, found other logs beside them: {', '.join(others)}; name each"
        )
    parts = [part for p in inside if (part := PART.fullmatch(p.stem)) is not None]
    split = len(parts) == len(inside) and len({part[1] for part in parts}) == 1 and "0" in {part[2] for part in parts}
    return [path] if len(inside) < 2 or split else inside


def robots_of(path: Path, source: LaserSource) -> tuple[str | None, ...]:
    """The robots of the log at `path`, in natural order of their names; a log of one robot gives None for it.

    Topics given by hand choose one robot, too.
    """
    if not is_bag(path) or source.scan_topic is not None or source.odom_topic is not None:
        return (None,)
    from .ros import robots_in  # noqa: PLC0415  (message types cost a second; only recordings need them)

    names = robots_in(path)
    return names if len(names) > 1 else (None,)


def read_laser(path: Path, robot: str = "1", source: LaserSource | None = None) -> LaserLog:
    """The log at `path` as robot `robot`. Raises ReaderError when its format is not known or the file is damaged."""
    source = source or LaserSource()
    if not path.exists():
        raise ReaderError(path, "no such file")
    if is_bag(path):
        from .ros import read_ros  # noqa: PLC0415  (message types cost a second; only recordings need them)

        return read_ros(
            path,
            robot,
            name=source.name,
            scan_topic=source.scan_topic,
            odom_topic=source.odom_topic,
            sensor_pose=source.sensor_pose,
            mirrored=source.mirrored,
            height=source.height,
            fixes=source.fixes,
        )
    if is_rawlog(path):
        return read_rawlog_scans(path, robot, sensor_pose=source.sensor_pose, mirrored=source.mirrored)
    try:
        log = TextLog(path)
    except NotTextError:
        raise not_known(path) from None
    if source.table is not None:
        return read_scan_table(log, robot, source.table, sensor_pose=source.sensor_pose, mirrored=source.mirrored)
    for reader in _readers():
        if reader.reads(log):
            return reader.read(log, robot, sensor_pose=source.sensor_pose, mirrored=source.mirrored)
    raise not_known(path)


def _readers() -> list[Reader]:
    """Formats of text in the order in which they are asked."""
    return [load(found) for found in plugged("readers").values()]
