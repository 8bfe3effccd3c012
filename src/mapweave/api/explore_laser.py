"""Exploration with lasers: many seeded runs of one laser world, scored."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.config import expect_positive, load
from ..core.errors import ConfigError, UsageError
from ..exploration.laser.config import LaserMissionConfig, with_odometry_noise
from ..exploration.laser.experiment import LaserMission, explore_laser_many, explore_laser_once
from ..exploration.laser.result import LaserExploreResult
from ..exploration.laser.scenario import LaserScenarioConfig, make_place
from ..exploration.planner_interface import find_planner, is_built_in
from ..exploration.world import check_cells
from ..report.result import ResultBase, Rows
from .explore_options import ExploreOptions, check_magnitudes, end_of, factor_of, kills_of

if TYPE_CHECKING:
    from ..report.style import Target

POSITIVE = (
    *("robots.radius", "robots.speed", "robots.turn", "robots.period", "robots.scanner.beams", "robots.scanner.far"),
    *("plan.resolution", "plan.max_steps", "plan.replan_every", "plan.split", "plan.most_goals"),
    *("map_resolution", "tolerance", "beam_stride", "frontier_check_every", "false_distance", "false_turn"),
    *("plan.goals.same", "plan.goals.arrived", "plan.follower.lookahead", "plan.follower.arc_sample"),
    *("plan.allocation.wall_cost", "plan.allocation.parked_cost", "plan.right_of_way.meeting"),
)
COARSEST = 1.0  # [m], cells that could still show a door
FARTHEST_BEAM = 1000.0  # [m]
MOST_BEAMS = 20_000  # of one scan, each cast through all walls
DEAREST = 255  # what a metre of way may count as


@dataclass(frozen=True, slots=True, repr=False)
class LaserExploration(ResultBase, LaserExploreResult):
    """What `explore` gives with lasers: the scores of all runs, and the first run in full."""

    def lines(self) -> list[str]:
        return LaserExploreResult.lines(self)

    def headline(self) -> Rows:
        head = ("seed", "finished", "steps", "area mapped", "map error [m]", "trajectory RMSE [m]", "collisions")
        rows = [
            (r.seed, r.finished, r.steps, r.area_mapped, r.map_error, r.trajectory_rmse, r.collisions)
            for r in self.runs
        ]
        return head, rows

    def write_into(self, folder: Path) -> None:
        """runs.csv, metrics.json, the first run's logs, map and figures, report.html."""
        from ..io.exploration import write_laser_runs  # noqa: PLC0415
        from ..report.laser_exploration import write_laser_exploration  # noqa: PLC0415  (figures cost a second)

        write_laser_runs(folder, self.runs, self.metrics, self.first)
        write_laser_exploration(folder, self)

    def draw(self, target: "Target") -> None:
        from ..report.laser_exploration_figures import draw_map  # noqa: PLC0415

        draw_map(target, self.first)


def explore_laser(name: str, scenario: LaserScenarioConfig, options: ExploreOptions) -> LaserExploration:
    """Explorations of the laser world `scenario`, called `name`.

    noise: a factor on the errors of odometry, calibrated being 1. Raises UsageError, ConfigError, ReaderError,
    DataError or EstimateError; nothing is written then.
    """
    if options.association is not None:
        raise UsageError("--association: a laser world has no landmarks whose identities could be known or not")
    planner = "coverage" if options.planner is None else options.planner
    factor = _factor(options.noise)
    cfg = load(LaserMissionConfig, options.config)
    expect_positive(cfg, str(options.config), *POSITIVE)
    check_magnitudes(cfg, str(options.config))
    _check_sizes(cfg, str(options.config))
    cfg = with_odometry_noise(cfg, factor)
    place = make_place(scenario, options.robots, options.seed)
    for key, cell in (("plan.resolution", cfg.plan.resolution), ("map_resolution", cfg.map_resolution)):
        check_cells(key, place.lower, place.upper, cell)
    kills = kills_of(options.kill or {}, len(place.starts))
    mission = LaserMission(scenario, options.robots, planner, _end(options.until), kills, options.drop, cfg)
    find_planner(planner, "laser")

    def mapped_so_far(step: int, explored: float) -> None:
        del step
        options.on_progress("the first run: area mapped", explored, 1.0)

    return options.explore(
        partial(explore_laser_once, mission),
        partial(explore_laser_many, mission),
        partial(LaserExploration, name, mission, options.seed, factor),
        ours=is_built_in(planner, "laser") and not isinstance(scenario.walls, str),
        on_progress=mapped_so_far,
    )


def _check_sizes(cfg: LaserMissionConfig, where: str) -> None:
    """Raises ConfigError for cells coarser, scans longer or ways dearer than planning can use."""
    limits = (
        ("plan.resolution", cfg.plan.resolution, COARSEST),
        ("map_resolution", cfg.map_resolution, COARSEST),
        ("plan.allocation.wall_cost", cfg.plan.allocation.wall_cost, DEAREST),
        ("plan.allocation.parked_cost", cfg.plan.allocation.parked_cost, DEAREST),
        ("robots.scanner.far", cfg.robots.scanner.far, FARTHEST_BEAM),
        ("robots.scanner.beams", cfg.robots.scanner.beams, MOST_BEAMS),
    )
    out_of_range = [f"{key}: expected at most {most:g}, found {value:g}" for key, value, most in limits if value > most]
    if out_of_range:
        raise ConfigError(f"{where}: {'; '.join(out_of_range)}")


def _factor(noise: str | float) -> float:
    if noise == "calibrated":
        return 1.0
    if noise == "printed":
        raise UsageError(
            "--noise printed: the paper prints noise of landmark worlds alone; give calibrated or a factor on odometry"
        )
    return factor_of(noise, "calibrated")


def _end(until: str | int) -> str | int:
    if until == "landmarks":
        raise UsageError("--until landmarks: a laser world has none; give field or a number of steps")
    return end_of(until, "field")
