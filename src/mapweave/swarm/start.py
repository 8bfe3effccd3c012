"""What is known before any refinement: a start without a guess, and what these sightings can tell at all.

Positions come from directions alone. With B the projection across a sighting b, `sum |B (p_j - p_i)|^2` is quadratic
in the positions (the bearing Laplacian of Zhao and Zelazo, Automatica 69, 2016). Noise turns b a little, which adds
`tau sum |p_j - p_i|^2` on average and so shrinks the answer; a pull of equal strength towards the usual distance r
along each ray, `mu sum |p_j - p_i - r b|^2`, undoes that, and decides what the sightings leave open: a robot sighted
once stands at the usual distance along its ray.

Robots in the plane that share no axis get headings first, then positions as if there were one.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ..core.errors import DataError
from ..solve import Factor, Information, Pattern, Problem
from .gauge import Gauge, gauge_of, normalise
from .headings import anchored_turn, beacon_headings, headings_at, mutual_headings, resected_headings, world_directions
from .network import BearingNetwork, Components, components
from .observability import Observability, observe, without_lines

TRACE = 1e-7  # least weight of the usual distance against a sighting's own
ROUNDS = 20  # of spreading headings from robots that see each other to those that only see


def bias(net: BearingNetwork) -> Float[np.ndarray, " m"]:
    """tau: how much of `|p_j - p_i|^2` the noise of each sighting adds to the linear cost, on average."""
    v = net.sigma**2
    return np.asarray(2 * v / (1 + 4 * v) if net.dim == 3 else 0.5 * (1 - np.exp(-2 * v)))


def linear_start(
    net: BearingNetwork,
    parts: Components,
    direction: Float[np.ndarray, "m d"],
    pattern: Pattern,
    held: Bool[np.ndarray, " n"],
    weights: Float[np.ndarray, " m"] | None = None,
) -> Float[np.ndarray, "n d"]:
    """Positions [m] (units of the usual distance in components whose scale is free).

    direction: sightings in the common axes; pattern: of the sightings' blocks over both ends, positions of `held`
    robots fixed: the anchors and one robot of every component without any, which stands at the origin. weights: (m,).
    """
    n, dim = len(net), net.dim
    w = np.ones(len(direction)) if weights is None else weights
    origin = np.zeros((n, dim))
    for k, p in net.anchors.items():
        origin[k] = p
    tau = bias(net)
    mu = np.maximum(tau, TRACE)
    W = w[:, None, None] * ((1.0 + mu)[:, None, None] * np.eye(dim) - direction[:, :, None] * direction[:, None, :])
    blocks = np.concatenate([np.concatenate([W, -W], axis=2), np.concatenate([-W, W], axis=2)], axis=1)
    base = np.concatenate([origin[net.observer], origin[net.target]], axis=1)
    along = (w * (mu + tau))[:, None] * direction
    H, g_known = pattern.assemble([blocks], [np.einsum("mab,mb->ma", blocks, base)])
    _, g_along = pattern.assemble([blocks], [np.concatenate([along, -along], axis=1)])
    solved = Information.of(H, pattern.elimination).solve(-np.stack([g_known, g_along], axis=1))
    moving = np.repeat(~held, dim)
    still, pulled = origin.ravel().copy(), np.zeros(n * dim)
    still[moving] += solved[:, 0]
    pulled[moving] = solved[:, 1]
    scaled = np.array([k >= 2 for k in parts.known])[parts.label]  # by robot: its component has a scale
    usual = np.where(scaled, _usual_distance(net, still.reshape(n, dim), pulled.reshape(n, dim), scaled), 1.0)
    x = still.reshape(n, dim) + usual[:, None] * pulled.reshape(n, dim)
    return _scaled(net, parts, x)


def linear_pattern(net: BearingNetwork, parts: Components) -> tuple[Pattern, Bool[np.ndarray, " n"]]:
    """The sparsity of the linear start, and the robots it holds: anchors, and one of each component without any."""
    n, dim = len(net), net.dim
    held = net.is_anchor
    label = parts.label
    if net.distances:  # one that only a distance joins to others is free as far as directions go
        label = components(replace(net, distances=())).label
    first = np.full(label.max(initial=-1) + 1, n)
    np.minimum.at(first, label, np.arange(n))
    has = np.zeros(len(first), dtype=bool)
    has[label[held]] = True
    held[first[~has]] = True
    k = np.arange(dim)
    at = np.concatenate([dim * net.observer[:, None] + k, dim * net.target[:, None] + k], axis=1)
    none = np.zeros((len(at), 1))
    shape = Factor(at, lambda _: none, lambda _: none[:, :, None], 1)
    problem = Problem(np.zeros(n * dim), [shape], np.repeat(held, dim))
    return Pattern.of(problem).dissected(problem.free // dim), held


def _usual_distance(net: BearingNetwork, still: np.ndarray, pulled: np.ndarray, chosen: np.ndarray) -> float:
    """The typical distance r: positions `still + r pulled` have r as their median sighting; found by iterating."""
    rows = chosen[net.observer]
    a = (still[net.target] - still[net.observer])[rows]
    b = (pulled[net.target] - pulled[net.observer])[rows]
    r = 0.0
    for _ in range(20 if len(a) else 0):
        length = np.linalg.norm(a + r * b, axis=1)
        r = float(np.median(length[length > 1e-3 * length.max()])) if length.any() else 1.0
    return r


def _scaled(net: BearingNetwork, parts: Components, x: np.ndarray) -> np.ndarray:
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


def start_without_axis(
    net: BearingNetwork, parts: Components
) -> tuple[np.ndarray, np.ndarray, Observability, np.ndarray]:
    """Positions, headings, who can be located, and (m,) the sightings whose observer's heading was found.

    Robots that sighted each other share their headings directly; the others get theirs from the positions found so
    far, as long as that reaches anybody new. Anchors give the orientation when two of them are reached, one the place.
    Where no two robots sighted each other, those that see three anchors begin. Raises DataError when there are none of
    them either.
    """
    heading, known = mutual_headings(net)
    turned = not known.any()
    if turned:
        heading, known = beacon_headings(net)
    if not known.any():
        what = "no two robots sighted each other and none sees three anchors"
        raise DataError(f"no axis is common, {what}: no heading can be started")
    free = replace(net, anchors={}, distances=(), axis=True) if not turned else replace(net, axis=True)
    position, placed = np.zeros((len(net), 2)), np.zeros(len(net), dtype=bool)
    for _ in range(ROUNDS):
        rows = known[net.observer]
        if not rows.any():
            break
        seen_by = free.select(rows)
        pieces = components(seen_by)
        z = world_directions(net, heading)[rows]
        position = linear_start(seen_by, pieces, z, *linear_pattern(seen_by, pieces))
        placed = observe(seen_by, pieces, position).localisable
        heading, more = resected_headings(net, position, placed, heading, known)
        if (more == known).all():
            break
        known = more
    if not turned and parts.known[parts.reference] >= 2 and np.count_nonzero(placed & net.is_anchor) >= 2:
        heading = heading + anchored_turn(net, position, placed)
        rows = known[net.observer]
        flat = replace(net, axis=True).select(rows)
        pieces = components(flat)
        position = linear_start(flat, pieces, world_directions(net, heading)[rows], *linear_pattern(flat, pieces))
    elif not turned and np.count_nonzero(placed & net.is_anchor) == 1:
        only = int(np.flatnonzero(placed & net.is_anchor)[0])
        position = position + net.anchors[only] - position[only]
    used = known[net.observer]
    heard = net.select(used)
    return position, heading, observe(heard, components(heard), position), used


@dataclass(frozen=True, slots=True)
class SwarmStart:
    """Everything found before the refinement: components, positions, headings, who can be located, sightings of use."""

    parts: Components
    position: Float[np.ndarray, "n d"]
    heading: Float[np.ndarray, " n"] | None
    seen: Observability
    gauge: Gauge
    used: Bool[np.ndarray, " m"]
    pattern: Pattern | None = None  # of the sightings alone with the anchors held, where that is the whole problem


def prepare(net: BearingNetwork, initial: np.ndarray | None = None, heading: np.ndarray | None = None) -> SwarmStart:
    """A start without a guess, and what can be told from these sightings at all.

    initial: positions that take its place; heading: [rad], without a common axis (else those that fit `initial`).
    """
    parts = components(net)
    used = np.ones(len(net.observer), dtype=bool)
    pattern = None
    if net.axis:
        pattern, held = linear_pattern(net, parts)
        position = linear_start(net, parts, net.direction, pattern, held) if initial is None else initial
        if net.distances or not (held == net.is_anchor).all():
            pattern = None  # what follows holds other entries
        seen = observe(net, parts, position, pattern)
    elif initial is not None:
        position, heading = initial, headings_at(net, initial) if heading is None else heading
        seen = observe(net, parts, position)
    else:
        position, heading, seen, used = start_without_axis(net, parts)
        net = net.select(used)
        parts = components(net)
    seen = without_lines(net, parts, seen, world_directions(net, heading))
    gauge = gauge_of(net, parts, seen.localisable)
    position, heading = normalise(gauge, position, heading)
    return SwarmStart(parts, position, heading, seen, gauge, used, pattern)
