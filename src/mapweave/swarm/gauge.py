"""What the sightings leave free, held and named: place, scale and orientation of a swarm without enough anchors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..core.se2 import rotation, wrap_angle
from .factors import width
from .network import BearingNetwork, Components


@dataclass(frozen=True, slots=True)
class Gauge:
    """The freedom left by the sightings. name: for people, "" for none; members: (n,) the component it is of.

    place, scale, turn: whether each is free.
    """

    name: str
    place: bool
    scale: bool
    turn: bool
    members: Bool[np.ndarray, " n"]
    centre: Float[np.ndarray, " d"]  # the one anchor when place is known, else the origin

    @property
    def free(self) -> str:
        """What is free, in a few words."""
        named = (("place", self.place), ("scale", self.scale), ("orientation", self.turn))
        return " and ".join(name for name, is_free in named if is_free)


def gauge_of(net: BearingNetwork, parts: Components, localisable: Bool[np.ndarray, " n"]) -> Gauge:
    """The gauge of the reference component, over the robots located up to it."""
    c = parts.reference
    members = (parts.label == c) & localisable if len(net) else np.zeros(0, dtype=bool)
    if not (members & ~net.is_anchor).any() or parts.known[c] >= 2:
        return Gauge("", False, False, False, members, np.zeros(net.dim))
    place, scale, turn = parts.known[c] == 0, not parts.measured[c], not net.axis
    centre = next((p for k, p in net.anchors.items() if parts.label[k] == c), np.zeros(net.dim))
    held = [
        text
        for free, text in (
            (place, "place free (the located robots' centroid is set to the origin)"),
            (scale, f"scale free (root mean square distance from the {'centroid' if place else 'anchor'} is set to 1)"),
            (turn, "orientation free (the located robots' mean heading is set to 0)"),
        )
        if free
    ]
    return Gauge("; ".join(held), bool(place), bool(scale), turn, members, centre)


def normalise(gauge: Gauge, position: np.ndarray, heading: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
    """The same shape brought to the gauge's place, size and orientation; all components move together."""
    m = gauge.members
    if not gauge.name or not m.any():
        return position, heading
    centre = position[m].mean(axis=0) if gauge.place else gauge.centre
    p = position - centre
    if gauge.turn and heading is not None:
        mean = float(np.angle(np.exp(1j * heading[m]).sum()))
        p = p @ rotation(-mean).T
        heading = np.asarray(wrap_angle(heading - mean))
    size = float(np.sqrt(np.square(p[m]).sum(axis=1).mean()))
    if gauge.scale and size > 0:
        p = p / size
    return p + gauge.centre, heading


def gauge_pins(net: BearingNetwork, gauge: Gauge, position: np.ndarray) -> np.ndarray:
    """State entries (n, w) to fix so that the members have no freedom left."""
    fixed = np.zeros((len(net), width(net)), dtype=bool)
    m = np.flatnonzero(gauge.members)
    if not gauge.name or not len(m):
        return fixed
    first = m[np.argmin(np.square(position[m] - position[m].mean(axis=0)).sum(axis=1))]
    if gauge.place:
        fixed[first, : net.dim] = True
        centre = position[first]
    else:
        centre = gauge.centre
    away = position - centre
    if gauge.scale or gauge.turn:
        far = m[np.argmax(np.square(away[m]).sum(axis=1))]
        axis = int(np.argmax(np.abs(away[far])))
        if gauge.scale:
            fixed[far, axis] = True
        if gauge.turn:
            fixed[far, 1 - axis] = True
    return fixed


def gauge_basis(net: BearingNetwork, gauge: Gauge, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motions G (n w, g) that no sighting sees and the conditions C (n w, g) with `C^T dx = 0` that the gauge sets."""
    n, w, dim = len(net), width(net), net.dim
    m = gauge.members
    p = (position - (position[m].mean(axis=0) if gauge.place else gauge.centre)) * m[:, None]
    G, C = [], []
    if gauge.place:
        for k in range(dim):
            g = np.zeros((n, w))
            g[m, k] = 1.0
            G.append(g)
            C.append(g)
    if gauge.scale:
        g = np.zeros((n, w))
        g[:, :dim] = p
        G.append(g)
        C.append(g)
    if gauge.turn:
        g, c = np.zeros((n, w)), np.zeros((n, w))
        g[:, 0], g[:, 1], g[m, 2] = -p[:, 1], p[:, 0], 1.0
        c[m, 2] = 1.0
        G.append(g)
        C.append(c)
    if not G:
        return np.zeros((n * w, 0)), np.zeros((n * w, 0))
    return np.stack([g.ravel() for g in G], axis=1), np.stack([c.ravel() for c in C], axis=1)
