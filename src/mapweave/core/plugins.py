"""What may be plugged in without opening this package: log formats, scan matchers, planners, by entry points.

A package names its own in its `pyproject.toml`, as `[project.entry-points."mapweave.readers"] mine = "package:object"`;
those of this one are registered the same way. `doctor` tells what is there.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from .errors import UsageError
from .laser_log import LaserLog

OURS = __name__.partition(".")[0]


class Text(Protocol):
    """A text file that is read: where it lies, all its text, and its lines with their numbers from 1."""

    path: Path
    text: str

    def lines(self) -> Iterator[tuple[int, str]]: ...


@runtime_checkable
class Reader(Protocol):
    """A format of laser logs that are text; `mapweave.readers`. Asked after those of this package.

    `read` raises ReaderError with file and line for what it cannot read. sensor_pose: `T_robot_sensor` [m, m, rad]
    where the log does not tell it; mirrored: beams run clockwise.
    """

    def reads(self, log: Any) -> bool: ...
    def read(self, log: Any, robot: str, *, sensor_pose: Any, mirrored: bool) -> LaserLog: ...


@runtime_checkable
class Matcher(Protocol):
    """What is known around a robot, and where a scan fits in; `mapweave.matchers`, made as `matcher(cfg, tangent)`.

    Poses are (3,) [m, m, rad] in its own frame. Of a scan, in the robot's frame: `b.s` (n, 2) points [m], `b.normal`
    (n, 2) of the walls there, `b.q` (n,) light. A match is a
    `mapweave.laser.scan_matching.ScanMatch`: pose, information (3, 3) over robot-frame x, y, theta, innovation (3,)
    against the pose that was expected, and how many of how many beams match.
    """

    def match(self, b: Any, predicted: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]) -> Any:
        """The match of scan `b`, expected at `predicted` with standard deviations `sd`; nothing is added."""

    def match_alone(
        self, b: Any, last: Float[np.ndarray, "3"], step: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]
    ) -> Any:
        """The match of a scan of which only the last pose and the last motion are known."""

    def insert(self, b: Any, pose: Float[np.ndarray, "3"]) -> bool:
        """What scan `b` at `pose` saw is known from now on, where that is worth it: whether it was."""

    def hold(self, scans: Sequence[tuple[Any, Float[np.ndarray, "3"]]]) -> None:
        """These scans, each at its pose, are all that is known."""

    def information(self, b: Any, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """What the walls alone tell of a scan at `pose`, over robot-frame x, y, theta."""


@runtime_checkable
class Planner(Protocol):
    """Where a team drives next; `mapweave.planners`, called `landmarks.NAME` or `laser.NAME` by what robots carry."""

    def __call__(self, belief: Any, poses: Float[np.ndarray, "r 3"], cfg: Any) -> Float[np.ndarray, "r 2"]:
        """The commands of every robot, v [m/s] and w [rad/s], for what the team believes."""


KINDS = ("readers", "matchers", "planners")


@cache
def plugged(kind: str) -> dict[str, EntryPoint]:
    """All that is plugged in of a kind (`readers`, `matchers`, `planners`), by name, this package's own first.

    Raises UsageError where not even those are registered.
    """
    found = sorted(entry_points(group=f"{OURS}.{kind}"), key=lambda one: (not is_ours(one), one.name))
    if not found or not is_ours(found[0]):
        raise UsageError(f"the {kind} of {OURS} are not registered: install it anew (pip install -e . of its sources)")
    return {one.name: one for one in found if one.name not in {two.name for two in found[: found.index(one)]}}


def is_ours(found: EntryPoint) -> bool:
    """Whether this package itself has registered it."""
    return found.value.partition(".")[0] == OURS


def plugged_in(kind: str, name: str, option: str) -> Any:
    """What is plugged in under `name`; raises UsageError that names `option` and those there are."""
    there = plugged(kind)
    if name not in there:
        raise UsageError(f"{option}: expected one of {', '.join(there)}, found {name!r}")
    return load(there[name])


def load(found: EntryPoint) -> Any:
    """The object an entry point names; raises UsageError where its package cannot be imported or lacks it."""
    try:
        return found.load()
    except Exception as error:
        whose = f" of {found.dist.name}" if found.dist is not None else ""
        problem = f"{type(error).__name__}: {error}"
        raise UsageError(f"{found.group} {found.name!r}{whose}: {found.value} cannot be loaded ({problem})") from error
