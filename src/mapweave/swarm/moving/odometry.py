"""A robot's odometry between any two instants: the motion it says, how its scales change it, how well it is known."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.records import Odometry
from .result import TrackConfig

STEP = 1e-4  # by which the scales of v and w are varied


@dataclass(frozen=True, slots=True)
class OdometrySteps:
    """Between k + 1 instants. pose: (k + 1, 3) in the robot's own odometry frame; delta: (k, 3) in the frame of the
    pose before; slope: (k, 3, 2) of delta by relative errors of v and w; sigma: (k, 3) [m, m, rad].
    """

    pose: Float[np.ndarray, "K 3"]
    delta: Float[np.ndarray, "k 3"]
    slope: Float[np.ndarray, "k 3 2"]
    sigma: Float[np.ndarray, "k 3"]


def odometry_steps(rows: Odometry | None, t: Float[np.ndarray, " K"], cfg: TrackConfig) -> OdometrySteps:
    """The motion between the instants `t` (ascending); a robot without odometry stands still."""
    if rows is None:
        k = len(t) - 1
        return OdometrySteps(np.zeros((k + 1, 3)), np.zeros((k, 3)), np.zeros((k, 3, 2)), np.full((k, 3), 1e-6))
    pose = _integrate(rows, t, 1.0, 1.0)
    delta = _steps(pose)
    by_v = (_steps(_integrate(rows, t, 1.0 + STEP, 1.0)) - delta) / STEP
    by_w = (_steps(_integrate(rows, t, 1.0, 1.0 + STEP)) - delta) / STEP
    return OdometrySteps(pose, delta, np.stack([by_v, by_w], axis=-1), _noise(rows, t, cfg))


def _pieces(rows: Odometry, t: Float[np.ndarray, " K"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants at which the velocity may change or a pose is asked for, and v, w of each piece between them."""
    at = np.unique(np.concatenate([rows.t, t]))
    at = at[(at >= t[0]) & (at <= t[-1])]
    row = np.searchsorted(rows.t, at[:-1], side="right") - 1
    begun = row >= 0
    row = np.maximum(row, 0)
    return at, np.where(begun, rows.v[row], 0.0), np.where(begun, rows.w[row], 0.0)


def _integrate(rows: Odometry, t: Float[np.ndarray, " K"], scale_v: float, scale_w: float) -> Float[np.ndarray, "K 3"]:
    """Poses at `t`, the first at the origin, along arcs."""
    at, v, w = _pieces(rows, t)
    dt = np.diff(at)
    turn = scale_w * w * dt
    theta = np.concatenate([[0.0], np.cumsum(turn)])
    chord = scale_v * v * dt * np.sinc(turn / (2.0 * np.pi))
    middle = theta[:-1] + 0.5 * turn
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    k = np.searchsorted(at, t)
    return np.column_stack([x[k], y[k], theta[k]])


def _steps(pose: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "k 3"]:
    out = se2.compose(se2.inverse(pose[:-1]), pose[1:])
    out[:, 2] = pose[1:, 2] - pose[:-1, 2]
    return np.asarray(out)


def _noise(rows: Odometry, t: Float[np.ndarray, " K"], cfg: TrackConfig) -> Float[np.ndarray, "k 3"]:
    at, v, w = _pieces(rows, t)
    dt = np.diff(at)
    along = np.concatenate([[0.0], np.cumsum((cfg.slip_floor + cfg.slip * np.abs(v)) ** 2 * dt)])
    turn = np.concatenate([[0.0], np.cumsum((cfg.turn_floor + cfg.turn * np.abs(w)) ** 2 * dt)])
    k = np.searchsorted(at, t)
    a, b = np.sqrt(np.diff(along[k])), np.sqrt(np.diff(turn[k]))
    return np.asarray(np.maximum(np.column_stack([a, cfg.side * a, b]), 1e-6))
