"""The same answer without a centre: each robot keeps its own position and talks only to those it sees or is seen by.

First the linear start by Jacobi over-relaxation: everybody tells its position and moves to where its neighbours and
its sightings put it; without a common axis robots agree on one before (`common_axis`). Then Gaussian belief
propagation: what robot i tells j is what all its other neighbours make it believe about j through their common
sightings. Who has nothing new to say stays silent; when all are silent it ends.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import breadth_first_order

from ..core.errors import DataError
from ..core.se2 import rotation, wrap_angle
from ..solve import SolveStatus
from . import bearing
from .batch import refine
from .config import SWARM_TOLERANCE, SwarmConfig
from .network import BearingNetwork, components, effective_sigma
from .posterior import posterior
from .result import FLOAT, SwarmEstimate, Traffic
from .start import (
    SWEEPS,
    SwarmStart,
    beacon_headings,
    headings_at,
    mutual_headings,
    mutual_pairs,
    prepare,
    resected_headings,
    world_directions,
)

MESSAGES_RELAXATION = 0.95  # share of a Jacobi step that is taken towards what the neighbours say
MESSAGES_QUIET = 1e-4  # of the usual distance; a linear step below this is not told
MESSAGES_RELINEARISE = 5  # rounds between new linearisations
MESSAGES_FAINT = 1e-8  # a robot's own prior, of the information of one sighting
MESSAGES_FIRMER = 1e-5  # share of a link's own information below which a change of it is not told

ROUNDS = 20  # of spreading headings from robots that see each other to those that only see
FLAT = 1e-3  # share of a robot's stiffer direction below which the other is not held by its sightings

Relaxed = Callable[[BearingNetwork], tuple[np.ndarray, Traffic]]


def agree_on_axis(
    net: BearingNetwork, relaxed: Relaxed, initial: Float[np.ndarray, "n 2"] | None = None
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"], Traffic]:
    """Positions, headings [rad], whose heading is known, and what was said; with `initial` nothing had to be.

    relaxed: the linear start of a network whose sightings are against a common axis. Raises DataError when no heading
    can be started.
    """
    n = len(net)
    if initial is not None:
        return initial.copy(), headings_at(net, initial), np.ones(n, dtype=bool), Traffic(0, 0, 0)
    heading, known = mutual_headings(net)
    said, turned = _averaged(net), False
    if not known.any():
        turned = True
        heading, known = beacon_headings(net)
    if not known.any():
        what = "no two robots sighted each other and none sees three anchors"
        raise DataError(f"no axis is common, {what}: no heading can be started")
    position = np.zeros((n, 2))
    for _ in range(ROUNDS):
        rows = known[net.observer]
        directions = world_directions(net, heading)[rows]
        flat = replace(net.select(rows), bearing=np.arctan2(directions[:, 1], directions[:, 0]), axis=True)
        if turned:
            position, more = relaxed(flat)
        else:
            position, turn, more = _with_turn(flat, relaxed)
            heading, turned = np.asarray(wrap_angle(heading + turn)), True
        said = said + more
        heading, more_known = resected_headings(net, position, _held(flat, position), heading, known)
        if (more_known == known).all():
            break
        known = more_known
    return position, heading, known, said


def _averaged(net: BearingNetwork) -> Traffic:
    """The messages that `mutual_headings` takes: along a spanning tree from one robot to all, then in every sweep."""
    a, _ = mutual_pairs(net)
    each = 2 * len(a)
    rounds = SWEEPS + (_depth(net) if each else 0)
    return Traffic(rounds if each else 0, each * (1 + SWEEPS), each * (1 + SWEEPS) * 2 * FLOAT)


def _depth(net: BearingNetwork) -> int:
    """Steps from the first robot that sights somebody to the one furthest from it."""
    graph = sp.csr_array((np.ones(len(net.observer)), (net.observer, net.target)), shape=(len(net), len(net)))
    order, before = breadth_first_order(graph, int(net.observer[0]), directed=False)
    depth = np.zeros(len(net), dtype=int)
    for k in order[1:]:
        depth[k] = depth[before[k]] + 1
    return int(depth.max())


def _with_turn(net: BearingNetwork, relaxed: Relaxed) -> tuple[Float[np.ndarray, "n 2"], float, Traffic]:
    """Positions and the turn [rad] of a network whose sightings share an axis that lies anyhow to the anchors."""
    middle = np.mean(list(net.anchors.values()), axis=0)
    q, said = [], Traffic(0, 0, 0)
    for across in (np.eye(2), rotation(-np.pi / 2)):  # what the anchors are, turned back by 0 and by 90 degrees
        start, more = relaxed(replace(net, anchors={k: across @ (p - middle) for k, p in net.anchors.items()}))
        q.append(start)
        said = said + more
    u = net.direction
    span = np.stack([start[net.target] - start[net.observer] for start in q])  # (2, m, 2)
    off = u[:, 0] * span[..., 1] - u[:, 1] * span[..., 0]  # (2, m)
    cosine, sine = np.linalg.eigh(off @ off.T)[1][:, 0]
    if (cosine * span[0] + sine * span[1]).ravel() @ u.ravel() < 0:
        cosine, sine = -cosine, -sine
    turn = float(np.arctan2(sine, cosine))
    each = 2 * (len(net) - 1)  # sums go up the paths to one robot, and the turn comes down
    added = Traffic(2 * _depth(net), each, each // 2 * (5 + 2) * FLOAT)
    return (cosine * q[0] + sine * q[1]) @ rotation(turn).T + middle, turn, said + added


def _held(net: BearingNetwork, position: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """Whose place its sightings hold in both directions, as far as its neighbours can tell."""
    i, j = net.observer, net.target
    d = position[j] - position[i]
    u = d / np.maximum(np.linalg.norm(d, axis=1), 1e-12)[:, None]
    D = np.zeros((len(net), 2, 2))
    for end in (i, j):
        np.add.at(D, end, np.eye(2) - u[:, :, None] * u[:, None, :])
    low, high = np.linalg.eigvalsh(D).T
    return np.asarray((low > FLAT * np.maximum(high, 1e-12)) | net.is_anchor)


TINY = 1e-9  # [m rad] that a guard against dividing by zero adds


@dataclass(frozen=True, slots=True)
class MessageLinks:
    """Directed links a -> b, both ways for every pair with a sighting; `back[k]` is the opposite of link k."""

    a: Int[np.ndarray, " l"]
    b: Int[np.ndarray, " l"]
    back: Int[np.ndarray, " l"]
    of_sighting: Int[np.ndarray, " m"]  # the link observer -> target of each sighting


def distributed(net: BearingNetwork, cfg: SwarmConfig, initial: np.ndarray | None = None) -> SwarmEstimate:
    """Positions agreed on by talking; covariances and verdicts are added centrally, for the reader.

    Without a common axis the sightings of robots whose heading nobody could tell are left out. Raises DataError without
    two anchors at distinct places, or with known distances: a gauge or a length is nothing neighbours can agree on by
    themselves.
    """
    if not net.axis and net.dim == 3:
        raise DataError("in space the distributed method needs common axes: use the batch method")
    if net.distances or len({tuple(p) for p in net.anchors.values()}) < 2:
        raise DataError("the distributed method needs two anchors, and takes no known distances")
    everyone, (net, reached) = net, anchored(net)
    links = links_of(net)
    anchors = np.array(list(net.anchors.values()))
    usual = float(np.linalg.norm(np.ptp(anchors, axis=0))) / np.sqrt(len(net))  # known to all beforehand
    heading, told = None, np.ones(len(everyone.observer), dtype=bool)
    if not net.axis:
        position, heading, known, said = agree_on_axis(
            net, lambda flat: relaxed_start(flat, links_of(flat), usual, cfg), initial
        )
        told = known[everyone.observer] | ~reached[everyone.observer]
        everyone = everyone.select(told)
        net, reached = anchored(everyone)
        links = links_of(net)
    elif initial is None:
        position, said = relaxed_start(net, links, usual, cfg)
    else:
        position, said = initial.copy(), Traffic(0, 0, 0)
    for k, p in net.anchors.items():
        position[k] = p
    position, heading, more = belief_propagation(net, links, position, cfg, heading, usual)
    traffic = said + more
    net = everyone
    if not reached.all():
        position[~reached] = prepare(net).position[~reached]
    start: SwarmStart = prepare(net, position, heading)
    solution, problem, pattern = refine(net, start, replace(cfg, max_iterations=0))
    notes = () if more.rounds < cfg.max_rounds else (f"still talking after {more.rounds} rounds",)
    converged = replace(solution, iterations=traffic.rounds, status=solution.status if notes else SolveStatus.CONVERGED)
    return posterior(net, start, converged, problem, cfg, "distributed", ~told, traffic, notes, pattern)


def anchored(net: BearingNetwork) -> tuple[BearingNetwork, Bool[np.ndarray, " n"]]:
    """The sightings of components with two anchors, and who is in them; others hear of no two anchors and stay silent.

    Raises DataError when there is no such component.
    """
    parts = components(net)
    reached = (parts.known >= 2)[parts.label]
    if not reached[net.observer].any():
        raise DataError("no two anchors hang together by sightings: the distributed method has nothing to start from")
    return net.select(reached[net.observer]), reached


def links_of(net: BearingNetwork) -> MessageLinks:
    """Who talks to whom: both ends of every sighting, both ways."""
    n = len(net)
    there, back = net.observer * n + net.target, net.target * n + net.observer
    key = np.unique(np.concatenate([there, back]))
    a, b = key // n, key % n
    return MessageLinks(a, b, np.searchsorted(key, b * n + a), np.searchsorted(key, there))


def relaxed_start(
    net: BearingNetwork, links: MessageLinks, usual: float, cfg: SwarmConfig
) -> tuple[Float[np.ndarray, "n d"], Traffic]:
    """The linear start by Jacobi over-relaxation from the anchors' midpoint, and what was said."""
    n, dim = len(net), net.dim
    u = net.direction
    across = np.eye(dim) - u[:, :, None] * u[:, None, :]
    C = _by_link(links, across)
    D = np.zeros((n, dim, dim))
    np.add.at(D, links.a, C)
    D += 1e-6 * np.eye(dim)
    inverse = np.linalg.inv(D)
    position = np.tile(np.mean(list(net.anchors.values()), axis=0), (n, 1))
    for k, p in net.anchors.items():
        position[k] = p
    free = ~net.is_anchor
    heard = position.copy()  # what each robot said last
    rounds = messages = 0
    speaks = np.ones(n, dtype=bool)
    degree = np.bincount(links.a, minlength=n)
    while speaks.any() and rounds < cfg.max_rounds:
        rounds += 1
        messages += int(degree[speaks].sum())
        heard[speaks] = position[speaks]
        pull = np.zeros((n, dim))
        np.add.at(pull, links.a, np.einsum("lab,lb->la", C, heard[links.b]))
        wanted = np.einsum("nab,nb->na", inverse, pull + 1e-6 * position)
        position[free] += MESSAGES_RELAXATION * (wanted - position)[free]
        speaks = np.linalg.norm(position - heard, axis=1) > MESSAGES_QUIET * usual
    return position, Traffic(rounds, messages, messages * dim * FLOAT)


