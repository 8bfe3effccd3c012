"""The experiments behind `reproduce kojima`: the paper's Table 2 and Fig. 7, honesty of the weights, unequal maps.

Their world: two e-pucks on circles, eight landmarks, an EKF-SLAM each. The paper does not print its layout, so worlds
are drawn: many at once, every array with the world as leading axis.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ...core import se2
from ...core.workers import Progress, no_progress
from ...fusion.relative_information import Measurement, RelativeLayout, Weights, baseline_pair, measurement
from ..kojima import rls
from .rls import solve_all

KOJIMA_ARENA = 1.5  # [m]
KOJIMA_SPEED = 0.05  # [m/s]
KOJIMA_RADIUS = 0.22  # [m]
KOJIMA_PERIOD = 0.1  # [s]
OBSERVATION_VARIANCE = 1e-4  # of the sensor: [m^2] and [rad^2]
PROCESS_VARIANCE = 1e-6  # a step, of x, y [m^2] and theta [rad^2]; none while the robot stands
RLS_VARIANCE = 1e-3  # rls variance
KOJIMA_PRIOR_FRAME_VARIANCE = 1e5  # prior frame variance
PRIOR_LANDMARK_VARIANCE = 1e-3  # prior landmark variance

COMMON = 2
OWN = 3
SEEN = (np.array([0, 1, 2, 3, 4]), np.array([0, 1, 5, 6, 7]))  # landmarks of either robot, the common two first


@dataclass(frozen=True, slots=True, kw_only=True)
class KojimaConfig:
    """The paper's Table 1, its misprints mended, and the geometry chosen for it."""

    drive_steps: int = 800
    steps: int = 1500
    filter_variance: float = 1e-5  # what the EKF takes the sensor's variance for
    first_pose_variance: float = 1e-5  # printed as the landmarks'; the two are exchanged in the table
    delta: float = 80.0


@dataclass(frozen=True, slots=True)
class Worlds:
    """S worlds in frame 1. landmarks: (S, 8, 2) [m], two common, three of either robot; start: (S, 2, 3)."""

    landmarks: Float[np.ndarray, "s 8 2"]
    start: Float[np.ndarray, "s 2 3"]


@dataclass(frozen=True, slots=True)
class LocalMaps:
    """Both robots' maps at one step: mean (S, 2, 5, 2) in their own frames; cov (S, 2, 10, 10)."""

    mean: Float[np.ndarray, "s 2 5 2"]
    cov: Float[np.ndarray, "s 2 10 10"]


def draw_worlds(count: int, rng: np.random.Generator) -> Worlds:
    """`count` layouts: landmarks 0.2 m apart at least and clear of both paths, the common ones 0.4 m apart."""
    middle = 0.5 * KOJIMA_ARENA
    centres = np.array([[middle - 0.35, middle], [middle + 0.35, middle]])
    below, above = (
        centres[0] - [0.0, KOJIMA_RADIUS],
        centres[1] + [0.0, KOJIMA_RADIUS],
    )  # robot 1 turns left, robot 2 right
    T_arena_start = np.array([[*below, 0.0], [*above, 0.0]])
    landmarks = np.stack([_layout(centres, rng) for _ in range(count)])
    T_1_arena = se2.inverse(T_arena_start[0])
    return Worlds(
        landmarks=se2.act(T_1_arena, landmarks),
        start=np.broadcast_to(se2.compose(T_1_arena, T_arena_start), (count, 2, 3)),
    )


def _layout(centres: Float[np.ndarray, "2 2"], rng: np.random.Generator) -> Float[np.ndarray, "8 2"]:
    edge, left, right = 0.1, 0.55, 0.95
    spans = [(left, right)] * COMMON + [(edge, left)] * OWN + [(right, KOJIMA_ARENA - edge)] * OWN
    while True:
        p: list[np.ndarray] = []
        for low, high in spans:
            for _ in range(200):
                q = np.array([rng.uniform(low, high), rng.uniform(edge, KOJIMA_ARENA - edge)])
                apart = 0.4 if len(p) < COMMON else 0.2
                path = np.abs(np.linalg.norm(centres - q, axis=1) - KOJIMA_RADIUS).min()
                if path > 0.08 and all(np.linalg.norm(q - other) >= apart for other in p):
                    p.append(q)
                    break
        if len(p) == len(spans):
            return np.array(p)


