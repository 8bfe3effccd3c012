"""A fused map made as good as the logs allow: all trajectories, landmarks and calibrations together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.landmark_log import LandmarkLog
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..solve import SingularError, Solution, Status
from .commanded_motion import LAG, TURN
from .config import SmoothingConfig
from .covariance import TeamCovariance, team_covariance
from .smoothing import PARAMETERS, RobotPart, TeamProblem, team_problem
from .team_map import TeamMap

Calibration = Mapping[str, tuple[float, float]]  # parameter -> (value, standard deviation)


@dataclass(frozen=True, slots=True)
class Refined:
    """One component after smoothing. calibration: a robot each; inflation: of its poses' model covariance.

    used: factors of each kind; poses: how many were estimated; refused: why the map is still the filters', or "".
    """

    map: TeamMap
    calibration: Mapping[str, Calibration]
    inflation: Mapping[str, float]
    used: Mapping[str, int]
    poses: int
    iterations: int
    status: str
    refused: str = ""


def refine(
    team: TeamMap,
    logs: Sequence[LandmarkLog],
    labels: Mapping[str, Mapping[str, str]],
    cfg: SmoothingConfig,
    calibration: Mapping[str, Calibration] | None = None,
) -> Refined:
    """`team` with all of `logs` (those of its robots) worked into one least-squares problem, started at the filters'.

    labels[robot]: own landmark name -> name in the map. calibration: what is known beforehand of some robots, in place
    of the prior; a standard deviation of 0 holds a value. Poses stand at every odometry and sighting stamp. Where the
    problem has no minimum near the start, the map stays as it was and `refused` says why.
    """
    own = {log.robot: log for log in logs}
    chosen = [own[robot] for robot in team.robots if robot in own and len(own[robot])]
    problem = team_problem(chosen, team.landmarks, team.tracks, labels, calibration or {}, cfg)
    if not problem.used:
        return _kept(team, problem, "nobody saw a landmark of the map or another robot")
    solution = problem.solve(cfg)
    if solution.status in {Status.SINGULAR, Status.DIVERGED} or not np.isfinite(solution.x).all():
        return _kept(team, problem, f"the problem of the whole team is {solution.status}", solution)
    try:
        cov = team_covariance(problem, solution, cfg)
    except SingularError as error:
        return _kept(team, problem, str(error), solution)
    tracks = dict(team.tracks)
    for part, P in zip(problem.parts, cov.poses, strict=True):
        tracks[part.robot] = _dense(part, solution.x, P)
    m = 2 * len(problem.landmarks)
    mean = solution.x[problem.landmark_start : problem.landmark_start + m].reshape(-1, 2)
    landmarks = LandmarkMap(problem.landmarks, mean, cov.landmarks, team.landmarks.frame)
    return Refined(
        map=replace(team, landmarks=landmarks, tracks=tracks),
        calibration=_calibration(problem, solution, cov),
        inflation={part.robot: f for part, f in zip(problem.parts, cov.inflation, strict=True)},
        used=problem.used,
        poses=sum(len(part.instants.t) for part in problem.parts),
        iterations=solution.iterations,
        status=str(solution.status),
    )


def _kept(team: TeamMap, problem: TeamProblem, why: str, solution: Solution | None = None) -> Refined:
    poses = sum(len(part.instants.t) for part in problem.parts)
    status = "not tried" if solution is None else str(solution.status)
    return Refined(team, {}, {}, problem.used, poses, 0 if solution is None else solution.iterations, status, why)


def _calibration(problem: TeamProblem, solution: Solution, cov: TeamCovariance) -> dict[str, Calibration]:
    """What was found of every robot; parameters that were held are left out."""
    free = np.zeros(len(solution.x), bool)
    free[solution.free] = True
    out: dict[str, Calibration] = {}
    for part, sd in zip(problem.parts, cov.calibration, strict=True):
        at = part.parameters + np.arange(len(PARAMETERS))
        out[part.robot] = {
            name: (float(solution.x[i]), float(d)) for name, i, d in zip(PARAMETERS, at, sd, strict=True) if free[i]
        }
    return out


def _dense(part: RobotPart, x: Float[np.ndarray, " n"], cov: Float[np.ndarray, "k 3 3"]) -> Track:
    """Poses at every stamp of the log: between instants as commanded, bent so that both ends are met."""
    log, at = part.log, part.instants.t
    stamps = [log.sightings.t] if log.odometry is None else [log.sightings.t, log.odometry.t]
    t = np.unique(np.concatenate(stamps))
    poses = x[part.start : part.start + 3 * len(at)].reshape(-1, 3)
    k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, max(len(at) - 2, 0))
    span = np.maximum(at[k + 1] - at[k], 1e-9) if len(at) > 1 else np.ones(len(t))
    share = np.clip((t - at[k]) / span, 0.0, 1.0)
    after = np.minimum(k + 1, len(at) - 1)
    P = (1 - share)[:, None, None] * cov[k] + share[:, None, None] * cov[after]
    if part.motion is None:
        return Track(t, se2.interpolate(t, at, poses), P)
    speed, turn, lag = (float(x[part.parameters + j]) for j in (0, TURN, LAG))
    said_at, said = (part.motion.at(stamp, speed, turn, lag)[0] for stamp in (at, t))
    there = se2.compose(poses[k], se2.between(said_at[k], said))
    end = se2.compose(poses[k], se2.between(said_at[k], said_at[after]))
    miss = se2.log(se2.between(end, poses[after]))
    return Track(t, se2.compose(there, se2.exp(share[:, None] * miss)), P)
