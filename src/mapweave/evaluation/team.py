"""The whole score of a team's map: landmarks, trajectories under the same alignment, single maps for comparison."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.names import in_order, robot_key
from ..core.records import Track
from ..core.truth import Survey
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .consistency import STILL, another_order_fits, beyond, by_chance, mean_or_none, some, spread_of
from .landmarks import Exchange, LandmarkScore, find_exchanges, naive_mean, rmse_after_alignment, score_landmarks
from .trajectory import align_tracks, ate, paired, rpe

RPE_SECONDS = 10.0  # [s] over which relative pose errors are taken
Spans = Sequence[tuple[float, float]]  # (begin, end) [s]
LOOSE = "file "  # begins the name of a trajectory that no robot of the result is left for
OTHER_UNIT = 2.0  # times as far, or as little, as the result a truth spreads that is in another unit


@dataclass(frozen=True, slots=True)
class RobotTruth:
    """kind: which truth it is (Groundtruth, Instants, Keyframes or TUM); dense: it is thinned to 1 Hz."""

    kind: str
    track: Track
    dense: bool = True


@dataclass(frozen=True, slots=True)
class RobotScore:
    """ate [m] over n truth poses; `component`: from 1; rpe over ten seconds [m, rad].

    left_out: truth poses [1] inside spans that the map says it knows nothing of; they do not count.
    """

    ate: float | None
    n: int
    truth: str | None
    single_map_rmse: float | None
    component: int | None
    rpe_trans: float | None = None
    rpe_rot: float | None = None
    left_out: int = 0


@dataclass(frozen=True, slots=True)
class TeamScore:
    """What `evaluate` prints. `alignment`: `T_truth_map` of the largest component; doubts: why the truth may be of
    another recording.
    """

    landmarks: LandmarkScore
    alignment: Float[np.ndarray, "3"] | None
    mean_single_rmse: float | None
    naive_rmse: float | None
    robots: Mapping[str, RobotScore]
    exchanges: tuple[Exchange, ...] = ()
    landmarks_exchanged: LandmarkScore | None = None
    mean_single_rmse_exchanged: float | None = None
    naive_rmse_exchanged: float | None = None
    components: tuple[LandmarkScore, ...] = field(default_factory=tuple)
    doubts: tuple[str, ...] = ()


def score_team(
    maps: Sequence[TeamMap],
    singles: Mapping[str, LandmarkMap],
    survey: Survey,
    truths: Mapping[str, RobotTruth],
) -> TeamScore:
    """The score of `maps` (largest component first); `singles`: each robot's own landmarks, in any frame."""
    scores = tuple(score_landmarks(m.landmarks, survey) for m in maps)
    robots: dict[str, RobotScore] = {}
    alignments = [_alignment(m, s, truths) for m, s in zip(maps, scores, strict=True)]
    where = {robot: k for k, m in enumerate(maps) for robot in m.robots}
    for robot in sorted({*where, *singles}, key=in_order):
        k = where.get(robot)
        track = maps[k].tracks.get(robot) if k is not None else None
        single = rmse_after_alignment(singles[robot], survey) if robot in singles else None
        gaps = maps[k].left_out.get(robot, ()) if k is not None else ()
        robots[robot] = _score_robot(track, truths.get(robot), None if k is None else alignments[k], single, k, gaps)
    tied = [singles[r] for r in maps[0].robots if r in singles]
    naive = naive_mean(tied)
    exchanges, mended = find_exchanges(maps[0].landmarks, survey)
    exchanged_back = score_landmarks(maps[0].landmarks, mended) if exchanges else None
    return TeamScore(
        landmarks=scores[0],
        alignment=alignments[0],
        mean_single_rmse=mean_or_none([rmse_after_alignment(m, survey) for m in tied]),
        naive_rmse=None if naive is None else rmse_after_alignment(naive, survey),
        robots=robots,
        exchanges=exchanges,
        landmarks_exchanged=exchanged_back,
        mean_single_rmse_exchanged=(
            mean_or_none([rmse_after_alignment(m, mended) for m in tied]) if exchanges else None
        ),
        naive_rmse_exchanged=rmse_after_alignment(naive, mended) if exchanges and naive is not None else None,
        components=scores,
        doubts=_doubts(maps, exchanged_back or scores[0], mended, truths, robots),
    )


