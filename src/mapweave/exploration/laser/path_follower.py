"""From a path to the next command: along the path, never nearer to anything seen than the robot's radius."""

from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from ...core import se2
from ...core.records import frozen
from ...core.se2 import wrap_angle
from ...kernels.exploration.arcs import arc_clearance, arc_points
from .config import LaserExploreConfig


@cache
def candidate_commands(cfg: LaserExploreConfig) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 3"]]:
    """All (v, w) a robot chooses from: standing still first, then turning on the spot, then faster; and where each
    ends in the robot's frame.
    """
    turns = cfg.turn * np.array([0.0, *(s * k / 10 for k in range(1, 11) for s in (1, -1))])
    speeds = cfg.speed * np.array([0.0, 1 / 6, 1 / 3, 1 / 2, 2 / 3, 5 / 6, 1.0])
    ahead = np.array([(v, w) for v in speeds for w in turns])
    back = np.array([(-cfg.follower.reverse_speed * cfg.speed, w) for w in turns[::4]])
    commands = frozen(np.concatenate([ahead, back]))
    return commands, frozen([arc_points(v, w, cfg.period, 1)[1] for v, w in commands])


def collision_free(
    commands: Float[np.ndarray, "m 2"], points: Float[np.ndarray, "k 2"], least: float, cfg: LaserExploreConfig
) -> tuple[Bool[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Which arcs keep `least` [m] from every point (robot's frame), or come no nearer than the robot stands; and how
    near each comes (m,).
    """
    stride = cfg.speed * cfg.period
    near = points[np.hypot(*points.T) < least + stride + cfg.roomy]
    clearance = arc_clearance(commands, cfg.period, np.ascontiguousarray(near), cfg.follower.arc_sample)
    still = np.hypot(*near.T).min() if len(near) else np.inf
    return clearance >= min(least, still) - 1e-9, clearance


def steer(
    pose: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "2"] | None,
    scan: Float[np.ndarray, "k 2"],
    others: Float[np.ndarray, "n 2"],
    cfg: LaserExploreConfig,
) -> Float[np.ndarray, "2"]:
    """The allowed command that heads for `target` soonest; stands still without one.

    scan: points in the robot's frame, which no arc comes nearer than radius + guard; others: places in the map where
    other robots are or will be during this step, which the robot's middle comes no nearer than 2 radii + apart.
    """
    if target is None:
        return np.zeros(2)
    commands, ends = candidate_commands(cfg)
    free, clearance = collision_free(commands, scan, cfg.radius + cfg.guard, cfg)
    if len(others):
        free &= collision_free(commands, se2.act(se2.inverse(pose), others), 2 * cfg.radius + cfg.apart, cfg)[0]
    goal = se2.act(se2.inverse(pose), target)
    d = goal - ends[:, :2]
    distance = np.hypot(d[:, 0], d[:, 1])
    error = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - ends[:, 2]))
    error = error * np.minimum(1.0, distance / cfg.follower.heading_near)
    tight = np.clip(cfg.roomy - clearance, 0.0, cfg.roomy)
    backwards = cfg.follower.reverse_cost * (commands[:, 0] < 0.0)
    cost = np.where(
        free, distance + cfg.follower.heading_cost * error + cfg.follower.closeness_cost * tight + backwards, np.inf
    )
    return np.asarray(commands[np.argmin(cost)])


def predicted_path(
    pose: Float[np.ndarray, "3"], command: Float[np.ndarray, "2"], cfg: LaserExploreConfig
) -> Float[np.ndarray, "n 2"]:
    """Places (n, 2) along the arc of one step, in the frame of `pose`'s map, start and end among them."""
    arc = arc_points(float(command[0]), float(command[1]), cfg.period, 6)
    return np.asarray(se2.act(pose, arc[:, :2]))
