"""Robots so close to each other that their distance is not known: what a sighting between them really tells.

A sighting of length r with error s places the two across the ray to r s. Where r itself is hardly known the estimate
may put them on nearly one spot, since nothing but the direction of the sighting holds them apart, and the linear
covariance then claims a place across the ray of any sharpness. What the sighting tells on average over the lengths it
may have is told by `r^2 + v` in place of `r^2`, v the variance of the distance along the ray.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..solve import Factor, Information, Pattern, Problem, SingularError
from . import bearing, factors
from .network import BearingNetwork

CLOSE = 3.0  # standard deviations of its own length below which a sighting is close; beyond, r^2 errs by a tenth
ANY_DIRECTION = float(np.pi / np.sqrt(3.0))  # [rad] standard deviation of a direction drawn at random
ROUNDS = 3  # of lengthening: what is told of one pair changes what is known of others


def with_true_lengths(
    net: BearingNetwork,
    x: Float[np.ndarray, " s"],
    problem: Problem,
    information: Information,
    pattern: Pattern | None,
    deviation: Float[np.ndarray, " n"],
    chosen: Bool[np.ndarray, " n"],
    unchecked: Bool[np.ndarray, " m"] | None = None,
) -> tuple[Information, int]:
    """The information at `x` with close sightings counted by the lengths they may have, and of how many pairs they are.

    problem: whose first term are the sightings; deviation: (n,) [m] no less than that of each of the robots `chosen`
    along any direction. Where no sighting between those is close it is the very `information`.
    unchecked: (m,) close sightings that may be wrong: they count as directions drawn at random, next to nothing.
    """
    u, r = bearing.predict(*_ends(net, x))
    apart = r < CLOSE * (deviation[net.observer] + deviation[net.target])
    rows = np.flatnonzero(apart & chosen[net.observer] & chosen[net.target])
    if not len(rows) or not np.any(net.sigma > 0):
        return information, 0
    pattern = pattern or Pattern.of(problem)
    parts = [term.normal(x) for term in problem.terms]
    sightings, current = factors.bearing_factor(net), information
    length = r.copy()
    for _ in range(ROUNDS):
        along = _along(net, current, problem.free, rows, u[rows])
        length[rows] = np.where(r[rows] ** 2 < CLOSE**2 * along, np.sqrt(r[rows] ** 2 + along), r[rows])
        if (length == r).all():
            return information, 0
        share = r / length
        if unchecked is not None:
            anywhere = unchecked & (share < 1.0)
            share[anywhere] *= np.minimum(net.sigma[anywhere] / ANY_DIRECTION, 1.0)
        wider = _weighed(sightings, share)
        H, _ = pattern.assemble([wider.normal(x)[0], *(a for a, _ in parts[1:])], [b for _, b in parts])
        try:
            current = Information.of(H, pattern.elimination)
        except SingularError:
            return information, 0
    close = length > r
    pairs = np.sort(np.stack([net.observer[close], net.target[close]], axis=1), axis=1)
    return current, len(np.unique(pairs, axis=0))


def _ends(net: BearingNetwork, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p = x.reshape(len(net), factors.width(net))[:, : net.dim]
    return p[net.observer], p[net.target]


def _along(
    net: BearingNetwork,
    information: Information,
    free: np.ndarray,
    rows: Int[np.ndarray, " c"],
    u: Float[np.ndarray, "c d"],
) -> Float[np.ndarray, " c"]:
    """The variance [m^2] of the length of each of the sightings `rows`, whose directions are u."""
    w, k = factors.width(net), np.arange(net.dim)
    at = np.full(len(net) * w, -1)
    at[free] = np.arange(len(free))
    out = np.zeros(len(rows))
    step = 256
    for a in range(0, len(rows), step):
        part = slice(a, min(a + step, len(rows)))
        E = np.zeros((information.size + 1, part.stop - part.start))  # the last row takes what is fixed
        columns = np.arange(E.shape[1])[:, None]
        for end, sign in ((net.observer, -1.0), (net.target, 1.0)):
            E[at[w * end[rows[part], None] + k], columns] = sign * u[part]
        E = E[:-1]
        out[part] = np.einsum("ec,ec->c", E, information.solve(E))
    return out


def _weighed(term: Factor, share: Float[np.ndarray, " m"]) -> Factor:
    """The factor with its standard deviations divided by `share`."""
    white = np.ones((1, term.rows)) if term.sqrt_info is None else term.sqrt_info
    return replace(term, sqrt_info=white * share[:, None])
