"""Joining Cartesian local maps with their full covariance: sparse Gauss-Newton over frames, scales and landmarks.

Each map k says where its landmarks lie in its own frame, `z_k = s_k R_k^T (p - t_k) + noise`, noise ~ N(0, V_k). The
scale s_k is a parameter with a prior at 1, never part of the covariance (there it shrinks maps). V_k is the map's
covariance times a variance factor found from the join's own residuals, plus a floor.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core.gaussian import solve_psd, symmetrise
from ..landmarks.landmark_map import LandmarkMap
from ..solve import Factor, Pattern, Problem, Solution, SolveConfig, Term, minimise, wrapping
from .cluster import Cluster, JoinedMap

VARIANCE_LEAST = 0.05  # the smallest factor that is believed
VARIANCE_GREATEST = 400.0  # the largest one
VARIANCE_ROUNDS = 20  # of estimating all factors, at most
VARIANCE_STILL = 0.01  # relative change of the factors at which they are found


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

    def jacobian(self, x: np.ndarray) -> Float[np.ndarray, "m d"]:
        """Derivatives of the residual by everything it touches, in the order of `where`."""
        c, s, k = np.cos(x[self.where[2]]), np.sin(x[self.where[2]]), x[self.where[3]]
        turn = np.kron(np.eye(self.size // 2), k * np.array([[c, s], [-s, c]]))
        return np.concatenate([self.design(x), turn], axis=1)

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


EXACT = 1000  # variables up to which the expectation is computed and not sampled
DRAWS = 32  # solutions it is sampled from


def variance_factors(
    maps: Sequence[LandmarkMap],
    problem: Problem,
    solution: Solution,
    factors: Float[np.ndarray, " k"],
    prior: float,
) -> Float[np.ndarray, " k"]:
    """The next estimate of each map's factor; the problem's first terms are the maps with the present `factors`.

    One step of Helmert's variance components: the map's part of chi-square over what that part is expected to be,
    held at 1 with `prior` degrees of freedom.
    """
    terms = [t for t in problem.terms if isinstance(t, MapTerm)]
    own = [v * m.cov for v, m in zip(factors, maps, strict=True)]  # the part of the noise that the factor scales
    expected = _exactly(terms, own, solution) if len(solution.x) <= EXACT else _sampled(terms, own, solution)
    out = factors.copy()
    for k, (term, part, e) in enumerate(zip(terms, own, expected, strict=True)):
        Ar = term.information @ term.residual(solution.x)
        out[k] = (factors[k] * float(Ar @ part @ Ar) + prior) / (max(e, 0.0) + prior)
    return np.asarray(np.clip(out, VARIANCE_LEAST, VARIANCE_GREATEST))


def _exactly(terms: Sequence[MapTerm], own: Sequence[np.ndarray], solution: Solution) -> Iterator[float]:
    """`tr(A V_own) - tr(A J P J^T A V_own)` for each map, P the covariance of the solution."""
    P = solution.covariance()
    for term, part in zip(terms, own, strict=True):
        A, J = term.information, term.jacobian(solution.x)
        AJ = A @ J
        yield float(np.sum(A * part) - np.sum((AJ @ P[np.ix_(term.where, term.where)] @ AJ.T) * part))


def _sampled(terms: Sequence[MapTerm], own: Sequence[np.ndarray], solution: Solution) -> Iterator[float]:
    """The same from residuals of noise drawn as it is said to be: a few solutions instead of the whole covariance."""
    rng = np.random.default_rng(0)
    pull = np.zeros((len(solution.x), DRAWS))
    drawn = []
    for term in terms:
        J, L = term.jacobian(solution.x), np.linalg.cholesky(term.information)
        white = rng.normal(size=(term.size, DRAWS))
        pull[term.where] += J.T @ (L @ white)  # J^T A w, where w = L^-T white has covariance A^-1
        drawn.append((J, np.linalg.solve(L.T, white)))
    deviation = np.zeros_like(pull)
    if solution.information is not None:
        deviation[solution.free] = solution.information.solve(pull[solution.free])
    for term, part, (J, w) in zip(terms, own, drawn, strict=True):
        Ar = term.information @ (w - J @ deviation[term.where])
        yield float(np.einsum("id,ij,jd->", Ar, part, Ar, optimize=True)) / DRAWS


SOLVE = SolveConfig(max_iterations=100, damping=1e-6, step_tolerance=1e-8, cost_tolerance=1e-11)
NEARER = SolveConfig(max_iterations=2, damping=0.0)  # between two estimates of the variance factors
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
    for i in range(VARIANCE_ROUNDS if variance_prior is not None else 0):
        new = variance_factors(maps, problem, solution, factors, variance_prior or 0.0)
        last = np.abs(np.log(new / factors)).max() < VARIANCE_STILL or i == VARIANCE_ROUNDS - 1
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
