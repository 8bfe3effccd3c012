"""The same answer without a centre: each robot keeps its own position and talks only to those it sees or is seen by.

First the linear start by Jacobi over-relaxation: everybody tells its position and moves to where its neighbours and
its sightings put it. Then Gaussian belief propagation: what robot i tells j is what all its other neighbours make it
believe about j through their common sightings. Who has nothing new to say stays silent; when all are silent it ends.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import DataError
from ..solve import Status as SolveStatus
from . import bearing
from .batch import refine
from .config import SwarmConfig
from .network import Network, components, effective_sigma
from .posterior import posterior
from .result import SwarmEstimate, Traffic
from .start import Start, prepare

TINY = 1e-9  # [m rad] that a guard against dividing by zero adds
FLOAT = 8  # bytes of a number in a message


@dataclass(frozen=True, slots=True)
class MessageLinks:
    """Directed links a -> b, both ways for every pair with a sighting; `back[k]` is the opposite of link k."""

    a: Int[np.ndarray, " l"]
    b: Int[np.ndarray, " l"]
    back: Int[np.ndarray, " l"]
    of_sighting: Int[np.ndarray, " m"]  # the link observer -> target of each sighting


def distributed(net: Network, cfg: SwarmConfig, initial: np.ndarray | None = None) -> SwarmEstimate:
    """Positions agreed on by talking; covariances and verdicts are added centrally, for the reader.

    Raises DataError without a common axis, without two anchors at distinct places, or with known distances: a gauge or
    a length is nothing neighbours can agree on by themselves.
    """
    if not net.axis or net.distances or len({tuple(p) for p in net.anchors.values()}) < 2:
        raise DataError("the distributed method needs a common axis and two anchors, and takes no known distances")
    parts = components(net)
    reached = (parts.known >= 2)[parts.label]  # others hear of no two anchors, whoever passes word on, and stay silent
    everyone, net = net, net.select(reached[net.observer])
    if not len(net.observer):
        raise DataError("no two anchors hang together by sightings: the distributed method has nothing to start from")
    links = links_of(net)
    anchors = np.array(list(net.anchors.values()))
    usual = float(np.linalg.norm(np.ptp(anchors, axis=0))) / np.sqrt(len(net))  # known to all beforehand
    position, said = (initial.copy(), Traffic(0, 0, 0)) if initial is not None else relaxed(net, links, usual, cfg)
    for k, p in net.anchors.items():
        position[k] = p
    position, more = believed(net, links, position, cfg)
    traffic = Traffic(said.rounds + more.rounds, said.messages + more.messages, said.bytes + more.bytes)
    net = everyone
    if not reached.all():
        position[~reached] = prepare(net).position[~reached]
    start: Start = prepare(net, position)
    solution, problem, pattern = refine(net, start, replace(cfg, max_iterations=0))
    notes = () if more.rounds < cfg.max_rounds else (f"still talking after {more.rounds} rounds",)
    converged = replace(solution, iterations=traffic.rounds, status=solution.status if notes else SolveStatus.CONVERGED)
    return posterior(net, start, converged, problem, cfg, "distributed", traffic=traffic, notes=notes, pattern=pattern)


def links_of(net: Network) -> MessageLinks:
    """Who talks to whom: both ends of every sighting, both ways."""
    n = len(net)
    there, back = net.observer * n + net.target, net.target * n + net.observer
    key = np.unique(np.concatenate([there, back]))
    a, b = key // n, key % n
    return MessageLinks(a, b, np.searchsorted(key, b * n + a), np.searchsorted(key, there))


def relaxed(
    net: Network, links: MessageLinks, usual: float, cfg: SwarmConfig
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
        position[free] += cfg.messages.relaxation * (wanted - position)[free]
        speaks = np.linalg.norm(position - heard, axis=1) > cfg.messages.quiet * usual
    return position, Traffic(rounds, messages, messages * dim * FLOAT)


def believed(
    net: Network, links: MessageLinks, start: Float[np.ndarray, "n d"], cfg: SwarmConfig
) -> tuple[Float[np.ndarray, "n d"], Traffic]:
    """Gaussian belief propagation from `start`, linearised anew as the beliefs move."""
    n, dim = len(net), net.dim
    eye = np.eye(dim)
    fixed = net.is_anchor
    x = start.copy()
    at = start.copy()  # where each robot's sightings are linearised
    faint = cfg.messages.faint / max(float(np.median(_range(net, x) * effective_sigma(net))), TINY) ** 2
    W, s, size = _linearised(net, links, at)
    # Link a -> b: what a told b; at first as if a were known, since two who each know one direction tell nothing.
    Lam = W.copy()
    eta = np.einsum("lab,lb->la", W, at[links.b]) + s
    rounds, messages = 1, len(links.a)
    speaks = np.ones(len(links.a), dtype=bool)
    while speaks.any() and rounds < cfg.max_rounds:
        rounds += 1
        belief, carried = np.tile(faint * eye, (n, 1, 1)), faint * x
        np.add.at(belief, links.b, Lam)
        np.add.at(carried, links.b, eta)
        x[~fixed] = np.linalg.solve(_firm(belief), carried[..., None])[~fixed, :, 0]
        if rounds % cfg.messages.relinearise == 0:
            at = x.copy()
            W, s, size = _linearised(net, links, at)
        own = np.einsum("lab,lb->la", W, at[links.b] - at[links.a]) + s  # of b; of a it is the negative
        cavity = W + belief[links.a] - Lam[links.back]
        left = carried[links.a] - eta[links.back] - own
        gain = np.linalg.solve(_firm(cavity), np.concatenate([W, left[..., None]], axis=2))
        to_b = W - W @ gain[..., :dim]
        new_eta = own + np.einsum("lab,lb->la", W, gain[..., dim])
        known = fixed[links.a]
        to_b[known] = W[known]
        new_eta[known] = (own + np.einsum("lab,lb->la", W, x[links.a]))[known]
        change = (new_eta - eta) - np.einsum("lab,lb->la", to_b - Lam, x[links.b])
        firmer = np.linalg.norm(to_b - Lam, axis=(1, 2)) > cfg.messages.firmer * np.linalg.norm(W, axis=(1, 2))
        speaks = (firmer | (np.linalg.norm(change, axis=1) * size > cfg.tolerance)) & ~fixed[links.b]
        Lam[speaks], eta[speaks] = to_b[speaks], new_eta[speaks]
        messages += int(np.count_nonzero(speaks))
    floats = dim * (dim + 1) // 2 + 2 * dim  # information, its vector, and where the sender stands
    return x, Traffic(rounds, messages, messages * floats * FLOAT)


def _firm(A: np.ndarray) -> np.ndarray:
    """`A` (k, d, d) with enough on the diagonal that rounding cannot make it singular."""
    return np.asarray(A + (1e-13 * np.abs(A).max(axis=(1, 2)) + 1e-30)[:, None, None] * np.eye(A.shape[1]))


def _by_link(links: MessageLinks, value: np.ndarray) -> np.ndarray:
    """Sightings' values summed on their link and its opposite."""
    out = np.zeros((len(links.a), *value.shape[1:]))
    np.add.at(out, links.of_sighting, value)
    return np.asarray(out + out[links.back])


def _linearised(net: Network, links: MessageLinks, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """W (l, d, d) and s (l, d): information and pull of all sightings on a link; size (l,): from pull to radians."""
    u, r = bearing.predict(at[net.observer], at[net.target])
    e = bearing.log_map(u, net.direction)
    sigma = effective_sigma(net)
    information = 1.0 / (sigma * r) ** 2
    W = _by_link(links, information[:, None, None] * (np.eye(net.dim) - u[:, :, None] * u[:, None, :]))
    out = np.zeros((len(links.a), net.dim))
    np.add.at(out, links.of_sighting, (information * r)[:, None] * e)
    size = np.zeros(len(links.a))
    np.maximum.at(size, links.of_sighting, sigma**2 * r)
    return W, out - out[links.back], np.maximum(size, size[links.back])


def _range(net: Network, x: np.ndarray) -> Float[np.ndarray, " m"]:
    return np.asarray(np.linalg.norm(x[net.target] - x[net.observer], axis=1))
