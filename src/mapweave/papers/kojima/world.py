"""The world of Kojima, Okawa and Namerikawa's experiment: two e-pucks on circles, eight landmarks, an EKF-SLAM each.

The paper does not print its layout, so worlds are drawn: many at once, every array with the world as leading axis.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import se2

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
