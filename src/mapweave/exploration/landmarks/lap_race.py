"""Plans of laps against each other on the same layouts of landmarks: most changes are told to be worse after a few.

The mean over all layouts differs little between two plans and much between two lots of layouts. So a plan is held
against its rival layout by layout, and given up as soon as the mean of the differences leaves no doubt.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...kernels.exploration.laps import first_seen
from ...kernels.walls.segments import Raster, Sector
from .lap_judge import LapJudge, Plan

FIRST_LOOK = 4  # layouts after which a plan may be given up: fewer tell nothing of how the differences spread
DOUBT = 2.0  # standard errors of the mean difference that a plan may be better than it looks


@dataclass(frozen=True, slots=True)
class JudgedLaps:
    """A plan with what it comes to. cost: [steps]; errors: [m] expected of each layout.

    track: (M, n, 3) the drive; seen: (M, ny, nx) at which of its steps each robot first sees a cell.
    """

    plan: Plan
    cost: float
    errors: Float[np.ndarray, " layouts"]
    track: Float[np.ndarray, "r n 3"]
    seen: Int[np.ndarray, "r ny nx"]


class LapRace(LapJudge):
    """The same cost as `LapJudge`'s of a task that begins, with no more worked out than a comparison needs."""

    def judged(self, plan: Plan) -> JudgedLaps:
        """The plan with its cost."""
        track, seen = self._drives(plan, None)
        layout_error = self.layout_errors(track)
        errors = np.array([layout_error(k) for k in range(len(self.layouts))])
        cost = self.time_cost(self._shares(seen, track.shape[1])) + self.task.error_weight * float(errors.mean())
        return JudgedLaps(plan, cost, errors, track, seen)

    def unless_dearer(self, plan: Plan, rival: JudgedLaps, enough: float) -> JudgedLaps | None:
        """The plan with its cost; None where that is above `enough`, or after some layouts very probably.

        What robots do whose places are those of `rival`'s plan is taken from there.
        """
        track, seen = self._drives(plan, rival)
        if np.array_equal(track, rival.track):  # a place changed that nobody gets to
            return replace(rival, plan=plan)
        weight, cost = self.task.error_weight, self.time_cost(self._shares(seen, track.shape[1]))
        if cost > enough:
            return None
        layout_error = self.layout_errors(track)
        errors, before = np.empty(len(self.layouts)), float(rival.errors.mean())
        for k in range(len(errors)):
            errors[k] = layout_error(k)
            if k % 2 and k + 1 >= FIRST_LOOK:
                differences = errors[: k + 1] - rival.errors[: k + 1]
                doubt = DOUBT * float(differences.std(ddof=1)) / np.sqrt(k + 1)
                if cost + weight * (before + float(differences.mean()) - doubt) > enough:
                    return None
        cost += weight * float(errors.mean())
        return JudgedLaps(plan, cost, errors, track, seen) if cost <= enough else None

    def whole_drive(self, track: Float[np.ndarray, "r n 3"]) -> Float[np.ndarray, "r k 3"]:
        """All steps of the task, its last ones, in which loops close, among them; then everybody stands still."""
        every, steps = self.task.search.pose_stride, self.task.steps
        still = np.repeat(track[:, steps : steps + 1], -steps % every, axis=1)
        return np.concatenate([track[:, : steps + 1], still], axis=1)

    def _drives(self, plan: Plan, rival: JudgedLaps | None) -> tuple[np.ndarray, np.ndarray]:
        """The drive of every robot, and when it first sees each cell."""
        ways, counts = plan
        s, search = self.task.submap, self.task.search
        sector, raster = Sector(s.reach - search.reach_margin, s.half_angle), Raster(self.lower, search.coarse_cell)
        tracks, seen = [], []
        for j, n in enumerate(counts):
            if rival is not None and n == rival.plan[1][j] and np.array_equal(ways[j, :n], rival.plan[0][j, :n]):
                tracks.append(rival.track[j])
                seen.append(rival.seen[j])
                continue
            tracks.append(self.drive((ways[j : j + 1], counts[j : j + 1]), self.here[j : j + 1])[0])
            seen.append(first_seen(tracks[-1], sector, raster, *self.past.explored.shape))
        return np.stack(tracks), np.stack(seen)

    def _shares(self, seen: np.ndarray, steps: int) -> np.ndarray:
        """What share of the field anybody has seen by each of so many steps."""
        first = seen.min(axis=0).ravel()
        return np.asarray(np.cumsum(np.bincount(first, minlength=steps + 1)[:steps]) / first.size)
