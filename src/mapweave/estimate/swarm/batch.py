"""The default: a linear start, sparse Levenberg-Marquardt on whitened bearings, covariance from the information.

Nothing needs a guess, nothing fails because some robots cannot be located, and where anchors are too few the answer
is the shape, in a gauge that is named.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import DataError
from ...maps.network import Network
from ...maps.swarm import SwarmEstimate
from ...solve import Factor, GemanMcClure, Pattern, Problem, Solution, SolveConfig, minimise
from . import factors
from .config import SwarmConfig
from .finish import finish
from .gauge import Gauge, gauge_of, normalise, pins
from .graph import Components, components
from .headings import heading_start, world_directions
from .linear import linear_start
from .observability import Observability, observe

LOOSE = 1e4  # median sighting lengths a robot that nothing determines may stray from its start


@dataclass(frozen=True, slots=True)
class Start:
    """Everything found before the refinement: pieces, positions, headings, and who can be located."""

    parts: Components
    position: Float[np.ndarray, "n d"]
    heading: Float[np.ndarray, " n"] | None
    seen: Observability
    gauge: Gauge


def batch(net: Network, cfg: SwarmConfig, initial: np.ndarray | None = None) -> SwarmEstimate:
    """The maximum-likelihood positions of `net`; `initial` (n, d) takes the place of the linear start."""
    start = prepare(net, initial)
    solution, problem, pattern = refine(net, start, cfg)
    return finish(net, start, solution, problem, cfg, "batch", pattern=pattern)


def prepare(
    net: Network,
    initial: np.ndarray | None = None,
    weights: Float[np.ndarray, " m"] | None = None,
) -> Start:
    """A start without a guess, and what can be told from these sightings at all."""
    if not len(net.observer):
        raise DataError("no sightings: nothing can be located")
    parts = components(net)
    heading = None if net.axis else heading_start(net)
    position = initial
    if position is None:
        direction = world_directions(net, heading)
        position = linear_start(net, parts, direction, *linear_pattern(net, parts), weights)
    seen = observe(net, parts, position)
    gauge = gauge_of(net, parts, seen.localisable)
    position, heading = normalise(gauge, position, heading)
    return Start(parts, position, heading, seen, gauge)


def linear_pattern(net: Network, parts: Components) -> tuple[Pattern, Bool[np.ndarray, " n"]]:
    """The sparsity of the linear start, and the robots it holds: anchors, and one of each piece without any."""
    n, dim = len(net), net.dim
    held = net.is_anchor
    first = np.full(len(parts.known), n)
    np.minimum.at(first, parts.label, np.arange(n))
    has = np.zeros(len(parts.known), dtype=bool)
    has[parts.label[held]] = True
    held[first[~has]] = True
    k = np.arange(dim)
    at = np.concatenate([dim * net.observer[:, None] + k, dim * net.target[:, None] + k], axis=1)
    none = np.zeros((len(at), 1))
    shape = Factor(at, lambda _: none, lambda _: none[:, :, None], 1)
    problem = Problem(np.zeros(n * dim), [shape], np.repeat(held, dim))
    return Pattern.of(problem).dissected(problem.free // dim), held


def refine(
    net: Network, start: Start, cfg: SwarmConfig, kernel: GemanMcClure | None = None, pattern: Pattern | None = None
) -> tuple[Solution, Problem, Pattern]:
    """Levenberg-Marquardt from `start`; robots that nothing determines are held loosely where they are."""
    n, w, dim = len(net), factors.width(net), net.dim
    x0 = np.zeros((n, w))
    x0[:, :dim] = start.position
    if start.heading is not None:
        x0[:, dim] = start.heading
    fixed = pins(net, start.gauge, start.position)
    fixed[list(net.anchors), :dim] = True
    loose = np.repeat(~start.seen.localisable[:, None], w, axis=1)
    if not net.axis:
        deaf = np.ones(n, dtype=bool)
        deaf[net.observer] = False
        fixed[deaf, dim] = True
    loose &= ~fixed
    for k, p in net.anchors.items():
        x0[k, :dim] = p
    flat = x0.ravel()
    span = np.linalg.norm(start.position[net.target] - start.position[net.observer], axis=1)
    terms = [factors.bearing_factor(net, kernel)]
    if net.distances:
        terms.append(factors.distance_factor(net))
    if loose.any():
        terms.append(factors.prior_factor(np.flatnonzero(loose.ravel()), flat, LOOSE * float(np.median(span))))
    problem = Problem(flat, terms, fixed.ravel(), lambda x, dx: factors.retract(net, x, dx))
    pattern = pattern or Pattern.of(problem).dissected(problem.free // w)
    solve = SolveConfig(max_iterations=cfg.max_iterations, step_tolerance=1e-9 * float(np.median(span)))
    return minimise(problem, solve, pattern), problem, pattern
