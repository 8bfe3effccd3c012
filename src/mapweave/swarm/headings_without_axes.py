"""The start of robots in the plane that share no axis: headings first, then positions as if there were one."""

from dataclasses import replace

import numpy as np

from ..core.errors import DataError
from .graph import Components, components
from .headings import anchored_turn, beacon_headings, mutual_headings, resected_headings, world_directions
from .linear import linear_pattern, linear_start
from .network import Network
from .observability import Observability, observe

ROUNDS = 20  # of spreading headings from robots that see each other to those that only see


def start_without_axis(net: Network, parts: Components) -> tuple[np.ndarray, np.ndarray, Observability, np.ndarray]:
    """Positions, headings, who can be located, and (m,) the sightings whose observer's heading was found.

    Robots that sighted each other share their headings directly; the others get theirs from the positions found so
    far, as long as that reaches anybody new. Anchors give the orientation when two of them are reached. Where no two
    robots sighted each other, those that see three anchors begin. Raises DataError when there are none of them either.
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
    used = known[net.observer]
    heard = net.select(used)
    return position, heading, observe(heard, components(heard), position), used
