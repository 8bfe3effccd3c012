"""How well each proposal knows the distance along a flush wall, which geometry does not show."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...laser.beam import beams
from ...laser.scan_matching import FrontEndConfig
from ...laser.scan_odometry import ScanOdometry
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import choose_feature
from ...sim.corridor import CorridorConfig, simulate_corridor
from .methods import WHEELS

STRETCH = 40  # scans: 10 m
STRAIGHT = 0.05  # [rad] turned in a stretch at most


@dataclass(frozen=True, slots=True)
class AlongRow:
    """error: (seeds,) root mean square error [m] of the distance driven in straight stretches of 10 m."""

    name: str
    error: Float[np.ndarray, " s"]


def try_along(seeds: range, loop: CorridorConfig | None = None) -> tuple[AlongRow, ...]:
    """Wheels, matching that trusts them little (the default), and matching that knows how good they are."""
    cases: tuple[tuple[str, FrontEndConfig | None, str], ...] = (
        ("odometry", None, "none"),
        ("matching, geometry, wheels trusted little", FrontEndConfig(), "none"),
        ("matching, geometry, wheels trusted as they deserve", WHEELS, "none"),
        ("matching, intensity, wheels trusted little", FrontEndConfig(), "normalised"),
    )
    error = np.empty((len(cases), len(seeds)))
    for s, seed in enumerate(seeds):
        sim = simulate_corridor(loop, seed)
        truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
        for row, (_, front_end, name) in enumerate(cases):
            cfg = LaserConfig(feature=name)
            feature = choose_feature(sim.log, cfg)
            way = ScanOdometry(front_end or FrontEndConfig(), feature=feature.name, matching=front_end is not None)
            for scan in sim.log.scans:
                way.advance(scan, beams(scan, feature.name, feature.calibration, cfg.beam))
            error[row, s] = along_error(np.array(way.poses), truth)
    return tuple(AlongRow(name, e) for (name, _, _), e in zip(cases, error, strict=True))


def along_error(poses: Float[np.ndarray, "m 3"], truth: Float[np.ndarray, "m 3"]) -> float:
    """Root mean square error [m] of the distance driven over stretches in which the robot does not turn."""
    driven, true = (se2.between(p[:-STRETCH], p[STRETCH:]) for p in (poses, truth))
    straight = np.abs(true[:, 2]) < STRAIGHT
    miss = np.hypot(driven[:, 0], driven[:, 1]) - np.hypot(true[:, 0], true[:, 1])
    return float(np.sqrt(np.mean(miss[straight] ** 2))) if straight.any() else float("nan")
