"""Robots that decide where to drive: many seeded runs of one scenario, scored."""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.config import expect_positive, load
from ..core.errors import ConfigError, UsageError
from ..core.paths import AnyConfig, path_arguments
from ..core.workers import Progress, no_progress, one_blas_thread
from ..exploration.landmarks.config import ExploreConfig
from ..exploration.landmarks.experiment import (
    CALIBRATED,
    ExploreResult,
    LandmarkMission,
    explore_many,
    explore_once,
    noise_factor,
    with_noise,
)
from ..exploration.landmarks.scenario import check_rasters, find_scenario, make_field
from ..exploration.laser.scenario import find_laser_scenario
from ..exploration.planner_interface import find_planner, is_built_in
from ..io.directory import check_target
from ..report.result import ResultBase, Rows
from .explore_laser import LaserExploration, explore_laser
from .explore_options import ExploreOptions, check_magnitudes, end_of, factor_of, kills_of

if TYPE_CHECKING:
    from ..report.style import Target

NOISE = {"printed": 1.0, "calibrated": CALIBRATED}
POSITIVE = (
    *("mission.cell", "mission.max_steps", "commands.speeds", "objective.apart_distance", "handover.by"),
    *("coverage.radius", "coverage.replan_every"),
    *("loop.radius", "loop.rate", "loop.rate_alone", "joint.rate", "joint.rate_alone", "joint.density"),
    *("joint.search.tries", "joint.search.first_plans", "joint.search.most_places", "joint.search.coarse_cell"),
    *("joint.search.pose_stride", "joint.search.layouts", "joint.search.least_range"),
    *("walls.robot_radius", "walls.path_cell", "walls.stride", "walls.station_spacing", "walls.leg"),
    *("submap.period", "submap.reach", "submap.half_angle"),
    *("submap.range_sd", "submap.bearing_sd", "submap.gate"),
)
ASSOCIATIONS = ("known", "nn", "jcbb")


@dataclass(frozen=True, slots=True, repr=False)
class LandmarkExploration(ResultBase, ExploreResult):
    """What `explore` gives among landmarks: the scores of all runs, and the first run in full."""

    def lines(self) -> list[str]:
        return ExploreResult.lines(self)

    def headline(self) -> Rows:
        head = ("seed", "finished", "steps", "map error [m]", "C/N [m²]", "NEES/dof")
        return head, [(r.seed, r.finished, r.steps, r.map_error, r.c_per_n, r.nees_per_dof) for r in self.runs]

    def write_into(self, folder: Path) -> None:
        """runs.csv, metrics.json, the first run's log and figures, report.html."""
        from ..io.exploration import write_runs  # noqa: PLC0415
        from ..report.exploration import write_exploration  # noqa: PLC0415  (figures cost a second)

        write_runs(folder, self.runs, self.metrics, self.first)
        write_exploration(folder, self)

    def draw(self, target: "Target") -> None:
        from ..report.exploration import draw_map  # noqa: PLC0415

        draw_map(target, self.first)


