"""Joining Cartesian local maps with their full covariance: sparse Gauss-Newton over frames, scales and landmarks.

Each map k says where its landmarks lie in its own frame, `z_k = s_k R_k^T (p - t_k) + noise`, noise ~ N(0, V_k). The
scale s_k is a parameter with a prior at 1, never part of the covariance (there it shrinks maps). V_k is the map's
covariance times a variance factor found from the join's own residuals, plus a floor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core.gaussian import solve_psd, symmetrise
from ..landmarks.landmark_map import LandmarkMap
from ..solve import Factor, Pattern, Problem, Solution, SolveConfig, Term, minimise, wrapping
from .cluster import Cluster, JoinedMap
from .map_term import MapTerm
from .variance_factors import variance_factors

SOLVE = SolveConfig(max_iterations=100, damping=1e-6, step_tolerance=1e-8, cost_tolerance=1e-11)
NEARER = SolveConfig(max_iterations=2, damping=0.0)  # between two estimates of the variance factors
ROUNDS = 20
STILL = 0.01  # relative change of the variance factors that is waited for
LARGE = 3000  # variables from which nested dissection pays


@dataclass(frozen=True, slots=True)
class JoinLayout:
    """Where everything stands in x: k frames, then k scales, then n landmarks."""

    maps: int
    ids: tuple[str, ...]
    index: dict[str, int] = field(repr=False)

    @classmethod
    def of(cls, maps: int, ids: tuple[str, ...]) -> "JoinLayout":
        return cls(maps, ids, {name: i for i, name in enumerate(ids)})

    @property
    def landmarks(self) -> int:
        """Where the first landmark stands."""
        return 4 * self.maps

    @property
    def size(self) -> int:
        return self.landmarks + 2 * len(self.ids)

    def columns(self, k: int, names: Sequence[str]) -> Int[np.ndarray, " d"]:
        rows = np.array([self.index[name] for name in names], dtype=np.intp)
        points = self.landmarks + (2 * rows[:, None] + np.arange(2)).ravel()
        return np.concatenate([3 * k + np.arange(3), [3 * self.maps + k], points])


def build(
    maps: Sequence[LandmarkMap],
    start: Cluster,
    noise: Sequence[np.ndarray],
    scale_sigma: float | None,
    extra: Sequence[Term] = (),
) -> tuple[Problem, JoinLayout]:
    """The least-squares problem of joining `maps` (those of `start.members`, in order) with covariances `noise`.

    scale_sigma: the deviation of the scales from 1 a priori; None holds them at 1. The first map's frame is fixed.
    """
    layout = JoinLayout.of(len(maps), start.ids)
    x0 = np.concatenate([start.frames.ravel(), np.ones(len(maps)), start.points.ravel()])
    fixed = np.zeros(layout.size, dtype=bool)
    fixed[:3] = True
    scales = 3 * len(maps) + np.arange(len(maps))
    terms: list[Term] = []
    for k, (m, V) in enumerate(zip(maps, noise, strict=True)):
        information = symmetrise(solve_psd(V, np.eye(len(V))))
        terms.append(MapTerm(layout.columns(k, m.ids), m.mean.ravel(), information))
    if scale_sigma is None:
        fixed[scales] = True
    else:
        prior = Factor(
            columns=scales[:, None],
            residual=lambda x: x[scales, None] - 1.0,
            jacobian=lambda _: np.ones((len(scales), 1, 1)),
            rows=1,
            sqrt_info=np.full((1, 1), 1.0 / scale_sigma),
        )
        terms.append(prior)
    terms.extend(extra)
    return Problem(x0=x0, terms=terms, fixed=fixed, retract=wrapping(3 * np.arange(len(maps)) + 2)), layout


def grouped(pattern: Pattern, problem: Problem, layout: JoinLayout) -> Pattern:
    """The pattern, to be factorised by nested dissection where the problem is large; landmarks stay whole."""
    if pattern.size < LARGE:
        return pattern
    k = layout.maps
    group = np.concatenate([np.repeat(np.arange(k), 3), np.arange(k), k + np.repeat(np.arange(len(layout.ids)), 2)])
    return pattern.dissected(group[problem.free])


def join(
    maps: Sequence[LandmarkMap],
    start: Cluster,
    *,
    scale_sigma: float | None = None,
    floor: float = 0.0,
    variance_prior: float | None = None,
    extra: Sequence[Term] = (),
) -> JoinedMap:
    """`maps` (those of `start.members`, in order) as one map with its full covariance.

    floor [m]: an independent error of every landmark of every map. variance_prior: None takes each covariance as it
    is; else each map's variance factor is estimated, held at 1 with that many degrees of freedom.
    """
    factors = np.ones(len(maps))
    problem, layout = build(maps, start, _noise(maps, factors, floor), scale_sigma, extra)
    pattern = grouped(Pattern.of(problem), problem, layout)
    solution = minimise(problem, SOLVE, pattern)
    for i in range(ROUNDS if variance_prior is not None else 0):
        new = variance_factors(maps, problem, solution, factors, variance_prior or 0.0)
        last = np.abs(np.log(new / factors)).max() < STILL or i == ROUNDS - 1
        factors = new
        problem, layout = build(
            maps, _from(start, solution.x, layout), _noise(maps, factors, floor), scale_sigma, extra
        )
        solution = minimise(problem, SOLVE if last else NEARER, pattern)
        if last:
            break
    return _read(solution, layout, factors)


def _noise(maps: Sequence[LandmarkMap], factors: Float[np.ndarray, " k"], floor: float) -> list[np.ndarray]:
    return [v * m.cov + floor**2 * np.eye(2 * len(m)) for m, v in zip(maps, factors, strict=True)]


def _from(start: Cluster, x: np.ndarray, layout: JoinLayout) -> Cluster:
    frames, points = x[: 3 * layout.maps].reshape(-1, 3), x[layout.landmarks :].reshape(-1, 2)
    return Cluster(start.members, frames, start.ids, points, start.shared)


def _read(solution: Solution, layout: JoinLayout, factors: Float[np.ndarray, " k"]) -> JoinedMap:
    k = layout.maps
    return JoinedMap(
        ids=layout.ids,
        mean=solution.x[layout.landmarks :].reshape(-1, 2),
        cov=solution.covariance(np.arange(layout.landmarks, layout.size)),
        frames=solution.x[: 3 * k].reshape(k, 3),
        frame_cov=solution.blocks(np.arange(3 * k).reshape(k, 3)),
        scales=solution.x[3 * k : 4 * k],
        variance_factors=factors,
        chi2=solution.chi2,
        dof=solution.dof,
    )