def run_filters(cfg: KojimaConfig, worlds: Worlds, rng: np.random.Generator) -> Iterator[LocalMaps]:
    """The local maps when the robots come to rest, and after every step of standing still, to `cfg.steps`."""
    S = len(worlds.landmarks)
    T_1_robot = worlds.start.copy()
    points = np.stack([worlds.landmarks[:, index] for index in SEEN], axis=1)
    x, P = _first_map(cfg, *_observe(T_1_robot, points, rng))
    sigma = np.sqrt(PROCESS_VARIANCE)
    turn = np.array([KOJIMA_SPEED, 0.0, KOJIMA_SPEED / KOJIMA_RADIUS]) * KOJIMA_PERIOD
    twist = np.stack([turn, turn * [1.0, 0.0, -1.0]])  # the two circles are driven in opposite senses
    for step in range(1, cfg.steps + 1):
        if step <= cfg.drive_steps:
            T_1_robot = se2.compose(T_1_robot, se2.exp(twist)) + sigma * rng.standard_normal((S, 2, 3))
            x, P = _predict(x, P, twist)
        x, P = _correct(cfg, x, P, *_observe(T_1_robot, points, rng))
        if step >= cfg.drive_steps:
            yield LocalMaps(x[..., 3:].reshape(S, 2, -1, 2), P[..., 3:, 3:])


def _observe(
    pose: Float[np.ndarray, "s 2 3"], points: Float[np.ndarray, "s 2 5 2"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "s 2 5"], Float[np.ndarray, "s 2 5"]]:
    """Noisy ranges [m] and bearings [rad] of all five landmarks of each robot."""
    d = points - pose[..., None, :2]
    z = rng.standard_normal((*d.shape[:-1], 2)) * np.sqrt(OBSERVATION_VARIANCE)
    return np.hypot(d[..., 0], d[..., 1]) + z[..., 0], np.arctan2(d[..., 1], d[..., 0]) - pose[..., 2:3] + z[..., 1]


def _first_map(
    cfg: KojimaConfig, r: Float[np.ndarray, "s 2 5"], b: Float[np.ndarray, "s 2 5"]
) -> tuple[Float[np.ndarray, "s 2 13"], Float[np.ndarray, "s 2 13 13"]]:
    """Pose zero and every landmark by inverse observation, with all cross terms."""
    n = r.shape[-1]
    c, s = np.cos(b), np.sin(b)
    x = np.concatenate([np.zeros((*r.shape[:-1], 3)), np.stack([r * c, r * s], axis=-1).reshape(*r.shape[:-1], -1)], -1)
    G = np.zeros((*r.shape[:-1], 3 + 2 * n, 3 + 2 * n))
    G[..., :3, :3] = np.eye(3)
    k = np.arange(n)
    G[..., 3 + 2 * k, 0] = G[..., 4 + 2 * k, 1] = 1.0
    G[..., 3 + 2 * k, 2], G[..., 4 + 2 * k, 2] = -r * s, r * c
    G[..., 3 + 2 * k, 3 + 2 * k], G[..., 3 + 2 * k, 4 + 2 * k] = c, -r * s
    G[..., 4 + 2 * k, 3 + 2 * k], G[..., 4 + 2 * k, 4 + 2 * k] = s, r * c
    noise = np.r_[np.full(3, cfg.first_pose_variance), np.full(2 * n, cfg.filter_variance)]
    return x, (G * noise) @ np.swapaxes(G, -1, -2)


def _predict(
    x: Float[np.ndarray, "s 2 13"],
    P: Float[np.ndarray, "s 2 13 13"],
    twist: Float[np.ndarray, "2 3"],
) -> tuple[Float[np.ndarray, "s 2 13"], Float[np.ndarray, "s 2 13 13"]]:
    pose = se2.compose(x[..., :3], se2.exp(twist))
    F = np.broadcast_to(np.eye(3), (*x.shape[:-1], 3, 3)).copy()
    F[..., 0, 2], F[..., 1, 2] = x[..., 1] - pose[..., 1], pose[..., 0] - x[..., 0]
    P = P.copy()
    P[..., :3, :] = F @ P[..., :3, :]
    P[..., :, :3] = P[..., :, :3] @ np.swapaxes(F, -1, -2)
    P[..., [0, 1, 2], [0, 1, 2]] += PROCESS_VARIANCE
    return np.concatenate([pose, x[..., 3:]], axis=-1), P


