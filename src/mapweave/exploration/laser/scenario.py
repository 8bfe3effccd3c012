"""Where a team explores with lasers: an office of any size by name, or walls of the user's own from a TOML file."""

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...core.config import build, config
from ...core.errors import ConfigError, DataError, UsageError
from ...core.walls import Walls
from ...sim.laser import LaserWorld
from ...sim.laser_worlds import GREATEST, LEAST, office_floor
from ..world import (
    WorldConfig,
    check_cells,
    check_enough,
    check_robots,
    check_world,
    floor_plan,
    given_starts,
    plan_walls,
    wall_segments,
)

OFFICE = 500.0  # [m^2], the scenario `office`
TEAM = 2  # robots unless said
FINEST = 0.1  # [m], cells in which a robot's disc is driven everywhere to see what it reaches


@config
class LaserScenarioConfig(WorldConfig):
    """An office by its area, or walls: a ROS map, an image with `resolution` and `origin`, or segments.

    Lengths in metres, headings in radians; a file's name is relative to the TOML file; an office has its own starts.
    """

    sensor: Literal["laser"] = "laser"
    office: float | None = None  # [m^2]
    floor: int | None = None  # the seed of one office for all runs; else each run has its own


@dataclass(frozen=True, slots=True)
class LaserPlace:
    """The world of one run: walls between `lower` and `upper` (2,) [m], and where the robots (M, 3) start."""

    world: LaserWorld
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    starts: Float[np.ndarray, "r 3"]


def find_laser_scenario(name: str) -> LaserScenarioConfig | None:
    """`office`, `office-AREA`, or what a TOML file with `sensor = "laser"` describes; None when it is none of these."""
    if name == "office":
        return LaserScenarioConfig(office=OFFICE)
    if name.startswith("office-"):
        return LaserScenarioConfig(office=_area(name))
    path = Path(name)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError):
        return None  # said by who reads landmark scenarios
    if "sensor" not in values and "office" not in values:
        return None
    scenario = build(LaserScenarioConfig, values, str(path))
    if (scenario.office is None) == (scenario.walls is None):
        raise ConfigError(f"{path}: expected office = AREA or walls, one of them")
    if scenario.floor is not None and scenario.floor < 0:
        raise ConfigError(f"{path}: floor: expected 0 or more, found {scenario.floor}")
    if scenario.office is not None and not LEAST <= scenario.office <= GREATEST:
        raise ConfigError(f"{path}: office: expected {LEAST:g} to {GREATEST:g} m^2, found {scenario.office:g}")
    if scenario.walls is not None and not scenario.starts:
        raise ConfigError(f"{path}: expected starts = [[x, y, theta], ...], one a robot")
    check_world(path, scenario)
    if isinstance(scenario.walls, str):
        return replace(scenario, walls=str(path.parent / scenario.walls))
    return scenario


def make_place(scenario: LaserScenarioConfig, robots: int | None, seed: int) -> LaserPlace:
    """The world of one run; an office follows from `seed` unless the scenario says which floor it is."""
    check_robots(robots)
    if scenario.office is not None:
        floor = office_floor(scenario.office, seed if scenario.floor is None else scenario.floor)
        world, lower, upper, starts = floor.world, floor.lower, floor.upper, floor.starts
        wanted: int | None = TEAM if robots is None else robots
    else:
        walls, lower, upper = _walls(scenario)
        world = LaserWorld(walls.segments, walls.reflectance, walls.solid, "walls")
        starts, wanted = np.zeros((0, 3)), robots
    given = given_starts(scenario, robots)
    if given is None:
        check_enough(wanted, len(starts))
        given = starts[:wanted]
    place = LaserPlace(world, lower, upper, given)
    _check_starts(place)
    return place


def _walls(scenario: LaserScenarioConfig) -> tuple[Walls, np.ndarray, np.ndarray]:
    plan = floor_plan(scenario)
    if plan is not None:
        walls, (lower, upper) = plan_walls(str(scenario.walls), plan), plan.extent()
    else:
        segments = wall_segments(scenario)
        if segments is None or not len(segments.segments):
            raise ConfigError("walls: expected segments [x0, y0, x1, y1] of finite numbers")
        ends = segments.segments.reshape(-1, 2)
        walls, lower, upper = segments, ends.min(axis=0), ends.max(axis=0)
    check_cells("walls", lower, upper, FINEST)
    return walls, lower, upper


def _check_starts(place: LaserPlace) -> None:
    at = place.starts[:, :2]
    if not np.isfinite(place.starts).all():
        raise DataError("starts: expected finite numbers")
    for j in np.flatnonzero(~((at >= place.lower) & (at <= place.upper)).all(axis=1)).tolist():
        raise DataError(f"robot{j + 1} would start outside the walls at ({at[j, 0]:g}, {at[j, 1]:g})")
    for j in np.flatnonzero(place.world.inside(at)).tolist():
        raise DataError(f"robot{j + 1} would start inside a wall at ({at[j, 0]:g}, {at[j, 1]:g})")


def _area(name: str) -> float:
    try:
        area = float(name.removeprefix("office-"))
    except ValueError:
        area = np.nan
    if not LEAST <= area <= GREATEST:
        raise UsageError(f"scenario {name!r}: expected office-AREA with {LEAST:g} to {GREATEST:g} m^2")
    return area
