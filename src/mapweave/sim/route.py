"""Where a robot drives: straight lines and arcs, and the poses along them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import frozen


@dataclass(frozen=True, slots=True)
class Route:
    """Pieces of constant curvature from `start` on. length: (k,) [m]; curvature: (k,) [1/m], to the left."""

    start: Float[np.ndarray, "3"]
    length: Float[np.ndarray, " k"]
    curvature: Float[np.ndarray, " k"]

    def __post_init__(self) -> None:
        for name in ("start", "length", "curvature"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def total(self) -> float:
        return float(self.length.sum())

    def poses(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Poses (n, 3) at the distances `s` [m] from the start; beyond the end the last piece goes on."""
        ends = np.cumsum(self.length)
        corner = [np.asarray(self.start)]
        for span, bend in zip(self.length, self.curvature, strict=True):
            corner.append(se2.compose(corner[-1], se2.exp(np.array([span, 0.0, span * bend]))))
        piece = np.minimum(np.searchsorted(ends, s, side="right"), len(ends) - 1)
        rest = s - (ends[piece] - self.length[piece])
        twist = np.column_stack([rest, np.zeros_like(rest), rest * self.curvature[piece]])
        return se2.compose(np.array(corner)[piece], se2.exp(twist))


def ring(wide: float, high: float, radius: float, distance: float, start: float) -> Route:
    """Round a rectangle `wide` x `high` [m] to the left, corners rounded, `distance` [m] long.

    It begins at the origin heading along +x, `start` [m] after the lower left corner.
    """
    arc = (0.5 * np.pi * radius, 1.0 / radius)
    first = (wide - start - radius, 0.0)
    lap = [arc, (high - 2 * radius, 0.0), arc, (wide - 2 * radius, 0.0), arc, (high - 2 * radius, 0.0), arc]
    pieces = [first, *lap]
    while sum(length for length, _ in pieces) < distance:
        pieces += [(wide - 2 * radius, 0.0), *lap]
    return _cut(np.zeros(3), pieces, distance)


def through(points: Sequence[tuple[float, float]], radius: float) -> Route:
    """Past the `points` [m], corners rounded with `radius` [m] or as the legs allow; no leg turns straight back."""
    P = np.array(points, dtype=float)
    legs = np.diff(P, axis=0)
    length = np.hypot(legs[:, 0], legs[:, 1])
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turn = se2.wrap_angle(np.diff(heading))
    half = np.tan(0.5 * np.abs(turn))
    room = 0.5 * np.minimum(length[:-1], length[1:])
    bend = np.minimum(radius, room / np.maximum(half, 1e-9))
    cut = np.concatenate([[0.0], bend * half, [0.0]])
    pieces = []
    for k in range(len(legs)):
        pieces.append((float(length[k] - cut[k] - cut[k + 1]), 0.0))
        if k < len(turn) and abs(turn[k]) > 1e-9:
            pieces.append((float(bend[k] * abs(turn[k])), float(np.sign(turn[k]) / bend[k])))
    return _cut(np.array([P[0, 0], P[0, 1], heading[0]]), pieces, float("inf"))


def _cut(start: np.ndarray, pieces: Sequence[tuple[float, float]], distance: float) -> Route:
    kept: list[tuple[float, float]] = []
    left = distance
    for length, bend in pieces:
        if left <= 0:
            break
        if length > 1e-9:
            kept.append((min(length, left), bend))
            left -= length
    lengths, bends = zip(*kept, strict=True)
    return Route(start, np.array(lengths), np.array(bends))
