"""Rao-Blackwellized particle filter [Hara07]: many trajectories, each with its own map of geometry and intensity.

p(x, m | u, z) = p(m | x, z) p(x | u, z) # [Hara07] eq. 6: given a trajectory its map is a mere laying together of
scans, so only trajectories are sampled.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Event, Scan
from ..kernels.laser.refine import ScanCost, refine, systematic
from ..kernels.laser.tiles import NearestRule
from .beam import STEERING, Beams, IntensityCalibration, beams
from .config import (
    FILTER_LEAST_BEAMS,
    FILTER_SHARED,
    FILTER_SIGMA,
    PAPER_SIGMA2,
    REFINE_BARE_TANGENT,
    REFINE_KAPPA,
    REFINE_NEFF,
    REFINE_SD_TURN,
    REFINE_SD_XY,
    REFINE_SIGMA,
    FilterConfig,
    LaserTrackingConfig,
)
from .particle_grid import CELL_CAP, ParticleGrid
from .scan_odometry import PoseEstimate, ScanInfo, ScanOdometry, blended

RAW_ALPHA = 0.1  # [m^2 per q^2] what raw intensity counts, which range changes too


@dataclass(slots=True)
class ParticleState:
    """P particles. `step` changes it in place: the maps are too large to copy.

    poses: (P, 3) in `local_k`; log_weight: (P,) since the last resampling; total: (P,) accumulated log-likelihood,
    inherited; history: for every update the odometry's row, the poses (k, 3) that a particle of today descends from and
    the ancestor (k,) of each among those of the update before; the last has all P.
    """

    odometry: ScanOdometry
    maps: ParticleGrid
    poses: Float[np.ndarray, "p 3"]
    log_weight: Float[np.ndarray, " p"]
    total: Float[np.ndarray, " p"]
    feature: str
    calibration: IntensityCalibration | None
    history: list[tuple[int, np.ndarray, np.ndarray]] = field(default_factory=list)


def init(
    robot: str,  # noqa: ARG001  (every estimator is begun the same way)
    cfg: LaserTrackingConfig,
    rng: np.random.Generator,  # noqa: ARG001
    *,
    feature: str = "none",
    calibration: IntensityCalibration | None = None,
    gated: bool = False,
) -> ParticleState:
    """All particles at the origin of `local_k` with empty maps. `gated`: one particle that moves where it must."""
    P = 1 if gated else cfg.particles
    matching = cfg.filter.proposal == "front end"
    gate = cfg.eps if gated else None
    odometry = ScanOdometry(cfg.front_end, feature=feature, gate=gate, matching=matching)
    cells = replace(cfg.cells, alpha=RAW_ALPHA) if feature == "raw" else cfg.cells
    zero = np.zeros(P)
    return ParticleState(odometry, ParticleGrid(P, cells), np.zeros((P, 3)), zero, zero, feature, calibration)


def step(
    state: ParticleState, event: Event, cfg: LaserTrackingConfig, rng: np.random.Generator, *, leapt: bool = False
) -> tuple[ParticleState, ScanInfo | None]:
    """Scans move the estimate; odometry packets do not (a scan brings its own odometry) and give no info.

    leapt: the scan's odometry was set anew, tells nothing.
    """
    if not isinstance(event.record, Scan):
        return state, None
    b = beams(event.record, state.feature, state.calibration, cfg.beam)
    info = state.odometry.advance(event.record, b, leapt=leapt, t=event.t)
    row = len(state.odometry.poses) - 1
    if info.decision in {"first", "empty"} and state.history:
        return state, info
    points, weights = as_points(b), b.w.astype(np.float32)
    if not state.history:
        ancestors = np.arange(len(state.poses))
        state.maps.insert(ancestors, state.poses, points, weights)
        state.history.append((row, state.poses, ancestors))
        return state, info
    u = se2.between(state.odometry.poses[state.history[-1][0]], state.odometry.poses[row])
    d = float(np.hypot(u[0], u[1]))
    f = cfg.filter
    if (d < f.update_distance and abs(u[2]) < f.update_turn) or len(points) < FILTER_LEAST_BEAMS:
        return state, replace(info, decision="skipped" if info.decision == "matched" else info.decision)
    state.poses = move(state.poses, u, f, rng)
    least = None
    if f.refine_iterations and not (state.odometry.gate is not None and info.decision == "odometry"):
        state.poses, least = _refined(state, points, b, f)
    state.log_weight, state.total, matches = _weighed(state, points, cfg, least)
    n_eff, ancestors = _resampled(state, cfg, rng)
    state.maps.insert(np.arange(len(state.poses)), state.poses, points, weights)
    state.history.append((row, state.poses, ancestors))
    if (ancestors != np.arange(len(ancestors))).any():
        state.history[:] = living(state.history)
    many = len(state.poses) > 1  # a single hypothesis has no weight to tell of
    resampled = many and bool((state.log_weight == 0).all())
    n_eff = n_eff if many else np.nan
    decision = info.decision if state.odometry.matching else "matched"
    return state, replace(info, matches=max(info.matches, matches), decision=decision, n_eff=n_eff, resampled=resampled)


def trajectory(state: ParticleState) -> Float[np.ndarray, "m 3"]:
    """Poses at every scan of the particle with the greatest accumulated likelihood, and of its ancestors."""
    i = int(np.argmax(state.total))
    poses = []
    for _, now, ancestors in reversed(state.history):
        poses.append(now[i])
        i = int(ancestors[i])
    at = np.array([row for row, _, _ in state.history])
    return blended(state.odometry.poses.array, at, np.array(poses[::-1]))


def current(state: ParticleState) -> PoseEstimate:
    """The latest pose of the particle with the greatest accumulated likelihood, and how the others lie round it."""
    if not state.history:
        return PoseEstimate(np.zeros(3), np.zeros((3, 3)))
    motion = se2.between(state.odometry.poses[state.history[-1][0]], state.odometry.pose)
    poses = se2.compose(state.poses, motion)
    best = poses[int(np.argmax(state.total))]
    off = poses - best
    off[:, 2] = se2.wrap_angle(off[:, 2])
    w, _ = effective(state.log_weight)
    return PoseEstimate(np.array(best), np.asarray((off * (w / w.sum())[:, None]).T @ off))


Lineages = list[tuple[int, np.ndarray, np.ndarray]]


def living(history: Lineages) -> Lineages:
    """The same updates without the poses that no particle of the last one descends from."""
    if not history:
        return []
    out = [history[-1]]
    for row, poses, ancestors in reversed(history[:-1]):
        kept, at = np.unique(out[-1][2], return_inverse=True)
        out[-1] = (*out[-1][:2], at.astype(np.int32))
        if len(kept) == len(poses):  # all live on, and so do those before them
            out += reversed(history[: len(history) - len(out)])
            break
        out.append((row, poses[kept], ancestors[kept]))
    return out[::-1]


def as_points(b: Beams) -> Float[np.ndarray, "n 3"]:
    """(x, y, q) as the kernels want them, float32."""
    return np.ascontiguousarray(np.column_stack([b.s, b.q]), dtype=np.float32)


def move(
    poses: Float[np.ndarray, "p 3"], u: Float[np.ndarray, "3"], f: FilterConfig, rng: np.random.Generator
) -> Float[np.ndarray, "p 3"]:
    """x_i = x_i (+) (u + w_i) with w_i normal # [Hara07] eq. 7; a single particle is not scattered."""
    if len(poses) == 1:
        return np.asarray(se2.compose(poses, u))
    d = float(np.hypot(u[0], u[1]))
    xy, turn = f.sd_xy + f.sd_xy_per_m * d, f.sd_turn + f.sd_turn_per_m * d
    return np.asarray(se2.compose(poses, u + rng.standard_normal((len(poses), 3)) * [xy, xy, turn]))


