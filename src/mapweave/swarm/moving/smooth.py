"""All sightings of all times at once: the smoothed positions of robots at nearly constant velocity."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from ...core.bearings import BearingTable
from ...core.errors import DataError
from ...solve import Problem, Solution, SolveConfig, minimise
from .factors import prior_factor, ray_factor, sighting_factor, velocity_factor
from .poses import Timeline, timeline
from .result import RobotTrajectory, SwarmTrack, TrackConfig, without_outliers

Anchors = Mapping[int, Float[np.ndarray, " d"]]


def smooth(
    table: BearingTable, anchors: Anchors, cfg: TrackConfig | None = None, *, covariance: bool = True
) -> SwarmTrack:
    """The most probable motion of all robots given a stamped `table` in common axes; no guess is needed.

    Anchors stand still. Raises DataError when fewer than two are given: without odometry nothing else holds the scale.
    """
    cfg = cfg or TrackConfig()
    line, solution, index = solve_velocity(table, anchors, cfg)
    d = table.dim
    cov = None
    if covariance and solution.information is not None:
        cov = solution.dissected(np.repeat(np.arange(len(line)), 2 * d)).blocks(index[:, :d])
    tracks = {}
    for robot in np.unique(line.robot).tolist():
        rows = line.of(robot)
        tracks[robot] = RobotTrajectory(line.t[rows], solution.x[index[rows, :d]], None if cov is None else cov[rows])
    seen = sighting_factor(_pair(line, index, d), table.direction, table.sigma)
    out, chi2, dof = without_outliers(seen.squares(solution.x), d - 1, solution, cfg)
    return SwarmTrack(tracks, "smoothed", solution.converged, solution.iterations, chi2, dof, out)


def solve_velocity(
    table: BearingTable, anchors: Anchors, cfg: TrackConfig
) -> tuple[Timeline, Solution, Int[np.ndarray, "K c"]]:
    """Timeline, solution and where each knot's position and velocity stand in it."""
    present = set(table.observer.tolist()) | set(table.target.tolist())
    if len(set(anchors) & present) < 2:
        raise DataError(
            "robots that move, with bearings in common axes, need two anchors that are seen, found "
            f"{len(set(anchors) & present)}"
        )
    d = table.dim
    line = timeline(table, set(anchors), cfg.merge)
    index = np.arange(2 * d * len(line)).reshape(len(line), 2 * d)
    known = np.isin(line.robot, list(anchors))
    fixed = np.repeat(known, 2 * d)
    x0 = np.zeros(index.size)
    for robot, place in anchors.items():
        rows = line.of(robot)
        x0[index[rows, :d]] = place
    places = np.stack(list(anchors.values()))
    centre, extent = places.mean(axis=0), float(np.linalg.norm(np.ptp(places, axis=0)))
    if extent <= 0.0:
        raise DataError("the anchors stand at one point: the scale is not held")

    moves = line.moves
    start = line.first & ~known
    motion = velocity_factor(
        np.column_stack([index[moves[:, 0]], index[moves[:, 1]]]),
        line.t[moves[:, 1]] - line.t[moves[:, 0]],
        cfg.acceleration,
    )
    speed = prior_factor(index[start, d:], np.zeros((int(start.sum()), d)), cfg.speed)
    # So weak that it says nothing; it keeps the problem regular where a robot is not tied to the others.
    somewhere = prior_factor(index[start, :d], np.tile(centre, (int(start.sum()), 1)), 1e3 * extent)
    pair = _pair(line, index, d)
    rays = ray_factor(pair, table.direction, table.sigma * 0.25 * extent)
    once = SolveConfig(max_iterations=1, damping=0.0)
    x1 = minimise(Problem(x0, (motion, speed, somewhere, rays), fixed), once).x
    seen = sighting_factor(pair, table.direction, table.sigma, cfg.kernel)
    return line, minimise(Problem(x1, (motion, speed, somewhere, seen), fixed)), index


def _pair(line: Timeline, index: Int[np.ndarray, "K c"], d: int) -> Int[np.ndarray, "m p"]:
    """Where the positions of observer and target of each sighting stand in the solution."""
    return np.column_stack([index[line.observer, :d], index[line.target, :d]])
