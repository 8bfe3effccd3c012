"""Robots that drive with odometry while they sight each other, with or without common axes."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.bearings import BearingTable
from ...core.errors import DataError
from ...core.records import Odometry
from ...core.workers import Progress, no_progress
from .grow import grow
from .poses import PoseProblem
from .result import RobotTrajectory, SwarmTrack, TrackConfig, without_outliers
from .smooth import solve_velocity

Anchors = Mapping[int, Float[np.ndarray, "2"]]


def smooth_driving(
    table: BearingTable,
    odometry: Mapping[int, Odometry],
    anchors: Anchors,
    cfg: TrackConfig | None = None,
    *,
    covariance: bool = True,
    on_progress: Progress = no_progress,
) -> SwarmTrack:
    """The most probable motion of robots in the plane given sightings and odometry, found without a guess.

    A robot without odometry stands still, anchors too. In common axes two anchors are needed for the start; without
    them none: the frame is then the first pose of the robot named in `gauge`. Raises DataError otherwise.
    """
    cfg = cfg or TrackConfig()
    if table.dim != 2:
        raise DataError("odometry moves robots in the plane; the sightings are of three dimensions")
    problem = PoseProblem.of(table, odometry, anchors, cfg)
    warnings: list[str] = []
    if table.axis:
        x = _from_velocity(problem, table, anchors, cfg)
        placed = set(np.unique(problem.line.robot).tolist())
    else:
        x, placed = grow(problem, cfg, on_progress)
        x = _onto_anchors(problem, x, anchors, placed)
    on_progress("smoothing", 0, 2)
    solution = problem.solve(x, placed, cfg, hold_anchors=len(set(anchors) & placed) >= 2, iterations=100)
    on_progress("smoothing", 1, 2)
    lost = sorted(set(np.unique(problem.line.robot).tolist()) - placed)
    if lost:
        names = ", ".join(table.ids[k] for k in lost[:10])
        warnings.append(f"{len(lost)} robots are never tied to the others: {names}")
    warnings += [
        f"robot {table.ids[k]} has no odometry: taken to stand still"
        for k in sorted(placed - set(odometry) - set(anchors))
    ]
    cov = None
    if covariance and solution.information is not None:
        cov = solution.dissected(*problem.places_in_time()).blocks(problem.index[:, :2])
    on_progress("smoothing", 2, 2)
    out, chi2, dof = without_outliers(problem.sighted(placed).squares(solution.x), 1, solution, cfg)
    tracks = {}
    for robot in sorted(placed):
        rows = problem.line.of(robot)
        pose = solution.x[problem.index[rows]]
        own = None if cov is None else cov[rows]
        tracks[robot] = RobotTrajectory(problem.line.t[rows], pose[:, :2], own, pose[:, 2])
    scale = {k: (1.0 + solution.x[c], 1.0 + solution.x[d]) for k, (c, d) in problem.scales.items() if k in placed}
    gauge = (
        ""
        if len(set(anchors) & placed) >= 2
        else f"place and turn free (the frame is the first pose of robot {table.ids[problem.root(placed)]})"
    )
    return SwarmTrack(
        tracks,
        "smoothed with odometry",
        solution.converged,
        solution.iterations,
        chi2,
        dof,
        out,
        gauge,
        tuple(warnings),
        {k: (float(a), float(b)) for k, (a, b) in scale.items()},
    )


def _from_velocity(problem: PoseProblem, table: BearingTable, anchors: Anchors, cfg: TrackConfig) -> np.ndarray:
    """Positions as of robots without odometry; each robot's heading then turns its odometry upon them."""
    line, solution, index = solve_velocity(table, anchors, replace(cfg, acceleration=max(cfg.acceleration, 0.1)))
    x = problem.x0.copy()
    x[problem.index[:, 2]] = problem.own[:, 2]
    for robot in np.unique(problem.line.robot).tolist():
        rows, there = problem.line.of(robot), line.of(robot)
        t = problem.line.t[rows]
        place = np.column_stack([np.interp(t, line.t[there], solution.x[index[there, c]]) for c in range(2)])
        x[problem.index[rows, :2]] = place
        own = problem.own[rows]
        step, said = np.diff(place, axis=0), np.diff(own[:, :2], axis=0)
        turn = np.angle(np.sum((step[:, 0] + 1j * step[:, 1]) * np.conj(said[:, 0] + 1j * said[:, 1])))
        x[problem.index[rows, 2]] = se2.wrap_angle(own[:, 2] + turn)
    return x


def _onto_anchors(problem: PoseProblem, x: np.ndarray, anchors: Anchors, placed: set[int]) -> np.ndarray:
    """The whole motion moved rigidly so that anchors lie best upon their places; as it is with fewer than two."""
    seen = sorted(set(anchors) & placed)
    if len(seen) < 2:
        return x
    at = np.array([x[problem.index[problem.line.of(k)][0, :2]] for k in seen])
    moved = x.copy()
    T = se2.align(at, np.stack([anchors[k] for k in seen]))
    moved[problem.index] = se2.compose(T, x[problem.index])
    for k in seen:
        moved[problem.index[problem.line.of(k)][0, :2]] = anchors[k]
    return moved
