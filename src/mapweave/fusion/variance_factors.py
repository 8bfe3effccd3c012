"""How much larger each map's covariance should be for the join's residuals to be what they are."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from ..landmarks.landmark_map import LandmarkMap
from ..solve import Problem, Solution
from .map_term import MapTerm

FACTORS = (0.05, 400.0)  # between which a variance factor is believed
EXACT = 1000  # variables up to which the expectation is computed and not sampled
DRAWS = 32


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
    return np.asarray(np.clip(out, *FACTORS))


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
    moved = np.zeros_like(pull)
    if solution.information is not None:
        moved[solution.free] = solution.information.solve(pull[solution.free])
    for term, part, (J, w) in zip(terms, own, drawn, strict=True):
        Ar = term.information @ (w - J @ moved[term.where])
        yield float(np.einsum("id,ij,jd->", Ar, part, Ar, optimize=True)) / DRAWS
