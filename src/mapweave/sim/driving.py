"""How simulated robots drive: commands towards waypoints, followed late and not quite."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2

COMMAND_STEP = 0.02  # [s] between command rows
DECIDE_EVERY = 10  # rows between new commands
TOP_SPEED, TOP_TURN = 0.14, 0.5  # [m/s], [rad/s]
SLIP_V, SLIP_W = 0.05, 0.05  # of the velocity, one sigma
CREEP_V, CREEP_W = 0.002, 0.008  # [m/s], [rad/s], one sigma
SLIP_MEMORY = 1.0  # [s]


@dataclass(frozen=True, slots=True)
class Drive:
    """t: (n,) [s] from 0; command: (n, 2) v, w as logged; pose: (n, 3) as driven; then what nobody told the robot."""

    t: Float[np.ndarray, " n"]
    command: Float[np.ndarray, "n 2"]
    pose: Float[np.ndarray, "n 3"]
    speed_scale: float
    turn_scale: float
    lag: float
    bearing_bias: float
    range_scale: float


def scattered(count: int, size: Float[np.ndarray, "2"], rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """`count` points in a rectangle of `size` [m] round the origin, none very near another (best of ten draws)."""
    points = np.zeros((count, 2))
    for i in range(count):
        draws = rng.uniform(-0.5, 0.5, (10, 2)) * size
        if i:
            away = np.linalg.norm(draws[:, None] - points[None, :i], axis=2).min(1)
            points[i] = draws[np.argmax(away)]
        else:
            points[i] = draws[0]
    return points


def drive_team(
    robots: int,
    size: Float[np.ndarray, "2"],
    seconds: float,
    noise: float,
    bias: float,
    rng: np.random.Generator,
    wide: float = 0.0,
) -> list[Drive]:
    """Each robot roams round a home of its own; neighbouring homes overlap.

    wide: times what a careless workshop leaves of wheels and cameras, instead of `bias` times a real team's errors.
    """
    n = max(2, round(seconds / COMMAND_STEP))
    homes = scattered(robots, 0.7 * size, rng)
    roam = max(4.0, 1.2 * np.sqrt(size[0] * size[1] / robots))
    v_scale = 1 + bias * rng.normal(-0.02, 0.02, robots)
    w_scale = 1 + bias * rng.normal(-0.07, 0.02, robots)
    lag = np.round(bias * rng.uniform(0.12, 0.20, robots) / COMMAND_STEP).astype(np.intp)
    range_scale = 1 + bias * rng.normal(0.0, 0.01, robots)
    bearing_bias = bias * rng.normal(0.0, 0.006, robots)
    if wide > 0:
        v_scale = 1 + wide * rng.uniform(-0.1, 0.1, robots)
        w_scale = 1 + wide * rng.uniform(-0.3, 0.1, robots)
        lag = np.round(wide * rng.uniform(0.0, 0.3, robots) / COMMAND_STEP).astype(np.intp)
        range_scale = 1 + wide * rng.normal(0.0, 0.02, robots)
        bearing_bias = wide * rng.normal(0.0, 0.02, robots)

    pose = np.zeros((n, robots, 3))
    command = np.zeros((n, robots, 2))
    pose[0, :, :2], pose[0, :, 2] = homes, rng.uniform(-np.pi, np.pi, robots)
    goal = _waypoints(homes, roam, size, rng)
    fade = np.exp(-COMMAND_STEP / SLIP_MEMORY)
    slip = rng.normal(size=(robots, 2))
    kicks = np.sqrt(1 - fade * fade) * rng.normal(size=(n, robots, 2))
    everyone = np.arange(robots)
    for i in range(n - 1):
        if i % DECIDE_EVERY == 0:
            reached = np.linalg.norm(goal - pose[i, :, :2], axis=1) < 0.4
            if reached.any():
                goal[reached] = _waypoints(homes[reached], roam, size, rng)
            command[i] = _towards(pose[i], goal)
        else:
            command[i] = command[i - 1]
        late = command[np.maximum(i - lag, 0), everyone] * (i >= lag)[:, None]
        slip = fade * slip + kicks[i]
        v = v_scale * late[:, 0] + noise * slip[:, 0] * (SLIP_V * np.abs(late[:, 0]) + CREEP_V * (late[:, 0] > 0))
        w = w_scale * late[:, 1] + noise * slip[:, 1] * (SLIP_W * np.abs(late[:, 1]) + CREEP_W * (late[:, 0] > 0))
        twist = np.column_stack([v, np.zeros(robots), w]) * COMMAND_STEP
        pose[i + 1] = se2.compose(pose[i], se2.exp(twist))
    command[-1] = command[-2]
    t = COMMAND_STEP * np.arange(n)
    hidden = np.column_stack([v_scale, w_scale, lag * COMMAND_STEP, bearing_bias, range_scale])
    return [Drive(t, command[:, k], pose[:, k], *hidden[k].tolist()) for k in range(robots)]


def _waypoints(
    homes: Float[np.ndarray, "k 2"], roam: float, size: Float[np.ndarray, "2"], rng: np.random.Generator
) -> Float[np.ndarray, "k 2"]:
    turn = rng.uniform(-np.pi, np.pi, len(homes))
    away = roam * np.sqrt(rng.uniform(0.05, 1.0, len(homes)))
    points = homes + away[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(np.clip(points, -0.55 * size, 0.55 * size))


def _towards(pose: Float[np.ndarray, "k 3"], goal: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    """Turn to the goal, drive as far as the robot already looks there; in thousandths, as a log would keep it."""
    d = goal - pose[:, :2]
    off = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - pose[:, 2])
    w = np.clip(0.8 * off, -TOP_TURN, TOP_TURN)
    v = TOP_SPEED * np.clip(np.cos(off), 0.0, 1.0)
    return np.round(np.column_stack([v, w]), 3)
