"""Locating in spite of wrong sightings, with a verdict on the result's own reliability.

Two robots that saw each other must have seen opposite directions; least unsquared deviations start the positions,
graduated non-convexity (Geman-McClure) finds which sightings belong together, robots that fell in with wrong ones are
put where most of theirs meet, and those sightings alone are then used as by the batch estimator, so that the covariance
means what it says.
"""

from dataclasses import replace
from math import erf, sqrt

import numpy as np
from jaxtyping import Bool, Float

from ..core.gaussian import chi2_quantile
from ..solve import GemanMcClure
from .alternatives import doubts as alternatives
from .batch import batch, refine
from .config import ROBUST, RobustConfig, SwarmConfig
from .factors import bearing_factor
from .fallen import fallen_together, unchecked
from .headings import mutual_pairs, world_directions
from .network import BearingNetwork, components, effective_sigma
from .posterior import posterior
from .relocation import relocated, unsupported
from .result import SwarmEstimate
from .start import SwarmStart, linear_pattern, linear_start, prepare
from .verdict import doubtful_warnings, fallen_warnings, support_warnings, trust_warnings


def robust(net: BearingNetwork, cfg: SwarmConfig, initial: np.ndarray | None = None) -> SwarmEstimate:
    """The most likely positions under the sightings found to agree; the others are marked in `outlier`."""
    if not np.any(net.sigma > 0):
        return replace(batch(net, cfg, initial), method="robust")
    agree = mutual_agreement(net, cfg.mutual_gate)
    if not agree.any():
        agree[:] = True  # nothing agrees: the verdict will say so
    kept = net.select(agree)
    start = prepare(kept, initial)
    used = agree.copy()
    used[agree] = start.used
    kept = net.select(used)
    start = replace(start, position=unsquared_start(kept, start, cfg.robust) if initial is None else start.position)
    x = graduated(kept, start, cfg)
    if net.axis:
        x = relocated(kept, x.reshape(len(net), net.dim), outlier_limit(net, cfg.inlier_gate), cfg.robust).ravel()
    inlier = agreeing(net, x, cfg.inlier_gate) & ~without_heading(net, used)
    if not inlier.any():
        return _nothing_agrees(net, cfg, initial)
    doubts: list[str] = []
    for round_ in range(cfg.robust.reselections):
        estimate, inlier, start = _selected(net, x, start, used, inlier, cfg)
        if not net.axis or not cfg.covariance:
            break
        fallen = fallen_together(net, inlier, estimate, outlier_limit(net, cfg.inlier_gate), cfg)
        if not len(fallen.wrong) or round_ == cfg.robust.reselections - 1:
            doubts = fallen_warnings(net, np.concatenate([fallen.wrong, fallen.undecided]))
            break
        inlier[fallen.wrong] = False
        chosen = net.select(inlier)
        start = prepare_at(chosen, estimate.position.ravel(), start)
        x = refine(chosen, start, cfg, everyone=True)[0].x
        inlier = agreeing(net, x, cfg.inlier_gate)
    outside = alternatives(net, inlier, estimate, cfg.alternatives)
    doubts += doubtful_warnings(net, outside, cfg.alternatives.doubt)
    doubts += [*trust_warnings(net, ~inlier, cfg.verdict), *support_warnings(net, unsupported(net, ~inlier))]
    return replace(estimate, reliable=estimate.reliable and not doubts, warnings=(*doubts, *estimate.warnings))


def _selected(
    net: BearingNetwork, x: np.ndarray, start: SwarmStart, used: np.ndarray, inlier: np.ndarray, cfg: SwarmConfig
) -> tuple[SwarmEstimate, Bool[np.ndarray, " m"], SwarmStart]:
    """The estimate of the sightings that agree with it, found from those that agree at x; and which they are."""
    for _ in range(cfg.robust.reselections):
        chosen = net.select(inlier)
        start = prepare_at(chosen, x, start)
        solution, problem, pattern = refine(chosen, start, cfg, everyone=True)
        x = solution.x
        again = agreeing(net, x, cfg.inlier_gate) & ~without_heading(net, used)
        if (again == inlier).all() or not again.any():
            break
        inlier = again
    chosen = net.select(inlier)
    if len(chosen.observer) != problem.terms[0].size // (net.dim - 1):
        start = prepare_at(chosen, x, start)
        solution, problem, pattern = refine(chosen, start, cfg, everyone=True)
    estimate = posterior(chosen, start, solution, problem, cfg, "robust", ~inlier, pattern=pattern)
    if net.axis and not inlier.all():  # where some are wrong, one that nothing checks may be
        alone = unchecked(net, inlier, estimate, cfg.fallen)[inlier]
        if alone.any():
            estimate = posterior(
                chosen, start, solution, problem, cfg, "robust", ~inlier, pattern=pattern, unchecked=alone
            )
    return estimate, inlier, start


