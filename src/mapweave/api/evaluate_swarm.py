"""The score of what `locate` wrote, against the truth `id,x,y[,z]` (with `t` for robots that moved)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import DataError
from ..evaluation.swarm import StandingSwarm, SwarmScore, score_moving, score_standing
from ..io.directory import read_json
from ..io.positions import Positions, read_network, read_positions, read_track, track_files
from ..io.sightings import SwarmTruth
from .result import EvaluationBase
from .swarm_input import read_truth

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False)
class SwarmEvaluation(EvaluationBase):
    """Positions of a swarm scored against truth, as `locate` scores them but for the Cramer-Rao bound."""

    score: SwarmScore
    not_localisable: int

    @property
    def unscored(self) -> str:
        if self.score.rmse is not None:
            return ""
        if self.score.scored:
            return "the true places are of other times than the result's"
        return (
            f"no robot of the truth was located freely ({self.not_localisable} cannot be located, anchors don't count)"
        )

    def draw(self, target: "Target") -> None:
        from ..report.score import draw_bars  # noqa: PLC0415  (figures cost half a second)

        errors = self.score.errors
        lengths = {"RMSE": self.score.rmse, "of distances": errors.distance if errors else None}
        angles = {"of angles": errors.angle_deg if errors else None}
        groups = {"error [m]": lengths, "error [deg]": angles}
        draw_bars(target, {unit: {k: v for k, v in e.items() if v is not None} for unit, e in groups.items()})

    def as_json(self) -> dict[str, Any]:
        return {**self.score.as_json(), "robots": self.score.scored, "not_localisable": self.not_localisable}

    def lines(self) -> list[str]:
        return self.score.lines()


def applies(directory: Path, truth: Path) -> bool:  # noqa: ARG001  (any truth of robots is scored)
    """Whether `directory` is what `locate` wrote."""
    return (directory / "positions.csv").is_file()


def evaluate(directory: Path, truth: Sequence[Path]) -> SwarmEvaluation:
    """The score of the positions, or of the trajectories where the robots moved.

    Raises ReaderError for a damaged result or truth, DataError when the truth names none of its robots.
    """
    metrics = _metrics(directory / "metrics.json")
    true = read_truth(truth[0])
    positions = read_positions(directory / "positions.csv")
    if not set(true.ids) & set(positions.ids):
        raise DataError(f"{truth[0]}: the truth names none of the robots of {directory}")
    anchors, gauge = frozenset(map(str, metrics.get("anchors") or ())), str(metrics.get("gauge") or "")
    if metrics.get("moving"):
        score = _moving(directory, positions, anchors, gauge, true)
    else:
        pairs, information = read_network(directory / "network.npz", len(positions.ids))
        anchor = np.array([name in anchors for name in positions.ids], dtype=bool)
        cov = positions.cov if np.isfinite(positions.cov[positions.localisable]).all() else None
        degrees = metrics.get("sigma_deg")
        sigma = float(np.radians(degrees)) if isinstance(degrees, float | int) else None
        standing = StandingSwarm(
            positions.ids, positions.position, cov, positions.localisable, anchor, gauge, pairs, information, sigma
        )
        score = score_standing(standing, true).score
    return SwarmEvaluation(score, int((~positions.localisable).sum()))


def _moving(directory: Path, positions: Positions, anchors: frozenset[str], gauge: str, true: SwarmTruth) -> SwarmScore:
    lost = {name for name, ok in zip(positions.ids, positions.localisable.tolist(), strict=True) if not ok}
    paths = {name: directory / "trajectories" / file for name, file in track_files(positions.ids).items()}
    tracks = {name: read_track(path) for name, path in paths.items() if name not in lost or path.is_file()}
    return score_moving(tracks, anchors | lost, gauge, true)[0]


def _metrics(path: Path) -> dict[str, Any]:
    return read_json(path)
