"""What scenarios of every kind say about their world: walls, starts, how many robots; and what is too large to explore.

A world beyond these limits is refused with its number before anything is allocated for it.
"""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.errors import ConfigError, UsageError
from ..core.walls import Walls
from ..io.ros_map import RosMap, read_plan, read_ros_map

Segment = tuple[float, float, float, float]  # x0 y0 x1 y1 [m]
Pose = tuple[float, float, float]
MOST_ROBOTS = 200  # whose joint planning still takes seconds
MOST_WALLS = 200_000  # segments
MOST_CELLS = 25_000_000  # of a raster laid over the world: 500 m x 500 m in cells of 0.1 m
MOST_KNOWN = 10_000_000  # cells times robots, each of which keeps what it has seen
MOST_PIXELS = 25_000_000  # of a plan
FARTHEST = 1e5  # [m] from the origin along each axis


@config
class WorldConfig:
    """Walls and starts. Lengths in metres, headings in radians; a file's name is relative to the TOML file."""

    walls: str | tuple[Segment, ...] | None = None  # a ROS map.yaml, an image, or segments x0 y0 x1 y1 [m]
    resolution: float | None = None  # [m] a pixel of an image
    origin: tuple[float, float] | Pose = (0.0, 0.0)  # [m], [rad], lower left corner of an image and its turn
    starts: tuple[Pose, ...] | None = None  # [m], [rad], one a robot


W = TypeVar("W", bound=WorldConfig)


def checked_world(path: Path, world: W) -> W:
    """`world` as the file `path` describes it, its file of walls found from there.

    Raises ConfigError, naming `path`, when walls or starts of it cannot be or lie too far away.
    """
    if world.starts is not None:
        if not world.starts:
            raise ConfigError(f"{path}: starts: expected [[x, y, theta], ...], one a robot, found none")
        check_places(f"{path}: starts", np.array(world.starts))
        check_robots(len(world.starts), f"{path}: starts")
    check_places(f"{path}: origin", np.array([world.origin[:2]]))
    if isinstance(world.walls, tuple):
        if not world.walls:
            raise ConfigError(f"{path}: walls: expected segments [x0, y0, x1, y1], found none")
        if len(world.walls) > MOST_WALLS:
            raise ConfigError(f"{path}: walls: expected at most {MOST_WALLS:,}, found {len(world.walls):,}")
        check_places(f"{path}: walls", np.array(world.walls))
        for k, (x0, y0, x1, y1) in enumerate(world.walls):
            if (x0, y0) == (x1, y1):
                raise ConfigError(
                    f"{path}: walls.{k}: expected x0, y0, x1, y1, found a wall without length at ({x0:g}, {y0:g})"
                )
    if isinstance(world.walls, str):
        return replace(world, walls=str(path.parent / Path(world.walls).expanduser()))
    return world


def check_places(what: str, places: Float[np.ndarray, "n k"]) -> None:
    """Raises ConfigError, beginning with `what`, when a coordinate is no number or beyond `FARTHEST`."""
    for k, row in enumerate(places):
        wild = [v for v in row if not abs(v) <= FARTHEST]
        if wild:
            raise ConfigError(f"{what}.{k}: expected numbers up to {FARTHEST:g}, found {wild[0]:g}")


def check_robots(robots: int | None, what: str = "--robots") -> None:
    """Raises UsageError, beginning with `what`, for fewer robots than one or more than `MOST_ROBOTS`."""
    if robots is not None and robots < 1:
        raise UsageError(f"{what}: expected at least 1, found {robots}")
    if robots is not None and robots > MOST_ROBOTS:
        raise UsageError(f"{what}: expected at most {MOST_ROBOTS} robots, found {robots:,}")


def check_cells(
    what: str, lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"], cell: float, most: float = MOST_CELLS
) -> None:
    """Raises ConfigError, beginning with `what`, when cells of `cell` [m] over the rectangle are more than `most`."""
    width, height = (np.asarray(upper, float) - lower).tolist()
    cells = float(np.ceil(width / cell)) * float(np.ceil(height / cell))
    if not cells <= most:
        raise ConfigError(
            f"{what}: a world of {width:g} m x {height:g} m in cells of {cell:g} m has {cells:.3g} of them, "
            f"expected at most {most:.3g}"
        )


def floor_plan(world: WorldConfig) -> RosMap | None:
    """The map or image that `walls` names, read; None where it names none.

    Raises ReaderError for a damaged or too large file and ConfigError for an image of which nobody says how large it
    is, or a plan that reaches too far.
    """
    if not isinstance(world.walls, str):
        return None
    return _read_plan(world.walls, world.resolution, world.origin)


@lru_cache(maxsize=4)
def _read_plan(name: str, resolution: float | None, origin: tuple[float, ...]) -> RosMap:
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        plan = read_ros_map(path, most_pixels=MOST_PIXELS)
    elif resolution is None or resolution <= 0:
        raise ConfigError(f"{path}: an image as walls needs `resolution` [m a pixel] above 0 and `origin` beside it")
    else:
        plan = read_plan(path, resolution, np.array([*origin, 0.0][:3]), most_pixels=MOST_PIXELS)
    check_places(f"{path}: a plan of {plan.resolution:g} m a pixel: corner", np.stack(plan.extent()))
    return plan


def plan_walls(path: str, plan: RosMap) -> Walls:
    """Solid walls of the plan that `path` names. Raises ConfigError when they are more than `MOST_WALLS` segments."""
    walls = plan.walls()
    if len(walls.segments) > MOST_WALLS:
        raise ConfigError(f"{path}: expected at most {MOST_WALLS:,} segments of wall, found {len(walls.segments):,}")
    return walls


def wall_segments(world: WorldConfig) -> Walls | None:
    """Thin walls of the segments that `walls` lists; None where it lists none."""
    if not isinstance(world.walls, tuple):
        return None
    return Walls.of(np.array(world.walls, dtype=float).reshape(-1, 4))


def given_starts(world: WorldConfig, robots: int | None) -> Float[np.ndarray, "r 3"] | None:
    """The first `robots` of the scenario's starts, all without a number; None where it has none of its own.

    Raises UsageError when it has fewer.
    """
    if world.starts is None:
        return None
    starts = np.array(world.starts, dtype=float).reshape(-1, 3)
    check_enough(robots, len(starts))
    return starts[:robots]


def check_enough(robots: int | None, starts: int) -> None:
    """Raises UsageError when more robots are asked for than there are starts."""
    if robots is not None and robots > starts:
        raise UsageError(f"--robots: {robots} asked for, the scenario has {starts} starts")
