"""What EKF-SLAM's kernels share: the layout of the state, the noise, angles.

State `x`: [px, py, theta, v scale, turn scale, lag, bearing bias, range scale, p_1x, p_1y, ...]; `P` its covariance.
A parameter that is not estimated has zero variance and stays.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from .._jit import kernel

Array: TypeAlias = np.ndarray

POSE = 3  # entries of the state that are the pose; the calibration follows
HEAD = 8  # pose and calibration
# entries of the calibration in the state
V_SCALE, TURN_SCALE, LAG, BEARING_BIAS, RANGE_SCALE = 3, 4, 5, 6, 7


class Belief(NamedTuple):
    """The filter between two sightings: changed in place.

    x: (n,) and P: (n, n) as of the last sighting but for the pose in x; Phi: (3, HEAD), Q: (3, 3) of what was driven
    since then.
    """

    x: Array
    P: Array
    Phi: Array
    Q: Array


class Commands(NamedTuple):
    """t: (k,) stamps [s] from which on the robot drives v [m/s], w [rad/s]; v and w may be longer."""

    t: Array
    v: Array
    w: Array


class CameraFrame(NamedTuple):
    """n sightings: of which landmark (slot (n,), below zero of none), range [m] and bearing [rad]."""

    slot: Array
    range: Array
    bearing: Array


class SightingRows(NamedTuple):
    """n sightings in order: stamp t [s], of which landmark (slot, below zero of none), range [m], bearing [rad]."""

    t: Array
    slot: Array
    range: Array
    bearing: Array


class PoseRows(NamedTuple):
    """A trajectory to fill, a row a stamp: t [s], pose (n, 3) and its covariance."""

    t: Array
    pose: Array
    cov: Array


class LandmarkTable(NamedTuple):
    """What is known of each landmark, changed in place.

    started: (m,) whether it is in the state; waiting: (m, CANDIDATES, 2), filled: (m,) the places it was seen at
    before; astray: (1,) sightings in a row that hardly counted.
    """

    started: Array
    waiting: Array
    filled: Array
    astray: Array


class UpdateOutcomes(NamedTuple):
    """nis, weight: (n,) of each sighting, NaN where it was no update of a landmark; filled."""

    nis: Array
    weight: Array


class Noise(NamedTuple):
    """What the kernels take from the configuration, in metres, radians and seconds."""

    along: float  # [m / sqrt(m)] of distance commanded
    across: float  # [m / sqrt(m)]
    drift: float  # [rad / sqrt(m)] heading over distance commanded
    turn: float  # [rad / sqrt(rad)] heading over angle commanded
    rest_xy: float  # [m / sqrt(s)]
    rest_theta: float  # [rad / sqrt(s)]
    lost_xy: float  # [m / sqrt(s)] while no command is known
    lost_theta: float  # [rad / sqrt(s)]
    hold: float  # [s] a command is held at most
    speed: float  # [m/s] a robot without odometry drives at; 0: commands are known
    speed_time: float  # [s] it keeps its speed
    spin: float  # [rad/s] it turns at
    spin_time: float  # [s]
    range_floor: float  # [m]
    range_share: float  # of the distance
    bearing: float  # [rad]
    range_inflation: float  # of the variance, for correlated errors
    bearing_inflation: float
    gate: float  # normalised innovation from which a sighting counts less
    far: float  # normalised innovation from which it hardly counts
    agree: int  # sightings that must agree before a landmark starts


@kernel
def plain(number: int) -> int:
    """`number`, no longer a literal: Numba compiles a callee once more for each literal argument."""
    return number


@kernel
def quadratic(
    e0: float,
    e1: float,
    s00: float,
    s01: float,
    s11: float,
) -> float:
    """`e^T S^-1 e` in two dimensions."""
    q: float = (s11 * e0 * e0 - 2.0 * s01 * e0 * e1 + s00 * e1 * e1) / (s00 * s11 - s01 * s01)
    return q


@kernel
def wrap(
    angle: float,
) -> float:
    """`angle` [rad] in [-pi, pi)."""
    wrapped: float = angle - 2.0 * np.pi * np.floor((angle + np.pi) / (2.0 * np.pi))
    return wrapped
