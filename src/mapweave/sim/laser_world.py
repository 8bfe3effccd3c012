"""Walls with paint on them: segments and how much light each sends back."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..core.config import config
from ..core.walls import Walls

Stretch = tuple[float, float, float, float]  # from, to [m] along a wall; reflectance; depth behind the wall line [m]


@dataclass(frozen=True, slots=True)
class LaserWorld(Walls):
    """Walls with a name, for a laser to look at."""

    name: str = "world"


@config
class WallStyle:
    """Paint with objects on it: gaps of paint, then a door or a poster, then paint again."""

    gap: tuple[float, float] = (0.8, 3.5)  # [m] of paint between objects
    paint: float = 0.6
    mottle: float = 0.03  # relative spread of the paint from piece to piece
    mottle_length: float = 0.5  # [m]
    door_share: float = 0.4
    door_width: float = 0.9  # [m]
    door: tuple[float, float] = (0.2, 0.45)
    poster_width: tuple[float, float] = (0.3, 1.2)  # [m]
    poster_dark: tuple[float, float] = (0.05, 0.3)
    poster_bright: tuple[float, float] = (0.75, 0.95)


class WorldBuilder:
    """Walls put up one by one; `world` is what stands at the end."""

    def __init__(self, name: str, style: WallStyle, rng: np.random.Generator) -> None:
        self.name, self.style, self.rng = name, style, rng
        self._segments: list[tuple[float, float, float, float]] = []
        self._reflectance: list[float] = []

    def segment(self, a: np.ndarray, b: np.ndarray, reflectance: float) -> None:
        self._segments.append((float(a[0]), float(a[1]), float(b[0]), float(b[1])))
        self._reflectance.append(reflectance)

    def wall(self, a: tuple[float, float], b: tuple[float, float], *, recess: float = 0.0) -> None:
        """A wall from a to b, free space on its left, with objects; doors stand back by `recess` [m]."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        self._put(a, b, self._objects(length, recess))

    def plain(self, a: tuple[float, float], b: tuple[float, float], reflectance: float | None = None) -> None:
        """A wall of paint alone, or of one reflectance throughout."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        self._put(a, b, self._paint(0.0, length) if reflectance is None else [(0.0, length, reflectance, 0.0)])

    def marked(self, a: tuple[float, float], b: tuple[float, float], marks: list[Stretch]) -> None:
        """A painted wall that carries `marks` (ascending, apart from each other)."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        out, at = [], 0.0
        for mark in marks:
            out += [*self._paint(at, mark[0]), mark]
            at = mark[1]
        self._put(a, b, out + self._paint(at, length))

    def box(self, x: float, y: float, wide: float, deep: float, reflectance: float) -> None:
        """A closed box with its lower left corner at x, y."""
        corners = [(x, y), (x + wide, y), (x + wide, y + deep), (x, y + deep), (x, y)]
        for a, b in pairwise(corners):
            self.segment(np.array(a), np.array(b), reflectance)

    def world(self) -> LaserWorld:
        return LaserWorld(np.array(self._segments), np.array(self._reflectance), name=self.name)

    def _objects(self, length: float, recess: float) -> list[Stretch]:
        style, rng = self.style, self.rng
        out: list[Stretch] = []
        at = 0.0
        while True:
            start = at + rng.uniform(*style.gap)
            if rng.random() < style.door_share:
                end, light, depth = start + style.door_width, rng.uniform(*style.door), recess
            else:
                end = start + rng.uniform(*style.poster_width)
                light = rng.uniform(*(style.poster_dark if rng.random() < 0.5 else style.poster_bright))
                depth = 0.0
            if end > length - 0.2:
                return out + self._paint(at, length)
            out += [*self._paint(at, start), (start, end, float(light), depth)]
            at = end

    def _paint(self, start: float, end: float) -> list[Stretch]:
        style = self.style
        if end - start < 1e-9:
            return []
        cuts = np.linspace(start, end, max(1, round((end - start) / style.mottle_length)) + 1)
        light = style.paint * (1.0 + style.mottle * self.rng.standard_normal(len(cuts) - 1))
        return [(float(p), float(q), float(v), 0.0) for p, q, v in zip(cuts, cuts[1:], light, strict=False)]

    def _put(self, a: tuple[float, float], b: tuple[float, float], stretches: list[Stretch]) -> None:
        start = np.array(a, dtype=float)
        along = np.array(b, dtype=float) - start
        along /= np.hypot(*along)
        behind = np.array([along[1], -along[0]])
        for p, q, light, depth in stretches:
            u, v = start + p * along, start + q * along
            if depth > 0:
                self.segment(u, u + depth * behind, self.style.paint)
                self.segment(v + depth * behind, v, self.style.paint)
            self.segment(u + depth * behind, v + depth * behind, light)
