"""Fusing while the robots drive: a fresher version of a robot's map takes the place of its older one.

The information of a team's map is the sum of what its local maps say; exchanging one is `Lambda += new - old`. Every
map's latest version is kept whole and the sum is taken anew at the latest estimate, so nothing counts twice, nothing
stays linearised at an old guess, an update costs what the maps hold and not how many came before, and after the last
one the map is the one that fusing at the end gives.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..landmarks.landmark_map import LocalMap
from .config import FuseConfig
from .join import fuse
from .result import Component, Fusion

NOTHING = Fusion((), ())


@dataclass(frozen=True, slots=True)
class OnlineFuser:
    """The latest map of every robot heard of and what they fuse to."""

    cfg: FuseConfig = field(default_factory=FuseConfig)
    recordings: Mapping[str, str] | None = None  # as `fuse` takes them
    latest: Mapping[str, LocalMap] = field(default_factory=dict)
    fusion: Fusion = NOTHING

    def update(self, *fresher: LocalMap) -> "OnlineFuser":
        """The fuser after these maps, each in place of its robot's older one."""
        latest = {**self.latest, **{m.robot: m for m in fresher}}
        fusion = fuse(list(latest.values()), self.cfg, self.recordings)
        return OnlineFuser(self.cfg, self.recordings, latest, fusion)

    @property
    def largest(self) -> Component | None:
        """The component that most robots are tied into, if anything is mapped yet."""
        return self.fusion.components[0] if self.fusion.components else None

    @property
    def tied_in(self) -> int:
        """How many robots are part of the largest component."""
        return len(self.largest.robots) if self.largest else 0

    @property
    def trace(self) -> float | None:
        """The sum of all landmark variances of the largest component [m^2]; None while nothing is mapped."""
        return float(np.trace(self.largest.map.cov)) if self.largest and len(self.largest.map) else None

    @property
    def log_det(self) -> float | None:
        """The logarithm of the determinant of its landmark covariance; None while nothing is mapped."""
        return float(np.linalg.slogdet(self.largest.map.cov)[1]) if self.largest and len(self.largest.map) else None
