"""One experiment: its settings, how one of its runs ended, and many runs with seeds in a row."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Generic, TypeVar

from ..io.kept import parts

Scenario = TypeVar("Scenario")
Config = TypeVar("Config")
Experiment = TypeVar("Experiment")
Score = TypeVar("Score")


@dataclass(frozen=True, slots=True)
class Mission(Generic[Scenario, Config]):
    """One experiment's settings. kills: robot index -> step at whose start it dies; drop: share of messages lost.

    until: landmarks, field, or a number of steps; robots: None for as many as the scenario has.
    """

    scenario: Scenario
    robots: int | None
    planner: str
    until: str | int
    kills: Mapping[int, int] | None
    drop: float
    cfg: Config


@dataclass(frozen=True, slots=True)
class RunScore:
    """How a run ended. Lengths in metres in the map's frame without alignment; None where there is no such figure.

    c_per_n: mean ellipse area [m^2] of what the map consists of, landmarks or keyframe positions; ms_per_decision: the
    processor's time, which differs between equal runs.
    """

    run: int
    seed: int
    finished: bool
    steps: int
    map_error: float | None
    c_per_n: float | None
    nees_per_dof: float | None
    duplicates: int | None
    misassociations: int
    missed: int | None
    ms_per_decision: float


def run_seeds(
    score_one: Callable[[Experiment, int, int], Score],
    mission: Experiment,
    runs: int,
    seed: int,
    executor: Executor | None = None,
) -> list[Score]:
    """Scores of `runs` runs with seeds `seed`, `seed` + 1, ...; the same with any executor.

    score_one: (mission, seed, run) -> how that run ended.
    """
    return parts(score_one, [(mission, seed + k, k) for k in range(runs)], executor)
