"""A team's map as a sum of information, in which a robot's newer map takes the place of its older one.

What each map says of its frame, its scale and its landmarks is a part of the sum, `Lambda = sum H_k`, taken at the
estimate of its time. A newer version costs `Lambda += new - old`; a part is taken anew in the same way when the
estimate has moved away from where it was taken, so that the sum ends where all maps joined at once end.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.gaussian import solve_psd, symmetrise
from ..landmarks.landmark_map import LandmarkMap
from .full_covariance import JoinLayout, MapTerm
from .result import Component

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