def belief_propagation(
    net: BearingNetwork,
    links: MessageLinks,
    start: Float[np.ndarray, "n d"],
    cfg: SwarmConfig,
    heading: Float[np.ndarray, " n"] | None = None,
    usual: float = 1.0,
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, " n"] | None, Traffic]:
    """Gaussian belief propagation from `start`, linearised anew as the beliefs move; headings where there are any.

    usual: [m] by which headings are multiplied, so that all a robot believes is of one unit and size.
    """
    n, dim = len(net), net.dim
    x = start.copy() if heading is None else np.column_stack([start, usual * heading])
    w = x.shape[1]
    eye = np.eye(w)
    held = np.zeros((n, w), dtype=bool)
    held[net.is_anchor, :dim] = True
    all_known = np.asarray(held.all(axis=1))
    at = x.copy()  # where each robot's sightings are linearised
    faint = MESSAGES_FAINT / max(float(np.median(_range(net, start) * effective_sigma(net))), TINY) ** 2
    said = _linearised(net, links, at, usual)
    # Link a -> b: what a told b; at first as if a were known, since two who each know one direction tell nothing.
    Lam = said.bb.copy()
    eta = said.of_known_a.copy()
    rounds, messages = 1, len(links.a)
    speaks = np.ones(len(links.a), dtype=bool)
    listens = ~all_known
    if heading is not None:
        listens[net.is_anchor] = False
        listens[net.observer] = True
    while speaks.any() and rounds < cfg.max_rounds:
        rounds += 1
        belief, carried = np.tile(faint * eye, (n, 1, 1)), faint * x
        np.add.at(belief, links.b, Lam)
        np.add.at(carried, links.b, eta)
        x = np.where(held, x, np.linalg.solve(_firm(belief), carried[..., None])[..., 0])
        if rounds % MESSAGES_RELINEARISE == 0:
            at = x.copy()
            said = _linearised(net, links, at, usual)
        cavity = said.bb[links.back] + belief[links.a] - Lam[links.back]
        left = carried[links.a] - eta[links.back] + said.own[links.back]
        gain = np.linalg.solve(_firm(cavity), np.concatenate([said.ab, left[..., None]], axis=2))
        ba = np.ascontiguousarray(said.ab.swapaxes(1, 2))
        to_b = said.bb - ba @ gain[..., :w]
        new_eta = said.own - np.einsum("lab,lb->la", ba, gain[..., w])
        known = all_known[links.a]
        to_b[known] = said.bb[known]
        new_eta[known] = (said.own - np.einsum("lab,lb->la", ba, x[links.a]))[known]
        change = (new_eta - eta) - np.einsum("lab,lb->la", to_b - Lam, x[links.b])
        firmer = np.linalg.norm(to_b - Lam, axis=(1, 2)) > MESSAGES_FIRMER * np.linalg.norm(said.bb, axis=(1, 2))
        speaks = (firmer | (np.linalg.norm(change, axis=1) * said.size > SWARM_TOLERANCE)) & listens[links.b]
        Lam[speaks], eta[speaks] = to_b[speaks], new_eta[speaks]
        messages += int(np.count_nonzero(speaks))
    floats = w * (w + 1) // 2 + 2 * w  # information, its vector, and where the sender stands
    traffic = Traffic(rounds, messages, messages * floats * FLOAT)
    return x[:, :dim], None if heading is None else np.asarray(wrap_angle(x[:, dim] / usual)), traffic


