"""What `explore` gives: an exploration's scores and first run, able to show and write themselves."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..exploration.landmarks.result import ExploreResult
from ..exploration.laser.result import LaserExploreResult
from ..report.result import ResultBase, Rows

if TYPE_CHECKING:
    from ..report.style import Target


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
