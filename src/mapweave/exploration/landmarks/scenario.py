"""Where a team explores: the paper's field by name, or a world of the user's own from a TOML file."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...core.config import config, load
from ...core.errors import ConfigError, DataError, UsageError
from ...core.walls import Walls
from ...io.ros_map import RosMap, read_plan, read_ros_map
from ...sim.field import START_RADIUS, YUAN_LANDMARKS, YUAN_LOWER, YUAN_UPPER, Field, circle_of_starts

WALL_GAP = 0.3  # [m] that random landmarks keep from walls
BUILT_IN = {"yuan": 1.0, "yuan-large": 4.0}  # name -> area relative to the paper's field


@config
class ScenarioConfig:
    """A rectangle with point landmarks and, where it has any, walls. Lengths in metres, headings in radians.

    lower, upper: by default the rectangle of the walls' map or image, without one the paper's field.
    """

    lower: tuple[float, float] | None = None
    upper: tuple[float, float] | None = None
    landmarks: int | tuple[tuple[float, float], ...] = YUAN_LANDMARKS  # how many at random, or where
    starts: tuple[tuple[float, float, float], ...] | None = None  # one a robot; else on a circle around the middle
    walls: str | tuple[tuple[float, float, float, float], ...] | None = None  # a ROS map.yaml, an image, or x0 y0 x1 y1
    resolution: float | None = None  # [m a pixel], of an image
    origin: tuple[float, float] | tuple[float, float, float] = (0.0, 0.0)  # lower left corner of an image, its turn


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
    found = load(ScenarioConfig, path)
    if isinstance(found.walls, str):
        found = replace(found, walls=str(path.parent / found.walls))
    check_segments(path, found.walls)
    lower, upper = bounds(found)
    if lower[0] >= upper[0] or lower[1] >= upper[1]:
        raise ConfigError(f"{path}: lower {tuple(lower.tolist())} must lie below upper {tuple(upper.tolist())}")
    return found


def check_segments(path: Path, walls: str | tuple[tuple[float, float, float, float], ...] | None) -> None:
    """Raises ConfigError when one of the segments that `walls` lists has no length."""
    for k, (x0, y0, x1, y1) in enumerate(walls if isinstance(walls, tuple) else ()):
        if (x0, y0) == (x1, y1):
            raise ConfigError(
                f"{path}: walls.{k}: expected x0, y0, x1, y1, found a wall without length at ({x0:g}, {y0:g})"
            )


def floor_plan(scenario: ScenarioConfig) -> RosMap | None:
    """The map or image that `walls` names, read; None where it names none.

    Raises ReaderError for a damaged file and ConfigError for an image of which nobody says how large it is.
    """
    if not isinstance(scenario.walls, str):
        return None
    return _read_plan(scenario.walls, scenario.resolution, scenario.origin)


@lru_cache(maxsize=4)
def _read_plan(name: str, resolution: float | None, origin: tuple[float, ...]) -> RosMap:
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return read_ros_map(path)
    if resolution is None or resolution <= 0:
        raise ConfigError(f"{path}: an image as walls needs `resolution` [m a pixel] above 0 and `origin` beside it")
    return read_plan(path, resolution, np.array([*origin, 0.0][:3]))


def find_walls(scenario: ScenarioConfig) -> Walls | None:
    """The scenario's walls; None in an open field."""
    plan = floor_plan(scenario)
    if plan is not None:
        return plan.walls()
    if scenario.walls is None or isinstance(scenario.walls, str):
        return None
    return Walls.of(np.array(scenario.walls, dtype=float).reshape(-1, 4))


def bounds(scenario: ScenarioConfig) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (2,) [m] of the field: as given, else those of the plan, else the paper's."""
    plan = floor_plan(scenario)
    lower, upper = (np.array(YUAN_LOWER), np.array(YUAN_UPPER)) if plan is None else plan.extent()
    return (
        lower if scenario.lower is None else np.array(scenario.lower),
        upper if scenario.upper is None else np.array(scenario.upper),
    )


def make_field(scenario: ScenarioConfig, robots: int | None, seed: int) -> Field:
    """The world of one run: a new layout of landmarks a seed, the same for any number of robots."""
    if robots is not None and robots < 1:
        raise UsageError(f"--robots: expected at least 1, found {robots}")
    lower, upper = bounds(scenario)
    walls = find_walls(scenario)
    if isinstance(scenario.landmarks, int):
        if scenario.landmarks < 1:
            raise DataError("the scenario has no landmarks: there is nothing to map")
        rng = np.random.default_rng([seed, 0])
        landmarks = _scatter(lower, upper, scenario.landmarks, walls, floor_plan(scenario), rng)
    else:
        landmarks = np.array(scenario.landmarks, dtype=float).reshape(-1, 2)
    return Field(lower, upper, landmarks, _starts(scenario, robots, lower, upper), walls)


def _scatter(
    lower: np.ndarray, upper: np.ndarray, n: int, walls: Walls | None, plan: RosMap | None, rng: np.random.Generator
) -> np.ndarray:
    """`n` random places (n, 2), none nearer than `WALL_GAP` to a wall, all on free ground of the `plan`."""
    if walls is None:
        return rng.uniform(lower, upper, size=(n, 2))
    found = np.zeros((0, 2))
    for _ in range(1000):
        more = rng.uniform(lower, upper, size=(n, 2))
        good = walls.clearance(more) >= WALL_GAP
        found = np.vstack([found, more[good if plan is None else good & plan.free(more)]])
        if len(found) >= n:
            return found[:n]
    raise DataError(f"the walls leave no room for {n} landmarks")


def _starts(scenario: ScenarioConfig, robots: int | None, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """As given; else a circle around the middle, of the paper's radius or, in a smaller field, half way to its edge."""
    if scenario.starts is not None:
        given = np.array(scenario.starts, dtype=float).reshape(-1, 3)
        if robots is not None and robots > len(given):
            raise UsageError(f"--robots: {robots} asked for, the scenario has {len(given)} starts")
        return given[:robots]
    radius = min(START_RADIUS, 0.25 * float((upper - lower).min()))
    around = circle_of_starts(2 if robots is None else robots, radius)
    around[:, :2] += 0.5 * (lower + upper)
    return around
