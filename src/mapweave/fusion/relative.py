"""Fusing local maps through relative information: every map a measurement, all solved together, sparse.

The paper's recursive form is in `papers/kojima/rls.py`; here the same measurements are summed at once. Robots seen by
robots are measurements too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.errors import EstimateError
from ..core.findings import Finding
from ..core.records import Track
from ..core.se2 import wrap_angle
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..solve import Factor, Huber, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from . import relative_information
from .cluster import Cluster, clusters
from .relative_information import Measurement, RelativeLayout, Weights, measurement

Poses = Float[np.ndarray, "*b 3"]


def predict(T_map_a: Poses, T_a_seer: Poses, T_map_b: Poses, T_b_seen: Poses) -> Float[np.ndarray, "*b 2"]:
    """`[range m, bearing rad]` of the seen robot from the seer; broadcasts over leading axes.

    T_map_a, T_map_b: poses of the two local frames in the map; T_a_seer, T_b_seen: the robots' poses in their own
    local frames when the sighting was made. Bearing CCW from the seer's x, in (-pi, pi].
    """
    seer, seen = se2.compose(T_map_a, T_a_seer), se2.compose(T_map_b, T_b_seen)
    d = seen[..., :2] - seer[..., :2]
    bearing = se2.wrap_angle(np.arctan2(d[..., 1], d[..., 0]) - seer[..., 2])
    return np.stack([np.hypot(d[..., 0], d[..., 1]), bearing], axis=-1)


def innovation(z: Float[np.ndarray, "*b 2"], h: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 2"]:
    """`z - h` with the bearing wrapped."""
    e = np.asarray(z - h)
    e[..., 1] = se2.wrap_angle(e[..., 1])
    return e


def by_poses(T_map_a: Poses, T_a_seer: Poses, T_map_b: Poses, T_b_seen: Poses) -> Float[np.ndarray, "*b 2 12"]:
    """Derivatives of `predict` by `[T_map_a, T_a_seer, T_map_b, T_b_seen]`, (..., 2, 12)."""
    seer, seen = se2.compose(T_map_a, T_a_seer), se2.compose(T_map_b, T_b_seen)
    d = seen[..., :2] - seer[..., :2]
    square = np.sum(d * d, axis=-1)[..., None]
    G = np.stack([d / np.sqrt(square), np.stack([-d[..., 1], d[..., 0]], axis=-1) / square], axis=-2)
    H = np.zeros((*d.shape[:-1], 2, 12))
    for sign, at, frame, robot in ((-1.0, 0, T_map_a, seer), (1.0, 6, T_map_b, seen)):
        arm = robot[..., :2] - frame[..., :2]
        turned = np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
        H[..., at : at + 2] = sign * G
        H[..., at + 2] = sign * (G @ turned[..., None])[..., 0]
        H[..., at + 3 : at + 5] = sign * (G @ se2.rotation(frame[..., 2]))
    H[..., 1, 2] -= 1.0
    H[..., 1, 5] -= 1.0
    return H


@dataclass(frozen=True, slots=True)
class FrameSightings:
    """Robot of map `a` saw robot of map `b`, s times: poses of both in their own frames, z = [range, bearing].

    T_a_seer, T_b_seen: (s, 3); z: (s, 2) [m, rad]; R: (s, 2, 2), everything but the frames' own uncertainty.
    """

    a: int
    b: int
    T_a_seer: Float[np.ndarray, "s 3"]
    T_b_seen: Float[np.ndarray, "s 3"]
    z: Float[np.ndarray, "s 2"]
    R: Float[np.ndarray, "s 2 2"]


def sighting_factor(
    s: FrameSightings,
    where_a: Int[np.ndarray, " i"],
    where_b: Int[np.ndarray, " j"],
    scales: tuple[int, int] | None = None,
) -> Factor:
    """The sightings as a least-squares term over the two frames, an outlier bounded.

    where_a, where_b: (3,) the entries of x that hold each frame's pose, or none for the gauge, the identity; scales:
    the entries that say how many times too large each map is. A robot's track is as much too large as its map.
    """
    n = np.ones((len(s.z), 1))
    keep = np.r_[np.arange(len(where_a)), 6 + np.arange(len(where_b))]
    where = np.concatenate([where_a, where_b, np.array(scales or (), dtype=np.intp)]).astype(np.intp)

    def poses(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        T_a, T_b = (x[at] if len(at) else np.zeros(3) for at in (where_a, where_b))
        s_a, s_b = (1.0, 1.0) if scales is None else x[list(scales)]
        return n * T_a, s.T_a_seer / [s_a, s_a, 1.0], n * T_b, s.T_b_seen / [s_b, s_b, 1.0]

    def residual(x: np.ndarray) -> np.ndarray:
        return -innovation(s.z, predict(*poses(x)))

    def jacobian(x: np.ndarray) -> np.ndarray:
        at = poses(x)
        H = by_poses(*at)
        if scales is None:
            return H[:, :, keep]
        by_scale = [
            -(H[:, :, c : c + 2] @ at[k][:, :2, None])[..., 0] / x[scale]
            for c, k, scale in ((3, 1, scales[0]), (9, 3, scales[1]))
        ]
        return np.concatenate([H[:, :, keep], np.stack(by_scale, axis=-1)], axis=-1)

    whiten = np.linalg.inv(np.linalg.cholesky(s.R))
    return Factor(np.tile(where, (len(s.z), 1)), residual, jacobian, 2, whiten, Huber(2.0), "sighting")


def frame_sightings(
    maps: Sequence[LocalMap],
    frames: Float[np.ndarray, "m 3"],
    *,
    range_sigma: float,
    bearing_sigma: float,
    every: float,
) -> list[FrameSightings]:
    """The sightings between `maps`, as measurements between their frames.

    frames: (m, 3) `T_ref_local`, roughly: only the noise is linearised there. range_sigma [m], bearing_sigma [rad]: of
    one sighting, to which the tracks' own uncertainty is added.
    Tracks err slowly, so of the sightings of one robot by another only one in `every` seconds is kept, and none outside
    either track.
    """
    at = {m.robot: k for k, m in enumerate(maps)}
    out = []
    for a, m in enumerate(maps):
        seen = m.robot_sightings
        targets = np.array(seen.target, dtype=object)
        for target in dict.fromkeys(seen.target):
            b = at.get(target)
            if b is None or b == a:
                continue
            rows = np.flatnonzero((targets == target) & _inside(m.track, seen.t) & _inside(maps[b].track, seen.t))
            rows = rows[_spaced(seen.t[rows], every)]
            if len(rows):
                z = np.stack([seen.range[rows], seen.bearing[rows]], axis=-1)
                t = seen.t[rows]
                out.append(_between(a, b, m.track, maps[b].track, frames, t, z, (range_sigma, bearing_sigma)))
    return out


def _between(
    a: int,
    b: int,
    seer: Track,
    seen: Track,
    frames: Float[np.ndarray, "m 3"],
    t: Float[np.ndarray, " s"],
    z: Float[np.ndarray, "s 2"],
    sigma: tuple[float, float],
) -> FrameSightings:
    T_a, T_b = se2.interpolate(t, seer.t, seer.pose), se2.interpolate(t, seen.t, seen.pose)
    n = np.ones((len(t), 1))
    H = by_poses(n * frames[a], T_a, n * frames[b], T_b)
    R = np.tile(np.diag(np.square(sigma)), (len(t), 1, 1))
    for columns, track in ((slice(3, 6), seer), (slice(9, 12), seen)):
        if track.cov is not None:
            J = H[:, :, columns]
            R = R + J @ track.cov[_nearest(track.t, t)] @ J.swapaxes(1, 2)
    return FrameSightings(a, b, T_a, T_b, z, R)


def _inside(track: Track, t: Float[np.ndarray, " s"]) -> Bool[np.ndarray, " s"]:
    return (t >= track.t[0]) & (t <= track.t[-1]) if len(track.t) else np.zeros(len(t), dtype=bool)


def _spaced(t: Float[np.ndarray, " s"], every: float) -> list[int]:
    kept: list[int] = []
    for i in np.argsort(t, kind="stable"):
        if not kept or t[i] - t[kept[-1]] >= every:
            kept.append(int(i))
    return kept


def _nearest(stamps: Float[np.ndarray, " n"], t: Float[np.ndarray, " s"]) -> np.ndarray:
    right = np.clip(np.searchsorted(stamps, t), 1, max(len(stamps) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(stamps) - 1)
    return np.where(t - stamps[left] <= stamps[right] - t, left, right)


RELATIVE_PRIOR_FRAME_VARIANCE = 1e5  # [m^2 and rad^2]

ROUGH = SolveConfig(max_iterations=400)
POLISH = SolveConfig(damping=0.0, max_iterations=8, step_tolerance=1e-12)


@dataclass(frozen=True, slots=True, kw_only=True)
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
    solution = _converge(Problem(x0, terms, retract=wrapping(layout.angles)))
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


def _converge(problem: Problem) -> Solution:
    """Levenberg-Marquardt to the basin's floor, then plain Gauss-Newton to rounding."""
    pattern = Pattern.of(problem)
    rough = minimise(problem, ROUGH, pattern)
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
