"""Robots that decide where to drive: many seeded runs of one scenario, scored."""

from collections.abc import Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config import load
from ..core.errors import UsageError
from ..explore.experiment import CALIBRATED, Mission, explore_many, explore_once, with_noise
from ..explore.result import ExploreResult
from ..explore.scenario import find_scenario, make_field
from ..explore.view import ExploreConfig, find_planner
from ..writers.directory import check_target, result_directory
from .map_options import Tick, no_tick

NOISE = {"printed": 1.0, "calibrated": CALIBRATED}
ASSOCIATIONS = ("known", "nn", "jcbb")


def explore(
    scenario: str = "yuan",
    out: Path | str | None = None,
    *,
    robots: int | None = None,
    runs: int = 1,
    seed: int = 0,
    planner: str = "paper",
    association: str | None = None,
    noise: str | float = "calibrated",
    until: str | int = "field",
    kill: Mapping[str, int] | None = None,
    drop: float = 0.0,
    config: Path | str | None = None,
    jobs: int = 1,
    force: bool = False,
    executor: Executor | None = None,
    tick: Tick = no_tick,
) -> ExploreResult:
    """`runs` explorations of `scenario` with seeds `seed`, `seed` + 1, ..., written to `out` when one is given.

    planner: paper, area, coverage, loop, or a dotted name of `choose(maps, poses, cfg) -> commands`; noise: printed,
    calibrated or a factor on the printed standard deviations; until: landmarks, field or a number of steps; kill: robot
    name -> step at whose start it dies; drop: the share of messages between robots that is lost.
    Raises UsageError, ConfigError, DataError or EstimateError; nothing is written then.
    """
    cfg = load(ExploreConfig, None if config is None else Path(config))
    if association is not None:
        cfg = replace(cfg, submap=replace(cfg.submap, association=association))
    factor = _noise(noise)
    if config is None or noise != "calibrated":
        cfg = with_noise(cfg, factor)
    found = find_scenario(scenario)
    world = make_field(found, robots, seed)
    mission = Mission(found, robots, planner, _until(until), _kills(kill or {}, len(world.starts)), drop, cfg)
    _check(mission, runs, jobs)
    find_planner(planner)
    if out is not None:
        check_target(Path(out), force=force)
    tick("exploring", 0, runs)
    first_score, first = explore_once(mission, seed)
    scores = [first_score]
    pool = worker_pool(jobs, runs) if executor is None else nullcontext(executor)
    with pool as workers:
        step = max(1, jobs) * 2
        for start in range(1, runs, step):
            more = explore_many(mission, min(step, runs - start), seed + start, workers)
            scores += [replace(r, run=start + k) for k, r in enumerate(more)]
            tick("exploring", len(scores), runs)
    result = ExploreResult(scenario, mission, seed, factor, tuple(scores), first)
    if out is not None:
        with result_directory(Path(out), force=force) as work:
            _write(work, result)
    return result


def _write(folder: Path, result: ExploreResult) -> None:
    """runs.csv, metrics.json, the first run's log and figures, report.html."""
    from ..report.exploration import write_exploration  # noqa: PLC0415  (figures cost a second)
    from ..writers.exploration import write_runs  # noqa: PLC0415

    write_runs(folder, result.runs, result.metrics(), result.first)
    write_exploration(folder, result)


def parse_kills(text: list[str] | None) -> dict[str, int]:
    """`robot2@100` -> {"robot2": 100}."""
    out: dict[str, int] = {}
    for word in text or []:
        name, at, step = word.partition("@")
        if not at or not step.isdecimal():
            raise UsageError(f"--kill: expected robotK@STEP, found {word!r}")
        out[name] = int(step)
    return out


def worker_pool(jobs: int, runs: int) -> Any:
    """Processes for `runs` runs, as a context; None inside it when one is enough."""
    if jobs < 2 or runs < 3:
        return nullcontext(None)
    return ProcessPoolExecutor(min(jobs, runs - 1), mp_context=get_context("spawn"))


def _noise(noise: str | float) -> float:
    if isinstance(noise, str) and noise in NOISE:
        return NOISE[noise]
    try:
        factor = float(noise)
    except ValueError:
        raise UsageError(f"--noise: expected printed, calibrated or a factor, found {noise!r}") from None
    if not (np.isfinite(factor) and factor > 0):
        raise UsageError(f"--noise: expected a positive factor, found {noise!r}")
    return factor


def _until(until: str | int) -> str | int:
    if isinstance(until, str) and until in ("landmarks", "field"):
        return until
    try:
        steps = int(until)
    except ValueError:
        raise UsageError(f"--until: expected landmarks, field or a number of steps, found {until!r}") from None
    if steps < 1:
        raise UsageError(f"--until: expected at least 1 step, found {steps}")
    return steps


def _kills(kill: Mapping[str, int], robots: int) -> dict[int, int]:
    names = {f"robot{k + 1}": k for k in range(robots)}
    for name in kill:
        if name not in names:
            raise UsageError(f"--kill: no robot is called {name!r}; there are {', '.join(names)}")
    return {names[name]: step for name, step in kill.items()}


def _check(mission: Mission, runs: int, jobs: int) -> None:
    if runs < 1 or jobs < 1:
        raise UsageError(f"--runs and --jobs: expected at least 1, found {runs} and {jobs}")
    if not 0 <= mission.drop < 1:
        raise UsageError(f"--drop: expected a share of messages from 0 to below 1, found {mission.drop:g}")
    if mission.cfg.submap.association not in ASSOCIATIONS:
        raise UsageError(
            f"--association: expected one of {', '.join(ASSOCIATIONS)}, found {mission.cfg.submap.association!r}"
        )
