"""Going on from a finished laser result: which of its robots a log belongs to, or that it is a new one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import DataError
from ..core.laser_log import LaserLog
from ..core.names import robot_name
from ..io.laser_state import LaserState
from ..laser.laser_map import LaserMap


@dataclass(frozen=True, slots=True)
class Resumed:
    """What stands when going on. robots: the key each log is mapped under; notes: what was found, in words."""

    state: LaserState
    robots: tuple[str, ...]
    notes: tuple[str, ...]

    def maps(self, fresh: Sequence[LaserMap]) -> tuple[LaserMap, ...]:
        """Every robot's map: the old ones, those that went on in their place, then the new ones."""
        by_robot = {made.robot: made for made in fresh}
        old = [by_robot.pop(made.robot, made) for made in self.state.maps]
        return (*old, *by_robot.values())


def next_robots(there: Sequence[str], count: int) -> list[str]:
    """Keys for so many new robots: the numbers after the greatest there is."""
    last = max((int(robot) for robot in there if robot.isdecimal()), default=0)
    return [str(last + k) for k in range(1, count + 1)]


def resumed(folder: Path, state: LaserState, logs: Sequence[LaserLog]) -> Resumed:
    """What the result in `folder` makes of further `logs`.

    A log that begins with all the scans of one that is in the result already is that log, longer: its robot is mapped
    anew and keeps its number; the others get the next numbers. Raises DataError for a log that is in the result as it
    is, and for two that go on from the same robot.
    """
    robots: list[str] = []
    notes: list[str] = []
    fresh = next_robots([made.robot for made in state.maps], len(logs))
    for log in logs:
        own = next((made for made in state.maps if _begins_as(log, made)), None)
        if own is None:
            robots.append(fresh.pop(0))
            continue
        name, n = robot_name(own.robot), len(own.scans)
        if n == len(log.scans):
            raise DataError(f"{log.source}: these scans are in {folder} already, as {name}")
        if own.robot in robots:
            raise DataError(f"{log.source}: two logs begin as that of {name} in {folder}, expected one")
        robots.append(own.robot)
        notes.append(f"{name}: its log goes on, from scan {n + 1} to {len(log.scans)}")
    return Resumed(state, tuple(robots), tuple(notes))


def _begins_as(log: LaserLog, made: LaserMap) -> bool:
    n = len(made.scans)
    return 0 < n <= len(log.scans) and made.scan_hash == log.scan_hash(n)
