"""Scores against truth: which kind of truth it is decides who judges."""

import re
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import DataError, ReaderError, UsageError
from ..core.names import in_order, robot_key, robot_name
from ..core.paths import checked_arguments, is_path
from ..core.records import Track
from ..core.truth import NO_SURVEY, Relations, Survey
from ..core.workers import one_blas_thread
from ..evaluation.consistency import STILL
from ..evaluation.landmarks import exchanges_told
from ..evaluation.swarm import StandingSwarm, SwarmScore, score_moving, score_standing
from ..evaluation.team import LOOSE, RobotTruth, TeamScore, as_json, score_team
from ..evaluation.trajectory import (
    WITHIN,
    Errors,
    RelationScore,
    TrackScore,
    exact_pairs,
    nearest,
    paired,
    score_relations,
    score_tracks,
)
from ..io.directory import no_result, plain, read_json
from ..io.landmark_truth import TABLE, is_relations, read_relations, read_robot_truth, read_survey
from ..io.positions import Positions, read_network, read_positions, read_track, track_files
from ..io.pyfg import is_pyfg, read_pyfg
from ..io.saved_result import expect_whole
from ..io.sightings import SwarmTruth
from ..io.table import read_table
from ..io.team_map import read_metrics, read_single_maps, read_team_maps
from ..io.tum import read_result_track, read_tum, read_tum_rows, track_from
from ..report.result import ResultBase
from ..report.style import Target
from ..report.team_figures import draw_bars, draw_team_score, draw_tracks
from .in_memory import Truths, result_folder, truth_files
from .located import read_truth
from .map_options import expect_there
from .result import EvaluationBase, Result


@dataclass(frozen=True, slots=True, repr=False)
class TrackEvaluation(EvaluationBase):
    """APE and RPE of a trajectory; score: None where no stamp of it is one of the truth's."""

    name: str
    estimate: Track
    truth: Track
    score: TrackScore | None

    @property
    def unscored(self) -> str:
        return "" if self.score else f"no stamp of {self.name} is within {1000 * WITHIN:.0f} ms of one of the truth"

    def draw(self, target: Target) -> None:
        """Both trajectories from above, the estimate where it fits best."""
        if self.score is not None:
            draw_tracks(target, self.estimate, self.truth, self.score.T_truth_estimate)

    @property
    def doubts(self) -> tuple[str, ...]:
        """That only half a turn about a level axis fits the two, as it does a way and its mirror image."""
        if self.score is None or self.score.T_truth_estimate[2, 2] > 0:
            return ()
        ours, true, _ = paired(self.estimate, self.truth, dense=False)
        level = se2.act(se2.align(ours[:, :2], true[:, :2]), ours[:, :2]) - true[:, :2]
        # a straight way may be turned over for nothing
        if np.sqrt(np.square(level).sum(axis=1).mean()) < max(STILL, 2.0 * self.score.ape_aligned.rmse):
            return ()
        return ("aligned by turning it over: seen from above the trajectory or the truth is mirrored",)

    def as_json(self) -> dict[str, Any]:
        return {} if self.score is None else {**plain(asdict(self.score)), "warnings": [*self.doubts]}

    def lines(self) -> list[str]:
        if self.score is None:
            return [self.unscored]
        s = self.score
        rows = [("APE as it is", s.ape, "m"), ("APE aligned", s.ape_aligned, "m"), ("RPE a step", s.rpe, "m")]
        rows += [("heading as it is", s.ape_rotation, "deg"), ("turn a step", s.rpe_rotation, "deg")]
        return [
            f"{self.name}: {s.n} poses",
            *(_error_line(*row) for row in rows if row[1] is not None),
            *(f"warning: {doubt}" for doubt in self.doubts),
        ]


def _error_line(what: str, e: Errors | None, unit: str) -> str:
    return "" if e is None else f"{what}: RMSE {e.rmse:.4f} {unit}, mean {e.mean:.4f}, most {e.max:.4f}"


def is_track(path: object) -> bool:
    """Whether `path` is a file of a trajectory."""
    return isinstance(path, str | Path) and Path(path).suffix.lower() in {".tum", ".txt"} and Path(path).is_file()


