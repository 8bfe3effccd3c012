"""How much a difference in brightness should count: found from the log, and the error against it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from ...core import se2
from ...core.workers import Progress, no_progress
from ...laser.beam import Beams, beams
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import choose_feature, map_laser
from ...sim.corridor import CorridorConfig, simulate_corridor
from .methods import ICP, score

ALPHAS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # [m^2 per q^2]
REACH = 0.15  # [m] nearest returns of two scans farther apart are not of one place


def estimate_alpha(scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], cell: float = 0.1) -> float:
    """`sigma_s^2 / sigma_q^2` [m^2 per q^2]: what eq. 1 must weigh with, for D to be a chi-square but for its scale.

    Both from nearest returns of scans that follow one another, laid together by odometry `poses`: sigma_q^2 from how
    their brightness differs, sigma_s^2 from how far they lie apart (an axis), and the places of a map kept in cells
    of `cell` [m] are uncertain by `cell^2 / 12` besides. Medians, so that the rims of posters do not count. nan where
    scans share nothing.
    """
    apart: list[np.ndarray] = []
    differ: list[np.ndarray] = []
    for k in range(len(scans) - 1):
        if not len(scans[k].q) or not len(scans[k + 1].q):
            continue
        points = se2.act(se2.between(poses[k], poses[k + 1]), scans[k + 1].s)
        distance, nearest = cKDTree(scans[k].s).query(points)
        near = np.asarray(distance) < REACH
        apart.append(np.asarray(distance)[near])
        differ.append((scans[k + 1].q - scans[k].q[nearest])[near])
    if not apart or not sum(len(a) for a in apart):
        return float("nan")
    place = float(np.median(np.concatenate(apart) ** 2)) / (2.0 * np.log(2.0)) + cell**2 / 12.0
    light = (1.4826 * float(np.median(np.abs(np.concatenate(differ))))) ** 2
    return place / light if light > 0 else float("nan")


@dataclass(frozen=True, slots=True)
class AlphaCurve:
    """ate: (alphas, seeds) [m] of Intensity-ICP; estimate: (seeds,) by log; at_estimate: (seeds,) [m] its error."""

    alphas: tuple[float, ...]
    ate: Float[np.ndarray, "a s"]
    estimate: Float[np.ndarray, " s"]
    at_estimate: Float[np.ndarray, " s"]


def alpha_curve(seeds: range, loop: CorridorConfig | None = None, on_progress: Progress = no_progress) -> AlphaCurve:
    """Intensity-ICP on the ring with every alpha, and with the one found from its own log."""
    ate = np.empty((len(ALPHAS), len(seeds)))
    estimate, at_estimate = np.empty(len(seeds)), np.empty(len(seeds))
    for s, seed in enumerate(seeds):
        sim = simulate_corridor(loop, seed)
        feature = choose_feature(sim.log, ICP)
        seen = [beams(scan, feature.name, feature.calibration, ICP.beam) for scan in sim.log.scans]
        estimate[s] = estimate_alpha(seen, np.array([scan.odometry for scan in sim.log.scans]))
        for a, alpha in enumerate((*ALPHAS, float(estimate[s]))):
            on_progress("alpha", s * (len(ALPHAS) + 1) + a, len(seeds) * (len(ALPHAS) + 1))
            error = score(map_laser(sim.log, with_alpha(ICP, alpha), seed).track, sim.truth)
            if a < len(ALPHAS):
                ate[a, s] = error
            else:
                at_estimate[s] = error
    return AlphaCurve(ALPHAS, ate, estimate, at_estimate)


def with_alpha(cfg: LaserConfig, alpha: float) -> LaserConfig:
    """`cfg` with `alpha` wherever a feature is weighed."""
    return replace(
        cfg,
        icp=replace(cfg.icp, alpha=alpha),
        cells=replace(cfg.cells, alpha=alpha),
        front_end=replace(cfg.front_end, alpha=alpha),
    )
