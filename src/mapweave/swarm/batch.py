"""The default: a linear start, sparse Levenberg-Marquardt on whitened bearings, covariance from the information.

Nothing needs a guess, nothing fails because some robots cannot be located, and where anchors are too few the answer
is the shape, in a gauge that is named.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.attitude import Headings
from ..solve import GemanMcClure, Pattern, Problem, Solution, SolveConfig, minimise
from . import factors
from .config import SWARM_LOOSE, SWARM_NEAREST, SWARM_SELDOM, SwarmConfig
from .network import BearingNetwork
from .observability import gauge_pins, normalise
from .posterior import others_warnings, posterior
from .result import OtherAnswer, SwarmEstimate
from .start import SwarmStart, other_answers, prepare

LOWER = 1e-3  # of chi-square by which another answer is the better one


def batch(net: BearingNetwork, cfg: SwarmConfig, initial: np.ndarray | None = None) -> SwarmEstimate:
    """The maximum-likelihood positions of `net`; `initial` (n, d) takes the place of the linear start."""
    start = prepare(net, initial)
    used = net.select(start.used)
    solution, problem, pattern = refine(used, start, cfg)
    found = posterior(used, start, solution, problem, cfg, "batch", ~start.used, pattern=pattern)
    others = answers_beside(used, found, cfg)
    if others and others[0].chi2 < found.chi2 - LOWER:
        start = replace(start, position=others[0].position, heading=others[0].heading)
        solution, problem, pattern = refine(used, start, cfg)
        found = posterior(used, start, solution, problem, cfg, "batch", ~start.used, pattern=pattern)
        others = answers_beside(used, found, cfg)
    return with_others(found, others)


def answers_beside(net: BearingNetwork, found: SwarmEstimate, cfg: SwarmConfig) -> tuple[OtherAnswer, ...]:
    """The `other_answers` beside `found`, which is of the sightings of `net`, each refined as that was."""

    def refined(position: Float[np.ndarray, "n 3"], heading: Headings) -> OtherAnswer:
        start = prepare(net, position, heading)
        solution, problem, _ = refine(net, start, cfg)
        p, h = normalise(start.gauge, *factors.parted(net, solution.x))
        return OtherAnswer(p, np.zeros(0) if h is None else h, float(problem.terms[0].squares(solution.x).sum()))

    return other_answers(net, found, refined) if cfg.max_iterations else ()


def with_others(found: SwarmEstimate, others: tuple[OtherAnswer, ...]) -> SwarmEstimate:
    """`found`, not to be relied on where there are `others`."""
    if not others:
        return found
    warnings = (*others_warnings(found, others), *found.warnings)
    return replace(found, others=others, reliable=False, warnings=warnings)


def refine(
    net: BearingNetwork,
    start: SwarmStart,
    cfg: SwarmConfig,
    kernel: GemanMcClure | None = None,
    pattern: Pattern | None = None,
    *,
    everyone: bool = False,
) -> tuple[Solution, Problem, Pattern]:
    """Levenberg-Marquardt from `start`; robots that nothing determines are held loosely where they are.

    Robots seldom sighted are kept from falling onto their neighbours, with `everyone` all robots are.
    """
    n, w, dim = len(net), factors.width(net), net.dim
    x0 = factors.state(start.position, start.heading).reshape(n, w).copy()
    fixed = gauge_pins(net, start.gauge, start.position)
    fixed[list(net.anchors), :dim] = True
    loose = np.repeat(~start.seen.localisable[:, None], w, axis=1)
    loose[~start.seen.oriented, dim:] = True
    deaf = np.ones(n, dtype=bool)
    deaf[net.observer] = False
    fixed[deaf, dim:] = True
    loose &= ~fixed
    for k, p in net.anchors.items():
        x0[k, :dim] = p
    flat = x0.ravel()
    span = float(np.median(np.linalg.norm(start.position[net.target] - start.position[net.observer], axis=1))) or 1.0
    terms = [factors.bearing_factor(net, kernel)]
    if net.distances:
        terms.append(factors.distance_factor(net))
    if loose.any():
        terms.append(factors.prior_factor(np.flatnonzero(loose.ravel()), flat, SWARM_LOOSE * span))
    degree = np.bincount(np.concatenate([net.observer, net.target]), minlength=n)
    few = np.flatnonzero(everyone | (np.minimum(degree[net.observer], degree[net.target]) <= SWARM_SELDOM))
    if len(few):
        terms.append(factors.apart_factor(net, few, SWARM_NEAREST * span))
    problem = Problem(flat, terms, fixed.ravel(), lambda x, dx: factors.retract(net, x, dx))
    if len(terms) == 1 and pattern is None and int(problem.free.size) == n * w - dim * len(net.anchors):
        pattern = start.pattern
    pattern = pattern or Pattern.of(problem).dissected(problem.free // w)
    anyone = (start.seen.localisable & ~net.is_anchor).any()
    solve = SolveConfig(
        max_iterations=cfg.max_iterations if anyone else 0, step_tolerance=1e-9 * span, cost_tolerance=1e-7
    )
    return minimise(problem, solve, pattern), problem, pattern
