"""How a robot moves: a unicycle on an exact arc while its velocities hold. A pose is `[x m, y m, theta rad]`."""

import numpy as np
from jaxtyping import Float

from ..core.se2 import wrap_angle

Vector3 = Float[np.ndarray, "3"]


def unicycle(pose: Vector3, v: float, w: float, dt: float) -> Vector3:
    """The pose after `dt` [s] at `v` [m/s] forward and `w` [rad/s]; theta wrapped. [Thrun05] eq. 5.9, by its chord."""
    h = 0.5 * w * dt
    chord = v * dt * np.sinc(h / np.pi)
    phi = pose[2] + h
    return np.array([pose[0] + chord * np.cos(phi), pose[1] + chord * np.sin(phi), wrap_angle(pose[2] + 2.0 * h)])


def unicycle_jacobians(
    pose: Vector3, v: float, w: float, dt: float
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 2"]]:
    """Derivatives of `unicycle` by the pose and by `(v, w)`."""
    h = 0.5 * w * dt
    phi = pose[2] + h
    c, s = np.cos(phi), np.sin(phi)
    sinc = np.sinc(h / np.pi)
    dsinc = -h / 3.0 if abs(h) < 1e-4 else (np.cos(h) - sinc) / h
    dx, dy = v * dt * sinc * c, v * dt * sinc * s
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    chord_h = v * dt * dsinc
    G = np.array(
        [
            [dt * sinc * c, 0.5 * dt * (chord_h * c - dy)],
            [dt * sinc * s, 0.5 * dt * (chord_h * s + dx)],
            [0.0, dt],
        ]
    )
    return F, G
