"""What can be set about an exploration with lasers: where it is, by name or from a TOML file, robots, planning."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from ...core.config import build, config
from ...core.errors import ConfigError, DataError, UsageError
from ...core.walls import Walls
from ...mapping.config import LaserTeamConfig
from ...sim.laser import LaserWorld
from ...sim.laser_team import LaserRobotsConfig
from ...sim.laser_worlds import GREATEST, LEAST, office_floor
from ..world import (
    WorldConfig,
    check_cells,
    check_enough,
    check_robots,
    checked_world,
    floor_plan,
    given_starts,
    plan_walls,
    wall_segments,
)

OCCUPIED_SHARE = 0.2  # share of a cell's beams ending in it that makes it a wall: along a wall's face most go through
ARCS_APART = 0.12  # [m] beyond two radii that a driven arc keeps from the path another robot just chose
WALL_TOLERANCE = 0.1  # [m] from a wall up to which a cell of the map shows it: two cells


@config
class LaserExploreConfig:
    """How robots plan."""

    resolution: float = 0.2  # [m], cells of the grid that is planned on: a robot's radius
    margin: float = 0.1  # [m] beyond the radius that planned paths keep from walls: half a cell
    w_accuracy: float = 1 / 3  # weight of known walls around a goal, planners `paper` and `area`
    w_area: float = 1 / 3  # weight of unknown ground around a goal
    w_apart: float = 1 / 3  # weight of the distance from the others
    max_steps: int = 20000  # [steps] after which a run ends unfinished


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserPlan(LaserExploreConfig):
    """How robots plan, with the limits and the reach of those that drive."""

    period: float = 0.5  # [s], a step
    radius: float = 0.2  # [m] of a robot
    speed: float = 0.6  # [m/s], the fastest; robots drive backwards a third as fast
    turn: float = 1.0  # [rad/s], the fastest
    reach: float = 12.0  # [m] of the scanner


@config
class LaserMissionConfig:
    """Settings of `explore` with lasers: robots, mapping, planning. The planner's limits are taken from the robots."""

    MOVED: ClassVar[Mapping[str, str]] = {  # old keys and where they are now
        "team.near": "team.map.near",
        **{f"plan.{key}": f"robots.{key}" for key in ("period", "radius", "speed", "turn")},
        "plan.reach": "robots.scanner.far",
    }

    robots: LaserRobotsConfig = field(default_factory=LaserRobotsConfig)
    team: LaserTeamConfig = field(default_factory=LaserTeamConfig)
    plan: LaserExploreConfig = field(default_factory=LaserExploreConfig)
    map_resolution: float = 0.05  # [m], of the map that is written and scored

    def planning(self) -> LaserPlan:
        """The planner's configuration, with the limits and the reach of the robots."""
        r = self.robots
        own = {f.name: getattr(self.plan, f.name) for f in fields(self.plan)}
        return LaserPlan(**own, period=r.period, radius=r.radius, speed=r.speed, turn=r.turn, reach=r.scanner.far)


def with_odometry_noise(cfg: LaserMissionConfig, factor: float) -> LaserMissionConfig:
    """`cfg` with all odometry errors times `factor`, in the world and in the estimator alike."""
    odometry = replace(cfg.robots.odometry, factor=cfg.robots.odometry.factor * factor)
    noise = cfg.team.graph.keyframes.noise
    noise = replace(
        noise,
        wheels_xy=noise.wheels_xy * factor,
        wheels_turn=noise.wheels_turn * factor,
        wheels_turn_per_m=noise.wheels_turn_per_m * factor,
    )
    keyframes = replace(cfg.team.graph.keyframes, noise=noise)
    f, worse = cfg.team.front_end, max(1.0, factor)
    front_end = replace(
        f,
        sd_xy=f.sd_xy * worse,
        sd_xy_per_m=f.sd_xy_per_m * worse,
        sd_turn=f.sd_turn * worse,
        sd_turn_per_m=f.sd_turn_per_m * worse,
        sd_turn_per_rad=f.sd_turn_per_rad * worse,
    )
    team = replace(cfg.team, front_end=front_end, graph=replace(cfg.team.graph, keyframes=keyframes))
    return replace(cfg, robots=replace(cfg.robots, odometry=odometry), team=team)


OFFICE = 500.0  # [m^2], the scenario `office`
TEAM = 2  # robots unless said
FINEST = 0.1  # [m], cells in which a robot's disc is driven everywhere to see what it reaches


@config
class LaserScenarioConfig(WorldConfig):
    """An office by its area, or walls: a ROS map, an image with `resolution` and `origin`, or segments.

    Lengths in metres, headings in radians; a file's name is relative to the TOML file; an office has its own starts.
    """

    sensor: Literal["laser"] = "laser"  # what the robots carry: tells such a file from one of a landmark world
    office: float | None = None  # [m^2] floor of an office that is drawn anew for every run
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
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
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
    return checked_world(path, scenario)


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
