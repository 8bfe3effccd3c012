"""A robot's models as a textbook writes them, for kernels to be compared with."""

import numpy as np

from mapweave.core.se2 import wrap_angle


def unicycle(pose, v, w, dt):
    """The pose after `dt` [s] at `v` [m/s] and `w` [rad/s]: the exact arc."""
    if w == 0:
        return pose + np.array([v * dt * np.cos(pose[2]), v * dt * np.sin(pose[2]), 0.0])
    r, turned = v / w, pose[2] + w * dt
    dx, dy = r * (np.sin(turned) - np.sin(pose[2])), r * (np.cos(pose[2]) - np.cos(turned))
    return np.array([pose[0] + dx, pose[1] + dy, wrap_angle(turned)])


def observe(pose, point):
    """(range [m], bearing [rad]) of a point."""
    dx, dy = point - pose[:2]
    return np.array([np.hypot(dx, dy), wrap_angle(np.arctan2(dy, dx) - pose[2])])


def observe_by_pose(pose, point):
    """The derivative of `observe` by the pose."""
    dx, dy = point - pose[:2]
    r2 = dx * dx + dy * dy
    r = np.sqrt(r2)
    return np.array([[-dx / r, -dy / r, 0.0], [dy / r2, -dx / r2, -1.0]])


def locate(pose, z):
    """The point that `observe` gives `z` of."""
    phi = pose[2] + z[1]
    return np.array([pose[0] + z[0] * np.cos(phi), pose[1] + z[0] * np.sin(phi)])


def noise(distance, floor, share, bearing):
    """The covariance of a sighting at `distance` [m]."""
    return np.diag([floor**2 + (share * distance) ** 2, bearing**2])
