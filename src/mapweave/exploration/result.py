"""What many explorations come to, whatever the sensors: means over the runs, and what metrics.json tells of all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from ..core.version import __version__
from .mission import Mission, RunScore

AnyMission = TypeVar("AnyMission", bound=Mission[Any, Any])
Score = TypeVar("Score", bound=RunScore)
Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class ExplorationResult(Generic[AnyMission, Score, Record]):
    """Every run's score and the first run's record.

    noise: the factor on the errors of motion, None where the configuration is no multiple of the usual one.
    """

    scenario: str
    mission: AnyMission
    seed: int
    noise: float | None
    runs: tuple[Score, ...]
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
