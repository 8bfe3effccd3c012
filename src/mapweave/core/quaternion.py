"""Planar headings as the quaternions that ROS messages and TUM files carry, and back."""

import math

DECIMALS = 12


def from_yaw(theta: float) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a turn by `theta` about z."""
    return 0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta)


def to_yaw(x: float, y: float, z: float, w: float) -> float:
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


def representable(theta: float) -> float:
    """The heading in [-pi, pi] nearest to `theta` that comes back from its quaternion to the bit."""
    return round(math.remainder(theta, 2 * math.pi), DECIMALS)
