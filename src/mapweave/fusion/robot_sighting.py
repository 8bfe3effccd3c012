"""One robot sees another: range and bearing between robot poses of two local maps, a measurement of their frames."""

import numpy as np
from jaxtyping import Float

from ..core import se2

Poses = Float[np.ndarray, "*b 3"]


def predict(T_map_a: Poses, T_a_seer: Poses, T_map_b: Poses, T_b_seen: Poses) -> Float[np.ndarray, "*b 2"]:
    """`[range m, bearing rad]` of the seen robot from the seer; broadcasts over leading axes.

    T_map_a, T_map_b: poses of the two local frames in the map; T_a_seer, T_b_seen: the robots' poses in their own
    local frames when the sighting was made. Bearing CCW from the seer's x, in (-pi, pi].
    """
    seer, seen = se2.compose(T_map_a, T_a_seer), se2.compose(T_map_b, T_b_seen)
    d = seen[..., :2] - seer[..., :2]
    bearing = se2.wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - seer[..., 2])
    return np.stack([np.hypot(d[..., 0], d[..., 1]), bearing], axis=-1)


def residual(z: Float[np.ndarray, "*b 2"], h: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 2"]:
    """`z - h` with the bearing wrapped."""
    e = np.asarray(z - h)
    e[..., 1] = se2.wrap_angle(e[..., 1])
    return e


def jacobian(T_map_a: Poses, T_a_seer: Poses, T_map_b: Poses, T_b_seen: Poses) -> Float[np.ndarray, "*b 2 12"]:
    """Derivatives of `predict` by `[T_map_a, T_a_seer, T_map_b, T_b_seen]`, (..., 2, 12)."""
    seer, seen = se2.compose(T_map_a, T_a_seer), se2.compose(T_map_b, T_b_seen)
    d = seen[..., :2] - seer[..., :2]
    square = np.sum(d * d, axis=-1)[..., None]
    G = np.stack([d / np.sqrt(square), np.stack([-d[..., 1], d[..., 0]], axis=-1) / square], axis=-2)
    H = np.zeros((*d.shape[:-1], 2, 12))
    for sign, at, frame, robot in ((-1.0, 0, T_map_a, seer), (1.0, 6, T_map_b, seen)):
        arm = robot[..., :2] - frame[..., :2]
        turned = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
        H[..., at : at + 2] = sign * G
        H[..., at + 2] = sign * (G @ turned[..., None])[..., 0]
        H[..., at + 3 : at + 5] = sign * (G @ se2.rotation(frame[..., 2]))
    H[..., 1, 2] -= 1.0
    H[..., 1, 5] -= 1.0
    return H
