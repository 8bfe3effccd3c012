"""What is known before any refinement: a start without a guess, and what these sightings can tell at all."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..solve import Pattern
from .gauge import Gauge, gauge_of, normalise
from .graph import Components, components
from .headings import world_directions
from .headings_without_axes import start_without_axis
from .linear import linear_pattern, linear_start
from .network import Network
from .observability import Observability, observe, without_lines


@dataclass(frozen=True, slots=True)
class Start:
    """Everything found before the refinement: pieces, positions, headings, who can be located, sightings of use."""

    parts: Components
    position: Float[np.ndarray, "n d"]
    heading: Float[np.ndarray, " n"] | None
    seen: Observability
    gauge: Gauge
    used: Bool[np.ndarray, " m"]
    pattern: Pattern | None = None  # of the sightings alone with the anchors held, where that is the whole problem


def prepare(net: Network, initial: np.ndarray | None = None) -> Start:
    """A start without a guess, and what can be told from these sightings at all."""
    parts = components(net)
    heading, used = None, np.ones(len(net.observer), dtype=bool)
    pattern = None
    if net.axis:
        pattern, held = linear_pattern(net, parts)
        position = linear_start(net, parts, net.direction, pattern, held) if initial is None else initial
        if net.distances or not (held == net.is_anchor).all():
            pattern = None  # what follows holds other entries
        seen = observe(net, parts, position, pattern)
    else:
        position, heading, seen, used = start_without_axis(net, parts)
        net = net.select(used)
        parts = components(net)
    seen = without_lines(net, parts, seen, world_directions(net, heading))
    gauge = gauge_of(net, parts, seen.localisable)
    position, heading = normalise(gauge, position, heading)
    return Start(parts, position, heading, seen, gauge, used, pattern)
