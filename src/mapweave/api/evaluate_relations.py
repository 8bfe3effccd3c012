"""Trajectories against known relations between their poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError, UsageError
from ..core.names import in_order, robot_key
from ..core.records import Track
from ..core.truth import Relations
from ..evaluation.trajectory import RelationScore, exact_pairs, nearest, score_relations
from ..io.relations import is_relations, read_relations
from ..io.table import read_table
from ..io.team_map import read_metrics
from ..io.tum import read_tum
from .result import EvaluationBase

if TYPE_CHECKING:
    from ..report.style import Target


Scans = tuple[Float[np.ndarray, " m"], Sequence[str]]  # stamps [s] and hosts


@dataclass(frozen=True, slots=True, repr=False)
class RelationEvaluation(EvaluationBase):
    """A trajectory scored against known relative poses: over all, and over those with exact stamps."""

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

        scores = {"all": self.relations, "of exact stamps": self.relations_exact}
        shift = {name: s.trans_mean for name, s in scores.items() if s.trans_mean is not None}
        turn = {name: s.rot_mean_deg for name, s in scores.items() if s.rot_mean_deg is not None}
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
    """The score of the robot whose trajectory has poses at most of the relations.

    Robots that drove one after the other in one map count as one: relations reach from one to the next.
    """
    if len(truth) != 1:
        raise UsageError(f"--truth: expected one file of relations, found {len(truth)}")
    relations = read_relations(truth[0])
    homes = [directory, *sorted(directory.glob("components/[0-9]*"), key=lambda p: in_order(p.name))]
    tracks: dict[str, Track] = {}
    scans: dict[str, Scans] = {}
    for home in homes:
        component = _component(directory, home / "trajectories")
        tracks |= {name: track for name, (track, _) in component.items()}
        scans |= {name: seen for name, (_, seen) in component.items()}
    if not tracks:
        raise ReaderError(directory / "trajectories", "expected trajectories, found none")
    return evaluate_tracks(tracks, scans, relations)


def _component(directory: Path, folder: Path) -> dict[str, tuple[Track, Scans]]:
    """Robot -> its trajectory and scans; all of them as one where they drove one after the other in one map."""
    paths = sorted(folder.rglob("*.tum"), key=lambda p: in_order(p.as_posix()))
    names = [path.relative_to(folder).with_suffix("").as_posix() for path in paths]
    each = {name: (read_tum(path), _scans(directory, name)) for name, path in zip(names, paths, strict=True)}
    in_time = sorted(each.values(), key=lambda held: float(held[0].t[0]))
    apart = all(a.t[-1] < b.t[0] for (a, _), (b, _) in pairwise(in_time))
    if len(each) < 2 or not apart or not _one_map(directory, names):
        return each
    whole = Track(np.concatenate([t.t for t, _ in in_time]), np.concatenate([t.pose for t, _ in in_time]))
    hosts = [host for _, (_, seen) in in_time for host in seen]
    return {", ".join(names): (whole, (np.concatenate([t for _, (t, _) in in_time]), hosts))}


def _one_map(directory: Path, names: Sequence[str]) -> bool:
    """Whether the result says that these robots are connected: their trajectories are in one frame."""
    components = read_metrics(directory).get("components")
    groups = (
        [set(map(str, group)) for group in components if isinstance(group, list)]
        if isinstance(components, list)
        else []
    )
    return {robot_key(name) for name in names} in groups


def evaluate_tracks(
    tracks: dict[str, Track],
    scans: dict[str, Scans],
    relations: Relations,
) -> RelationEvaluation:
    """As `evaluate`, on trajectories in memory; `scans`: stamps [s] and hosts of every robot's scans."""

    def covered(robot: str) -> int:
        t = tracks[robot].t
        return int((nearest(t, relations.t1)[1] & nearest(t, relations.t2)[1]).sum())

    robot = max(sorted(tracks, key=in_order), key=covered)
    exact = relations.select(exact_pairs(relations, *scans[robot]))
    track = tracks[robot]
    return RelationEvaluation(robot, score_relations(track, relations), score_relations(track, exact))


def _scans(directory: Path, robot: str) -> Scans:
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
