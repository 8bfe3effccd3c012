"""The way between a robot's neighbouring poses, against its commands or against how a robot may wander."""

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..solve import Cauchy, Factor
from .commanded_motion import random_walk
from .config import SmoothingConfig
from .robot_part import LAG, RANGE, SPEED, TURN, RobotPart


def step_factor(part: RobotPart, cfg: SmoothingConfig, lag: float) -> Factor:
    """The way between neighbouring instants, against commands where there are any."""
    t = part.instants.t
    k = np.arange(len(t) - 1)
    columns = np.concatenate([part.pose_columns(k), part.pose_columns(k + 1)], axis=1)
    kernel = Cauchy(cfg.motion.outlier)
    if part.motion is None:
        return _wandering(part, columns, cfg)
    motion = part.motion
    parameters = np.tile(part.parameters + np.array([SPEED, TURN, LAG]), (len(k), 1))
    columns9 = np.concatenate([columns, parameters], axis=1)
    whiten = np.linalg.inv(np.linalg.cholesky(motion.noise(t, lag, cfg.motion)))

    def residual(x: np.ndarray) -> np.ndarray:
        speed, turn, lag = x[parameters[0]]
        r = _moved(x[columns])[0] / [speed, speed, 1.0] - motion.between(t, 1.0, turn, lag).step
        r[:, 2] = se2.wrap_angle(r[:, 2])
        return np.asarray(r)

    def jacobian(x: np.ndarray) -> np.ndarray:
        speed, turn, lag = x[parameters[0]]
        z, J = _moved(x[columns])
        J[:, :2] /= speed
        by = -motion.between(t, 1.0, turn, lag).by_calibration
        by[:, :2, SPEED] = -z[:, :2] / speed**2
        by[:, 2, SPEED] = 0.0
        return np.concatenate([J, by], axis=2)

    return Factor(columns9, residual, jacobian, 3, whiten, kernel, "odometry")


def _wandering(part: RobotPart, columns: Int[np.ndarray, "m 6"], cfg: SmoothingConfig) -> Factor:
    """A robot whose commands nobody knows wanders, ahead more than aside.

    In its camera's own metres: else a smaller map would be a likelier one.
    """
    scale = part.parameters + RANGE
    keeps = part.instants.gap
    if not len(part.log.sightings):
        keeps = np.maximum(keeps, cfg.motion.unknown_memory)
    whiten = np.linalg.inv(np.linalg.cholesky(random_walk(part.instants.t, cfg.motion, keeps)))

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray(_halfway(*_moved(x[columns]))[0] * [x[scale], x[scale], 1.0])

    def jacobian(x: np.ndarray) -> np.ndarray:
        z, J = _halfway(*_moved(x[columns]))
        J[:, :2] *= x[scale]
        by = np.zeros((len(columns), 3, 1))
        by[:, :2, 0] = z[:, :2]
        return np.concatenate([J, by], axis=2)

    with_scale = np.concatenate([columns, np.full((len(columns), 1), scale)], axis=1)
    return Factor(with_scale, residual, jacobian, 3, whiten, None, "wandering")


def _moved(x: Float[np.ndarray, "m 6"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 6"]]:
    """The second pose seen from the first, and its derivatives by both."""
    c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
    dx, dy = x[:, 3] - x[:, 0], x[:, 4] - x[:, 1]
    u, v = c * dx + s * dy, -s * dx + c * dy
    z = np.stack([u, v, se2.wrap_angle(x[:, 5] - x[:, 2])], axis=-1)
    J = np.zeros((len(x), 3, 6))
    J[:, 0, 0], J[:, 0, 1], J[:, 0, 2], J[:, 0, 3], J[:, 0, 4] = -c, -s, v, c, s
    J[:, 1, 0], J[:, 1, 1], J[:, 1, 2], J[:, 1, 3], J[:, 1, 4] = s, -c, -u, -s, c
    J[:, 2, 2], J[:, 2, 5] = -1.0, 1.0
    return z, J


def _halfway(
    z: Float[np.ndarray, "m 3"], J: Float[np.ndarray, "m 3 6"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 6"]]:
    """A step seen from the heading in its middle, where an arc goes straight ahead; and its derivatives."""
    c, s = np.cos(0.5 * z[:, 2]), np.sin(0.5 * z[:, 2])
    R = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=1)
    out, D = z.copy(), J.copy()
    out[:, :2] = (R @ z[:, :2, None])[..., 0]
    D[:, :2] = R @ J[:, :2]
    D[:, 0] += 0.5 * out[:, 1, None] * J[:, 2]
    D[:, 1] -= 0.5 * out[:, 0, None] * J[:, 2]
    return out, D
