"""Fusing while the robots drive: a fresher version of a robot's map takes the place of its older one.

Which landmarks are doubted, which maps are refused and how far each covariance is trusted is judged by `fuse` over all
maps: whenever a robot has mapped another landmark, and whenever the maps rest on a quarter more sightings. In between
a fresher map changes the sum of information alone, `Lambda += new - old`: nothing counts twice, and an update costs
what the maps hold and not how many came before.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.gaussian import is_positive_definite
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .config import FuseConfig
from .information_sum import InformationSum
from .join import fuse
from .result import Component, Fusion

NOTHING = Fusion((), ())
MOST = 2000  # variables up to which a sum is kept dense


@dataclass(frozen=True, slots=True)
class OnlineFuser:
    """The latest map of every robot heard of and what they fuse to.

    sums: a component each, where maps can be exchanged in sums; sightings: those behind the maps when all was judged;
    judged: how often it was.
    """

    cfg: FuseConfig = field(default_factory=FuseConfig)
    recordings: Mapping[str, str] | None = None  # as `fuse` takes them
    latest: Mapping[str, LocalMap] = field(default_factory=dict)
    fusion: Fusion = NOTHING
    sums: tuple[InformationSum, ...] = ()
    sightings: int = 0
    judged: int = 0

    def update(self, *fresher: LocalMap) -> "OnlineFuser":
        """The fuser after these maps, each in place of its robot's older one."""
        latest = {**self.latest, **{m.robot: m for m in fresher}}
        if not self._holds(fresher, latest):
            return replace(self, latest=latest).converged()
        newer = {m.robot: self._named(m) for m in fresher}
        sums = []
        for part in self.sums:
            mine = {robot: newer[robot] for robot in part.component.robots if robot in newer}
            sums.append(part.replace(mine) if mine else part)
        components = tuple(
            old if now is was else now.joined()
            for old, was, now in zip(self.fusion.components, self.sums, sums, strict=True)
        )
        scales = {r: s for c in components for r, s in c.scales.items()}
        decisions = tuple(replace(d, scale=scales.get(d.robot, d.scale)) for d in self.fusion.decisions)
        fusion = replace(self.fusion, components=components, decisions=decisions)
        return replace(self, latest=latest, fusion=fusion, sums=tuple(sums))

    def converged(self) -> "OnlineFuser":
        """All latest maps judged and joined anew, as `fuse` does at the end."""
        fusion = fuse(list(self.latest.values()), self.cfg, self.recordings)
        judged = replace(self, fusion=fusion, sightings=_sightings(self.latest), judged=self.judged + 1, sums=())
        return replace(judged, sums=judged.summed())

    def summed(self) -> tuple[InformationSum, ...]:
        """Sums of the components as they were judged; none where the weights asked for are not those of a sum."""
        cfg = self.cfg
        plain = (cfg.weights, cfg.identities, cfg.repeats, cfg.robot_sightings) == ("full-scaled", "known", 1, False)
        if not plain or any(4 * len(c.robots) + 2 * len(c.map) > MOST for c in self.fusion.components):
            return ()
        factors = {d.robot: d.variance_factor or 1.0 for d in self.fusion.decisions}
        return tuple(
            InformationSum.of(
                c,
                {r: self._named(self.latest[r]) for r in c.robots},
                {r: factors[r] for r in c.robots},
                cfg.scale_sigma,
                cfg.floor if len(c.robots) > 1 else 0.0,
            )
            for c in self.fusion.components
        )

    def _holds(self, fresher: tuple[LocalMap, ...], latest: Mapping[str, LocalMap]) -> bool:
        """Whether what was judged last still says what becomes of these maps."""
        known = {r for part in self.sums for r in part.component.robots}
        return (
            bool(self.sums)
            and _sightings(latest) < self.cfg.judge_again * self.sightings
            and all(
                m.robot in known
                and m.submap.ids == self.latest[m.robot].submap.ids
                and m.log_hash == self.latest[m.robot].log_hash
                and bool(np.isfinite(m.submap.mean).all() and np.isfinite(m.submap.cov).all())
                and is_positive_definite(m.submap.landmarks.cov)
                for m in fresher
            )
        )

    def _named(self, m: LocalMap) -> LandmarkMap:
        """Its landmarks by their names in the team's map."""
        labels, own = self.fusion.labels.get(m.robot, {}), m.submap.landmarks
        return LandmarkMap(tuple(labels.get(name, name) for name in own.ids), own.mean, own.cov, own.frame)

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


def _sightings(maps: Mapping[str, LocalMap]) -> int:
    return sum(sum(m.sightings.values()) for m in maps.values())
