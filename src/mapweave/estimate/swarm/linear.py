"""The linear start: positions from directions alone, without a guess.

With B the projection across a sighting b, `sum |B (p_j - p_i)|^2` is quadratic in the positions (the bearing
Laplacian of Zhao and Zelazo, Automatica 69, 2016). A trace of `sum |p_j - p_i - r b|^2`, with r the usual distance,
decides what the sightings leave open: a robot sighted once stands at the usual distance along the ray.
"""

import numpy as np
from jaxtyping import Bool, Float

from ...maps.network import Network
from ...solve import Information, Pattern, SingularError
from .graph import Components, effective_sigma

TRACE = 1e-7  # weight of the usual distance against a sighting's own


def linear_start(
    net: Network,
    parts: Components,
    direction: Float[np.ndarray, "m d"],
    pattern: Pattern,
    held: Bool[np.ndarray, " n"],
    weights: Float[np.ndarray, " m"] | None = None,
) -> Float[np.ndarray, "n d"]:
    """Positions [m] (units of the usual distance in pieces whose scale is free).

    direction: sightings in the common axes; pattern: of the sightings' blocks over both ends, positions of `held`
    robots fixed: the anchors and one robot of every piece without any, which stands at the origin.
    """
    n, dim = len(net), net.dim
    w = np.ones(len(direction)) if weights is None else weights
    origin = np.zeros((n, dim))
    for k, p in net.anchors.items():
        origin[k] = p
    across = np.eye(dim) - direction[:, :, None] * direction[:, None, :]
    information = None
    variance = float(np.mean(effective_sigma(net) ** 2)) if np.any(net.sigma > 0) else 0.0
    bias = 2 * variance / (1 + 4 * variance) if dim == 3 else 0.5 * (1 - np.exp(-2 * variance))
    shared = parts.anchored and len(parts.known) == 1 and parts.known[0] >= 2 and weights is None
    for tau in (bias, 0.0) if shared and variance > 0 else (0.0,):
        W = w[:, None, None] * (across + (TRACE - tau) * np.eye(dim))
        blocks = np.concatenate([np.concatenate([W, -W], axis=2), np.concatenate([-W, W], axis=2)], axis=1)
        try:
            H, _ = pattern.assemble([blocks], [np.zeros((len(w), 2 * dim))])
            information = Information.of(H, pattern.elimination)
            break
        except SingularError:
            continue
    if information is None:
        return origin
    moving = np.repeat(~held, dim)
    base = np.concatenate([origin[net.observer], origin[net.target]], axis=1)
    pull = np.einsum("mab,mb->ma", blocks, base)
    fixed = np.array([parts.known[c] >= 2 for c in range(len(parts.known))])[parts.label]
    usual = np.where(fixed, 0.0, 1.0)  # by robot: its piece's usual distance
    x = origin
    for turn in range(2):
        along = TRACE * (w * usual[net.observer])[:, None] * direction
        _, g = pattern.assemble([blocks], [pull + np.concatenate([along, -along], axis=1)])
        flat = origin.ravel().copy()
        flat[moving] += information.solve(-g)
        x = flat.reshape(n, dim)
        if turn == 1 or not fixed.any():
            break
        r = np.linalg.norm(x[net.target] - x[net.observer], axis=1)[fixed[net.observer]]
        usual[fixed] = float(np.median(r[r > 1e-3 * r.max(initial=0.0)])) if np.any(r > 0) else 1.0
    return _scaled(net, parts, x)


def _scaled(net: Network, parts: Components, x: np.ndarray) -> np.ndarray:
    """Pieces of free scale brought to their known distances, or to a median sighting of 1."""
    x = x.copy()
    r = np.linalg.norm(x[net.target] - x[net.observer], axis=1)
    for c in np.flatnonzero(parts.known < 2):
        mine = parts.label == c
        rows = mine[net.observer]
        typical = float(np.median(r[rows])) if rows.any() else 0.0
        ratios = [
            d.metres / span for d in net.distances if mine[d.i] and (span := float(np.linalg.norm(x[d.j] - x[d.i]))) > 0
        ]
        scale = float(np.median(ratios)) if ratios else 1.0 / typical if typical > 0 else 1.0
        centre = next((p for k, p in net.anchors.items() if mine[k]), np.zeros(net.dim))
        x[mine] = centre + scale * (x[mine] - centre)
    return x