def log_likelihood(
    D: Float[np.ndarray, "p n"], cfg: LaserTrackingConfig, feature: str
) -> tuple[Float[np.ndarray, " p"], int]:
    """(P,) log-likelihoods of one scan from the least D of its n beams in P maps, and how many beams counted.

    `matched`: the mean over the beams that at least half of the particles match, so that losing matches never pays.
    `paper`: -d^2 / (2 sigma_z^2) # [Hara07] eq. 8 with d the mean D of a particle's own matches # [Hara07] eq. 9.
    """
    f, cap = cfg.filter, CELL_CAP
    neff = f.neff if feature in STEERING else f.bare_neff
    matched = np.float32(cap) > D
    if cfg.likelihood == "paper":
        n = matched.sum(axis=1)
        d = np.where(matched, D, 0.0).sum(axis=1, dtype=float) / np.maximum(n, 1)
        return np.where(n > 0, -(d**2) / (2 * PAPER_SIGMA2**2), -(cap**2) / (2 * PAPER_SIGMA2**2)), int(n.max())
    shared = matched.sum(axis=0) >= FILTER_SHARED * len(D)
    count = int(shared.sum())
    if not count:
        return np.zeros(len(D)), 0
    return -neff / (2 * FILTER_SIGMA**2) * D[:, shared].mean(axis=1, dtype=float), count


