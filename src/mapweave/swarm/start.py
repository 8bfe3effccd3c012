"""What is known before any refinement: a start without a guess, and what these sightings can tell at all.

Robots in the plane that share no axis get headings first, then positions as if there were one.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ..core.errors import DataError
from ..solve import Pattern
from .gauge import Gauge, gauge_of, normalise
from .headings import anchored_turn, beacon_headings, headings_at, mutual_headings, resected_headings, world_directions
from .linear import linear_pattern, linear_start
from .network import BearingNetwork, Components, components
from .observability import Observability, observe, without_lines

ROUNDS = 20  # of spreading headings from robots that see each other to those that only see


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
