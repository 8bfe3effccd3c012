"""How a swarm is to be located."""

from typing import Literal

from ..core.config import config

Method = Literal["batch", "robust", "distributed", "ekf", "iekf", "fej"]


@config
class SwarmConfig:
    """covariance: per-robot blocks are computed; max_iterations: of Levenberg-Marquardt or the iterated filter."""

    method: Method = "batch"  # batch, robust, distributed, ekf, iekf or fej
    covariance: bool = True  # whether covariances are computed
    max_iterations: int = 50  # of Levenberg-Marquardt or the iterated filter
    prior_sigma: float = 10.0  # [m] of the filters' first estimate, each coordinate: the paper's P0 = 100 I
    mutual_gate: float = 4.0  # standard deviations of the difference of two mutual sightings
    inlier_gate: float = 3.5  # standard deviations a sighting may miss by and count as an inlier (robust)
    max_rounds: int = 20000  # of talking (distributed)
    tolerance: float = 1e-6  # [rad] of messages between robots (distributed): changes below are not sent on
