"""What a robot sees of a point: distance and direction, with Jacobians, inverse and noise.

range [m]; bearing [rad], counter-clockwise from the robot's x; poses `[x, y, theta]`, points in the poses' frame.
"""

import numpy as np
from jaxtyping import Float

from ..core.se2 import wrap_angle

Vector2 = Float[np.ndarray, "2"]
Vector3 = Float[np.ndarray, "3"]


def observe(pose: Float[np.ndarray, "... 3"], point: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """(range, bearing) of `point` from `pose`: `r = |p - t|`, `b = wrap(atan2(dy, dx) - theta)`; broadcasts."""
    d = np.asarray(point) - np.asarray(pose)[..., :2]
    bearing = wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - np.asarray(pose)[..., 2])
    return np.stack([np.hypot(d[..., 0], d[..., 1]), bearing], axis=-1)


def observe_jacobians(pose: Vector3, point: Vector2) -> tuple[Float[np.ndarray, "2 3"], Float[np.ndarray, "2 2"]]:
    """Derivatives of `observe` by the pose and by the point."""
    dx, dy = point - pose[:2]
    r2 = dx * dx + dy * dy
    r = np.sqrt(r2)
    by_point = np.array([[dx / r, dy / r], [-dy / r2, dx / r2]])
    by_pose = np.column_stack([-by_point, [0.0, -1.0]])
    return by_pose, by_point


def locate(pose: Vector3, z: Vector2) -> Vector2:
    """The point seen from `pose` as `z` = (range, bearing): the inverse of `observe`."""
    phi = pose[2] + z[1]
    return np.array([pose[0] + z[0] * np.cos(phi), pose[1] + z[0] * np.sin(phi)])


def locate_jacobians(pose: Vector3, z: Vector2) -> tuple[Float[np.ndarray, "2 3"], Float[np.ndarray, "2 2"]]:
    """Derivatives of `locate` by the pose and by `z`."""
    phi = pose[2] + z[1]
    c, s = np.cos(phi), np.sin(phi)
    by_z = np.array([[c, -z[0] * s], [s, z[0] * c]])
    by_pose = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]])
    return by_pose, by_z


def noise(distance: float, floor: float, share: float, bearing: float) -> Float[np.ndarray, "2 2"]:
    """Covariance of a sighting at the *predicted* `distance` [m]; range sd `sqrt(floor^2 + (share r)^2)` [m]."""
    return np.diag([floor**2 + (share * distance) ** 2, bearing**2])
