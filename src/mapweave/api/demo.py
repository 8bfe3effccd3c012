"""`demo`: a small simulated team, mapped, fused while it drives, and scored; everything from one seed.

`self_test`: every kind of job tried on simulated data.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import MapweaveError
from ..core.paths import checked_arguments
from ..core.version import __version__
from ..core.workers import Progress, no_progress
from ..io.directory import check_target, result_directory, write_json
from ..io.mrclam import write_mrclam
from ..report.result import ResultBase, Rows
from ..report.small_pages import draw_checks, write_small_page
from ..report.style import Target
from ..sim.landmarks import TeamWorld, simulate_team
from ..sim.laser_worlds import OfficeConfig
from ..sim.swarm import SwarmScene
from .evaluate import evaluate
from .laser_result import LaserResult
from .locate import locate
from .map import map as map_logs
from .map_landmarks import map_logs as map_team
from .map_options import MapOptions
from .result import load
from .simulate import simulate_landmarks, simulate_laser, simulate_swarm
from .team import TeamResult

WORLD = TeamWorld(robots=4, landmarks=24, minutes=5.0)
SHARE = {"2": 0.7, "4": 0.5}  # maps are unequal in practice
FUSE_EVERY = 15.0  # [s]


@checked_arguments
def demo(
    out: Path | str = "mapweave-demo", *, seed: int = 2012, force: bool = False, on_progress: Progress = no_progress
) -> TeamResult:
    """Simulate a small team, map what each robot saw, fuse the maps and score the result.

    The same seed gives the same result.

    Parameters
    ----------
    out
        The folder to write, with the simulated recording in `out/recording`.
    seed
        Of everything drawn at random (2012).

    Raises
    ------
    UsageError
        For an `out` that holds something other than a result.
    """
    target = Path(out)
    check_target(target, force=force)
    with TemporaryDirectory() as held:
        recording = Path(held) / "recording"
        on_progress("simulating", 0, 1)
        team = simulate_team(WORLD, seed)
        write_mrclam(recording, team)
        on_progress("simulating", 1, 1)
        options = MapOptions(share=SHARE, truth=(recording,), seed=seed, fuse_every=FUSE_EVERY, on_progress=on_progress)
        mapped = map_team([recording], options)
    local = tuple(replace(m, source="recording") for m in mapped.local)  # where the log is in the result
    result = replace(mapped, title="Four robots, one map", local=local)
    with result_directory(target, force=force) as work:
        result.write_into(work)
        write_mrclam(work / "recording", team)
        result.finish(work)
    return result


LANDMARKS_WITHIN, SCANS_WITHIN = 0.2, 0.15  # [m] from the truth that small simulated teams and drives come


class Trial(NamedTuple):
    """name: of the job; found: what came out, in words; good: whether that is as it should be."""

    name: str
    found: str
    good: bool


@dataclass(frozen=True, slots=True, repr=False)
class SelfTest(ResultBase):
    """What `self_test` found. timing: [s] of each trial, compiling included where kernels were not yet cached."""

    trials: tuple[Trial, ...]
    timing: dict[str, float]

    @property
    def healthy(self) -> bool:
        """Whether all trials came out as they should."""
        return all(trial.good for trial in self.trials)

    @property
    def metrics(self) -> dict[str, Any]:
        rows = [trial._asdict() for trial in self.trials]
        return {"version": __version__, "healthy": self.healthy, "trials": rows, "timing": self.timing}

    def lines(self) -> list[str]:
        told = [f"{t.name}: {t.found}{'' if t.good else ' (WRONG)'}" for t in self.trials]
        return [*told, "all is well" if self.healthy else "something is wrong: see above"]

    def headline(self) -> Rows:
        return ("job", "found", "good"), [(t.name, t.found, "yes" if t.good else "no") for t in self.trials]

    def draw(self, target: Target) -> None:
        """Every trial, how it came out, and how long it took."""
        draw_checks(target, self.trials, list(self.timing.items()))

    def write_into(self, folder: Path) -> None:
        """metrics.json, report.html and its picture."""
        png = folder / "figures" / "trials.png"
        self.draw(png)
        write_small_page(folder, "Every kind of job, tried", self.lines(), self.headline(), png)
        write_json(folder / "metrics.json", self.metrics)


def self_test(*, on_progress: Progress = no_progress) -> SelfTest:
    """Try every kind of job on small simulated data: maps, pages and scores, read back and compared with truth.

    Nothing is left behind, and nothing but the installed package is needed.

    Parameters
    ----------
    on_progress
        Called as `on_progress(stage, done, total)`.
    """
    trials, timing = [], {}
    with TemporaryDirectory() as held:
        for k, (name, trial) in enumerate(TRIALS.items()):
            on_progress(name, k, len(TRIALS))
            began = perf_counter()
            try:
                found, good = trial(Path(held))
            except (MapweaveError, OSError, ArithmeticError) as error:
                found, good = f"FAILED: {error}", False
            trials.append(Trial(name, found, good))
            timing[name] = perf_counter() - began
        on_progress("self-test", len(TRIALS), len(TRIALS))
    return SelfTest(tuple(trials), timing)


def _landmarks(home: Path) -> tuple[str, bool]:
    simulate_landmarks(home / "team", robots=3, landmarks=12, minutes=2.0, seed=1)
    map_logs(home / "team", home / "landmarks")
    rmse = evaluate(home / "landmarks", home / "team").as_json()["landmark_rmse"]
    page = (home / "landmarks" / "report.html").stat().st_size
    return f"3 robots, landmark RMSE {rmse:.3f} m, a page of {page / 1e3:.0f} kB", rmse < LANDMARKS_WITHIN


def _laser(home: Path) -> tuple[str, bool]:
    simulate_laser(home / "drive.mcap", OfficeConfig(rooms=2, visited=2), seed=1)
    made = map_logs(home / "drive.mcap", home / "laser")
    ate = evaluate(home / "laser", home / "drive.truth.tum").as_json()["robots"]["1"]["ate"]
    same = bool(np.array_equal(load(home / "laser", LaserResult).maps[0].grid.hits, made.maps[0].grid.hits))
    return f"verdict {made.verdict}, ATE {ate:.3f} m, read back {'the same' if same else 'ANOTHER'}", (
        same and made.verdict == "good" and ate < SCANS_WITHIN
    )


def _swarm(home: Path) -> tuple[str, bool]:
    simulate_swarm(home / "swarm.csv", SwarmScene(robots=100), seed=1)
    located = locate(home / "swarm.csv", home / "swarm")
    reliable = bool(located.metrics["reliable"])
    return f"100 robots, {'reliable' if reliable else 'NOT reliable'}", reliable


TRIALS: dict[str, Callable[[Path], tuple[str, bool]]] = {
    "landmarks": _landmarks,
    "laser": _laser,
    "swarm": _swarm,
}