def _correct(
    cfg: KojimaConfig,
    x: Float[np.ndarray, "s 2 13"],
    P: Float[np.ndarray, "s 2 13 13"],
    r: Float[np.ndarray, "s 2 5"],
    b: Float[np.ndarray, "s 2 5"],
) -> tuple[Float[np.ndarray, "s 2 13"], Float[np.ndarray, "s 2 13 13"]]:
    n = r.shape[-1]
    d = x[..., 3:].reshape(*r.shape, 2) - x[..., None, :2]
    square = np.sum(d * d, axis=-1)
    distance = np.sqrt(square)
    H = np.zeros((*r.shape[:-1], 2 * n, 3 + 2 * n))
    k = np.arange(n)
    for axis in (0, 1):
        g_r = d[..., axis] / distance
        g_b = (-d[..., 1], d[..., 0])[axis] / square
        H[..., k, axis], H[..., k, 3 + 2 * k + axis] = -g_r, g_r
        H[..., n + k, axis], H[..., n + k, 3 + 2 * k + axis] = -g_b, g_b
    H[..., n + k, 2] = -1.0
    e = np.concatenate([r - distance, se2.wrap_angle(b - np.arctan2(d[..., 1], d[..., 0]) + x[..., 2:3])], axis=-1)
    PHT = P @ np.swapaxes(H, -1, -2)
    S = H @ PHT + cfg.filter_variance * np.eye(2 * n)
    KT = np.linalg.solve(S, np.swapaxes(PHT, -1, -2))
    x = x + (e[..., None, :] @ KT)[..., 0, :]
    P = P - PHT @ KT
    return x, 0.5 * (P + np.swapaxes(P, -1, -2))


UNEQUAL_N = 10  # n
UNEQUAL_M = 6  # m
UNEQUAL_TOTAL = 2 * UNEQUAL_N - UNEQUAL_M
UNEQUAL_ARENA = 1.5  # [m]
UNEQUAL_SMALLEST = 0.002  # [m]
UNEQUAL_LARGEST = 0.05  # [m]


@dataclass(frozen=True, slots=True)
class UnequalMaps:
    """S worlds of two maps, the common landmarks first in each.

    landmarks: (S, N, 2) the truth in frame 1; frame: (S, 3) of map 2; index[k]: (n,) the landmarks of map k;
    mean: (S, 2, n, 2) in the maps' own frames; cov: (S, 2, 2n, 2n).
    """

    landmarks: Float[np.ndarray, "s t 2"]
    frame: Float[np.ndarray, "s 3"]
    index: tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]
    mean: Float[np.ndarray, "s 2 n 2"]
    cov: Float[np.ndarray, "s 2 d d"]


def draw_unequal(count: int, rng: np.random.Generator) -> UnequalMaps:
    """`count` worlds whose maps err as their covariances say."""
    landmarks = rng.uniform(0.0, UNEQUAL_ARENA, (count, UNEQUAL_TOTAL, 2))
    frame = rng.uniform([-UNEQUAL_ARENA, -UNEQUAL_ARENA, -np.pi], [UNEQUAL_ARENA, UNEQUAL_ARENA, np.pi], (count, 3))
    index = (np.arange(UNEQUAL_N), np.r_[np.arange(UNEQUAL_M), np.arange(UNEQUAL_N, UNEQUAL_TOTAL)])
    local = np.stack([landmarks[:, index[0]], se2.act(se2.inverse(frame)[:, None], landmarks[:, index[1]])], axis=1)
    sigma = np.exp(rng.uniform(np.log(UNEQUAL_SMALLEST), np.log(UNEQUAL_LARGEST), (count, 2, UNEQUAL_N)))
    variance = np.repeat(sigma**2, 2, axis=-1)
    return UnequalMaps(
        landmarks=landmarks,
        frame=frame,
        index=index,
        mean=local + sigma[..., None] * rng.standard_normal(local.shape),
        cov=variance[..., None] * np.eye(2 * UNEQUAL_N),
    )


