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
from ..maps.landmarks import LandmarkMap
from ..solve import Factor, Pattern, Problem, Solution, SolveConfig, Term, minimise, wrapping
from .joined import Joined
from .overlap import Cluster

SOLVE = SolveConfig(max_iterations=100, damping=1e-6, step_tolerance=1e-8, cost_tolerance=1e-11)
NEARER = SolveConfig(max_iterations=2, damping=0.0)  # between two estimates of the variance factors
ROUNDS = 20
LARGE = 20_000  # variables from which nested dissection pays
FACTORS = (0.05, 400.0)  # between which a variance factor is believed


@dataclass(frozen=True, slots=True)
class MapTerm:
    """One local map as a measurement of its frame (x, y, theta), its scale and its n landmarks, in that order.

    z: (2n,) [m]; information: (2n, 2n), the inverse of V_k. Its normal equations cost n^2, not n^3: the information
    is turned, not multiplied.
    """

    where: Int[np.ndarray, " d"]
    z: Float[np.ndarray, " m"]
    information: Float[np.ndarray, "m m"]

    @property
    def columns(self) -> Int[np.ndarray, "1 d"]:
        return self.where[None]

    @property
    def size(self) -> int:
        return len(self.z)

    def residual(self, x: np.ndarray) -> Float[np.ndarray, " m"]:
        frame, scale, points = x[self.where[:3]], x[self.where[3]], x[self.where[4:]].reshape(-1, 2)
        c, s = np.cos(frame[2]), np.sin(frame[2])
        d = points - frame[:2]
        r = -self.z
        r[0::2] += scale * (c * d[:, 0] + s * d[:, 1])
        r[1::2] += scale * (c * d[:, 1] - s * d[:, 0])
        return r

    def squares(self, x: np.ndarray) -> Float[np.ndarray, "1"]:
        r = self.residual(x)
        return np.array([r @ self.information @ r])

    def costs(self, x: np.ndarray) -> Float[np.ndarray, "1"]:
        return self.squares(x)

    def design(self, x: np.ndarray) -> Float[np.ndarray, "m 4"]:
        """Derivatives of the residual by frame and scale."""
        frame, scale, points = x[self.where[:3]], x[self.where[3]], x[self.where[4:]].reshape(-1, 2)
        c, s = np.cos(frame[2]), np.sin(frame[2])
        d = points - frame[:2]
        u, v = c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]
        D = np.empty((len(d), 2, 4))
        D[:, 0, 0], D[:, 0, 1], D[:, 1, 0], D[:, 1, 1] = -scale * c, -scale * s, scale * s, -scale * c
        D[:, 0, 2], D[:, 1, 2] = scale * v, -scale * u
        D[:, 0, 3], D[:, 1, 3] = u, v
        return D.reshape(-1, 4)

    def normal(self, x: np.ndarray) -> tuple[Float[np.ndarray, "1 d d"], Float[np.ndarray, "1 d"]]:
        A, D, r = self.information, self.design(x), self.residual(x)
        c, s, k = np.cos(x[self.where[2]]), np.sin(x[self.where[2]]), x[self.where[3]]
        AD, Ar = A @ D, A @ r
        H = np.empty((len(self.where), len(self.where)))
        H[:4, :4] = D.T @ AD
        H[4:, :4] = k * _turn_rows(AD, c, s)
        H[:4, 4:] = H[4:, :4].T
        H[4:, 4:] = k * k * _turn_rows(_turn_rows(A, c, s).T, c, s).T
        g = np.concatenate([D.T @ Ar, k * _turn_rows(Ar[:, None], c, s)[:, 0]])
        return H[None], g[None]


def _turn_rows(A: Float[np.ndarray, "m k"], c: float, s: float) -> Float[np.ndarray, "m k"]:
    """Every pair of rows turned by the rotation [[c, -s], [s, c]]."""
    out = np.empty_like(A)
    out[0::2] = c * A[0::2] - s * A[1::2]
    out[1::2] = s * A[0::2] + c * A[1::2]
    return out


@dataclass(frozen=True, slots=True)
class Layout:
    """Where everything stands in x: k frames, then k scales, then n landmarks."""

    maps: int
    ids: tuple[str, ...]
    index: dict[str, int] = field(repr=False)

    @classmethod
    def of(cls, maps: int, ids: tuple[str, ...]) -> "Layout":
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
) -> tuple[Problem, Layout]:
    """The least-squares problem of joining `maps` (those of `start.members`, in order) with covariances `noise`.

    scale_sigma: the deviation of the scales from 1 a priori; None holds them at 1. The first map's frame is fixed.
    """
    layout = Layout.of(len(maps), start.ids)
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


def grouped(pattern: Pattern, problem: Problem, layout: Layout) -> Pattern:
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
) -> Joined:
    """`maps` (those of `start.members`, in order) as one map with its full covariance.

    floor [m]: an independent error of every landmark of every map. variance_prior: None takes each covariance as it
    is; else each map's variance factor is estimated, held at 1 with that many degrees of freedom.
    """
    factors = np.ones(len(maps))
    problem, layout = build(maps, start, _noise(maps, factors, floor), scale_sigma, extra)
    pattern = grouped(Pattern.of(problem), problem, layout)
    solution = minimise(problem, SOLVE, pattern)
    for i in range(ROUNDS if variance_prior is not None else 0):
        new = _variance_factors(maps, problem, solution, factors, variance_prior or 0.0)
        last = np.abs(np.log(new / factors)).max() < 1e-3 or i == ROUNDS - 1
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


def _variance_factors(
    maps: Sequence[LandmarkMap],
    problem: Problem,
    solution: Solution,
    factors: Float[np.ndarray, " k"],
    prior: float,
) -> Float[np.ndarray, " k"]:
    """How much larger each map's covariance should be for its residuals to be what they are.

    Helmert's variance components: the map's part of chi-square over its part of the redundancy, one step of it.
    """
    out = factors.copy()
    for k, m in enumerate(maps):
        term = problem.terms[k]
        if not isinstance(term, MapTerm):  # pragma: no cover - terms begin with the maps
            continue
        r, A = term.residual(solution.x), term.information
        J = np.concatenate([term.design(solution.x), _blocks(term, solution.x)], axis=1)
        S = J @ solution.covariance(term.where) @ J.T
        Ar = A @ r
        own = factors[k] * m.cov  # the part of V_k that the factor scales
        found = float(Ar @ own @ Ar)
        expected = float(np.sum(A * own) - np.sum((A @ S @ A) * own))
        out[k] = (factors[k] * found + prior) / (max(expected, 0.0) + prior)
    return np.asarray(np.clip(out, *FACTORS))


def _blocks(term: MapTerm, x: np.ndarray) -> Float[np.ndarray, "m m"]:
    c, s, k = np.cos(x[term.where[2]]), np.sin(x[term.where[2]]), x[term.where[3]]
    return np.kron(np.eye(term.size // 2), k * np.array([[c, s], [-s, c]]))


def _from(start: Cluster, x: np.ndarray, layout: Layout) -> Cluster:
    frames, points = x[: 3 * layout.maps].reshape(-1, 3), x[layout.landmarks :].reshape(-1, 2)
    return Cluster(start.members, frames, start.ids, points, start.shared)


def _read(solution: Solution, layout: Layout, factors: Float[np.ndarray, " k"]) -> Joined:
    k = layout.maps
    return Joined(
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