def judge_track(path: Path, truth: Sequence[Path]) -> TrackEvaluation:
    """The score of the trajectory in `path`."""
    if len(truth) != 1 or not is_track(truth[0]):
        found = ", ".join(str(p) for p in truth)
        raise UsageError(f"truth: expected one TUM trajectory, as {path} is one, found {found}")
    own, true = read_tum_rows(path), read_tum_rows(truth[0])
    return TrackEvaluation(path.name, track_from(own), track_from(true), score_tracks(own, true))


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

    def draw(self, target: Target) -> None:
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
            f"{self.robot}: {_relation_line(score, what)}"
            for score, what in ((self.relations, "relations"), (self.relations_exact, "relations of exact stamps"))
        ]


def has_trajectories_for(directory: Path, truth: Path) -> bool:
    """Relations, for results with trajectories."""
    return is_relations(truth) and (directory / "trajectories").is_dir()


def judge_relations(directory: Path, truth: Sequence[Path]) -> RelationEvaluation:
    """The score, against relations, of the robot whose trajectory has poses at most of the relations.

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
    held = {name: read_result_track(path) for name, path in zip(names, paths, strict=True)}
    each = {name: (track, _scans(directory, name)) for name, track in held.items() if len(track.t)}
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
    """As `judge_relations`, on trajectories in memory; `scans`: stamps [s] and hosts of every robot's scans."""

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


def _relation_line(score: RelationScore, what: str) -> str:
    if not score.used:
        return f"none of {score.n} {what} has a pose at both ends"
    return (
        f"translation {score.trans_mean:.4f} +- {score.trans_std:.4f} m (max {score.trans_max:.3f}), rotation "
        f"{score.rot_mean_deg:.3f} +- {score.rot_std_deg:.3f} deg over {score.used} of {score.n} {what}"
    )


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

    def draw(self, target: Target) -> None:
        errors = self.score.errors
        lengths = {"RMSE": self.score.rmse, "of distances": errors.distance if errors else None}
        angles = {"of angles": errors.angle_deg if errors else None}
        groups = {"error [m]": lengths, "error [deg]": angles}
        draw_bars(target, {unit: {k: v for k, v in e.items() if v is not None} for unit, e in groups.items()})

    def as_json(self) -> dict[str, Any]:
        return {**self.score.as_json(), "robots": self.score.scored, "not_localisable": self.not_localisable}

    def lines(self) -> list[str]:
        return self.score.lines()


def is_of_swarm(directory: Path, truth: Path) -> bool:  # noqa: ARG001  (any truth of robots is scored)
    """Whether `directory` is what `locate` wrote."""
    return (directory / "positions.csv").is_file()


def judge_swarm(directory: Path, truth: Sequence[Path]) -> SwarmEvaluation:
    """The score of the positions, or of the trajectories where the robots moved.

    Raises ReaderError for a damaged result or truth, DataError when the truth names none of its robots.
    """
    metrics = read_json(directory / "metrics.json")
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

    def draw(self, target: Target) -> None:
        draw_team_score(target, self.score)

    def as_json(self) -> dict[str, Any]:
        return as_json(self.score)

    def lines(self) -> list[str]:
        return team_lines(self.score)


def is_of_team(directory: Path, truth: Path) -> bool:
    """Folders, zip files, TUM files and `id,x,y` tables, for results with landmarks or trajectories."""
    return _tells_of_team(truth) and ((directory / "landmarks.csv").exists() or (directory / "trajectories").is_dir())


def _tells_of_team(truth: Path) -> bool:
    return truth.is_dir() or truth.suffix.lower() in (".zip", ".tum", ".txt", ".csv") or is_pyfg(truth)


def judge_team(directory: Path, truth: Sequence[Path]) -> TeamEvaluation:
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
    out += exchanges_told(score.exchanges)
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
        robot = robot_name(named[1]) if named else robots[position] if position < len(robots) else f"{LOOSE}{path.name}"
        if robot in out:
            raise DataError(f"{path}: two true trajectories for {robot}, the other is {out[robot]}")
        out[robot] = path
    return out


def _named_as(tracks: dict[str, RobotTruth], robots: Sequence[str]) -> dict[str, RobotTruth]:
    """Truth of robotK also for a fused result's `DIR/robotK`."""
    return {**tracks, **{r: tracks[r.rpartition("/")[2]] for r in robots if r.rpartition("/")[2] in tracks}}


