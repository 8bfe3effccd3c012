"""What many explorations come to: every run's score, their means, the lines that tell of them."""

from dataclasses import asdict, dataclass
from typing import Any

from ..mission import ExplorationResult
from .experiment import LandmarkMission, LandmarkRunRecord, LandmarkRunScore


@dataclass(frozen=True, slots=True)
class ExploreResult(ExplorationResult[LandmarkMission, LandmarkRunScore, LandmarkRunRecord]):
    """noise: motion noise over the printed one, None if no multiple."""

    def averages(self) -> dict[str, Any]:
        """Counts, and means over the runs; a figure no run has is None."""
        return ExplorationResult.averages(self) | {"collisions": self._mean("collisions")}

    def left_out(self) -> dict[str, Any] | None:
        """What walls hide from everybody, None in an open field: pockets, and the first run's landmarks."""
        floor = self.first.floor
        if floor is None:
            return None
        return {
            "pockets": len(floor.pockets),
            "area_m2": sum(floor.pockets),
            "pocket_areas_m2": list(floor.pockets),
            "landmarks": [
                {"landmark": k + 1, "x": float(x), "y": float(y)}
                for k, (x, y) in zip(floor.hidden, self.first.world.landmarks[list(floor.hidden)], strict=True)
            ],
        }

    @property
    def metrics(self) -> dict[str, Any]:
        """What metrics.json holds; only `timing` and `ms_per_decision` differ between equal runs."""
        return self._settings(self.first.robots, {}, {"association": self.mission.cfg.submap.association}) | {
            "left_out": self.left_out(),
            "runs": [asdict(r) for r in self.runs],
        }

    def lines(self) -> list[str]:
        """The outcome in a few lines for people."""
        s = self.averages()
        lines = [self._line_of_steps()]
        if s["map_error_m"] is not None:
            lines.append(
                f"map error {s['map_error_m']:.3f} m, uncertainty C/N {s['c_per_n_m2']:.3f} m², "
                f"NEES per degree of freedom {s['nees_per_dof']:.2f}"
            )
        lines.append(
            f"a run: {s['duplicates']:.2f} duplicates, {s['misassociations']:.2f} misassociations, "
            f"{s['missed']:.2f} landmarks missed; {s['ms_per_decision']:.2f} ms a decision"
        )
        return lines + self.lines_on_walls()

    def lines_on_walls(self) -> list[str]:
        out = self.left_out()
        if out is None:
            return []
        met = [r.collisions for r in self.runs]
        lines = [
            f"robots were stopped short of walls {sum(met)} times, in {sum(n > 0 for n in met)} of {len(met)} runs"
        ]
        if out["pockets"]:
            what = "a pocket" if out["pockets"] == 1 else f"{out['pockets']} pockets"
            lines.append(f"left out: {what} no robot can see into, {out['area_m2']:.0f} m²")
        if out["landmarks"]:
            named = ", ".join(f"{m['landmark']} at ({m['x']:.1f}, {m['y']:.1f})" for m in out["landmarks"])
            lines.append(f"left out: landmarks that no robot can see: {named} (seed {self.seed})")
        return lines