LAYOUT = RelativeLayout(2, 8)
EARLY = np.array([100.0, 300.0, 1000.0, 3000.0, 10_000.0])  # updates
LATE = 10.0 * EARLY
MERGES = 700.0  # updates of the experiment


@dataclass(frozen=True, slots=True)
class Settling:
    """Over S maps under the paper's prior, delta: of eq. 14; maps: which.

    early, late: (S,) spread of `k |P_k - P_inf|` over k in `EARLY` and `LATE`, as a share of its mean (0 where the
    error falls as 1/k); left: (S,) `|P_k - P_inf| / |P_inf|` after the experiment's 700 updates; printed: (S,) the
    same of the paper's closed form, eqs. 24-27, in place of P_k.
    """

    maps: str
    delta: float
    early: Float[np.ndarray, " s"]
    late: Float[np.ndarray, " s"]
    left: Float[np.ndarray, " s"]
    printed: Float[np.ndarray, " s"]


def prior_information() -> Float[np.ndarray, "n n"]:
    """The inverse of the paper's `P^G_800`."""
    return np.diag(1 / np.r_[np.full(3, KOJIMA_PRIOR_FRAME_VARIANCE), np.full(16, PRIOR_LANDMARK_VARIANCE)])


def settling(
    cfg: KojimaConfig, local: LocalMaps, x: Float[np.ndarray, "s n"], rng: np.random.Generator
) -> tuple[Settling, ...]:
    """The experiment's own maps of robot 2 at the states `x`, and `len(x)` drawn ones of some 2 to 7 cm."""
    drawn_points = rng.uniform(-1, 1, (len(x), 5, 2)) + np.array([3.0, 0.0])
    A = 0.01 * rng.normal(size=(len(x), 10, 10))
    drawn_cov = A @ np.swapaxes(A, -1, -2) + 1e-4 * np.eye(10)
    state = np.zeros_like(x)
    state[:, 3:13] = drawn_points.reshape(len(x), -1)
    state[:, 13:] = rng.uniform(-1, 1, (len(x), 6))
    index = np.arange(5)
    out = []
    for delta in (1.0, cfg.delta):
        each = replace(cfg, delta=delta)
        out.append(_settling("the experiment's", each, SEEN[1], local.mean[:, 1], local.cov[:, 1], x))
        out.append(_settling("less certain", each, index, drawn_points, drawn_cov, state))
    return tuple(out)


def _settling(
    name: str,
    cfg: KojimaConfig,
    index: np.ndarray,
    mean: Float[np.ndarray, "s 5 2"],
    cov: Float[np.ndarray, "s 10 10"],
    x: Float[np.ndarray, "s n"],
) -> Settling:
    measured = measurement(1, index, mean, cov, "paper", delta=cfg.delta)
    information = prior_information()
    spreads = np.empty((4, len(x)))
    for s, (H, R) in enumerate(zip(measured.dense_jacobian(LAYOUT, x), measured.R, strict=True)):
        P_inf = rls.limit(information, H)
        for row, ks in enumerate((EARLY, LATE)):
            scaled = np.array([k * np.linalg.norm(rls.after(information, H, R, k) - P_inf) for k in ks])
            spreads[row, s] = np.ptp(scaled) / scaled.mean()
        rest = rls.after(information, H, R, MERGES) - P_inf
        spreads[2, s] = np.linalg.norm(rest) / np.linalg.norm(P_inf)
        closed = rls.printed_limit(information[:3, :3], information[3:, 3:], H[:, :3], H[:, 3:])
        spreads[3, s] = np.linalg.norm(closed - P_inf) / np.linalg.norm(P_inf)
    return Settling(name, cfg.delta, *spreads)


Reading = Literal["prior", "measurement"]
Rule = Literal["certain", "widest", "narrowest"]

READINGS: tuple[Reading, ...] = ("prior", "measurement")
SHORT: tuple[Weights, ...] = ("constant", "paper")


