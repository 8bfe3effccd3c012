"""How an exploration with lasers ended: its map against the walls, its poses against the truth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...evaluation.building import share_free, wall_scores
from ...laser.closures import Closure
from ...laser.occupancy import Occupancy
from ..mission import RunScore
from .config import LaserMissionConfig
from .mission import LaserRun, LaserStepRecord


@dataclass(frozen=True, slots=True)
class LaserScore(RunScore):
    """map_error: mean distance of the map's occupied cells to the nearest true wall; c_per_n: of keyframe positions.

    nees_per_dof: mean over keyframe poses, each with its own covariance; misassociations: loops closed between places
    that are not the same; duplicates and missed are figures of landmark worlds; area_mapped: share of the reachable
    area known to be free; wall_precision: share of occupied cells at a wall; wall_recall: share of the wall that can be
    seen which the map shows; refused: loop closures tried and not believed.
    """

    robots: int
    reachable_m2: float
    area_mapped: float
    collisions: int
    trajectory_rmse: float | None
    wall_precision: float | None
    wall_recall: float | None
    closures: int
    refused: int
    driven: float
    left_out: int
    seconds: float


def score(
    mission_run: LaserRun, moments: list[LaserStepRecord], merged: Occupancy, run: int, seconds: float
) -> LaserScore:
    """A finished run against the truth. merged: the map at the resolution that is scored."""
    team, world, cfg = mission_run.team, mission_run.place.world, mission_run.cfg
    cells = merged.centres(np.argwhere(merged.occupied))
    error, precision, recall = wall_scores(cells, world, mission_run.building, cfg.tolerance)
    true = true_keyframes(mission_run, moments)
    pose, P = team.graph().pose, team.covariances()
    e = np.column_stack([pose[:, :2] - true[:, :2], se2.wrap_angle(pose[:, 2] - true[:, 2])])
    tied = np.flatnonzero(np.linalg.eigvalsh(P)[:, 0] > 1e-7) if len(P) else np.zeros(0, int)  # `map` hangs on one
    nees = [float(e[k] @ np.linalg.solve(P[k], e[k])) / 3.0 for k in tied]
    ellipse = [np.pi * np.sqrt(max(float(np.linalg.det(P[k, :2, :2])), 0.0)) for k in range(len(P))]
    believed = [c for c in team.closures if c.accepted]
    return LaserScore(
        run=run,
        seed=mission_run.seed,
        finished=mission_run.finished,
        steps=mission_run.step,
        map_error=error,
        c_per_n=float(np.mean(ellipse)) if ellipse else None,
        nees_per_dof=float(np.mean(nees)) if nees else None,
        duplicates=None,
        misassociations=sum(is_false(c, true, cfg) for c in believed),
        missed=None,
        ms_per_decision=1e3 * sum(m.seconds for m in moments) / max(sum(m.decisions for m in moments), 1),
        robots=len(mission_run.robots),
        reachable_m2=mission_run.building.area,
        area_mapped=share_free(mission_run.building, merged.free, merged.origin, merged.resolution),
        collisions=int(mission_run.sim.collisions.sum()),
        trajectory_rmse=trajectory_rmse(mission_run, moments),
        wall_precision=precision,
        wall_recall=recall,
        closures=len(believed),
        refused=len(team.closures) - len(believed),
        driven=driven(moments),
        left_out=len(mission_run.memory.get("given_up", ())),
        seconds=seconds,
    )


def true_keyframes(mission_run: LaserRun, moments: list[LaserStepRecord]) -> Float[np.ndarray, "n 3"]:
    """Where the robots really were at the keyframes of the team's graph."""
    at = {m.t: k for k, m in enumerate(moments)}
    rows = [at[t] for t in mission_run.team.stamp.tolist()]
    poses = np.array([m.true_poses for m in moments])
    return np.asarray(poses[rows, mission_run.team.owner]).reshape(-1, 3)


def is_false(closure: Closure, true: Float[np.ndarray, "n 3"], cfg: LaserMissionConfig) -> bool:
    """Whether a closure says two places are one that are not."""
    off = se2.between(closure.measured, se2.between(true[closure.first], true[closure.second]))
    return bool(np.hypot(off[0], off[1]) > cfg.false_distance or abs(off[2]) > cfg.false_turn)


def trajectory_rmse(mission_run: LaserRun, moments: list[LaserStepRecord]) -> float | None:
    """Root mean square position error [m] over all robots' trajectories, without alignment."""
    squares: list[np.ndarray] = []
    at = {m.t: k for k, m in enumerate(moments)}
    for j in range(len(mission_run.robots)):
        track = mission_run.team.trajectory(j)
        rows = [at[t] for t in track.t.tolist()]
        true = np.array([moments[k].true_poses[j] for k in rows]).reshape(-1, 3)
        squares.append(((track.pose[:, :2] - true[:, :2]) ** 2).sum(axis=1))
    every = np.concatenate(squares)
    return float(np.sqrt(every.mean())) if len(every) else None


def driven(moments: list[LaserStepRecord]) -> float:
    """What all robots drove together [m]."""
    steps = np.diff(np.array([m.true_poses[:, :2] for m in moments]), axis=0)
    return float(np.hypot(steps[..., 0], steps[..., 1]).sum())
