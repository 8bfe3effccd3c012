"""Trajectories against known relations between their poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError, UsageError
from ..core.names import in_order
from ..core.records import Track
from ..core.truth import Relations
from ..evaluation.relations import RelationScore, exact_pairs, nearest, score_relations
from ..io.relations import is_relations, read_relations
from ..io.table import read_table
from ..io.tum import read_tum
from .result import EvaluationBase

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False)
class RelationEvaluation(EvaluationBase):
    """The score on all relations, and on those whose both ends are at scans with stamps that are right."""

    robot: str
    relations: RelationScore
    relations_exact: RelationScore

    @property
    def unscored(self) -> str:
        if self.relations.used:
            return ""
        return f"none of {self.relations.n} relations has a pose of the result within 6 ms at both ends"

    def draw(self, target: "Target") -> None:
        from ..report.score import draw_bars  # noqa: PLC0415  (figures cost half a second)

        told = {"all": self.relations, "of exact stamps": self.relations_exact}
        shift = {name: s.trans_mean for name, s in told.items() if s.trans_mean is not None}
        turn = {name: s.rot_mean_deg for name, s in told.items() if s.rot_mean_deg is not None}
        draw_bars(target, {"translation error, mean [m]": shift, "rotation error, mean [deg]": turn})

    def as_json(self) -> dict[str, Any]:
        return {
            "relations": self.relations.as_json(),
            "relations_exact": self.relations_exact.as_json(),
            "robot": self.robot,
        }

    def lines(self) -> list[str]:
        return [
            f"{self.robot}: {_line(score, what)}"
            for score, what in ((self.relations, "relations"), (self.relations_exact, "relations of exact stamps"))
        ]


def applies(directory: Path, truth: Path) -> bool:
    return is_relations(truth) and (directory / "trajectories").is_dir()


def evaluate(directory: Path, truth: Sequence[Path]) -> RelationEvaluation:
    """The score of the robot whose trajectory has poses at most of the relations."""
    if len(truth) != 1:
        raise UsageError(f"--truth: expected one file of relations, found {len(truth)}")
    relations = read_relations(truth[0])
    tracks = {path.stem: read_tum(path) for path in sorted((directory / "trajectories").glob("*.tum"))}
    if not tracks:
        raise ReaderError(directory / "trajectories", "expected trajectories, found none")
    return evaluate_tracks(tracks, {robot: _scans(directory, robot) for robot in tracks}, relations)


def evaluate_tracks(
    tracks: dict[str, Track],
    scans: dict[str, tuple[Float[np.ndarray, " m"], Sequence[str]]],
    relations: Relations,
) -> RelationEvaluation:
    """As `evaluate`, on trajectories in memory; `scans`: stamps [s] and hosts of every robot's scans."""

    def found(robot: str) -> int:
        t = tracks[robot].t
        return int((nearest(t, relations.t1)[1] & nearest(t, relations.t2)[1]).sum())

    robot = max(sorted(tracks, key=in_order), key=found)
    exact = relations.select(exact_pairs(relations, *scans[robot]))
    track = tracks[robot]
    return RelationEvaluation(robot, score_relations(track, relations), score_relations(track, exact))


def _scans(directory: Path, robot: str) -> tuple[Float[np.ndarray, " m"], Sequence[str]]:
    for path in (directory / "local" / robot / "scans.csv", directory / "scans.csv"):
        if path.is_file():
            table = read_table(path)
            if "t" in table.columns and "host" in table.columns:
                return table.numbers("t"), list(table.columns["host"])
    return np.zeros(0), []


def _line(score: RelationScore, what: str) -> str:
    if not score.used:
        return f"none of {score.n} {what} has a pose at both ends"
    return (
        f"translation {score.trans_mean:.4f} +- {score.trans_std:.4f} m (max {score.trans_max:.3f}), rotation "
        f"{score.rot_mean_deg:.3f} +- {score.rot_std_deg:.3f} deg over {score.used} of {score.n} {what}"
    )
