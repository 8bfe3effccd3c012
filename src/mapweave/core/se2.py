"""SE(2) on plain arrays `(..., 3)` = `[x m, y m, theta rad]`; no pose class.

`T_a_b` is the pose of b in a and carries points of b into a; inner names cancel:
``T_map_scan = compose(T_map_robot, T_robot_scan)``.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

Pose = Float[np.ndarray, "... 3"]
Points = Float[np.ndarray, "... 2"]

IDENTITY = np.zeros(3)
IDENTITY.setflags(write=False)


def wrap_angle(angle: np.ndarray | float) -> Any:
    """`angle` [rad] brought into (-pi, pi]; a scalar in, a scalar out."""
    return np.pi - np.mod(np.pi - np.asarray(angle, dtype=float), 2 * np.pi)


def pose(x: float, y: float, theta: float) -> Float[np.ndarray, "3"]:
    return np.array([x, y, theta], dtype=float)


def compose(T_a_b: Pose, T_b_c: Pose) -> Pose:
    """`T_a_c`; broadcasts over leading axes; theta wrapped."""
    a, b = np.asarray(T_a_b, float), np.asarray(T_b_c, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + c * b[..., 0] - s * b[..., 1],
            a[..., 1] + s * b[..., 0] + c * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def inverse(T_a_b: Pose) -> Pose:
    """`T_b_a`."""
    a = np.asarray(T_a_b, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], wrap_angle(-a[..., 2])], axis=-1)


def between(T_a_b: Pose, T_a_c: Pose) -> Pose:
    """`T_b_c`: the pose of c seen from b."""
    return compose(inverse(T_a_b), T_a_c)


def act(T_a_b: Pose, points_b: Points) -> Points:
    """Points of b carried into a; one pose for many points, or one each."""
    a, p = np.asarray(T_a_b, float), np.asarray(points_b, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y = p[..., 0], p[..., 1]
    return np.stack([a[..., 0] + c * x - s * y, a[..., 1] + s * x + c * y], axis=-1)


def rotation(theta: float) -> Float[np.ndarray, "2 2"]:
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s], [s, c]])


def exp(twist: Pose) -> Pose:
    """The pose reached by moving along `[vx, vy, w]` for unit time."""
    u = np.asarray(twist, float)
    w = u[..., 2]
    small = np.abs(w) < 1e-6
    d = np.where(small, 1.0, w)
    sinc = np.where(small, 1 - w * w / 6, np.sin(d) / d)
    cosc = np.where(small, w / 2, 2 * np.sin(0.5 * d) ** 2 / d)
    return np.stack([sinc * u[..., 0] - cosc * u[..., 1], cosc * u[..., 0] + sinc * u[..., 1], wrap_angle(w)], axis=-1)


def log(T_a_b: Pose) -> Pose:
    """The twist whose `exp` is `T_a_b`; theta in (-pi, pi]."""
    a = np.asarray(T_a_b, float)
    w = wrap_angle(a[..., 2])
    small = np.abs(w) < 1e-6
    d = np.where(small, 1.0, w)
    half = np.where(small, 1 - w * w / 12, 0.5 * d / np.tan(0.5 * d))
    return np.stack([half * a[..., 0] + 0.5 * w * a[..., 1], -0.5 * w * a[..., 0] + half * a[..., 1], w], axis=-1)


def compose_jacobians(
    T_a_b: Float[np.ndarray, "3"], T_b_c: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Derivatives of `compose` by `T_a_b` and by `T_b_c`."""
    c, s = np.cos(T_a_b[2]), np.sin(T_a_b[2])
    x, y = T_b_c[0], T_b_c[1]
    A = np.array([[1.0, 0.0, -s * x - c * y], [0.0, 1.0, c * x - s * y], [0.0, 0.0, 1.0]])
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return A, B


def interpolate(t: Float[np.ndarray, " m"], stamps: Float[np.ndarray, " n"], poses: Pose) -> Pose:
    """Poses at `t` [s], x and y linear and theta along the shorter arc; `stamps` ascending; ends held."""
    theta = np.unwrap(poses[:, 2])
    return np.stack(
        [
            np.interp(t, stamps, poses[:, 0]),
            np.interp(t, stamps, poses[:, 1]),
            wrap_angle(np.interp(t, stamps, theta)),
        ],
        axis=-1,
    )


def align(source: Points, target: Points, weights: Float[np.ndarray, " n"] | None = None) -> Float[np.ndarray, "3"]:
    """`T_target_source`: the rigid transform (no scale, no reflection) of least squared distance (Procrustes).

    Needs two distinct points at least; `weights` (n,) are relative.
    """
    w = np.ones(len(source)) if weights is None else np.asarray(weights, float)
    w = w / w.sum()
    ms, mt = w @ source, w @ target
    a, b = source - ms, target - mt
    theta = np.arctan2(w @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), w @ (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    t = mt - rotation(theta) @ ms
    return np.array([t[0], t[1], theta])