def _firm(A: np.ndarray) -> np.ndarray:
    """`A` (k, d, d) with enough on the diagonal that rounding cannot make it singular."""
    return np.asarray(A + (1e-13 * np.abs(A).max(axis=(1, 2)) + 1e-30)[:, None, None] * np.eye(A.shape[1]))


def _by_link(links: MessageLinks, value: np.ndarray) -> np.ndarray:
    """Sightings' values summed on their link and its opposite."""
    out = np.zeros((len(links.a), *value.shape[1:]))
    np.add.at(out, links.of_sighting, value)
    return np.asarray(out + out[links.back])


@dataclass(frozen=True, slots=True)
class LinkInformation:
    """All sightings on each link a -> b, linearised; known entries of the state do not count in `bb` and `ab`.

    bb: of b; ab: between a (rows) and b; own: the information vector of b, of_known_a: that with a where it is
    linearised; size: from a pull to radians.
    """

    bb: Float[np.ndarray, "l w w"]
    ab: Float[np.ndarray, "l w w"]
    own: Float[np.ndarray, "l w"]
    of_known_a: Float[np.ndarray, "l w"]
    size: Float[np.ndarray, " l"]


def _linearised(net: BearingNetwork, links: MessageLinks, at: np.ndarray, usual: float) -> LinkInformation:
    there = at[:, : net.dim]
    u, r = bearing.predict(there[net.observer], there[net.target])
    sigma = effective_sigma(net)
    size = np.zeros(len(links.a))
    np.maximum.at(size, links.of_sighting, sigma**2 * r)
    size = np.maximum(size, size[links.back])
    if not net.axis:
        return _with_headings(net, links, at, usual, size)
    e = bearing.log_map(u, net.direction)
    information = 1.0 / (sigma * r) ** 2
    W = _by_link(links, information[:, None, None] * (np.eye(net.dim) - u[:, :, None] * u[:, None, :]))
    out = np.zeros((len(links.a), net.dim))
    np.add.at(out, links.of_sighting, (information * r)[:, None] * e)
    pull = out - out[links.back]
    own = np.einsum("lab,lb->la", W, at[links.b] - at[links.a]) + pull
    return LinkInformation(W, -W, own, np.einsum("lab,lb->la", W, at[links.b]) + pull, size)


