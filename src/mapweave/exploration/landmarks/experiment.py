"""Many explorations with their scores: a run is a scenario, a seed and a team."""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from ...core.gaussian import mahalanobis2
from ...landmarks.global_map import GlobalMap
from ...landmarks.submap_slam import SubmapConfig
from ...sim.field import Field
from .config import ExploreConfig
from .ground import Ground
from .scenario import ScenarioConfig, make_field
from .team import Moment, Team
from .view import BUILT_IN, find_planner

PRINTED_SD = (0.3, 0.3, 0.05)  # [m], [m], [rad] a step, as the paper prints them
CALIBRATED = 0.05  # the factor on them with which the paper's table comes out


@dataclass(frozen=True, slots=True)
class Mission:
    """One experiment's settings. kills: robot index -> step at whose start it dies; drop: share of messages lost."""

    scenario: ScenarioConfig
    robots: int | None = None
    planner: str = "paper"
    until: str | int = "field"
    kills: Mapping[int, int] | None = None
    drop: float = 0.0
    cfg: ExploreConfig = field(default_factory=ExploreConfig)


@dataclass(frozen=True, slots=True)
class RunScore:
    """How a run ended. Errors in metres in the global frame, no alignment; `None` where no landmark was mapped."""

    run: int
    seed: int
    finished: bool
    steps: int
    map_error: float | None
    c_per_n: float | None
    nees_per_dof: float | None
    duplicates: int
    misassociations: int
    missed: int
    ms_per_decision: float
    collisions: int = 0  # how often a robot's true motion met a wall; it was stopped short of it
    hidden: int = 0  # landmarks that walls hide from every place a robot can reach: neither sought nor missed


@dataclass(frozen=True, slots=True)
class RunRecord:
    """What one run did, for figures and logs: its world, every moment, the final map and who is who in it."""

    world: Field
    robots: tuple[str, ...]
    moments: tuple[Moment, ...]
    first_look: Moment
    map: GlobalMap
    source: Mapping[str, int]
    period: float
    submap_borders: tuple[tuple[int, int, np.ndarray], ...]  # (step, robot, corners (k, 2)) at each hand-over
    ground: Ground | None = None


def with_noise(cfg: ExploreConfig, factor: float) -> ExploreConfig:
    """`cfg` with the printed motion noise times `factor`, in the world and in the filter alike."""
    sd = (PRINTED_SD[0] * factor, PRINTED_SD[1] * factor, PRINTED_SD[2] * factor)
    return replace(cfg, submap=replace(cfg.submap, motion_sd=sd))


def noise_factor(cfg: ExploreConfig) -> float | None:
    """The motion noise of `cfg` over the printed one; None where it is not a multiple of it."""
    ratio = np.array(cfg.submap.motion_sd) / PRINTED_SD
    return round(float(ratio[0]), 12) if np.allclose(ratio, ratio[0], rtol=1e-9) else None


def explore_once(mission: Mission, seed: int, run: int = 0) -> tuple[RunScore, RunRecord]:
    """One run: the landmarks' layout and all noise follow from `seed`."""
    world = make_field(mission.scenario, mission.robots, seed)
    _compile(mission.planner, mission.cfg.submap.association, walled=world.walls is not None)
    rng = np.random.default_rng([seed, 1])
    team = Team(
        world,
        mission.cfg,
        find_planner(mission.planner),
        rng,
        kills=dict(mission.kills or {}),
        drop=mission.drop,
        until=mission.until,
    )
    first = team.look_around()
    moments = tuple(team.play())
    record = RunRecord(
        world,
        team.robots,
        moments,
        first,
        team.G,
        dict(team.truth.source),
        mission.cfg.submap.period,
        tuple(team.borders),
        team.ground,
    )
    return score(team, run, seed, moments), record


@cache
def _compile(planner: str, association: str, *, walled: bool) -> None:
    """Has a built-in planner take a few steps, once a process, so that decisions are timed and not compilation."""
    if planner not in BUILT_IN or planner == "joint":  # whose search before the first step is no compilation
        return
    walls = ((0.0, 4.0, 0.0, 12.0),) if walled else None
    scenario = ScenarioConfig(
        lower=(-12.0, -12.0), upper=(12.0, 12.0), landmarks=((3.0, 3.0), (-3.0, -3.0)), walls=walls
    )
    cfg = ExploreConfig(submap=SubmapConfig(association=association))
    team = Team(make_field(scenario, 2, 0), cfg, find_planner(planner), np.random.default_rng(0), until=3)
    team.look_around()
    for _ in team.play():
        pass


def explore_many(mission: Mission, runs: int, seed: int, executor: Executor | None = None) -> list[RunScore]:
    """Scores of `runs` runs with seeds `seed`, `seed` + 1, ...; the same with any executor."""
    one = partial(_score_only, mission)
    jobs = [(seed + k, k) for k in range(runs)]
    if executor is None:
        return [one(job) for job in jobs]
    return list(executor.map(one, jobs))


def _score_only(mission: Mission, job: tuple[int, int]) -> RunScore:
    return explore_once(mission, *job)[0]


def score(team: Team, run: int, seed: int, moments: tuple[Moment, ...]) -> RunScore:
    """A finished run against the truth: mean landmark distance, mean ellipse area, NEES a degree of freedom."""
    source = team.truth.source
    known = [i for i, name in enumerate(team.G.ids) if name in source]
    marks = team.G.landmarks.select([team.G.ids[i] for i in known])
    true = np.array([source[name] for name in marks.ids], dtype=int)
    decisions = sum(m.decisions for m in moments)
    seconds = sum(m.seconds for m in moments)
    error = marks.mean - team.world.landmarks[true] if known else np.zeros((0, 2))
    blocks = [marks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(len(known))]
    return RunScore(
        run=run,
        seed=seed,
        finished=team.finished,
        steps=team.step,
        map_error=float(np.linalg.norm(error, axis=1).mean()) if known else None,
        c_per_n=float(np.mean([np.pi * np.sqrt(max(np.linalg.det(b), 0.0)) for b in blocks])) if known else None,
        nees_per_dof=mahalanobis2(error.ravel(), marks.cov) / error.size if known else None,
        duplicates=len(known) - len(set(true.tolist())),
        misassociations=team.truth.misassociations,
        missed=len(team.wanted - set(true.tolist())),
        ms_per_decision=1e3 * seconds / max(decisions, 1),
        collisions=team.bumper.collisions,
        hidden=len(team.world.landmarks) - len(team.wanted),
    )