@dataclass(frozen=True, slots=True)
class Run:
    """One weighting under one reading of the reference map, over S worlds and K updates.

    robot, landmark: (S,) errors [m], the landmarks' as the root of their mean square; trace: (K + 1,) mean trace of
    the covariance over the worlds, low and high its 5 and 95 % quantiles; limit: what Theorem 2 says it tends to.
    """

    reading: Reading
    weights: Weights
    robot: Float[np.ndarray, " s"]
    landmark: Float[np.ndarray, " s"]
    trace: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    limit: float
    final: rls.Estimate

    @property
    def robot_rmse(self) -> float:
        return float(np.sqrt(np.mean(self.robot**2)))

    @property
    def landmark_rmse(self) -> float:
        return float(np.sqrt(np.mean(self.landmark**2)))


def merge_online(
    cfg: KojimaConfig, worlds: Worlds, rng: np.random.Generator, on_progress: Progress = no_progress
) -> tuple[tuple[Run, ...], LocalMaps]:
    """Both weightings under both readings, merging at every step since the robots stand; and the maps at the start."""
    keys = tuple(product(READINGS, SHORT))
    maps = run_filters(cfg, worlds, rng)
    on_progress("driving", 0, None)
    first = next(maps)
    estimates = dict.fromkeys(keys, _initial(first))
    traces: dict[tuple, list[np.ndarray]] = {key: [_trace(estimates[key])] for key in keys}
    for step, local in enumerate(maps):
        on_progress("merging", step + 1, cfg.steps - cfg.drive_steps)
        measurements = {w: [_measure(cfg, local, k, w) for k in (0, 1)] for w in SHORT}
        for reading, weights in keys:
            used = measurements[weights] if reading == "measurement" else measurements[weights][1:]
            estimates[reading, weights] = rls.repeat(LAYOUT, estimates[reading, weights], used)
            traces[reading, weights].append(_trace(estimates[reading, weights]))
    return tuple(_run(cfg, worlds, key, estimates[key], traces[key], first) for key in keys), first


def _initial(local: LocalMaps) -> rls.Estimate:
    """The paper's start: robot 1's map, robot 2's fitted onto it by the two common landmarks, and a wide prior."""
    T = np.stack([se2.align(m[1, :2], m[0, :2]) for m in local.mean])
    points = np.concatenate([local.mean[:, 0], se2.act(T[:, None], local.mean[:, 1, 2:])], axis=1)
    x = np.concatenate([T, points.reshape(len(T), -1)], axis=1)
    return rls.Estimate(x, np.tile(np.linalg.inv(prior_information()), (len(T), 1, 1)))


def _measure(cfg: KojimaConfig, local: LocalMaps, k: int, weights: Weights) -> Measurement:
    return measurement(k, SEEN[k], local.mean[:, k], local.cov[:, k], weights, delta=cfg.delta, variance=RLS_VARIANCE)


def _trace(estimate: rls.Estimate) -> Float[np.ndarray, " s"]:
    return np.asarray(np.trace(estimate.P, axis1=-2, axis2=-1))


def _run(
    cfg: KojimaConfig,
    worlds: Worlds,
    key: tuple[Reading, Weights],
    estimate: rls.Estimate,
    traces: list[np.ndarray],
    first: LocalMaps,
) -> Run:
    reading, weights = key
    trace = np.stack(traces)
    limit = 0.0
    if reading == "prior":
        H = _measure(cfg, first, 1, weights).dense_jacobian(LAYOUT, estimate.x)
        limit = float(np.mean([np.trace(rls.limit(prior_information(), each)) for each in H]))
    return Run(
        reading=reading,
        weights=weights,
        robot=np.linalg.norm(estimate.x[:, :2] - worlds.start[:, 1, :2], axis=1),
        landmark=np.sqrt(np.mean(np.sum((LAYOUT.points(estimate.x) - worlds.landmarks) ** 2, axis=-1), axis=1)),
        trace=trace.mean(axis=1),
        low=np.quantile(trace, 0.05, axis=1),
        high=np.quantile(trace, 0.95, axis=1),
        limit=limit,
        final=estimate,
    )


