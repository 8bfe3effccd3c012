"""Bearings between robots: residual, Jacobian and noise in 2D and 3D, vectorised over m sightings.

Prediction and sighting are unit vectors; the error is the turn that carries the one to the other, a vector in the
plane (2D: the line) tangent to the prediction. Never a raw azimuth or elevation, never `arctan`: its lost sign would
let the point reflection in.
"""

import numpy as np
from jaxtyping import Float

from ..core.se2 import wrap_angle

TINY = 1e-12  # [m]; robots closer than this have no direction between them


def predict(p_i: Float[np.ndarray, "m d"], p_j: Float[np.ndarray, "m d"]) -> tuple[np.ndarray, np.ndarray]:
    """Direction u (m, d) from robot i to robot j and their distance r (m,) [m], at least `TINY`."""
    d = p_j - p_i
    r = np.maximum(np.sqrt(np.einsum("mk,mk->m", d, d)), TINY)
    return np.asarray(d / r[:, None]), r


def angle(p_i: Float[np.ndarray, "m 2"], p_j: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, " m"]:
    """Bearing [rad] of robot j from robot i, counter-clockwise from the common axis."""
    d = p_j - p_i
    return np.asarray(np.arctan2(d[:, 1], d[:, 0]))  # [Hamatani] eq. 2, with the ray's sign kept


def angle_residual(z: Float[np.ndarray, " m"], p_i: np.ndarray, p_j: np.ndarray) -> Float[np.ndarray, " m"]:
    """Sighting less prediction [rad], in (-pi, pi]."""
    return np.asarray(wrap_angle(z - angle(p_i, p_j)))  # [Hamatani] eq. 4


def angle_jacobian(p_i: Float[np.ndarray, "m 2"], p_j: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 2"]:
    """Derivative [rad/m] of the bearing by `p_j`; by `p_i` it is the negative."""
    d = p_j - p_i
    r2 = np.maximum(np.einsum("mk,mk->m", d, d), TINY**2)
    return np.asarray(np.stack([-d[:, 1], d[:, 0]], axis=1) / r2[:, None])


def tangent_basis(u: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3 2"]:
    """Two orthonormal columns per row, both orthogonal to the unit vector `u`; finite for every u."""
    s = np.where(u[:, 2] >= 0, 1.0, -1.0)
    a = -1.0 / (s + u[:, 2])
    b = u[:, 0] * u[:, 1] * a
    B = np.empty((len(u), 3, 2))
    B[:, 0, 0], B[:, 1, 0], B[:, 2, 0] = 1.0 + s * u[:, 0] ** 2 * a, s * b, -s * u[:, 0]
    B[:, 0, 1], B[:, 1, 1], B[:, 2, 1] = b, s + u[:, 1] ** 2 * a, -u[:, 1]
    return B


def log_map(u: Float[np.ndarray, "m d"], b: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m d"]:
    """The tangent vector at `u` [rad] whose length is the angle to `b` and which points towards `b`."""
    cosine = np.einsum("mk,mk->m", u, b)
    t = b - cosine[:, None] * u
    sine = np.sqrt(np.einsum("mk,mk->m", t, t))
    theta = np.arctan2(sine, cosine)
    scale = np.where(sine > TINY, theta / np.maximum(sine, TINY), 1.0)
    e = scale[:, None] * t
    opposite = (sine <= TINY) & (cosine < 0)
    if opposite.any():  # every tangent direction is as good as any other
        axis = np.eye(u.shape[1])[np.abs(u[opposite]).argmin(axis=1)]
        side = axis - np.einsum("mk,mk->m", axis, u[opposite])[:, None] * u[opposite]
        e[opposite] = np.pi * side / np.linalg.norm(side, axis=1, keepdims=True)
    return np.asarray(e)


def sphere_residual(b: Float[np.ndarray, "m 3"], p_i: np.ndarray, p_j: np.ndarray) -> Float[np.ndarray, "m 2"]:
    """Sighting less prediction [rad] in the tangent plane of the prediction, in the columns of `tangent_basis`."""
    u, _ = predict(p_i, p_j)
    return np.asarray(np.einsum("mkc,mk->mc", tangent_basis(u), log_map(u, b)))


def turn_jacobian(u: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m k t"]:
    """Derivative of prediction less sighting by a turn of the observer about the common axes, the sighting near `u`."""
    if u.shape[1] == 2:
        return np.full((len(u), 1, 1), -1.0)
    return np.cross(tangent_basis(u).swapaxes(1, 2), u[:, None, :])


def sphere_jacobian(p_i: Float[np.ndarray, "m 3"], p_j: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 2 3"]:
    """Derivative [rad/m] of the predicted direction by `p_j` in its own tangent plane; by `p_i` the negative."""
    u, r = predict(p_i, p_j)
    return np.asarray(tangent_basis(u).swapaxes(1, 2) / r[:, None, None])