def _with_headings(
    net: BearingNetwork, links: MessageLinks, at: np.ndarray, usual: float, size: np.ndarray
) -> LinkInformation:
    """The same over (x, y, usual times the heading); anchors' places are known."""
    i, j = net.observer, net.target
    p, q = at[i, :2], at[j, :2]
    by_q = bearing.angle_jacobian(p, q)
    free = np.where(net.is_anchor, 0.0, 1.0)[:, None]
    J_i = np.column_stack([-by_q * free[i], np.full(len(i), -1.0 / usual)])
    J_j = np.column_stack([by_q * free[j], np.zeros(len(i))])
    e = bearing.angle_residual(net.bearing + at[i, 2] / usual, p, q)
    weight = 1.0 / effective_sigma(net) ** 2
    bb, ab, pull = (np.zeros((len(links.a), *shape)) for shape in ((3, 3), (3, 3), (3,)))
    forth, back = links.of_sighting, links.back[links.of_sighting]
    for link, J_a, J_b in ((forth, J_i, J_j), (back, J_j, J_i)):
        weighted = weight[:, None] * J_b
        np.add.at(bb, link, J_b[:, :, None] * weighted[:, None, :])
        np.add.at(ab, link, J_a[:, :, None] * weighted[:, None, :])
        np.add.at(pull, link, e[:, None] * weighted)
    of_known_a = np.einsum("lab,lb->la", bb, at[links.b]) + pull
    own = of_known_a + np.einsum("lab,la->lb", ab, at[links.a])
    return LinkInformation(bb, ab, own, of_known_a, size)


def _range(net: BearingNetwork, x: np.ndarray) -> Float[np.ndarray, " m"]:
    return np.asarray(np.linalg.norm(x[net.target] - x[net.observer], axis=1))
