"""A team's map against surveyed landmarks and true trajectories."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import DataError, ReaderError
from ..core.names import in_order, robot_key, robot_name
from ..core.truth import NO_SURVEY, Survey
from ..evaluation.team import RobotTruth, TeamScore, as_json, score_team
from ..io.landmark_truth import TABLE, read_robot_truth, read_survey
from ..io.pyfg import is_pyfg, read_pyfg
from ..io.team_map import read_single_maps, read_team_maps
from ..io.tum import read_tum
from .result import EvaluationBase

if TYPE_CHECKING:
    from ..report.style import Target


DENSE = 0.5  # [s] median spacing under which truth is thinned
IN_NAME = re.compile(r"robot[_-]?([0-9]+)", re.IGNORECASE)
KINDS = {"groundtruth": ("Groundtruth", True), "instants": ("Instants", False), "keyframes": ("Keyframes", True)}


@dataclass(frozen=True, slots=True)
class TeamTruth:
    """The survey and the true trajectories there are; either may be empty."""

    survey: Survey
    robots: dict[str, RobotTruth]


@dataclass(frozen=True, slots=True, repr=False)
class TeamEvaluation(EvaluationBase):
    """A team's map and trajectories scored against surveyed landmarks and true trajectories."""

    score: TeamScore

    @property
    def unscored(self) -> str:
        return unscored(self.score)

    def draw(self, target: "Target") -> None:
        from ..report.score import draw_team_score  # noqa: PLC0415  (figures cost half a second)

        draw_team_score(target, self.score)

    def as_json(self) -> dict[str, Any]:
        return as_json(self.score)

    def lines(self) -> list[str]:
        return team_lines(self.score)


def applies(directory: Path, truth: Path) -> bool:
    """Folders, zip files, TUM files and `id,x,y` tables, for results with landmarks or trajectories."""
    known = truth.is_dir() or truth.suffix.lower() in (".zip", ".tum", ".txt", ".csv") or is_pyfg(truth)
    return known and ((directory / "landmarks.csv").exists() or (directory / "trajectories").is_dir())


def evaluate(directory: Path, truth: Sequence[Path]) -> TeamEvaluation:
    """The score of the result in `directory`."""
    maps = read_team_maps(directory)
    known = read_team_truth(truth, sorted({r for m in maps for r in m.robots}, key=in_order))
    return TeamEvaluation(score_team(maps, read_single_maps(directory), known.survey, known.robots))


def read_team_truth(paths: Sequence[Path], robots: Sequence[str]) -> TeamTruth:
    """Survey and trajectories of data sets, tables and TUM files together; `robots`: whose a TUM file may be."""
    survey = NO_SURVEY
    tracks: dict[str, RobotTruth] = {}
    paths = [p for path in paths for p in _with_tracks(path)]
    loose = [p for p in paths if p.is_file() and p.suffix.lower() in (".tum", ".txt")]
    for path in paths:
        if path in loose:
            continue
        if is_pyfg(path):
            true, places = read_pyfg(path).truth()
            tracks |= {robot: RobotTruth("vertices", track, dense=True) for robot, track in true.items()}
            survey = Survey(tuple(places), np.array(list(places.values())).reshape(-1, 2)) if places else survey
            continue
        if path.is_dir() or path.suffix.lower() in (".zip", ".csv"):
            survey = read_survey(path)
            for robot, (track, kind) in read_robot_truth(path).items():
                tracks[robot] = RobotTruth(KINDS[kind][0], track, KINDS[kind][1])
        else:
            raise ReaderError(path, "expected an MRCLAM data set, id,x,y as .csv, or .tum trajectories, found neither")
    for robot, path in _belonging(loose, robots).items():
        track = read_tum(path, "survey")
        dense = len(track.t) > 1 and float(np.median(np.diff(track.t))) < DENSE
        tracks[robot] = RobotTruth("TUM", track, dense)
    if not len(survey) and not tracks:
        raise DataError(f"{paths[0]}: no surveyed landmark and no true trajectory in it")
    return TeamTruth(survey, _named_as(tracks, robots))


def _with_tracks(path: Path) -> list[Path]:
    """`path`, and the trajectories beside the survey where it is a folder of both (or holds one called `truth`)."""
    if (path / "truth" / TABLE).is_file():
        path = path / "truth"
    return [path, *sorted(path.glob("*.tum"))] if (path / TABLE).is_file() else [path]


def unscored(score: TeamScore) -> str:
    """Why neither landmarks nor trajectories could be scored; empty where something was."""
    if score.landmarks.rmse is not None or any(r.ate is not None for r in score.robots.values()):
        return ""
    named = [name for name, r in score.robots.items() if r.truth]
    if named:
        return f"the true poses of {', '.join(named)} are of other times than the result's"
    robots = ", ".join(score.robots) or "none"
    return f"no landmark of the result is surveyed, and no true trajectory is of its robots ({robots})"


def team_lines(score: TeamScore) -> list[str]:
    """The score for people: metres, degrees where angles are meant."""
    metrics = as_json(score)
    out = []
    if score.landmarks.rmse is not None:
        nees = _figure(score.landmarks.nees_per_dof, "{:.2f}")
        out.append(
            f"landmarks: RMSE {score.landmarks.rmse:.3f} m over {len(score.landmarks.ids)} surveyed, "
            f"NEES/dof {nees} ({score.landmarks.dof} dof)"
        )
        out.append(
            f"  mean single map {_figure(score.mean_single_rmse)} m, naive average {_figure(score.naive_rmse)} m "
            f"(ratios {_figure(metrics['ratio_to_mean_single'], '{:.2f}')}, "
            f"{_figure(metrics['ratio_to_naive'], '{:.2f}')})"
        )
    if score.landmarks.unsurveyed:
        out.append(f"  {score.landmarks.unsurveyed} landmarks have no survey and are left out")
    out += [str(e) for e in score.exchanges]
    if score.landmarks_exchanged is not None:
        mended = score.landmarks_exchanged
        out.append(
            f"  exchanged back: RMSE {_figure(mended.rmse)} m, NEES/dof {_figure(mended.nees_per_dof, '{:.2f}')}"
        )
    for name, r in score.robots.items():
        ate = f"ATE {_figure(r.ate)} m over {r.n} poses ({r.truth})" if r.truth else "no true trajectory"
        ate += f", {r.left_out} where it is left out do not count" if r.left_out else ""
        own = "" if r.single_map_rmse is None else f", own map {_figure(r.single_map_rmse)} m"
        out.append(f"robot {robot_key(name)}: {ate}{own}")
    return [*out, *(f"warning: {doubt}" for doubt in score.doubts)]


def _belonging(paths: Sequence[Path], robots: Sequence[str]) -> dict[str, Path]:
    """Robot -> its TUM file: by the number in the file's name, else by position."""
    out: dict[str, Path] = {}
    for path, position in zip(paths, range(len(paths)), strict=True):
        named = IN_NAME.search(path.name)
        robot = robot_name(named[1]) if named else robots[position] if position < len(robots) else f"file {path.name}"
        if robot in out:
            raise DataError(f"{path}: two true trajectories for {robot}, the other is {out[robot]}")
        out[robot] = path
    return out


def _named_as(tracks: dict[str, RobotTruth], robots: Sequence[str]) -> dict[str, RobotTruth]:
    """Truth of robotK also for a fused result's `DIR/robotK`."""
    return {**tracks, **{r: tracks[r.rpartition("/")[2]] for r in robots if r.rpartition("/")[2] in tracks}}


def _figure(value: object, form: str = "{:.3f}") -> str:
    return "-" if value is None else form.format(value)
