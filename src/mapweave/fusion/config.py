"""How fusing weighs, doubts and refuses."""

from typing import Literal

from ..core.config import config
from .identities import IdentityConfig

Weights = Literal["constant", "paper", "diagonal", "full", "full-scaled", "naive"]
Identities = Literal["known", "unknown"]


@config
class FuseConfig:
    """weights: "full-scaled" takes each map's full covariance, a scale and a variance factor of its own; "full" its
    covariance alone; "constant", "paper", "diagonal" the paper's relative information; "naive" the plain mean.

    scale_sigma: a priori deviation of a map's scale from 1. floor: independent error of every landmark of every map
    that no covariance knows of [m]. A landmark is doubted in one map when the other maps put it further away than
    `gate` [m] and `gate_sigmas` standard deviations; a map is refused when half its shared landmarks lie further off
    than `refuse` [m] and as many deviations. repeats: how often each relative measurement is fed (the paper's
    habit; anything but 1 counts one measurement many times). delta: the paper's factor on the noise.
    robot_sightings: sightings of robots by robots tie the frames too (on real logs, whose tracks err, this can make
    a map worse).
    """

    weights: Weights = "full-scaled"
    identities: Identities = "known"
    scale_sigma: float = 0.02
    floor: float = 0.01
    variance_prior: float = 4.0  # degrees of freedom with which a map's variance factor is held at 1
    gate: float = 0.35
    gate_sigmas: float = 5.0
    refuse: float = 0.5
    repeats: int = 1
    delta: float = 1.0
    constant_variance: float = 1e-3
    robot_sightings: bool = False
    matching: IdentityConfig = IdentityConfig()
