"""What can be set about an exploration among landmarks: where it is, by name or from a TOML file, and every planner."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ...core.config import config, load
from ...core.errors import ConfigError, DataError, UsageError
from ...core.walls import Walls
from ...fusion.handover import PairingConfig
from ...io.ros_map import RosMap
from ...landmarks.submap_slam import SubmapConfig
from ...sim.landmarks import START_RADIUS, YUAN_LANDMARKS, YUAN_LOWER, YUAN_UPPER, Field, circle_of_starts
from ..world import (
    MOST_CELLS,
    MOST_KNOWN,
    WorldConfig,
    check_cells,
    check_places,
    check_robots,
    checked_world,
    floor_plan,
    given_starts,
    plan_walls,
    wall_segments,
)

STEERING_HEADING_COST = 3.0  # [m/rad] that a wrong heading counts as: no circling round a goal, no crawling

WALLS_COMFORT = 1.2  # [m] beyond the radius that robots keep where nothing draws them nearer
FIELD_WALL_GAP = 0.3  # [m] that random landmarks keep from walls


@config
class LapSearchConfig:
    """How planner `joint` searches its laps and judges them."""

    tries: int = 700  # changes tried of a plan: with the others, twelve seconds for the paper's field
    coarse_cell: float = 2.0  # [m], cells in which coverage is judged: four times faster than the field's own
    tries_by_now: int = 120  # changes tried under way: a tenth of a second


@config
class CoverageConfig:
    """Planner `coverage`: discs over what is unexplored, shared out as balanced tours."""

    rate: float = 22.0  # [m^2] of field a robot and step: how long the tours of an open field take
    rate_alone: float = 19.0  # [m^2] the same for one robot
    error_weight: float = 70.0  # [steps/m] that expected map error is worth
    tour_radius: float = 13.0  # [m] of a disc of the first tours, which are improved as laps are
    search: LapSearchConfig = LapSearchConfig()


@config
class LoopConfig:
    """Planner `loop`: a closed tour for each robot, then `coverage`."""

    rate: float = 19.5  # [m^2] of field a robot and step: how long it goes on to close loops
    rate_alone: float = 17.0  # [m^2] the same for one robot, whose lap is longer


@config
class JointConfig:
    """Planner `joint`: laps of all robots planned together."""

    rate: float = 23.0  # [m^2] of field a robot and step: how long the laps take
    rate_alone: float = 20.0  # [m^2] the same for one robot
    density: float = 1 / 275  # [1/m^2] landmarks expected: those of the paper's field
    error_weight: float = 100.0  # [steps/m] that expected map error is worth
    search: LapSearchConfig = LapSearchConfig()


@config
class WallsConfig:
    """Robots among walls of which they know the plan."""

    robot_radius: float = 0.3  # [m] of the disc that a robot is
    margin: float = 0.4  # [m] beyond the radius that planned paths and offered controls keep from walls
    path_cell: float = 0.4  # [m], raster on which paths round walls are found: half of what the narrowest door needs


@config
class CommandsConfig:
    """What a robot may be told to do: every speed with every turn rate."""

    speeds: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)  # [m/s] offered, as in the paper
    turns: tuple[float, ...] = tuple(float(k) * np.pi / 8 for k in range(-4, 5))  # [rad/s] offered, as in the paper


@config
class ObjectiveConfig:
    """Planners `paper` and `area`: what a command is worth, and when a robot escapes from where nothing is."""

    w_accuracy: float = 1 / 3  # weight of the map's expected accuracy, w1: the paper gives all three the same
    w_area: float = 1 / 3  # weight of new area, w2
    w_apart: float = 1 / 3  # weight of the distance to the others' submaps, w3
    apart_distance: float = 20.0  # [m] beyond which being farther from others is worth no more, d_t
    escape_uncertainty: float = 0.3  # [m^2] a landmark below which a robot that gains no area escapes, C_t
    negligible_gain: int = 12  # [cells] up to which a control gains no area; the print's 0 keeps robots at specks
    stall_steps: int = 10  # [steps] without gain after which the robot escapes whatever its uncertainty
    literal_escape: bool = False  # the printed rule alone: deadlocks under the stated noise


@config
class HandoverConfig:
    """When a submap goes into the global map, and which landmarks are taken for one then."""

    after: int = 10  # [steps] before which no submap is handed over, n_s
    uncertainty: float = 0.3  # [m^2] a landmark below which a submap is handed over, C_f
    by: int = 60  # [steps] after which a submap is handed over whatever its uncertainty
    pairing: PairingConfig = PairingConfig(sure=0.98)  # surer than a lone pair far off ever is: that waits


@config
class MissionConfig:
    """How finely the field is kept, and how long a run may take."""

    cell: float = 1.0  # [m], side of the explored raster's cells, as in the paper
    max_steps: int = 1500  # [steps] after which a run ends unfinished
    rendezvous: int = 100  # [steps] out of touch after which robots meet, radio limited; 0: when all is seen


@config
class ExploreConfig:
    """Weights, thresholds and discretisation of one exploration."""

    MOVED: ClassVar[Mapping[str, str]] = {  # old keys and where they are now
        "speeds": "commands.speeds",
        "turns": "commands.turns",
        "cell": "mission.cell",
        "max_steps": "mission.max_steps",
        **{
            key: f"objective.{key}"
            for key in ("w_accuracy", "w_area", "w_apart", "apart_distance", "escape_uncertainty")
        },
        **{key: f"objective.{key}" for key in ("negligible_gain", "stall_steps", "literal_escape")},
        **{f"fuse_{key}": f"handover.{key}" for key in ("after", "uncertainty", "by")},
        **{f"fusion_{key}": f"handover.pairing.{key}" for key in ("gate", "sure", "density")},
    }

    mission: MissionConfig = MissionConfig()
    submap: SubmapConfig = SubmapConfig()
    commands: CommandsConfig = CommandsConfig()
    objective: ObjectiveConfig = ObjectiveConfig()
    handover: HandoverConfig = HandoverConfig()
    coverage: CoverageConfig = CoverageConfig()
    loop: LoopConfig = LoopConfig()
    joint: JointConfig = JointConfig()
    walls: WallsConfig = WallsConfig()

    @property
    def controls(self) -> Float[np.ndarray, "m 2"]:
        """All (v, w) offered, slow and right-turning first."""
        return np.array([(v, w) for v in self.commands.speeds for w in self.commands.turns])


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
    scenario = checked_world(path, load(ScenarioConfig, path))
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
        landmarks = _scatter(lower, upper, scenario.landmarks, walls, FIELD_WALL_GAP, floor_plan(scenario), rng)
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
