"""The factors of a moving swarm: nearly constant velocity, odometry, sightings between knots, priors."""

import numpy as np
from jaxtyping import Float, Int

from ...core import se2
from ...core.se2 import wrap_angle
from ...solve import Cauchy, Factor
from .. import bearing as model


def velocity_factor(columns: Int[np.ndarray, "s c"], dt: Float[np.ndarray, " s"], q: float) -> Factor:
    """Motion at nearly constant velocity over `dt` [s].

    columns: p, v of a knot, then p, v of the next; q: white-noise acceleration density [m^2/s^3].
    """
    s, d = len(dt), columns.shape[1] // 4
    eye = np.eye(d)
    J = np.zeros((s, 2 * d, 4 * d))
    J[:, :d, :d], J[:, d:, d : 2 * d] = -eye, -eye
    J[:, :d, 2 * d : 3 * d], J[:, d:, 3 * d :] = eye, eye
    J[:, :d, d : 2 * d] = -dt[:, None, None] * eye
    W2 = np.linalg.cholesky(np.linalg.inv(velocity_noise(dt, q))).swapaxes(1, 2)
    W = np.einsum("sij,kl->sikjl", W2, eye).reshape(s, 2 * d, 2 * d)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray((J @ x[columns][..., None])[..., 0])

    return Factor(columns, residual, lambda _x: J, 2 * d, sqrt_info=W, name="velocity")


def velocity_noise(dt: Float[np.ndarray, " s"], q: float) -> Float[np.ndarray, "s 2 2"]:
    """Covariance of position and velocity on one axis after `dt` of white acceleration noise."""
    return np.asarray(
        q * np.stack([np.stack([dt**3 / 3, dt**2 / 2], -1), np.stack([dt**2 / 2, dt], -1)], -2),
    )


def odometry_factor(
    columns: Int[np.ndarray, "s 8"],
    delta: Float[np.ndarray, "s 3"],
    slope: Float[np.ndarray, "s 3 2"],
    sigma: Float[np.ndarray, "s 3"],
) -> Factor:
    """The next pose lies `delta` (in the frame of the one before) away, for the scales found of v and w.

    columns: pose, next pose, then the robot's scale errors of v and w; slope: how delta changes with them.
    """

    def residual(x: np.ndarray) -> np.ndarray:
        a, b, c = x[columns[:, :3]], x[columns[:, 3:6]], x[columns[:, 6:]]
        cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, 0], (b - a)[:, 1]
        step = np.column_stack([cos * dx + sin * dy, -sin * dx + cos * dy, b[:, 2] - a[:, 2]])
        r = step - delta - (slope @ c[..., None])[..., 0]
        r[:, 2] = wrap_angle(r[:, 2])
        return np.asarray(r)

    def jacobian(x: np.ndarray) -> np.ndarray:
        A, B = se2.between_jacobians(x[columns[:, :3]], x[columns[:, 3:6]])
        return np.concatenate([A, B, -slope], axis=2)

    return Factor(columns, residual, jacobian, 3, sqrt_info=1.0 / sigma, name="odometry")


def sighting_factor(
    columns: Int[np.ndarray, "m c"],
    direction: Float[np.ndarray, "m d"],
    sigma: Float[np.ndarray, " m"],
    kernel: float = 0.0,
) -> Factor:
    """Sightings between knots, by the bearing models of a swarm that stands still.

    columns: position of the observer, then of the target, then, where there is no common axis, the observer's heading.
    """
    d = direction.shape[1]
    robust = Cauchy(kernel) if kernel else None
    p, q = columns[:, :d], columns[:, d : 2 * d]
    W = (1.0 / sigma)[:, None]
    if d == 3:

        def residual3(x: np.ndarray) -> np.ndarray:
            return model.sphere_residual(direction, x[p], x[q])

        def jacobian3(x: np.ndarray) -> np.ndarray:
            H = model.sphere_jacobian(x[p], x[q])
            return np.concatenate([H, -H], axis=2)

        return Factor(columns, residual3, jacobian3, 2, sqrt_info=W, kernel=robust, name="sighting")
    z = np.arctan2(direction[:, 1], direction[:, 0])
    turned = columns.shape[1] == 5

    def residual(x: np.ndarray) -> np.ndarray:
        seen = z + x[columns[:, 4]] if turned else z
        return model.angle_residual(np.asarray(seen), x[p], x[q])[:, None]

    def jacobian(x: np.ndarray) -> np.ndarray:
        H = model.angle_jacobian(x[p], x[q])
        parts = [H, -H, np.ones((len(z), 1))] if turned else [H, -H]
        return np.concatenate(parts, axis=1)[:, None, :]

    return Factor(columns, residual, jacobian, 1, sqrt_info=W, kernel=robust, name="sighting")


def ray_factor(
    columns: Int[np.ndarray, "m c"], direction: Float[np.ndarray, "m d"], sigma: Float[np.ndarray, " m"]
) -> Factor:
    """How far the target lies off the ray [m] over `sigma` [m]: linear in the positions, so it needs no guess."""
    m, d = direction.shape
    if d == 2:
        B = np.stack([-direction[:, 1], direction[:, 0]], axis=1)[:, None, :]
    else:
        B = model.tangent_basis(direction).swapaxes(1, 2)
    J = np.concatenate([-B, B], axis=2)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray((J @ x[columns][..., None])[..., 0])

    W = np.broadcast_to((1.0 / sigma)[:, None], (m, d - 1))
    return Factor(columns, residual, lambda _x: J, d - 1, sqrt_info=np.ascontiguousarray(W), name="ray")


def prior_factor(columns: Int[np.ndarray, "m c"], mean: Float[np.ndarray, "m c"], sigma: float) -> Factor:
    """Each of the entries `columns` of x is `mean`, give or take `sigma`."""
    m, c = columns.shape
    J = np.broadcast_to(np.eye(c), (m, c, c))
    W = np.full((1, c), 1.0 / sigma)
    return Factor(columns, lambda x: np.asarray(x[columns] - mean), lambda _x: J, c, sqrt_info=W, name="prior")
