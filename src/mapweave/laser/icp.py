"""Intensity-ICP [Hara07]: scans laid on each other by nearest points whose brightness agrees too."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..kernels.laser.icp import IcpRules, intensity_icp

ICP_ITERATIONS = 50  # of pairing and solving, at most
ICP_TOLERANCE = 1e-4  # [m, rad] a smaller step ends the search
ICP_LEAST_PAIRS = 20  # of returns, or the match fails

CELL = 0.1  # [m] of the grid the nearest points are found on; the result does not depend on it


@config
class IcpConfig:
    alpha: float = 1.0  # [m^2 per q^2] what a difference in the feature counts
    gate: float = 0.4  # [m] farthest D^(1/2) of a pair in the first iteration,
    gate_decay: float = 0.8  # shrinking by this
    least_gate: float = 0.1  # [m] down to this


class IcpMatch(NamedTuple):
    """pose: `T_map_robot` where the scan fits; status: "converged", "stopped" (out of iterations) or "failed"."""

    pose: Float[np.ndarray, "3"]
    status: str
    pairs: int
    iterations: int
    rms: float


def match(
    reference: Float[np.ndarray, "m 3"], scan: Float[np.ndarray, "n 3"], start: Float[np.ndarray, "3"], cfg: IcpConfig
) -> IcpMatch:
    """Where `scan` (x, y, q in the robot frame) fits `reference` (x, y, q in the map), searched from pose `start`.

    First step: for every point the reference point of least D = |m_s - z_s|^2 + alpha (m_q - z_q)^2 # [Hara07] eq. 1
    inside the gate. Second step: the pose of least F = mean |m_s - T z_s|^2 # [Hara07] eq. 2, in closed form.
    Third step: the scan moved by it # [Hara07] eq. 3, and again.
    """
    rules = IcpRules(
        cfg.alpha, cfg.gate, cfg.least_gate, cfg.gate_decay, ICP_ITERATIONS, ICP_TOLERANCE, ICP_LEAST_PAIRS, CELL
    )
    pose, pairs, iterations, mean2, _ = intensity_icp(
        np.ascontiguousarray(reference, dtype=float),
        np.ascontiguousarray(scan, dtype=float),
        np.ascontiguousarray(start, dtype=float),
        rules,
    )
    status = "failed" if pairs < ICP_LEAST_PAIRS else "stopped" if iterations == ICP_ITERATIONS else "converged"
    pose[2] = se2.wrap_angle(pose[2])
    return IcpMatch(pose, status, int(pairs), int(iterations), float(np.sqrt(mean2)))
