"""Where a team explores: the paper's field by name, or a world of the user's own from a TOML file."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.config import config, load
from ...core.errors import ConfigError, DataError, UsageError
from ...core.walls import Walls
from ...io.ros_map import RosMap
from ...sim.field import START_RADIUS, YUAN_LANDMARKS, YUAN_LOWER, YUAN_UPPER, Field, circle_of_starts
from ..world import (
    MOST_CELLS,
    MOST_KNOWN,
    WorldConfig,
    check_cells,
    check_places,
    check_robots,
    check_world,
    floor_plan,
    given_starts,
    plan_walls,
    wall_segments,
)
from .config import ExploreConfig

MOST_LANDMARKS = 3000  # their joint covariance takes 300 MB
BUILT_IN = {"yuan": 1.0, "yuan-large": 4.0}  # name -> area relative to the paper's field


@config
class ScenarioConfig(WorldConfig):
    """A rectangle with point landmarks and, where it has any, walls. Lengths in metres, headings in radians.

    lower, upper: by default the rectangle of the walls' map or image, without one the paper's field; starts: by default
    on a circle around the middle.
    """

    lower: tuple[float, float] | None = None  # [m], corner of the field
    upper: tuple[float, float] | None = None  # [m], the opposite corner
    landmarks: int | tuple[tuple[float, float], ...] = YUAN_LANDMARKS  # how many at random, or where [m]
    wall_gap: float = 0.3  # [m] that random landmarks keep from walls


def find_scenario(name: str) -> ScenarioConfig:
    """A built-in scenario, or the one a TOML file describes. Raises UsageError when it is neither."""
    if name in BUILT_IN:
        side = float(np.sqrt(BUILT_IN[name]))
        return ScenarioConfig(
            lower=(YUAN_LOWER[0] * side, YUAN_LOWER[1] * side),
            upper=(YUAN_UPPER[0] * side, YUAN_UPPER[1] * side),
            landmarks=round(YUAN_LANDMARKS * BUILT_IN[name]),
        )
    path = Path(name)
    if path.suffix != ".toml" and not path.exists():
        if name.startswith("office"):
            raise UsageError(f"scenario {name!r}: a laser world, where there are no landmarks")
        known = ", ".join((*BUILT_IN, "office", "office-AREA"))
        raise UsageError(f"scenario {name!r}: not one of {known} and not a TOML file")
    scenario = load(ScenarioConfig, path)
    if isinstance(scenario.walls, str):
        scenario = replace(scenario, walls=str(path.parent / scenario.walls))
    check_world(path, scenario)
    _check_landmarks(path, scenario)
    lower, upper = bounds(scenario)
    if lower[0] >= upper[0] or lower[1] >= upper[1]:
        raise ConfigError(f"{path}: lower {tuple(lower.tolist())} must lie below upper {tuple(upper.tolist())}")
    check_places(f"{path}: corner", np.stack([lower, upper]))
    return scenario


def _check_landmarks(path: Path, scenario: ScenarioConfig) -> None:
    """Raises ConfigError when there are too many landmarks, or some too far away."""
    marks = scenario.landmarks
    count = marks if isinstance(marks, int) else len(marks)
    if count > MOST_LANDMARKS:
        raise ConfigError(f"{path}: landmarks: expected at most {MOST_LANDMARKS:,}, found {count:,}")
    if isinstance(marks, tuple):
        check_places(f"{path}: landmarks", np.array(marks).reshape(-1, 2))


def find_walls(scenario: ScenarioConfig) -> Walls | None:
    """The scenario's walls; None in an open field."""
    plan = floor_plan(scenario)
    return wall_segments(scenario) if plan is None else plan_walls(str(scenario.walls), plan)


def bounds(scenario: ScenarioConfig) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (2,) [m] of the field: as given, else those of the plan, else the paper's."""
    plan = floor_plan(scenario)
    lower, upper = (
        (np.array(YUAN_LOWER, dtype=float), np.array(YUAN_UPPER, dtype=float)) if plan is None else plan.extent()
    )
    return (
        lower if scenario.lower is None else np.array(scenario.lower, dtype=float),
        upper if scenario.upper is None else np.array(scenario.upper, dtype=float),
    )


def check_rasters(scenario: ScenarioConfig, robots: int, cfg: ExploreConfig) -> None:
    """Raises ConfigError when a raster over the field would have too many cells, or none."""
    lower, upper = bounds(scenario)
    if (upper - lower).min() < cfg.mission.cell:
        w, h = upper - lower
        raise ConfigError(
            f"mission.cell: a field of {w:g} m x {h:g} m is smaller than a cell of {cfg.mission.cell:g} m"
        )
    check_cells(f"mission.cell, {robots} robots", lower, upper, cfg.mission.cell, MOST_KNOWN / robots)
    check_cells("joint.search.coarse_cell", lower, upper, cfg.joint.search.coarse_cell, MOST_KNOWN)
    if scenario.walls is not None:
        check_cells("walls.path_cell / 4", lower, upper, 0.25 * cfg.walls.path_cell, MOST_CELLS)


def make_field(scenario: ScenarioConfig, robots: int | None, seed: int) -> Field:
    """The world of one run: a new layout of landmarks a seed, the same for any number of robots."""
    check_robots(robots)
    lower, upper = bounds(scenario)
    walls = find_walls(scenario)
    if isinstance(scenario.landmarks, int):
        if scenario.landmarks < 1:
            raise DataError("the scenario has no landmarks: there is nothing to map")
        rng = np.random.default_rng([seed, 0])
        landmarks = _scatter(lower, upper, scenario.landmarks, walls, scenario.wall_gap, floor_plan(scenario), rng)
    else:
        landmarks = np.array(scenario.landmarks, dtype=float).reshape(-1, 2)
    return Field(lower, upper, landmarks, _starts(scenario, robots, lower, upper), walls)


def _scatter(
    lower: np.ndarray,
    upper: np.ndarray,
    n: int,
    walls: Walls | None,
    gap: float,
    plan: RosMap | None,
    rng: np.random.Generator,
) -> np.ndarray:
    """`n` random places (n, 2), none nearer than `gap` [m] to a wall, all on free ground of the `plan`."""
    if walls is None:
        return rng.uniform(lower, upper, size=(n, 2))
    places = np.zeros((0, 2))
    for _ in range(1000):
        more = rng.uniform(lower, upper, size=(n, 2))
        good = walls.clearance(more) >= gap
        places = np.vstack([places, more[good if plan is None else good & plan.free(more)]])
        if len(places) >= n:
            return places[:n]
    raise DataError(f"the walls leave no room for {n} landmarks")


def _starts(scenario: ScenarioConfig, robots: int | None, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """As given; else a circle around the middle, of the paper's radius or, in a smaller field, half way to its edge."""
    given = given_starts(scenario, robots)
    if given is not None:
        return given
    radius = min(START_RADIUS, 0.25 * float((upper - lower).min()))
    around = circle_of_starts(2 if robots is None else robots, radius)
    around[:, :2] += 0.5 * (lower + upper)
    return around
