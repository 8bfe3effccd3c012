"""Where a team explores: the paper's field by name, or a world of the user's own from a TOML file."""

from pathlib import Path

import numpy as np

from ..core.config import config, load
from ..core.errors import ConfigError, DataError, UsageError
from ..sim.field import YUAN_LANDMARKS, YUAN_LOWER, YUAN_UPPER, Field, circle_of_starts

BUILT_IN = {"yuan": 1.0, "yuan-large": 4.0}  # name -> area relative to the paper's field


@config
class ScenarioConfig:
    """A rectangle with point landmarks. Lengths in metres, headings in radians."""

    lower: tuple[float, float] = YUAN_LOWER
    upper: tuple[float, float] = YUAN_UPPER
    landmarks: int | tuple[tuple[float, float], ...] = YUAN_LANDMARKS  # how many at random, or where
    starts: tuple[tuple[float, float, float], ...] | None = None  # one a robot; else on a circle around the middle


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
        raise UsageError(f"scenario {name!r}: not one of {', '.join(BUILT_IN)} and not a TOML file")
    found = load(ScenarioConfig, path)
    if found.lower[0] >= found.upper[0] or found.lower[1] >= found.upper[1]:
        raise ConfigError(f"{path}: lower {found.lower} must lie below upper {found.upper}")
    return found


def make_field(scenario: ScenarioConfig, robots: int | None, seed: int) -> Field:
    """The world of one run: a new layout of landmarks a seed, the same for any number of robots."""
    if robots is not None and robots < 1:
        raise UsageError(f"--robots: expected at least 1, found {robots}")
    lower, upper = np.array(scenario.lower), np.array(scenario.upper)
    if isinstance(scenario.landmarks, int):
        if scenario.landmarks < 1:
            raise DataError("the scenario has no landmarks: there is nothing to map")
        rng = np.random.default_rng([seed, 0])
        landmarks = rng.uniform(lower, upper, size=(scenario.landmarks, 2))
    else:
        landmarks = np.array(scenario.landmarks, dtype=float).reshape(-1, 2)
    return Field(lower, upper, landmarks, _starts(scenario, robots, 0.5 * (lower + upper)))


def _starts(scenario: ScenarioConfig, robots: int | None, middle: np.ndarray) -> np.ndarray:
    if scenario.starts is not None:
        given = np.array(scenario.starts, dtype=float)
        if robots is not None and robots > len(given):
            raise UsageError(f"--robots: {robots} asked for, the scenario has {len(given)} starts")
        return given[:robots]
    around = circle_of_starts(2 if robots is None else robots)
    around[:, :2] += middle
    return around
