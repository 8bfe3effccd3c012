"""How little any estimator can err on the ring: with geometry and wheels, and with the rims that light shows.

The bound on geometry is exact but for the rotation being linearised: an estimator is granted every heading, every
distance across a wall, and every step on which a corner or a recessed door is in sight; what is left are the steps
along flush walls, of which wheels alone tell. Their errors are jointly normal: the conditional covariance bounds
whatever is made of them, with the noise of the wheels known. It bounds the expectation: of single drives some err
less. The bias of the heading, chosen so that the last pose errs as asked, is taken to tell nothing of the way. The
bound with light is the inverse information of rims and walls at the truth, by the noise they are weighed with.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core import se2
from ...core.workers import Progress, no_progress
from ...laser.beam import beams
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import choose_feature
from ...sim.corridor import CorridorConfig, simulate_corridor
from ...sim.laser import LaserSimulation
from .light_edges import at_truth

PROBES = 24  # random vectors by which a trace is told to a few per cent


@dataclass(frozen=True, slots=True)
class Bounds:
    """geometry, light: (s,) least expected root mean square error [m] after one rigid alignment, a drive each."""

    geometry: Float[np.ndarray, " s"]
    light: Float[np.ndarray, " s"]


def try_bounds(seeds: range, loop: CorridorConfig | None = None, on_progress: Progress = no_progress) -> Bounds:
    """Both bounds on every drive."""
    cfg = loop or CorridorConfig()
    geometry, light = np.empty(len(seeds)), np.empty(len(seeds))
    for k, seed in enumerate(seeds):
        on_progress("bounds", k, len(seeds))
        sim = simulate_corridor(cfg, seed)
        geometry[k] = geometry_bound(sim, cfg)
        light[k] = light_bound(sim, seed)
    return Bounds(geometry, light)


def geometry_bound(sim: LaserSimulation, cfg: CorridorConfig) -> float:
    """Least expected root mean square error [m] on geometry and wheels."""
    pose = _truth(sim)
    step = se2.between(pose[:-1], pose[1:])
    ds = np.hypot(step[:, 0], step[:, 1])
    flush = along_flush_walls(pose, cfg)[1:]
    drift = cfg.drive.drift
    way = np.cumsum(ds)
    C = drift.scale**2 * np.exp(-np.abs(way[:, None] - way) / drift.scale_length) * ds * ds[:, None]
    C += np.diag(drift.translation**2 * ds)
    left = C[np.ix_(flush, flush)]
    if not flush.all():
        cross = C[np.ix_(flush, ~flush)]
        left = left - cross @ np.linalg.solve(C[np.ix_(~flush, ~flush)], cross.T)
    move = np.diff(pose[:, :2], axis=0) / np.maximum(ds, 1e-12)[:, None]
    n = len(pose)
    after = np.tril(np.ones((n, n - 1)), -1)[:, flush]  # which steps lie before each scan
    J = (after[:, None, :] * move[flush].T[None]).reshape(2 * n, -1)
    J -= _aligned(pose) @ (_aligned(pose).T @ J)
    return float(np.sqrt(max(np.einsum("ij,jk,ik->", J, left, J), 0.0) / n))


def along_flush_walls(pose: Float[np.ndarray, "n 3"], cfg: CorridorConfig) -> Bool[np.ndarray, " n"]:
    """(n,) whether a scan shows nothing but flush walls: on a long leg, with no corner in sight."""
    half, far = 0.5 * cfg.width, cfg.drive.scanner.far
    left, right = -cfg.start - half, cfg.long_leg - cfg.start + half
    inside = (pose[:, 0] - left > far) & (right - pose[:, 0] > far)
    straight = np.abs(np.sin(pose[:, 2])) < 0.1
    return np.asarray(inside & straight)


def light_bound(sim: LaserSimulation, seed: int) -> float:
    """Least root mean square error [m] where rims and walls are known by their own noise."""
    cfg = LaserConfig()
    feature = choose_feature(sim.log, cfg)
    seen = [beams(scan, feature.name, feature.calibration, cfg.beam) for scan in sim.log.scans]
    pose = _truth(sim)
    noise = 0.0 if feature.calibration is None else feature.calibration.residual
    solution = at_truth(seen, pose, noise)
    if solution.information is None:
        return float("nan")
    Q = _aligned(pose)
    n, at = len(pose), np.full(len(solution.x), -1)
    at[solution.free] = np.arange(len(solution.free))
    where = at[3 * np.arange(n)[:, None] + np.arange(2)].ravel()
    z = np.random.default_rng(seed).choice([-1.0, 1.0], (2 * n, PROBES))  # the trace of a matrix is E z^T A z
    z -= Q @ (Q.T @ z)
    b = np.zeros((len(solution.free), PROBES))
    b[where[where >= 0]] = z[where >= 0]
    return float(np.sqrt(np.mean(np.sum(b * solution.information.solve(b), axis=0)) / n))


def _truth(sim: LaserSimulation) -> Float[np.ndarray, "n 3"]:
    return np.asarray(sim.truth.pose[np.searchsorted(sim.truth.t, sim.log.scan_t)])


def _aligned(pose: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """An orthonormal basis of what one rigid motion does to all positions, which alignment takes away."""
    n = len(pose)
    G = np.zeros((n, 2, 3))
    G[:, 0, 0] = G[:, 1, 1] = 1.0
    G[:, 0, 2], G[:, 1, 2] = -pose[:, 1], pose[:, 0]
    return np.asarray(np.linalg.qr(G.reshape(2 * n, 3))[0])