def _figure(value: object, form: str = "{:.3f}") -> str:
    return "-" if value is None else form.format(value)


@runtime_checkable
class Evaluation(Result, Protocol):
    """The score of a result against truth: `as_json` has the documented keys, `lines` are for people."""

    @property
    def unscored(self) -> str: ...
    def add_to(self, folder: Path, truth: Sequence[Path]) -> None: ...
    def as_json(self) -> dict[str, Any]: ...
    def lines(self) -> list[str]: ...


RULE = (
    "truth is an MRCLAM data set, a survey id,x,y (.csv), trajectories t x y z qx qy qz qw (.tum, of robot K where the "
    "name holds robotK, else in the order given), relations between poses (.relations), or id,x,y of a swarm's robots"
)


@checked_arguments
@one_blas_thread()
def evaluate(directory: Path | str | ResultBase, truth: Truths) -> Evaluation:
    """Score a result against what is true, by the rules that every table here is made with.

    Parameters
    ----------
    directory
        What `map`, `fuse`, `locate` or `localize` wrote, or gave; or a trajectory alone, as a TUM file.
    truth
        One or more files of one kind: an MRCLAM data set, a survey `id,x,y` (.csv), TUM trajectories (of robot K where
        the name holds `robotK`, else in the order given), relations, or the true positions of a swarm. Or tables in
        memory: a survey or a swarm with the columns id, x, y; trajectories with t, x, y, theta, and robot, or a table
        each in the order of the robots (or `Track`s); relations with t1, t2, x, y, theta. Metres, radians, seconds.

    Raises
    ------
    ReaderError
        Where either is missing or damaged.
    DataError
        Where nothing of the result could be scored, with the reason.
    UsageError
        Where nobody knows that kind of truth.

    Examples
    --------
    >>> team = simulate_landmarks("team", robots=2, landmarks=8, minutes=0.5, seed=1)
    >>> result = map("team", "out")
    >>> evaluate("out", "team").metrics["landmark_n"]
    7
    >>> evaluate("out/trajectories/robot1.tum", "out/trajectories/robot1.tum").metrics["ape"]["rmse"]  # as evo_ape
    0.0
    >>> x, y = zip(*team.landmarks.values())
    >>> survey = {"id": list(team.landmarks), "x": x, "y": y}
    >>> evaluate(result, survey).metrics["landmark_n"]
    7
    """
    alone = is_track(directory)
    folders = nullcontext(Path(str(directory))) if alone else result_folder(directory, "directory")
    with folders as folder, truth_files(truth) as paths:
        if not paths:
            raise UsageError("truth: expected paths or tables in memory, found none")
        if not alone and is_path(directory):
            expect_whole(folder)
        evaluation: Evaluation = judge_track(folder, paths) if alone else judged(folder, paths)
        if evaluation.unscored:
            raise DataError(f"{', '.join(map(str, paths))}: nothing to score: {evaluation.unscored}; {RULE}")
        return evaluation


def judged(folder: Path, truth: Sequence[Path]) -> Evaluation:
    """The score as its judge gives it, also where nothing could be scored."""
    if not (folder / "metrics.json").is_file():
        raise no_result(folder)
    if not truth:
        raise UsageError("--truth: expected a path, found none")
    expect_there(truth)
    for applies, judge in JUDGES:
        if applies(folder, truth[0]):
            return judge(folder, truth)
    raise UsageError(f"{truth[0]}: no kind of truth that is known for {folder}; {RULE}")


def expect_truth(paths: Sequence[Path]) -> None:
    """Raises what the score of a map would for truth that cannot be read: before the work, which it would cost."""
    if is_relations(paths[0]):
        read_relations(paths[0])
    elif _tells_of_team(paths[0]):
        read_team_truth(paths, ())
    else:
        raise UsageError(f"{paths[0]}: no kind of truth that is known; {RULE}")


JUDGES: tuple[tuple[Callable[[Path, Path], bool], Callable[[Path, Sequence[Path]], Evaluation]], ...] = (
    # asked in this order with the result and the first truth, names and first lines alone; who says yes judges
    (has_trajectories_for, judge_relations),
    (is_of_swarm, judge_swarm),
    (is_of_team, judge_team),
)