def _doubts(
    maps: Sequence[TeamMap],
    score: LandmarkScore,
    survey: Survey,
    truths: Mapping[str, RobotTruth],
    robots: Mapping[str, RobotScore],
) -> tuple[str, ...]:
    """Why the truth may be of another recording or unit: landmarks fit by chance, paths no nearer than their middle."""
    told = [f"{name}: it is of no robot of the result" for name in truths if name.startswith(LOOSE)]
    if score.rmse is not None:
        where = dict(zip(survey.ids, survey.xy, strict=True))
        ours, chosen = maps[0].landmarks, set(np.array(score.ids)[some(len(score.ids))].tolist())
        ids = [name for name in ours.ids if name in chosen]
        true = np.array([where[name] for name in ids])
        mean = ours.select(ids).mean

        def error(order: Int[np.ndarray, " k"]) -> float:
            T = se2.align(mean, true[order])
            return float(np.sqrt(np.mean(np.sum((se2.act(T, mean) - true[order]) ** 2, axis=1))))

        if another_order_fits(len(ids), error, spread_of(true)):
            return (*told, by_chance("landmarks", len(score.ids), score.rmse))
        return (*told, doubt) if (doubt := beyond(score.nees_per_dof)) else tuple(told)
    tracks = {name: track for one in maps for name, track in one.tracks.items()}
    for name, r in robots.items():
        if r.ate is None or r.ate <= STILL:
            continue
        found, sought, _ = paired(tracks[name], truths[name].track, dense=truths[name].dense)
        spread, wanted = max(spread_of(found[:, :2]), STILL), spread_of(sought[:, :2])
        if not 1.0 / OTHER_UNIT < wanted / spread < OTHER_UNIT and wanted > STILL:
            told.append(
                f"robot {robot_key(name)}: the true way spreads {wanted / spread:.3g} times as far: the truth "
                "may be in another unit, or of another robot or recording"
            )
        elif r.ate > wanted:
            told.append(
                f"robot {robot_key(name)}: a robot that stands in the middle of the true way is as near to it "
                f"({wanted:.3g} m): the truth may be of another robot or recording"
            )
    return tuple(told)


def as_json(score: TeamScore) -> dict[str, object]:
    """The keys of the contract and a few more; what does not exist is None."""
    mended = score.landmarks_exchanged
    return {
        "landmark_rmse": score.landmarks.rmse,
        "landmark_n": len(score.landmarks.ids),
        "landmark_unsurveyed": score.landmarks.unsurveyed,
        "nees_per_dof": score.landmarks.nees_per_dof,
        "dof": score.landmarks.dof,
        "alignment": None if score.alignment is None else score.alignment.tolist(),
        "mean_single_rmse": score.mean_single_rmse,
        "naive_rmse": score.naive_rmse,
        "ratio_to_naive": _ratio(score.landmarks.rmse, score.naive_rmse),
        "ratio_to_mean_single": _ratio(score.landmarks.rmse, score.mean_single_rmse),
        "exchanged": [[e.a, e.b, e.before, e.after] for e in score.exchanges],
        "landmark_rmse_exchanged": mended.rmse if mended else None,
        "nees_per_dof_exchanged": mended.nees_per_dof if mended else None,
        "mean_single_rmse_exchanged": score.mean_single_rmse_exchanged,
        "naive_rmse_exchanged": score.naive_rmse_exchanged,
        "mean_ate": mean_or_none([r.ate for r in score.robots.values()]),
        "robots": {
            robot_key(name): {
                "ate": r.ate,
                "n": r.n,
                "truth": r.truth,
                "single_map_rmse": r.single_map_rmse,
                "component": r.component,
                "left_out": r.left_out,
                "rpe_trans_10s": r.rpe_trans,
                "rpe_rot_10s": r.rpe_rot,
            }
            for name, r in score.robots.items()
        },
        **({"warnings": list(score.doubts)} if score.doubts else {}),
    }


def _alignment(team: TeamMap, score: LandmarkScore, truths: Mapping[str, RobotTruth]) -> Float[np.ndarray, "3"] | None:
    """Fitted to the landmarks; where there are none, to all trajectories together."""
    if score.alignment is not None:
        return score.alignment
    known = [
        (team.tracks[r], _outside(truths[r], team.left_out.get(r, ())))
        for r in team.robots
        if r in truths and r in team.tracks
    ]
    return align_tracks([(track, truth.track, truth.dense) for track, truth in known])


def _score_robot(
    track: Track | None,
    truth: RobotTruth | None,
    alignment: Float[np.ndarray, "3"] | None,
    single: float | None,
    k: int | None,
    gaps: Spans,
) -> RobotScore:
    component = None if k is None else k + 1
    if track is None or truth is None or alignment is None:
        return RobotScore(None, 0, None if truth is None else truth.kind, single, component)
    known = _outside(truth, gaps)
    error, n = ate(track, known.track, alignment, dense=truth.dense)
    drift = rpe(track, known.track, RPE_SECONDS, dense=truth.dense)
    gone = ate(track, truth.track, alignment, dense=truth.dense)[1] - n if gaps else 0
    return RobotScore(error, n, truth.kind, single, component, *drift, gone)


def _outside(truth: RobotTruth, gaps: Spans) -> RobotTruth:
    """The truth without its poses inside `gaps`, of which the map says that it knows nothing."""
    if not gaps:
        return truth
    t = truth.track.t
    keep = ~np.any([(t > a) & (t < b) for a, b in gaps], axis=0)
    return replace(truth, track=Track(t[keep], truth.track.pose[keep]))


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b
