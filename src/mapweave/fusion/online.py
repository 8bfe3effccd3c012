"""Fusing while the robots drive: a fresher version of a robot's map takes the place of its older one.

Which landmarks are doubted, which maps are refused and how far each covariance is trusted is judged by `fuse` over all
maps: whenever a robot has mapped another landmark, and whenever the maps rest on a quarter more sightings. In between
a fresher map changes the sum of information alone, `Lambda += new - old`: nothing counts twice, and an update costs
what the maps hold and not how many came before.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import is_positive_definite, solve_psd, symmetrise
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .config import JUDGE_AGAIN, FuseConfig
from .full_covariance import JoinLayout, MapTerm
from .join import fuse
from .result import Component, Fusion

NEAR = 1e-6  # [m], [rad], and of scales: so far the estimate may move from where a part was taken
ROUNDS = 30  # of taking parts anew, at most


@dataclass(frozen=True, slots=True)
class InformationTerm:
    """One map in the sum: its information H (d, d) over `where`, H times the place it was taken at less its gradient.

    at: (d,) where it was taken.
    """

    term: MapTerm
    at: Float[np.ndarray, " d"]
    H: Float[np.ndarray, "d d"]
    eta: Float[np.ndarray, " d"]

    @classmethod
    def of(cls, term: MapTerm, x: Float[np.ndarray, " n"]) -> "InformationTerm":
        H, g = term.normal(x)
        at = x[term.where]
        return cls(term, at, H[0], H[0] @ at - g[0])


@dataclass(frozen=True, slots=True)
class InformationSum:
    """All maps of one component as one Gaussian over k frames, k scales and n landmarks (`JoinLayout`).

    factors: what each robot's covariance is multiplied by; widened[robot][landmark]: variance added to one that is
    doubted [m^2]; floor [m]: independent error of every landmark of every map; Lambda, eta: the sum of all parts and
    of what is known of the scales beforehand.
    """

    component: Component
    layout: JoinLayout
    factors: Mapping[str, float]
    floor: float
    x: Float[np.ndarray, " n"]
    Lambda: Float[np.ndarray, "n n"]
    eta: Float[np.ndarray, " n"]
    parts: Mapping[str, InformationTerm]

    @classmethod
    def of(
        cls,
        component: Component,
        maps: Mapping[str, LandmarkMap],
        factors: Mapping[str, float],
        scale_sigma: float,
        floor: float,
    ) -> "InformationSum":
        """The sum of `maps` (a robot of the component each, named as in its map), started where the component lies."""
        robots, k = component.robots, len(component.robots)
        layout = JoinLayout.of(k, component.map.ids)
        frames = np.concatenate([component.frames[r] for r in robots])
        scales = np.array([component.scales.get(r, 1.0) for r in robots])
        x = np.concatenate([frames, scales, component.map.mean.ravel()])
        Lambda, eta = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
        known = 3 * k + np.arange(k)
        Lambda[known, known] = eta[known] = scale_sigma**-2
        out = cls(component, layout, factors, floor, x, Lambda, eta, {})
        for robot in robots:
            out = out.with_part(robot, InformationTerm.of(out._term(robot, maps[robot]), x))
        return out.converged()

    def replace(self, newer: Mapping[str, LandmarkMap]) -> "InformationSum":
        """The sum with these maps in place of their robots' older ones: `Lambda += new - old`, and solved."""
        now = self
        for robot, m in newer.items():
            now = now.with_part(robot, InformationTerm.of(self._term(robot, m), self.x))
        return now.converged()

    def converged(self) -> "InformationSum":
        """Solved, every part taken anew until the estimate stays within `NEAR` of where they were taken."""
        now = self
        for _ in range(ROUNDS):
            now = replace(now, x=now._solved())
            far = [r for r, part in now.parts.items() if np.abs(now.x[part.term.where] - part.at).max() > NEAR]
            if not far:
                break
            for robot in far:
                now = now.with_part(robot, InformationTerm.of(now.parts[robot].term, now.x))
        return now

    def joined(self) -> Component:
        """The component as the sum has it now."""
        k, robots = self.layout.maps, self.component.robots
        cov = np.zeros_like(self.Lambda)
        cov[3:, 3:] = symmetrise(solve_psd(self.Lambda[3:, 3:], np.eye(len(cov) - 3)))
        frames = self.x[: 3 * k].reshape(k, 3).copy()
        frames[:, 2] = se2.wrap_angle(frames[:, 2])
        first = self.layout.landmarks
        return replace(
            self.component,
            map=LandmarkMap(self.layout.ids, self.x[first:].reshape(-1, 2), cov[first:, first:]),
            frames=dict(zip(robots, frames, strict=True)),
            frame_cov={r: cov[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i, r in enumerate(robots)},
            scales={r: float(self.x[3 * k + i]) for i, r in enumerate(robots)},
        )

    def with_part(self, robot: str, part: InformationTerm) -> "InformationSum":
        """The sum with `part` in place of the robot's older one, not solved: `Lambda += new - old`."""
        Lambda, eta = self.Lambda.copy(), self.eta.copy()
        at = np.ix_(part.term.where, part.term.where)
        old = self.parts.get(robot)
        if old is None:
            Lambda[at] += part.H
            eta[part.term.where] += part.eta
        else:
            Lambda[at] += part.H - old.H
            eta[part.term.where] += part.eta - old.eta
        return replace(self, Lambda=Lambda, eta=eta, parts={**self.parts, robot: part})

    def _solved(self) -> Float[np.ndarray, " n"]:
        """The minimum of the sum; the first robot's frame is the gauge."""
        x = self.x.copy()
        x[3:] = solve_psd(self.Lambda[3:, 3:], self.eta[3:] - self.Lambda[3:, :3] @ x[:3])
        return x

    def _term(self, robot: str, m: LandmarkMap) -> MapTerm:
        extra = self.component.widened.get(robot, {})
        V = self.factors[robot] * (m.cov + np.diag(np.repeat([extra.get(name, 0.0) for name in m.ids], 2)))
        V = V + self.floor**2 * np.eye(len(V))
        k = self.component.robots.index(robot)
        return MapTerm(self.layout.columns(k, m.ids), m.mean.ravel(), symmetrise(solve_psd(V, np.eye(len(V)))))


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
            and _sightings(latest) < JUDGE_AGAIN * self.sightings
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
