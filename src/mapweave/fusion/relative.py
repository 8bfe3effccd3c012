"""Fusing local maps through relative information: every map a measurement, all solved together, sparse.

The paper's recursive form is in `papers/kojima/rls.py`; here the same measurements are summed in information form,
`Lambda += H^T R^-1 H`, and iterated to convergence from a Procrustes start. Source: [Kojima12], made exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ..core.config import config
from ..core.errors import EstimateError
from ..core.findings import Finding
from ..core.se2 import wrap_angle
from ..landmarks.landmark_map import LandmarkMap
from ..solve import Factor, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from . import relative_information
from .cluster import Cluster, clusters
from .relative_information import Measurement, RelativeLayout, Weights, measurement
from .robot_sightings import FrameSightings, sighting_factor

RELATIVE_PRIOR_FRAME_VARIANCE = 1e5  # [m^2 and rad^2]

ROUGH = SolveConfig(max_iterations=400)
POLISH = SolveConfig(damping=0.0, max_iterations=8, step_tolerance=1e-12)


@config
class RelativeConfig:
    """weights: how the noise of relative information is told from the local covariance.

    repeats: how often each map is counted; 1 is honest, K overconfident by K. reference: "measurement" counts the
    first map like any other; "prior" takes it only as the start, with the two prior variances (the paper's reading).
    """

    weights: Weights = "full"
    delta: float = 1.0
    variance: float = 1e-3  # [rad^2 and m^2] of every row under weights="constant"
    repeats: int = 1
    reference: Literal["measurement", "prior"] = "measurement"
    prior_landmark_variance: float = 1e-3  # [m^2]


@dataclass(frozen=True, slots=True)
class RelativeFusion:
    """One map from all maps given, in the frame of the first.

    x: laid out as `layout` says; ids: landmarks in its order; pairs: the baseline of each map; solution: how the
    solver ended, and the information behind the covariances.
    """

    layout: RelativeLayout
    ids: tuple[str, ...]
    x: Float[np.ndarray, " size"]
    pairs: tuple[tuple[str, str], ...]
    solution: Solution
    findings: tuple[Finding, ...] = ()

    @property
    def frames(self) -> Float[np.ndarray, "m 3"]:
        """`T_ref_local` of every map, the identity first."""
        poses = self.x[: self.layout.first_landmark].reshape(-1, 3)
        return np.concatenate([np.zeros((1, 3)), poses])

    @property
    def points(self) -> Float[np.ndarray, "n 2"]:
        return self.layout.points(self.x)

    def landmarks(self, frame: str = "map") -> LandmarkMap:
        """All landmarks with their joint covariance."""
        index = np.arange(self.layout.first_landmark, self.layout.size)
        return LandmarkMap(self.ids, self.points, self.solution.covariance(index), frame)

    def frame_cov(self) -> Float[np.ndarray, "m 3 3"]:
        """The covariance of every frame over x, y, theta; zero for the first, which is the gauge."""
        blocks = self.solution.blocks(np.arange(self.layout.first_landmark).reshape(-1, 3))
        return np.concatenate([np.zeros((1, 3, 3)), blocks])

    def covariance(self) -> Float[np.ndarray, "size size"]:
        """The joint covariance of the whole state."""
        return self.solution.covariance()


def fuse_relative(
    maps: Sequence[LandmarkMap],
    cfg: RelativeConfig | None = None,
    *,
    start: Cluster | None = None,
    pairs: Sequence[tuple[str, str]] | None = None,
    sightings: Sequence[FrameSightings] = (),
    solve: SolveConfig | None = None,
) -> RelativeFusion:
    """All `maps` as one, in the first one's frame; raises EstimateError when they are not connected.

    start: where the solver begins (found from the overlaps when None); pairs: the baseline of each map (the most
    certain pair it shares with the others when None); sightings: robots seen by robots, further measurements.
    """
    cfg = cfg or RelativeConfig()
    start = start or _start(maps)
    layout = RelativeLayout(len(maps), len(start.ids))
    place = {name: i for i, name in enumerate(start.ids)}
    pairs = tuple(pairs) if pairs is not None else baselines(maps)
    measurements = [as_measurement(k, m, pair, place, cfg) for k, (m, pair) in enumerate(zip(maps, pairs, strict=True))]
    x0 = layout.pack(start.frames, start.points)
    used = measurements if cfg.reference == "measurement" else measurements[1:]
    terms = [map_factor(layout, m, cfg.repeats) for m in used]
    terms += [sighting_factor(s, _where(layout, s.a), _where(layout, s.b)) for s in sightings]
    if cfg.reference == "prior":
        terms.append(_prior_factor(layout, x0, cfg))
    solution = _converge(Problem(x0, terms, retract=wrapping(layout.angles)), solve)
    if solution.information is None or not solution.converged:
        raise EstimateError(f"the maps could not be fused: the solver ended {solution.status.value}")
    findings = () if cfg.repeats == 1 else (Finding("maps-repeated", value=cfg.repeats),)
    return RelativeFusion(layout, start.ids, solution.x, pairs, solution, findings)


def baselines(maps: Sequence[LandmarkMap]) -> tuple[tuple[str, str], ...]:
    """For each map the most certain pair among the landmarks another map has too (among all when there are < 2)."""
    times: dict[str, int] = {}
    for m in maps:
        for name in m.ids:
            times[name] = times.get(name, 0) + 1
    out = []
    for m in maps:
        shared = np.flatnonzero([times[name] > 1 for name in m.ids])
        i, j = relative_information.baseline_pair(m.mean, m.cov, shared if len(shared) > 1 else None)
        out.append((m.ids[i], m.ids[j]))
    return tuple(out)


def as_measurement(
    frame: int, m: LandmarkMap, pair: tuple[str, str], place: dict[str, int], cfg: RelativeConfig
) -> Measurement:
    """The relative information of `m` about `pair`; `place` gives each landmark's place in the layout."""
    ordered = m.select((*pair, *(name for name in m.ids if name not in pair)))
    index = np.array([place[name] for name in ordered.ids], dtype=np.intp)
    return measurement(frame, index, ordered.mean, ordered.cov, cfg.weights, delta=cfg.delta, variance=cfg.variance)


def map_factor(layout: RelativeLayout, m: Measurement, repeats: int = 1) -> Factor:
    """One map as a term of the least-squares problem, its noise whitened, counted `repeats` times."""
    try:
        L = np.linalg.cholesky(m.R)
    except np.linalg.LinAlgError:
        raise EstimateError(f"the covariance of map {m.frame + 1} is not positive definite") from None
    whiten = np.sqrt(repeats) * np.linalg.solve(L, np.eye(len(L)))

    def residual(x: np.ndarray) -> np.ndarray:
        return -m.linearise(layout, x)[0][None]

    def jacobian(x: np.ndarray) -> np.ndarray:
        return m.linearise(layout, x)[1][None]

    return Factor(m.columns(layout)[None], residual, jacobian, len(m.y), whiten[None], name="map")


def _where(layout: RelativeLayout, k: int) -> Int[np.ndarray, " c"]:
    return layout.columns(k, np.zeros(0, dtype=np.intp))


def _prior_factor(layout: RelativeLayout, x0: Float[np.ndarray, " size"], cfg: RelativeConfig) -> Factor:
    sigma = np.sqrt(prior_variances(layout, cfg))
    n = layout.size

    def residual(x: np.ndarray) -> np.ndarray:
        e = x - x0
        e[layout.angles] = wrap_angle(e[layout.angles])
        return np.asarray(e[:, None])

    def jacobian(_x: np.ndarray) -> np.ndarray:
        return np.ones((n, 1, 1))

    return Factor(np.arange(n)[:, None], residual, jacobian, 1, (1 / sigma)[:, None], name="prior")


def prior_variances(layout: RelativeLayout, cfg: RelativeConfig) -> Float[np.ndarray, " size"]:
    """The diagonal of the paper's initial covariance: frames loose, landmarks near their start."""
    P = np.full(layout.size, cfg.prior_landmark_variance)
    P[: layout.first_landmark] = RELATIVE_PRIOR_FRAME_VARIANCE
    return P


def _converge(problem: Problem, solve: SolveConfig | None) -> Solution:
    """Levenberg-Marquardt to the basin's floor, then plain Gauss-Newton to rounding."""
    pattern = Pattern.of(problem)
    rough = minimise(problem, solve or ROUGH, pattern)
    fine = minimise(replace(problem, x0=rough.x), POLISH, pattern)
    if not fine.converged or fine.cost > rough.cost * (1 + 1e-9) + 1e-12:
        return rough
    return replace(fine, iterations=rough.iterations + fine.iterations, costs=rough.costs + fine.costs[1:])


def _start(maps: Sequence[LandmarkMap]) -> Cluster:
    parts = clusters(maps)
    if len(parts) != 1:
        listing = "; ".join(", ".join(str(i + 1) for i in part.members) for part in parts)
        raise EstimateError(
            f"expected maps that hang together by two shared landmarks, found the parts {listing or 'none'}"
        )
    return parts[0]