def effective(log_weight: Float[np.ndarray, " p"]) -> tuple[Float[np.ndarray, " p"], float]:
    """Weights (their greatest is 1) and the effective number of particles, 1 / sum of squared shares."""
    w = np.exp(log_weight - log_weight.max())
    return w, float(w.sum() ** 2 / (w @ w))


def _refined(
    state: ParticleState, points: Float[np.ndarray, "n 3"], b: Beams, f: FilterConfig
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "r n"]]:
    """Refined poses, and the least D of every beam there, which a single particle has no use for."""
    m = state.maps
    least = np.empty((len(m) if len(m) > 1 else 0, len(points)), np.float32)
    prior = np.diag([REFINE_SD_XY**-2.0, REFINE_SD_XY**-2.0, REFINE_SD_TURN**-2.0])
    steers = state.feature in STEERING
    poses = refine(
        m.tile_maps,
        np.arange(len(m)),
        state.poses,
        points,
        b.normal,
        NearestRule(m.cfg.alpha if steers else 0.0, CELL_CAP),
        ScanCost(
            REFINE_NEFF / REFINE_SIGMA**2,
            f.refine_tangent if steers else REFINE_BARE_TANGENT,
            REFINE_KAPPA,
        ),
        prior,
        f.refine_iterations,
        least,
    )
    return poses, least


def _weighed(
    state: ParticleState, points: np.ndarray, cfg: LaserTrackingConfig, least: Float[np.ndarray, "r n"] | None = None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Weights by how the scan fits; least: the least D of every beam where it is known already."""
    if len(state.poses) == 1:
        return state.log_weight, state.total, 0
    D = state.maps.score(np.arange(len(state.poses)), state.poses, points) if least is None else least
    gain, matches = log_likelihood(D, cfg, state.feature)
    return state.log_weight + gain, state.total + gain, matches


def _resampled(state: ParticleState, cfg: LaserTrackingConfig, rng: np.random.Generator) -> tuple[float, np.ndarray]:
    """The state after resampling where it was due; the effective number before, and the ancestors."""
    P = len(state.poses)
    w, n_eff = effective(state.log_weight)
    if P == 1 or n_eff > cfg.resample * P:
        return n_eff, np.arange(P)
    ancestors = systematic(w, float(rng.random()))
    state.maps.resample(ancestors)
    state.poses, state.total = state.poses[ancestors], state.total[ancestors]
    state.log_weight = np.zeros(P)
    return n_eff, ancestors
