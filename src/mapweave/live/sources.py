"""Where a live robot's rows come from: a log played at any rate, or a simulated team."""

import re
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import UsageError
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order, robot_key, robot_name
from ..io.landmark_logs import is_landmark_log, read_landmark_logs

SIMULATED = ("sim:landmarks", "sim:office")


@dataclass(frozen=True, slots=True)
class Source:
    """What one robot drives through. log: all of it, as a reader gives it."""

    log: LandmarkLog
    told: str


def open_source(source: str, name: str, robot: str | None) -> Source:
    """The log of one robot of `source`; raises UsageError when it is none or doesn't hold the robot.

    robot: which one of those in the log; when None the one that `name` ends with the number of, or the only one.
    """
    path = Path(source)
    if not path.exists():
        raise UsageError(f"--source {source}: no such file or folder")
    if not is_landmark_log(path):
        raise UsageError(f"--source {source}: expected an MRCLAM data set or a folder with sightings.csv")
    logs = {log.robot: log for log in read_landmark_logs(path)}
    return Source(logs[_chosen(sorted(logs, key=in_order), name, robot, source)], source)


def _chosen(robots: list[str], name: str, robot: str | None, source: str) -> str:
    there = ", ".join(map(robot_key, robots))
    if robot is not None:
        if robot_name(robot) not in robots:
            raise UsageError(f"--robot {robot}: {source} holds robots {there}")
        return robot_name(robot)
    number = re.search(r"(\d+)$", name)
    if number is not None and f"robot{int(number[1])}" in robots:
        return f"robot{int(number[1])}"
    if len(robots) == 1:
        return robots[0]
    raise UsageError(f"--robot: which robot is {name}? {source} holds {there}")
