"""What a robot tells its team: keyframes of the pose graph, and every scan as it fits to one of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .beam import Beams


class Keyframe(NamedTuple):
    """t [s]; local: (3,) pose in the robot's own frame; step: (3,) seen from its last keyframe (of the first: zero),
    cov: (3, 3) of it over x, y, theta of the keyframe's frame; path: [m] driven so far; beams: its returns.
    """

    robot: int
    number: int  # among this robot's keyframes, from 0
    t: float
    local: Float[np.ndarray, "3"]
    step: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]
    path: float
    beams: Beams


class Sweep(NamedTuple):
    """One scan. offset: (3,) pose in keyframe `number`; points: (n, 2) returns and ends: (m, 2) how far beams that
    did not come back are free, both [m] in the robot frame.
    """

    robot: int
    number: int
    t: float
    offset: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "n 2"]
    ends: Float[np.ndarray, "m 2"]
    origin: Float[np.ndarray, "2"]  # of the sensor on the robot [m]