def _nothing_agrees(net: BearingNetwork, cfg: SwarmConfig, initial: np.ndarray | None) -> SwarmEstimate:
    estimate = batch(net, cfg, initial)
    warning = "no sightings agree with each other: the estimate uses all of them"
    return replace(estimate, method="robust", reliable=False, warnings=(warning, *estimate.warnings))


def mutual_agreement(net: BearingNetwork, gate: float) -> Bool[np.ndarray, " m"]:
    """(m,) False for both of two mutual sightings that miss being opposite by `gate` standard deviations.

    Without a common axis mutual sightings tell the headings instead, and nothing can be checked.
    """
    agree = np.ones(len(net.observer), dtype=bool)
    if not net.axis:
        return agree
    a, b = mutual_pairs(net)
    u = net.direction
    cosine = -np.einsum("mk,mk->m", u[a], u[b])
    miss = np.arctan2(np.linalg.norm(u[a] + cosine[:, None] * u[b], axis=1), cosine)
    wrong = miss > gate * np.hypot(net.sigma[a], net.sigma[b])
    agree[a[wrong]] = agree[b[wrong]] = False
    return agree


def unsquared_start(net: BearingNetwork, start: SwarmStart, how: RobustConfig = ROBUST) -> Float[np.ndarray, "n d"]:
    """Positions of least summed (not squared) deviation, by reweighting the linear start."""
    parts = components(net)
    pattern, held = linear_pattern(net, parts)
    direction = world_directions(net, start.heading)
    plain = net if net.axis else replace(net, axis=True)
    position = start.position
    for _ in range(how.reweights):
        d = position[net.target] - position[net.observer]
        usual = float(np.median(np.linalg.norm(d, axis=1))) or 1.0
        along = np.einsum("mk,mk->m", d, direction)
        miss = np.linalg.norm(d - np.maximum(along, 0.0)[:, None] * direction, axis=1) / usual
        weights = 1.0 / np.maximum(miss, effective_sigma(net))
        position = linear_start(plain, parts, direction, pattern, held, weights / weights.max())
    return position


def graduated(net: BearingNetwork, start: SwarmStart, cfg: SwarmConfig) -> Float[np.ndarray, " s"]:
    """The state under a Geman-McClure kernel narrowed from covering all residuals to the inlier gate.

    All robots are kept apart, since a wrong sighting is escaped by falling together.
    """
    state = _state(start)
    largest = float(np.sqrt(bearing_factor(net).squares(state).max()))
    width, pattern = max(largest, cfg.inlier_gate), None
    stage = replace(cfg, max_iterations=cfg.robust.stage_iterations)
    while True:
        solution, _, pattern = refine(net, start, stage, GemanMcClure(width), pattern, everyone=True)
        start = _moved(net, start, solution.x)
        if width <= cfg.inlier_gate:
            return solution.x
        width = max(width / cfg.robust.cooling, cfg.inlier_gate)


def agreeing(net: BearingNetwork, x: Float[np.ndarray, " s"], gate: float) -> Bool[np.ndarray, " m"]:
    """(m,) sightings that miss the state by less than what `gate` standard deviations mean in one dimension."""
    return np.asarray(bearing_factor(net).squares(x) <= outlier_limit(net, gate))


def outlier_limit(net: BearingNetwork, gate: float) -> float:
    """The squared whitened residual of a sighting that is as unlikely as `gate` standard deviations."""
    return gate**2 if net.dim == 2 else chi2_quantile(_two_sided(gate), 2.0)


def without_heading(net: BearingNetwork, used: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """(m,) sightings by robots none of whose sightings was of use at the start (their heading is unknown)."""
    if net.axis:
        return np.zeros(len(used), dtype=bool)
    heard = np.zeros(len(net), dtype=bool)
    heard[net.observer[used]] = True
    return np.asarray(~heard[net.observer])


def prepare_at(net: BearingNetwork, x: Float[np.ndarray, " s"], start: SwarmStart) -> SwarmStart:
    """A start for other sightings of the same robots, at positions already found."""
    moved = _moved(net, start, x)
    fresh = prepare(replace(net, axis=True) if not net.axis else net, moved.position)
    return fresh if net.axis else replace(moved, parts=fresh.parts)


def _two_sided(gate: float) -> float:
    """The probability that a normal variable misses by less than `gate` standard deviations."""
    return erf(gate / sqrt(2.0))


def _state(start: SwarmStart) -> np.ndarray:
    return (start.position if start.heading is None else np.column_stack([start.position, start.heading])).ravel()


def _moved(net: BearingNetwork, start: SwarmStart, x: np.ndarray) -> SwarmStart:
    table = x.reshape(len(net), -1)
    return replace(start, position=table[:, : net.dim], heading=None if net.axis else table[:, net.dim])