def honesty(worlds: Worlds, local: LocalMaps, draws: int, rng: np.random.Generator) -> dict[tuple[Weights, int], float]:
    """Mean NEES per degree of freedom of the fused state, by weights and repeats, over `draws` of each world's maps.

    The maps are drawn about the truth from the covariances the filters ended with.
    """
    S = len(worlds.landmarks)
    cov = np.repeat(local.cov, draws, axis=0)
    L = np.linalg.cholesky(cov)
    own = se2.act(se2.inverse(worlds.start[:, 1])[:, None], worlds.landmarks[:, SEEN[1]])
    true = np.repeat(np.stack([worlds.landmarks[:, SEEN[0]], own], axis=1), draws, axis=0)
    mean = true + (L @ rng.standard_normal((S * draws, 2, 10, 1))).reshape(true.shape)
    x = np.repeat(np.concatenate([worlds.start[:, 1], worlds.landmarks.reshape(S, -1)], axis=1), draws, axis=0)
    out: dict[tuple[Weights, int], float] = {}
    cases: tuple[tuple[Weights, int], ...] = (("full", 1), ("paper", 1), ("full", 700))
    for weights, repeats in cases:
        measurements = [measurement(k, SEEN[k], mean[:, k], cov[:, k], weights) for k in (0, 1)]
        estimate = solve_all(LAYOUT, x, measurements, repeats=repeats)
        e = estimate.x - x
        e[:, LAYOUT.angles] = se2.wrap_angle(e[:, LAYOUT.angles])
        nees = np.sum(e * np.linalg.solve(estimate.P, e[..., None])[..., 0], axis=1)
        out[weights, repeats] = float(nees.mean() / LAYOUT.size)
    return out


@dataclass(frozen=True, slots=True)
class Unequal:
    """Root mean square errors [m] over all seeds of unequal maps, for one baseline rule and one weighting."""

    rule: Rule
    weights: Weights
    landmark_rmse: float
    frame_rmse: float


def unequal(
    seeds: int,
    rng: np.random.Generator,
    cases: tuple[tuple[Rule, Weights], ...],
    on_progress: Progress = no_progress,
) -> tuple[Unequal, ...]:
    """The same `seeds` worlds fused once for every (rule, weights), each map counted once and without a prior."""
    worlds = draw_unequal(seeds, rng)
    layout = RelativeLayout(2, UNEQUAL_TOTAL)
    out = []
    for at, (rule, weights) in enumerate(cases):
        on_progress("unequal maps", at, len(cases))
        x = np.stack([_fuse_unequal(layout, worlds, s, rule, weights) for s in range(seeds)])
        landmark = np.sum((layout.points(x) - worlds.landmarks) ** 2, axis=-1)
        frame = np.sum((x[:, :2] - worlds.frame[:, :2]) ** 2, axis=-1)
        out.append(Unequal(rule, weights, float(np.sqrt(landmark.mean())), float(np.sqrt(frame.mean()))))
    return tuple(out)


def _fuse_unequal(
    layout: RelativeLayout, worlds: UnequalMaps, s: int, rule: Rule, weights: Weights
) -> Float[np.ndarray, " size"]:
    measurements = []
    for k in (0, 1):
        mean, cov = worlds.mean[s, k], worlds.cov[s, k]
        pair = _pair(rule, mean, cov, UNEQUAL_M)
        order = np.array([*pair, *(i for i in range(UNEQUAL_N) if i not in pair)])
        rows = (2 * order[:, None] + np.arange(2)).ravel()
        measurements.append(measurement(k, worlds.index[k][order], mean[order], cov[np.ix_(rows, rows)], weights))
    x0 = np.concatenate([worlds.frame[s], worlds.landmarks[s].ravel()])
    return solve_all(layout, x0, measurements, iterations=30).x


def _pair(rule: Rule, mean: Float[np.ndarray, "n 2"], cov: Float[np.ndarray, "d d"], common: int) -> tuple[int, int]:
    if rule == "certain":
        return baseline_pair(mean, cov, np.arange(common))
    d = np.linalg.norm(mean[:common, None] - mean[None, :common], axis=-1)
    d = d if rule == "widest" else -d - 1e9 * np.eye(common)
    i, j = np.unravel_index(int(np.argmax(d)), d.shape)
    return int(i), int(j)
