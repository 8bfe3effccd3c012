"""How two robots' odometry frames lie to each other, found from bearings alone and without a guess."""

import numpy as np
from jaxtyping import Float

from ..core import se2

TURNS = 90  # headings tried around the circle


def meet(
    pose_i: Float[np.ndarray, "m 3"],
    pose_j: Float[np.ndarray, "m 3"],
    bearing: Float[np.ndarray, " m"],
    by_i: np.ndarray,
    limit: float = 0.1,
) -> tuple[Float[np.ndarray, "3"], float]:
    """T_i_j, the pose of robot j's odometry frame in robot i's, and the mean squared bearing error it leaves [rad^2].

    pose_i, pose_j: both robots in their own frames at m instants; bearing: (m,) of the other in the observer's frame;
    by_i: (m,) whether robot i was the observer; a sighting more
    than `limit` [rad] off counts as that much off. For a given turn between the frames the offset follows from linear
    least squares, so only the turn is searched.
    """
    tried = np.linspace(-np.pi, np.pi, TURNS, endpoint=False)
    tried_offsets = [_offset(pose_i, pose_j, bearing, by_i, turn, limit) for turn in tried]
    for width in (np.pi / TURNS, np.pi / TURNS / 4, np.pi / TURNS / 16):
        best = min(tried_offsets, key=lambda f: f[1])
        tried_offsets += [
            _offset(pose_i, pose_j, bearing, by_i, float(best[0][2]) + d * width, limit) for d in (-1.0, -0.5, 0.5, 1.0)
        ]
    return min(tried_offsets, key=lambda f: f[1])


def _offset(
    pose_i: np.ndarray, pose_j: np.ndarray, bearing: np.ndarray, by_i: np.ndarray, turn: float, limit: float
) -> tuple[Float[np.ndarray, "3"], float]:
    c, s = np.cos(turn), np.sin(turn)
    q = np.column_stack([c * pose_j[:, 0] - s * pose_j[:, 1], s * pose_j[:, 0] + c * pose_j[:, 1]])
    ray = np.where(by_i, pose_i[:, 2], pose_j[:, 2] + turn) + bearing
    n = np.column_stack([-np.sin(ray), np.cos(ray)])
    gap = pose_i[:, :2] - q  # the offset that would put j upon i
    scale = np.ones(len(n))
    a = np.zeros(2)
    for _ in range(3):
        A = n / scale[:, None]
        a = np.linalg.lstsq(A, np.sum(A * gap, axis=1), rcond=None)[0]
        scale = np.maximum(np.linalg.norm(a - gap, axis=1), 0.2)
    d = np.where(by_i[:, None], a - gap, gap - a)
    e = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - ray)
    return np.array([a[0], a[1], turn]), float(np.mean(np.minimum(e * e, limit**2)))
