"""Sightings and known distances as factors of the sparse solver.

The state holds `width` scalars a robot: its coordinates [m], then, where no axis is common, its heading [rad] or in
space its rotation vector.
"""

import numpy as np
from jaxtyping import Float, Int

from ..core.attitude import Headings, matrices, turned
from ..solve import Factor, Kernel
from . import bearing
from .network import EXACT_DISTANCE, BearingNetwork, effective_sigma


def width(net: BearingNetwork) -> int:
    """Scalars a robot."""
    return net.dim if net.axis else net.dim * (net.dim + 1) // 2


def state(position: Float[np.ndarray, "n d"], heading: Headings | None) -> Float[np.ndarray, " s"]:
    """Both as the solver has them."""
    return np.asarray(position if heading is None else np.column_stack([position, heading])).ravel()


def parted(net: BearingNetwork, x: Float[np.ndarray, " s"]) -> tuple[Float[np.ndarray, "n d"], Headings | None]:
    """Positions and headings of a state; None where an axis is common."""
    table = x.reshape(len(net), -1)
    turns = table[:, net.dim :]
    return table[:, : net.dim], None if net.axis else turns[:, 0] if net.dim == 2 else turns


def columns(net: BearingNetwork) -> Int[np.ndarray, "m c"]:
    """The state entries of each sighting: observer's coordinates, target's coordinates, observer's turn."""
    w, k = width(net), np.arange(net.dim)
    parts = [w * net.observer[:, None] + k, w * net.target[:, None] + k]
    if not net.axis:
        parts.append(w * net.observer[:, None] + np.arange(net.dim, w))
    return np.concatenate(parts, axis=1)


def bearing_factor(net: BearingNetwork, kernel: Kernel | None = None) -> Factor:
    """All sightings, whitened."""
    w, dim = width(net), net.dim
    at = columns(net)
    sigma = effective_sigma(net)

    def ends(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[at[:, :dim]], x[at[:, dim : 2 * dim]]

    def residual(x: np.ndarray) -> np.ndarray:
        p, q = ends(x)
        if dim == 3:
            seen = net.bearing
            if not net.axis:
                seen = np.einsum("mij,mj->mi", matrices(x[at[:, 6:]]), seen)
            return -bearing.sphere_residual(seen, p, q)
        z = net.bearing if net.axis else net.bearing + x[at[:, -1]]
        return -bearing.angle_residual(z, p, q)[:, None]

    def jacobian(x: np.ndarray) -> np.ndarray:
        p, q = ends(x)
        J = bearing.sphere_jacobian(p, q) if dim == 3 else bearing.angle_jacobian(p, q)[:, None, :]
        parts = [-J, J]
        if not net.axis:
            parts.append(bearing.turn_jacobian(bearing.predict(p, q)[0]))
        return np.concatenate(parts, axis=2)

    white = np.broadcast_to(1.0 / sigma[:, None], (len(sigma), dim - 1))
    return Factor(at, residual, jacobian, dim - 1, white, kernel, f"bearings ({w} scalars a robot)")


def distance_factor(net: BearingNetwork) -> Factor:
    """The known distances; exact ones are held far tighter than any bearing could."""
    w, k = width(net), np.arange(net.dim)
    i = np.array([d.i for d in net.distances], dtype=np.intp)
    j = np.array([d.j for d in net.distances], dtype=np.intp)
    metres = np.array([d.metres for d in net.distances])
    tight = EXACT_DISTANCE * float(effective_sigma(net).min(initial=1.0))
    sigma = np.array([d.sigma if d.sigma > 0 else tight * d.metres for d in net.distances])
    at = np.concatenate([w * i[:, None] + k, w * j[:, None] + k], axis=1)

    def residual(x: np.ndarray) -> np.ndarray:
        _, r = bearing.predict(x[w * i[:, None] + k], x[w * j[:, None] + k])
        return np.asarray((r - metres)[:, None])

    def jacobian(x: np.ndarray) -> np.ndarray:
        u, _ = bearing.predict(x[w * i[:, None] + k], x[w * j[:, None] + k])
        return np.concatenate([-u, u], axis=1)[:, None, :]

    return Factor(at, residual, jacobian, 1, (1.0 / sigma)[:, None], None, "distances")


def prior_factor(entries: Int[np.ndarray, " e"], x0: Float[np.ndarray, " n"], sigma: float) -> Factor:
    """State entries held loosely at `x0`: those of robots the sightings do not determine."""

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray((x[entries] - x0[entries])[:, None])

    ones = np.ones((len(entries), 1, 1))
    return Factor(entries[:, None], residual, lambda _: ones, 1, np.full((1, 1), 1.0 / sigma), None, "loose prior")


def apart_factor(net: BearingNetwork, rows: Int[np.ndarray, " e"], nearest: float) -> Factor:
    """The ends of sightings `rows` kept from falling together; silent beyond `nearest` [m].

    A robot sighted seldom can escape a contradiction by sliding onto its neighbour, where every bearing is right.
    """
    w, k = width(net), np.arange(net.dim)
    i, j = w * net.observer[rows, None] + k, w * net.target[rows, None] + k

    def residual(x: np.ndarray) -> np.ndarray:
        _, r = bearing.predict(x[i], x[j])
        return np.maximum(np.log(nearest / r), 0.0)[:, None]

    def jacobian(x: np.ndarray) -> np.ndarray:
        u, r = bearing.predict(x[i], x[j])
        J = np.where(r < nearest, 1.0 / r, 0.0)[:, None] * u
        return np.concatenate([J, -J], axis=1)[:, None, :]

    return Factor(np.concatenate([i, j], axis=1), residual, jacobian, 1, None, None, "apart")


def retract(net: BearingNetwork, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """The state after the step `dx`, whose turns are about the common axes."""
    (p, heading), (dp, turn) = parted(net, x), parted(net, dx)
    return state(p + dp, None if heading is None or turn is None else turned(heading, turn))
