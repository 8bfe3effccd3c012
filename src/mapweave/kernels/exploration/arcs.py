"""How near the arcs a robot could drive come to what its scanner sees."""

import numpy as np

from .._jit import kernel
from ..cells import cell_of


@kernel
def arc_points(v: float, w: float, period: float, samples: int) -> np.ndarray:
    """Poses (samples + 1, 3) along the circle arc that (v, w) drives in `period`, from the pose 0, evenly in time."""
    out = np.zeros((samples + 1, 3))
    for k in range(1, samples + 1):
        t = period * k / samples
        turn = w * t
        if abs(turn) < 1e-6:
            out[k, 0], out[k, 1] = v * t, 0.5 * v * t * turn
        else:
            out[k, 0], out[k, 1] = v / w * np.sin(turn), v / w * (1.0 - np.cos(turn))
        out[k, 2] = turn
    return out


@kernel
def arc_clearance(commands: np.ndarray, period: float, points: np.ndarray, step: float) -> np.ndarray:
    """Least distance (m,) [m] between each arc and any of `points`, infinite without points.

    commands: (m, 2) v [m/s], w [rad/s]; points: (k, 2) in the robot's frame; arcs are sampled every `step` [m] or
    finer, start and end among the samples.
    """
    out = np.full(commands.shape[0], np.inf)
    for m in range(commands.shape[0]):
        v, w = commands[m, 0], commands[m, 1]
        samples = cell_of(np.ceil(abs(v) * period / step)) + 1
        arc = arc_points(v, w, period, samples)
        least = np.inf
        for k in range(points.shape[0]):
            for a in range(arc.shape[0]):
                dx, dy = points[k, 0] - arc[a, 0], points[k, 1] - arc[a, 1]
                least = min(least, dx * dx + dy * dy)
        out[m] = np.sqrt(least)
    return out
