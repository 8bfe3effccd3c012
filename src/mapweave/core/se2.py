"""SE(2) on plain arrays `(..., 3)` = `[x m, y m, theta rad]`; no pose class.

`T_a_b` is the pose of b in a and carries points of b into a; inner names cancel:
``T_map_scan = compose(T_map_robot, T_robot_scan)``.

Headings also come and go as quaternions, which ROS messages and TUM files carry.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

Pose = Float[np.ndarray, "... 3"]
Points = Float[np.ndarray, "... 2"]
Jacobian = Float[np.ndarray, "... 3 3"]  # also covariances; over x, y, theta

IDENTITY = np.zeros(3)
IDENTITY.setflags(write=False)


def wrap_angle(angle: np.ndarray | float) -> Any:
    """`angle` [rad] brought into (-pi, pi]; a scalar in, a scalar out."""
    if isinstance(angle, float):
        return np.float64(_wrapped(float(angle)))
    return np.pi - np.mod(np.pi - np.asarray(angle, dtype=float), 2 * np.pi)


def _wrapped(angle: float) -> float:
    return np.pi - (np.pi - angle) % (2 * np.pi)


def pose(x: float, y: float, theta: float) -> Float[np.ndarray, "3"]:
    return np.array([x, y, theta], dtype=float)


def compose(T_a_b: Pose, T_b_c: Pose) -> Pose:
    """`T_a_c`; broadcasts over leading axes; theta wrapped."""
    a, b = np.asarray(T_a_b, float), np.asarray(T_b_c, float)
    if a.ndim == b.ndim == 1:
        return _composed(a, b)
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
    if a.ndim == 1:
        return _inverted(a)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], wrap_angle(-a[..., 2])], axis=-1)


def _composed(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """`compose` of two single poses, to the bit: arrays of so few numbers cost a multiple of the numbers."""
    (x, y, theta), (u, v, turned) = a.tolist(), b.tolist()
    c, s = float(np.cos(theta)), float(np.sin(theta))
    return np.array([x + c * u - s * v, y + s * u + c * v, _wrapped(theta + turned)])


def _inverted(a: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """`inverse` of a single pose, as `_composed`."""
    x, y, theta = a.tolist()
    c, s = float(np.cos(theta)), float(np.sin(theta))
    return np.array([-c * x - s * y, s * x - c * y, _wrapped(-theta)])


def between(T_a_b: Pose, T_a_c: Pose) -> Pose:
    """`T_b_c`: the pose of c seen from b."""
    return compose(inverse(T_a_b), T_a_c)


def act(T_a_b: Pose, points_b: Points) -> Points:
    """Points of b carried into a; one pose for many points, or one each."""
    a, p = np.asarray(T_a_b, float), np.asarray(points_b, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y = p[..., 0], p[..., 1]
    return np.stack([a[..., 0] + c * x - s * y, a[..., 1] + s * x + c * y], axis=-1)


def rotation(theta: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "... 2 2"]:
    """The matrix that turns points by `theta` [rad], or one for each of many angles."""
    c, s = np.cos(theta), np.sin(theta)
    out = np.empty((*np.shape(theta), 2, 2))
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    return out


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


def turn(theta: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "... 3 3"]:
    """The matrix that turns a pose's x and y by `theta` [rad] and leaves its heading."""
    out = np.zeros((*np.shape(theta), 3, 3))
    out[..., :2, :2] = rotation(theta)
    out[..., 2, 2] = 1.0
    return out


def compose_jacobians(T_a_b: Pose, T_b_c: Pose) -> tuple[Jacobian, Jacobian]:
    """Derivatives of `compose` by `T_a_b` and by `T_b_c`; broadcasts over leading axes."""
    a, b = np.broadcast_arrays(np.asarray(T_a_b, float), np.asarray(T_b_c, float))
    B = turn(a[..., 2])
    c, s, x, y = B[..., 0, 0], B[..., 1, 0], b[..., 0], b[..., 1]
    A = np.zeros_like(B)
    A[..., 0, 0] = A[..., 1, 1] = A[..., 2, 2] = 1.0
    A[..., 0, 2], A[..., 1, 2] = -s * x - c * y, c * x - s * y
    return A, B


def between_jacobians(T_a_b: Pose, T_a_c: Pose) -> tuple[Jacobian, Jacobian]:
    """Derivatives of `between` by `T_a_b` and by `T_a_c`; broadcasts over leading axes."""
    a, b = np.broadcast_arrays(np.asarray(T_a_b, float), np.asarray(T_a_c, float))
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    A, B = np.zeros((2, *a.shape, 3))
    B[..., 0, 0], B[..., 0, 1], B[..., 1, 0], B[..., 1, 1], B[..., 2, 2] = c, s, -s, c, 1.0
    A[..., :2, :2], A[..., 2, 2] = -B[..., :2, :2], -1.0
    A[..., 0, 2], A[..., 1, 2] = -s * dx + c * dy, -c * dx - s * dy
    return A, B


def inverse_jacobian(T_a_b: Pose) -> Jacobian:
    """Derivative of `inverse`."""
    a = np.asarray(T_a_b, float)
    return between_jacobians(a, np.zeros(3))[0]


def turned_covariance(theta: Float[np.ndarray, "..."] | float, P: Jacobian) -> Jacobian:
    """The covariance P of a pose in axes that are turned by `theta` [rad]: of `T_a_c` where P is of `T_b_c`."""
    R = turn(theta)
    return np.asarray(R @ P @ R.swapaxes(-1, -2))


def composed_covariance(T_a_b: Pose, P_a_b: Jacobian, T_b_c: Pose, P_b_c: Jacobian) -> Jacobian:
    """The covariance of `compose` where the errors of both poses are independent."""
    A, B = compose_jacobians(T_a_b, T_b_c)
    return np.asarray(A @ P_a_b @ A.swapaxes(-1, -2) + B @ P_b_c @ B.swapaxes(-1, -2))


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


DECIMALS = 12  # of a heading from a quaternion: a picoradian


def quaternion_of_heading(theta: float) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a turn by `theta` about z."""
    return 0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta)


def heading_of_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Heading [rad] of the frame's x axis, seen from above, to 12 decimals; the quaternion need not be of unit length.

    Rounding keeps a heading the same through any number of trips to a file and back: see `representable`.
    """
    if x == 0.0 and y == 0.0:
        theta = 2.0 * math.atan2(z, w)
        if abs(theta) > math.pi + 1e-9:
            theta -= math.copysign(2 * math.pi, theta)
    else:
        theta = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return round(theta, DECIMALS)


def is_upside_down(x: float, y: float, z: float, w: float) -> bool:
    """Whether the frame's z axis points down."""
    return w * w - x * x - y * y + z * z < 0


def representable_heading(theta: float) -> float:
    """The heading in [-pi, pi] nearest to `theta` that comes back from its quaternion to the bit."""
    return round(math.remainder(theta, 2 * math.pi), DECIMALS)
