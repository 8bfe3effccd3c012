"""Robots that decide where to drive, among landmarks or among walls: many seeded runs of one scenario, scored."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..core.config import load
from ..core.errors import ConfigError, UsageError
from ..core.paths import AnyConfig, checked_arguments
from ..core.workers import Progress, no_progress, one_blas_thread, worker_pool
from ..exploration.landmarks.config import ExploreConfig, check_rasters, find_scenario, make_field
from ..exploration.landmarks.experiment import (
    CALIBRATED,
    ExploreResult,
    LandmarkMission,
    explore_many,
    explore_once,
    noise_factor,
    with_noise,
)
from ..exploration.laser.config import (
    LaserMissionConfig,
    LaserScenarioConfig,
    find_laser_scenario,
    make_place,
    with_odometry_noise,
)
from ..exploration.laser.experiment import LaserExploreResult, LaserMission, explore_laser_many, explore_laser_once
from ..exploration.mission import RunScore
from ..exploration.planner_interface import find_planner, is_built_in
from ..exploration.world import check_cells
from ..io.directory import check_target
from ..io.kept import kept_parts, part
from ..report.exploration import write_exploration
from ..report.laser_exploration import write_laser_exploration
from ..report.result import ResultBase, Rows, written
from ..report.style import Target

Score = TypeVar("Score", bound=RunScore)
Record = TypeVar("Record")
Result = TypeVar("Result", bound=ResultBase)
LOUDEST = 1e4  # times the usual noise, far beyond what any filter bears
LARGEST = 1e9  # no length, count or weight of an exploration is beyond


def parse_kills(text: list[str] | None) -> dict[str, int]:
    """`robot2@100` -> {"robot2": 100}."""
    return _steps_of("--kill", text, "die")


def parse_kidnaps(text: list[str] | None) -> dict[str, int]:
    """`robot2@100` -> {"robot2": 100}."""
    return _steps_of("--kidnap", text, "be carried away")


def _steps_of(option: str, text: list[str] | None, what: str) -> dict[str, int]:
    out: dict[str, int] = {}
    for word in text or []:
        name, at, step = word.partition("@")
        if not at or not step.isdecimal():
            raise UsageError(f"{option}: expected robotK@STEP, found {word!r}")
        if name in out:
            raise UsageError(f"{option}: {name} can {what} but once, found {name}@{out[name]} and {word}")
        out[name] = int(step)
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class ExploreOptions:
    """What `explore` is asked for, among landmarks and among walls; a planner of None is the scenario's own.

    Raises UsageError for a number of runs, a seed, a number of processes or a share that cannot be.
    """

    robots: int | None
    runs: int
    seed: int
    planner: str | None
    association: str | None
    noise: str | float
    until: str | int
    kill: Mapping[str, int] | None
    drop: float
    unknown_starts: bool
    radio: float | None
    kidnap: Mapping[str, int] | None
    config: AnyConfig | None
    jobs: int
    executor: Executor | None
    out: Path | str | None
    force: bool
    on_progress: Progress

    def __post_init__(self) -> None:
        if self.runs < 1 or self.jobs < 1:
            raise UsageError(f"--runs and --jobs: expected at least 1, found {self.runs} and {self.jobs}")
        if not 0 <= self.drop < 1:
            raise UsageError(f"--drop: expected a share of messages from 0 to below 1, found {self.drop:g}")
        if self.radio is not None and not self.radio > 0:
            raise UsageError(f"--radio: expected a range above 0 m, found {self.radio:g}")

    def explore(
        self,
        once: Callable[[int], tuple[Score, Record]],
        many: Callable[[int, int, Executor | None], list[Score]],
        result: Callable[[tuple[Score, ...], Record], Result],
        *,
        ours: bool,
        **callbacks: Callable[[int, float], None],
    ) -> Result:
        """The result of all runs, numbered from 0, written to `out` if given; a folder that is refused stops it first.

        once: seed -> score and record of the first run; many: (how many, the seed of the first, where to run them) ->
        scores; result: (scores, the first run's record) -> what `explore` gives; ours: no module and no file beside
        decides what happens, so that finished runs can be kept;
        callbacks: who hears of the first run, by the names that `once` knows.
        """
        check_target(self.out, force=self.force)
        self.on_progress("exploring", 0, self.runs)
        with kept_parts() if ours else nullcontext():
            score, first = part(once, self.seed, **callbacks)
            return written(result(self._scored(score, many), first), self.out, force=self.force)

    def _scored(self, first: Score, many: Callable[[int, int, Executor | None], list[Score]]) -> tuple[Score, ...]:
        scores = [first]
        self.on_progress("exploring", 1, self.runs)
        with worker_pool(self.jobs, self.runs - 1, self.executor) as workers:
            step = max(1, self.jobs) * 2
            for start in range(1, self.runs, step):
                scores += many(min(step, self.runs - start), self.seed + start, workers)
                self.on_progress("exploring", len(scores), self.runs)
        return tuple(replace(score, run=k) for k, score in enumerate(scores))


def factor_of(noise: str | float, names: str) -> float:
    """A positive factor; `names` are the words that would have been understood too."""
    try:
        factor = float(noise)
    except ValueError:
        raise UsageError(f"--noise: expected {names} or a factor, found {noise!r}") from None
    if not 0 < factor <= LOUDEST:
        raise UsageError(f"--noise: expected a positive factor up to {LOUDEST:g}, found {noise!r}")
    return factor


def end_of(until: str | int, *words: str) -> str | int:
    """One of `words`, or a number of steps, at least one."""
    if isinstance(until, str) and until in words:
        return until
    try:
        steps = int(until)
    except ValueError:
        raise UsageError(f"--until: expected {', '.join(words)} or a number of steps, found {until!r}") from None
    if steps < 1:
        raise UsageError(f"--until: expected at least 1 step, found {steps}")
    return steps


def check_magnitudes(cfg: object, where: str) -> None:
    """Raises ConfigError that lists every number of `cfg`, tables included, that is beyond `LARGEST`."""
    wild = [f"{key}: expected at most {LARGEST:g}, found {v:g}" for key, v in _numbers(cfg, "") if abs(v) > LARGEST]
    if wild:
        raise ConfigError(f"{where}: {'; '.join(wild)}")


def _numbers(value: object, key: str) -> Iterator[tuple[str, float]]:
    """Every number under `value` with its dotted name."""
    if is_dataclass(value):
        for f in fields(value):
            yield from _numbers(getattr(value, f.name), f"{key}.{f.name}" if key else f.name)
    elif isinstance(value, tuple):
        for k, v in enumerate(value):
            yield from _numbers(v, f"{key}.{k}")
    elif isinstance(value, int | float):
        yield key, value


def kills_of(kill: Mapping[str, int], robots: int, option: str = "--kill") -> dict[int, int]:
    """The step at which each robot dies, by number from 0; a name that no robot has is refused, by the `option`."""
    names = {f"robot{k + 1}": k for k in range(robots)}
    for name in kill:
        if name not in names:
            raise UsageError(f"{option}: no robot is called {name!r}; there are {', '.join(names)}")
    return {names[name]: step for name, step in kill.items()}


LASER_POSITIVE = (
    *("robots.radius", "robots.speed", "robots.turn", "robots.period", "robots.scanner.beams", "robots.scanner.far"),
    *("robots.law.falloff", "plan.resolution", "plan.max_steps", "map_resolution"),
)
COARSEST = 1.0  # [m], cells that could still show a door
FARTHEST_BEAM = 1000.0  # [m]
MOST_BEAMS = 20_000  # of one scan, each cast through all walls
MOST_GAIN = 10.0  # [log units] sd of the gain that each beam has of its own


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

        write_laser_runs(folder, self.runs, self.metrics, self.first)
        write_laser_exploration(folder, self)

    def draw(self, target: Target) -> None:
        from ..report.exploration import laser_exploration_scene  # noqa: PLC0415

        laser_exploration_scene(self.first).draw(target)


def explore_laser(name: str, scenario: LaserScenarioConfig, options: ExploreOptions) -> LaserExploration:
    """Explorations of the laser world `scenario`, called `name`.

    noise: a factor on the errors of odometry, calibrated being 1. Raises UsageError, ConfigError, ReaderError,
    DataError or EstimateError; nothing is written then.
    """
    if options.association is not None:
        raise UsageError("--association: a laser world has no landmarks whose identities could be known or not")
    if options.radio is not None:
        raise UsageError("--radio: robots with lasers always hear each other; give a landmark world")
    if options.kidnap:
        raise UsageError("--kidnap: robots with lasers are not carried away; give a landmark world")
    planner = "coverage" if options.planner is None else options.planner
    factor = _factor(options.noise)
    cfg = load(LaserMissionConfig, options.config, positive=LASER_POSITIVE)
    check_magnitudes(cfg, str(options.config))
    _check_sizes(cfg, str(options.config))
    cfg = with_odometry_noise(cfg, factor)
    place = make_place(scenario, options.robots, options.seed)
    for key, cell in (("plan.resolution", cfg.plan.resolution), ("map_resolution", cfg.map_resolution)):
        check_cells(key, place.lower, place.upper, cell)
    kills = kills_of(options.kill or {}, len(place.starts))
    mission = LaserMission(
        scenario,
        options.robots,
        planner,
        _end(options.until),
        kills,
        options.drop,
        cfg,
        apart=options.unknown_starts,
    )
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
    """Raises ConfigError for cells coarser or scans longer than planning can use, and for what no scanner is."""
    scanner, law = cfg.robots.scanner, cfg.robots.law
    limits = (
        ("plan.resolution", cfg.plan.resolution, COARSEST),
        ("map_resolution", cfg.map_resolution, COARSEST),
        ("robots.scanner.far", scanner.far, FARTHEST_BEAM),
        ("robots.scanner.near", scanner.near, scanner.far),
        ("robots.scanner.opening", scanner.opening, 2.0 * np.pi),
        ("robots.scanner.beams", scanner.beams, MOST_BEAMS),
        ("robots.law.specular", law.specular, 1.0),
        ("robots.law.beams", law.beams, MOST_GAIN),
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


NOISE = {"printed": 1.0, "calibrated": CALIBRATED}
POSITIVE = (
    *("mission.cell", "mission.max_steps", "commands.speeds", "objective.apart_distance", "handover.by"),
    *("loop.rate", "loop.rate_alone", "joint.rate", "joint.rate_alone"),
    *("joint.density", "joint.search.tries", "joint.search.coarse_cell", "walls.robot_radius", "walls.path_cell"),
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

        write_runs(folder, self.runs, self.metrics, self.first)
        write_exploration(folder, self)

    def draw(self, target: Target) -> None:
        from ..report.exploration import landmark_scene  # noqa: PLC0415

        landmark_scene(self.first, self.mission.cfg).draw(target)


@checked_arguments
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
    unknown_starts: bool = False,
    radio: float | None = None,
    kidnap: Mapping[str, int] | None = None,
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
    unknown_starts
        No robot knows where the others start: each drives for itself until its map is found to be of the same place as
        another's (False).
    radio
        Within which distance [m] of each other, or over others, robots exchange what they know, among landmarks (any).
    kidnap
        Robot name -> step at whose start it is lifted and set down anywhere in the field, among landmarks (none).
    config
        Settings as `configuration("explore")` prints them: a TOML file, its tables as mappings, or an object of
        a configuration class; options here win.
    jobs
        How many runs are worked on at once, in processes of our own (1).

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
        unknown_starts=unknown_starts,
        radio=radio,
        kidnap=kidnap,
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
    cfg = load(ExploreConfig, options.config, positive=POSITIVE)
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
    if options.unknown_starts and options.radio is not None:
        raise UsageError("--radio: robots that part have to know where all start; give it without --unknown-starts")
    if options.kidnap and (options.radio is not None or world.walls is not None):
        raise UsageError("--kidnap: a robot that was carried finds back by landmarks alone; no --radio, no walls")
    if options.unknown_starts and world.walls is not None:
        raise UsageError("--unknown-starts: robots among walls are given the plan of them and where they stand in it")
    check_rasters(place, len(world.starts), cfg)
    until, kills = end_of(options.until, "landmarks", "field"), kills_of(options.kill or {}, len(world.starts))
    kidnaps = kills_of(options.kidnap or {}, len(world.starts), "--kidnap")
    radio = np.inf if options.radio is None else options.radio
    mission = LandmarkMission(
        place, options.robots, planner, until, kills, options.drop, cfg, options.unknown_starts, radio, kidnaps
    )
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
