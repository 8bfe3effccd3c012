"""One experiment: its settings, how one of its runs ended, many runs with seeds in a row, and what these come to."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from ..core.version import __version__
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


AnyMission = TypeVar("AnyMission", bound=Mission[Any, Any])
AnyScore = TypeVar("AnyScore", bound=RunScore)
Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class ExplorationResult(Generic[AnyMission, AnyScore, Record]):
    """Every run's score and the first run's record.

    noise: the factor on the errors of motion, None where the configuration is no multiple of the usual one.
    """

    scenario: str
    mission: AnyMission
    seed: int
    noise: float | None
    runs: tuple[AnyScore, ...]
    first: Record

    MEANS: ClassVar[Mapping[str, str]] = {
        "map_error_m": "map_error",
        "c_per_n_m2": "c_per_n",
        "nees_per_dof": "nees_per_dof",
        "duplicates": "duplicates",
        "misassociations": "misassociations",
        "missed": "missed",
        "ms_per_decision": "ms_per_decision",
    }  # summary key -> the score it is the mean of

    def averages(self) -> dict[str, Any]:
        """Counts, and means over the runs; a figure no run has is None."""
        steps = [r.steps for r in self.runs]
        return {
            "finished": sum(r.finished for r in self.runs),
            "runs": len(self.runs),
            "steps_min": min(steps),
            "steps_mean": float(np.mean(steps)),
            "steps_max": max(steps),
        } | {key: self._mean(name) for key, name in self.MEANS.items()}

    def _mean(self, name: str) -> float | None:
        values = [v for r in self.runs if (v := getattr(r, name)) is not None]
        return float(np.mean(values)) if values else None

    def _settings(
        self, robots: Sequence[str], world: Mapping[str, object], planning: Mapping[str, object]
    ) -> dict[str, Any]:
        """The head of metrics.json. world, planning: what this kind of exploration tells of both."""
        m = self.mission
        return {
            "version": __version__,
            "seed": self.seed,
            "scenario": self.scenario,
            **world,
            "robots": len(robots),
            "planner": m.planner,
            **planning,
            "noise_factor": self.noise,
            "until": m.until,
            "kill": {f"robot{j + 1}": step for j, step in (m.kills or {}).items()},
            "drop": m.drop,
            "summary": self.averages(),
        }

    def _line_of_steps(self) -> str:
        s = self.averages()
        steps = f"{s['steps_min']} / {s['steps_mean']:.1f} / {s['steps_max']} (min / mean / max)"
        return f"{s['finished']} of {s['runs']} runs finished; steps {steps}"
