"""What `locate` found of robots that move: for programs, for files and for people."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..evaluation.swarm import SwarmScore
from ..io.positions import track_files, write_positions, write_track
from ..report.result import ResultBase
from ..report.style import Target
from ..report.swarm import MovedStory, write_moved_report
from ..report.swarm_figures import tracks_figure
from ..swarm.moving.result import SwarmTrack
from ..swarm.posterior import chi2_warnings, share_warnings
from ..swarm.result import SwarmStatus
from .located import NO_SCORE, Settings, counts, dropped_lines, head, sigma_text, write_rest
from .swarm_input import SwarmInput


@dataclass(frozen=True, slots=True, repr=False)
class Moved(ResultBase):
    """What `locate` gives for robots that move: a trajectory each, with its covariances.

    truth: by robot index, the true positions at the trajectory's stamps.
    """

    given: SwarmInput
    settings: Settings
    track: SwarmTrack
    score: SwarmScore | None
    truth: Mapping[int, Float[np.ndarray, "k d"]]

    @property
    def reliable(self) -> bool:
        """Whether the smoothing converged, and enough sightings agree with it as `[swarm.verdict]` asks."""
        return self.track.converged and not self._doubts()

    def _doubts(self) -> list[str]:
        t = self.track
        doubts = share_warnings(t.outlier)
        misfit = chi2_warnings(t.chi2, t.dof)
        if misfit and t.dof > 0:
            ratio = t.chi2 / t.dof
            misfit = [f"residuals are {ratio:.3g} times what sigma and the motion model say: covariances are too small"]
        return doubts + misfit

    @property
    def not_localisable(self) -> tuple[str, ...]:
        """Robots without a track, and those whose positions are less sure than the swarm is wide."""
        return tuple(name for k, name in enumerate(self.given.table.ids) if not self.track.localisable(k))

    @property
    def warnings(self) -> tuple[str, ...]:
        warnings = [*self.given.warnings, *self.track.warnings]
        if not self.track.converged:
            warnings.append("the smoothing did not converge")
        else:
            warnings += self._doubts()
        return tuple(warnings)

    @property
    def metrics(self) -> dict[str, Any]:
        """`metrics.json`; keys as the contract names them."""
        t = self.track
        names = self.given.table.ids
        return {
            **head(self.given, self.settings),
            **(NO_SCORE if self.score is None else self.score.as_json()),
            "iterations": t.iterations,
            "status": str(SwarmStatus.CONVERGED if t.converged else SwarmStatus.ITERATION_LIMIT),
            "chi2": t.chi2,
            "dof": t.dof,
            "gauge": t.gauge,
            "null_space": None,
            "not_localisable": list(self.not_localisable),
            "reliable": self.reliable,
            "outliers": int(t.outlier.sum()),
            "moving": True,
            "odometry_scale": None
            if t.scale is None
            else {names[k]: [v, w] for k, (v, w) in sorted(t.scale.items()) if (v, w) != (1.0, 1.0)},
            "warnings": list(self.warnings),
            "timing": self.settings.timing,
        }

    def lines(self) -> list[str]:
        """A summary for people."""
        t = self.track
        knots = sum(len(one.t) for one in t.tracks.values())
        lines = [
            (
                f"{len(self.given.table.ids)} moving robots in {self.given.table.dim}D, "
                f"{len(self.given.table.observer)} sightings, {sigma_text(self.given)}, "
                f"{len(self.given.anchors)} anchors: {knots} positions, {t.method}, {t.iterations} iterations"
            )
        ]
        lines += dropped_lines(self.given)
        if t.gauge:
            lines.append(t.gauge)
        if self.not_localisable:
            lost = self.not_localisable
            lines.append(f"{len(lost)} robots cannot be located: {', '.join(lost[:20])}")
        lines.append(
            f"chi-square {t.chi2:.4g} with {t.dof} degrees of freedom, {int(t.outlier.sum())} outliers: "
            f"{'reliable' if self.reliable else 'NOT reliable'}"
        )
        if self.score is not None:
            lines += self.score.lines()
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def draw(self, target: Target) -> None:
        """The robots in the plane."""
        tracks_figure(target, self.given.table.ids, self.track, self.given.anchors, dict(self.truth))

    def write_into(self, out: Path) -> None:
        """trajectories/ID.csv, positions.csv (each robot's last), metrics.json, report.html and figures/."""
        self.write_data(out)
        story = MovedStory(
            self.given.table.ids, self.track, self.given.anchors, self.truth if self.score is not None else {}
        )
        write_moved_report(out, story, self.lines(), self.metrics)

    def write_data(self, out: Path) -> None:
        table, tracks = self.given.table, self.track.tracks
        n, d = len(table.ids), table.dim
        last, cov, located = np.full((n, d), np.nan), np.full((n, d, d), np.nan), np.zeros(n, dtype=bool)
        lost, files = set(self.not_localisable), track_files(table.ids)
        for k, one in tracks.items():
            write_track(out / "trajectories" / files[table.ids[k]], one.t, one.position, one.cov, one.heading)
            last[k], located[k] = one.position[-1], table.ids[k] not in lost
            if one.cov is not None:
                cov[k] = one.cov[-1]
        seen, wild = counts(n, table.observer, table.target, self.track.outlier)
        write_positions(out / "positions.csv", table.ids, last, cov, located, seen, wild)
        write_rest(out, self.given, self.metrics)