@path_arguments
@one_blas_thread()
def explore(
    scenario: Path | str = "yuan",
    out: Path | str | None = None,
    *,
    robots: int | None = None,
    runs: int = 1,
    seed: int = 0,
    planner: str | None = None,
    association: str | None = None,
    noise: str | float = "calibrated",
    until: str | int = "field",
    kill: Mapping[str, int] | None = None,
    drop: float = 0.0,
    config: AnyConfig | None = None,
    jobs: int = 1,
    force: bool = False,
    executor: Executor | None = None,
    on_progress: Progress = no_progress,
) -> LandmarkExploration | LaserExploration:
    """Let a team of robots decide where to drive until it knows the field, and score its map.

    Written to `out` if given. Run k has seed `seed` + k; the same seed gives the same runs, whatever `jobs`.

    Parameters
    ----------
    scenario
        yuan, yuan-large, office (lasers), office-AREA, or a TOML file (yuan).
    out
        The folder to write; an earlier result there is replaced whole.
    robots
        How many (2, or as many as the scenario has starts).
    runs
        How many (1).
    seed
        Of the first run (0).
    planner
        paper, area, coverage, loop, joint, or one's own `choose(belief, poses, cfg) -> (M, 2)` [m/s, rad/s] by dotted
        name `module:function` (paper; with lasers coverage).
    association
        known, nn or jcbb (jcbb); not with lasers.
    noise
        printed, calibrated, or a factor on the printed standard deviations; with lasers calibrated or a factor on the
        errors of odometry (calibrated).
    until
        landmarks (all were seen), field (no frontier is left) or a number of steps (field).
    kill
        Robot name -> step at whose start it dies (none).
    drop
        The share of messages between robots that is lost, from 0 to below 1 (0).
    config
        Settings as `configuration("explore")` prints them: a TOML file, its tables as mappings, or an object of
        a configuration class; options here win.
    jobs
        How many runs are worked on at once, in processes of our own (1).
    force
        Write into `out` even when something other than a result stands there (False).
    executor
        Any `concurrent.futures.Executor` in place of `jobs`.
    on_progress
        Called as `on_progress(stage, done, total)`.

    Raises
    ------
    ReaderError
        For a scenario file that is damaged.
    DataError
        For a world that cannot be.
    EstimateError
        For a planner that fails or commands what no robot can do.
    UsageError
        For options that cannot be; ConfigError for a configuration that is refused. Nothing is written then.

    Examples
    --------
    >>> result = explore("yuan", until=2, seed=1)
    >>> len(result.runs), result.runs[0].steps
    (1, 2)
    """
    scenario = str(scenario)
    options = ExploreOptions(
        robots=robots,
        runs=runs,
        seed=seed,
        planner=planner,
        association=association,
        noise=noise,
        until=until,
        kill=kill,
        drop=drop,
        config=config,
        jobs=jobs,
        executor=executor,
        out=out,
        force=force,
        on_progress=on_progress,
    )
    if out is not None:
        files = [scenario] if Path(scenario).is_file() else []  # a built-in name is none
        check_target(Path(out), force=force, reads=(*files, config))
    laser = find_laser_scenario(scenario)
    return _among_landmarks(scenario, options) if laser is None else explore_laser(scenario, laser, options)


def _among_landmarks(scenario: str, options: ExploreOptions) -> LandmarkExploration:
    planner = "paper" if options.planner is None else options.planner
    cfg = load(ExploreConfig, options.config)
    expect_positive(cfg, str(options.config), *POSITIVE)
    check_magnitudes(cfg, str(options.config))
    if not cfg.commands.turns:
        raise ConfigError(f"{options.config}: commands.turns: expected at least one turn rate [rad/s]")
    if options.association is not None:
        cfg = replace(cfg, submap=replace(cfg.submap, association=options.association))
    if cfg.submap.association not in ASSOCIATIONS:
        raise UsageError(f"--association: expected {', '.join(ASSOCIATIONS)}, found {cfg.submap.association!r}")
    if options.config is None or options.noise != "calibrated":
        cfg = with_noise(cfg, _noise(options.noise))
    place = find_scenario(scenario)
    world = make_field(place, options.robots, options.seed)
    check_rasters(place, len(world.starts), cfg)
    until, kills = end_of(options.until, "landmarks", "field"), kills_of(options.kill or {}, len(world.starts))
    mission = LandmarkMission(place, options.robots, planner, until, kills, options.drop, cfg)
    find_planner(planner, "landmarks")
    return options.explore(
        partial(explore_once, mission),
        partial(explore_many, mission),
        partial(LandmarkExploration, scenario, mission, options.seed, noise_factor(cfg)),
        ours=is_built_in(planner, "landmarks") and not isinstance(place.walls, str),
    )


def _noise(noise: str | float) -> float:
    if isinstance(noise, str) and noise in NOISE:
        return NOISE[noise]
    return factor_of(noise, "printed, calibrated")
