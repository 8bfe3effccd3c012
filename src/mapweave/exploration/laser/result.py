"""What many explorations with lasers come to: every run's score, their means, the lines that tell of them."""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from ...laser.closures import Closure
from ..mission import ExplorationResult
from .experiment import LaserMission, LaserRunRecord, LaserScore


@dataclass(frozen=True, slots=True)
class LaserExploreResult(ExplorationResult[LaserMission, LaserScore, LaserRunRecord]):
    """noise: the factor on odometry errors."""

    MEANS: ClassVar[Mapping[str, str]] = {
        **ExplorationResult.MEANS,
        "area_mapped": "area_mapped",
        "trajectory_rmse_m": "trajectory_rmse",
        "wall_precision": "wall_precision",
        "wall_recall": "wall_recall",
        "closures": "closures",
        "refused": "refused",
        "driven_m": "driven",
    }

    def averages(self) -> dict[str, Any]:
        """Counts, and means over the runs; a figure no run has is None."""
        return ExplorationResult.averages(self) | {
            "area_mapped_min": min(r.area_mapped for r in self.runs),
            "collisions": sum(r.collisions for r in self.runs),
        }

    @property
    def metrics(self) -> dict[str, Any]:
        """What metrics.json holds; only `timing` and `ms_per_decision` differ between equal runs."""
        first = self.first
        runs = [asdict(r) for r in self.runs]
        seconds = [r.pop("seconds") for r in runs]
        return self._settings(first.robots, {"sensor": "laser"}, {}) | {
            "runs": runs,
            "first_run": {
                "front_end": {
                    name: {"scans": sum(first.status[j].values()), **dict(sorted(first.status[j].items()))}
                    for j, name in enumerate(first.robots)
                },
                "collisions": dict(zip(first.robots, first.collisions, strict=True)),
                "keyframes": len(first.graph),
                "closures": {
                    "accepted": sum(c.accepted for c in first.closures),
                    "between_robots": sum(c.accepted and c.robots[0] != c.robots[1] for c in first.closures),
                    "refused": refusals(first.closures),
                },
                "unreachable": [dict(zip(("x", "y", "m2"), row, strict=True)) for row in first.building.shut.tolist()],
                "pockets": first.pockets.tolist(),
                "given_up": first.given_up.tolist(),
            },
            "timing": {"runs_s": seconds, "first_run_s": dict(first.timing)},
        }

    def lines(self) -> list[str]:
        """The outcome in a few lines for people."""
        s = self.averages()
        mapped = f"{100 * s['area_mapped']:.2f} % (least {100 * s['area_mapped_min']:.2f} %)"
        lines = [
            self._line_of_steps(),
            f"{mapped} of the reachable area mapped, {s['collisions']} collisions",
        ]
        if s["map_error_m"] is not None and s["trajectory_rmse_m"] is not None:
            lines.append(
                f"map error {s['map_error_m']:.3f} m, trajectory RMSE {s['trajectory_rmse_m']:.3f} m; "
                f"{100 * s['wall_precision']:.1f} % of the map's walls are walls, "
                f"{100 * (s['wall_recall'] or 0.0):.1f} % of the walls are in the map"
            )
        lines.append(
            f"a run: {s['closures']:.1f} loops closed, {s['refused']:.1f} refused, {s['misassociations']:.2f} false; "
            f"{s['driven_m']:.0f} m driven; {s['ms_per_decision']:.2f} ms a decision"
        )
        lines += [
            f"left out: {area:.1f} m² around ({x:.1f}, {y:.1f}) m, where no robot gets to"
            for x, y, area in self.first.building.shut.tolist()
        ]
        return lines


def refusals(closures: tuple[Closure, ...]) -> dict[str, int]:
    """Why closures were not believed, numbers left out of the reasons, most frequent first."""
    why = Counter(re.sub(r"-?\d+(\.\d+)?", "#", c.reason) for c in closures if not c.accepted)
    return dict(why.most_common())
