"""What many explorations come to: every run's score, their means, the lines that tell of them."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...core.version import __version__
from .experiment import Mission, RunRecord, RunScore


@dataclass(frozen=True, slots=True)
class ExploreResult:
    """Every run's score and the first run's record. noise: motion noise over the printed one, None if no multiple."""

    scenario: str
    mission: Mission
    seed: int
    noise: float | None
    runs: tuple[RunScore, ...]
    first: RunRecord

    def summary(self) -> dict[str, Any]:
        """Counts, and means over the runs; a figure no run has is None."""

        def mean(name: str) -> float | None:
            values = [v for r in self.runs if (v := getattr(r, name)) is not None]
            return float(np.mean(values)) if values else None

        steps = [r.steps for r in self.runs]
        return {
            "finished": sum(r.finished for r in self.runs),
            "runs": len(self.runs),
            "steps_min": min(steps),
            "steps_mean": float(np.mean(steps)),
            "steps_max": max(steps),
            "map_error_m": mean("map_error"),
            "c_per_n_m2": mean("c_per_n"),
            "nees_per_dof": mean("nees_per_dof"),
            "duplicates": mean("duplicates"),
            "misassociations": mean("misassociations"),
            "missed": mean("missed"),
            "ms_per_decision": mean("ms_per_decision"),
            "collisions": mean("collisions"),
        }

    def left_out(self) -> dict[str, Any] | None:
        """What walls hide from everybody, None in an open field: pockets, and the first run's landmarks."""
        ground = self.first.ground
        if ground is None:
            return None
        return {
            "pockets": len(ground.pockets),
            "area_m2": sum(ground.pockets),
            "pocket_areas_m2": list(ground.pockets),
            "landmarks": [
                {"landmark": k + 1, "x": float(x), "y": float(y)}
                for k, (x, y) in zip(ground.hidden, self.first.world.landmarks[list(ground.hidden)], strict=True)
            ],
        }

    def metrics(self) -> dict[str, Any]:
        """What metrics.json holds; only `timing` and `ms_per_decision` differ between equal runs."""
        m = self.mission
        return {
            "version": __version__,
            "seed": self.seed,
            "scenario": self.scenario,
            "robots": len(self.first.robots),
            "planner": m.planner,
            "association": m.cfg.submap.association,
            "noise_factor": self.noise,
            "until": m.until,
            "kill": {f"robot{j + 1}": step for j, step in (m.kills or {}).items()},
            "drop": m.drop,
            "summary": self.summary(),
            "left_out": self.left_out(),
            "runs": [asdict(r) for r in self.runs],
        }

    def lines(self) -> list[str]:
        """The outcome in a few lines for people."""
        s = self.summary()
        steps = f"{s['steps_min']} / {s['steps_mean']:.1f} / {s['steps_max']} (min / mean / max)"
        told = [f"{s['finished']} of {s['runs']} runs finished; steps {steps}"]
        if s["map_error_m"] is not None:
            told.append(
                f"map error {s['map_error_m']:.3f} m, uncertainty C/N {s['c_per_n_m2']:.3f} m², "
                f"NEES per degree of freedom {s['nees_per_dof']:.2f}"
            )
        told.append(
            f"a run: {s['duplicates']:.2f} duplicates, {s['misassociations']:.2f} misassociations, "
            f"{s['missed']:.2f} landmarks missed; {s['ms_per_decision']:.2f} ms a decision"
        )
        return told + self.lines_on_walls()

    def lines_on_walls(self) -> list[str]:
        out = self.left_out()
        if out is None:
            return []
        met = [r.collisions for r in self.runs]
        told = [f"robots were stopped short of walls {sum(met)} times, in {sum(n > 0 for n in met)} of {len(met)} runs"]
        if out["pockets"]:
            what = "a pocket" if out["pockets"] == 1 else f"{out['pockets']} pockets"
            told.append(f"left out: {what} no robot can see into, {out['area_m2']:.0f} m²")
        if out["landmarks"]:
            named = ", ".join(f"{m['landmark']} at ({m['x']:.1f}, {m['y']:.1f})" for m in out["landmarks"])
            told.append(f"left out: landmarks that no robot can see: {named} (seed {self.seed})")
        return told
