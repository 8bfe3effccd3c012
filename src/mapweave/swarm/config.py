"""How a swarm is to be located, and when the answer is doubted."""

from typing import Literal

from ..core.config import config

ALTERNATIVES_MOST = 100  # sightings up to which this is asked
ALTERNATIVES_MOST_TURNED = 60  # and in space without axes, where a robot has six unknowns
ALTERNATIVES_BEAM = 8  # sets a round whose neighbours are tried
ALTERNATIVES_UNLIKELY = 14.0  # log of the odds against a set from which on its neighbours are not
ALTERNATIVES_SWAPS = 4  # sightings called wrong up to which one may stand in place of another
ALTERNATIVES_EXTENT = 10.0  # median sighting lengths within which a robot is expected before anything is seen
ALTERNATIVES_GATE = 1e-5  # probability to lie by chance outside the gate of a covariance
ALTERNATIVES_DOUBT = 0.02  # probability of lying outside from which on a robot's place is doubted

MUTUAL_GATE = 4.0  # standard deviations of the difference of two mutual sightings
SWARM_TOLERANCE = 1e-6  # [rad] of messages between robots (distributed): changes below are not sent on
SWARM_SELDOM = 4  # a robot with no more sightings than this, made or suffered, is kept apart from its neighbours
SWARM_NEAREST = 0.1  # median sighting lengths that it is kept apart
SWARM_LOOSE = 10.0  # median sighting lengths a robot that nothing determines may stray from its start

Method = Literal["batch", "robust", "distributed", "ekf", "iekf", "fej"]


@config
class SwarmConfig:
    """covariance: per-robot blocks are computed; max_iterations: of Levenberg-Marquardt or the iterated filter."""

    method: Method = "batch"  # batch, robust, distributed, ekf, iekf or fej
    covariance: bool = True  # whether covariances are computed
    max_iterations: int = 50  # of Levenberg-Marquardt or the iterated filter
    prior_sigma: float = 10.0  # [m] of the filters' first estimate, each coordinate: the paper's P0 = 100 I
    max_rounds: int = 20000  # of talking (distributed)
