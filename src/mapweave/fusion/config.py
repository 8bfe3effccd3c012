"""How fusing weighs, doubts and refuses."""

from typing import Literal

from ..core.config import config
from ..core.errors import ConfigError
from .identities import IdentityConfig

MISLABELLED = 0.05  # probability that one robot gives a landmark a wrong name

VARIANCE_PRIOR = 4.0  # degrees of freedom with which a map's variance factor is held at 1
FUSE_GATE = 0.35  # [m] from where the others put a landmark, below which it is never doubted
GATE_SIGMAS = 5.0  # standard deviations, likewise
FUSE_REFUSE = 0.5  # [m] median distance of shared landmarks below which a map is not grossly wrong
FUSE_ODDS = 1000.0  # how much likelier than chance the same place must be for maps of two recordings
MISLABELLED_CHI2 = 18.0  # chi-square (two degrees) from which a shared name counts as wrong
FUSE_WEIGHED = 40  # landmarks in common that are weighed for it at most; more than enough
START_TOLERANCE = 0.5  # [m] between a start given and the one found from landmarks, above which it is told
FUSE_DELTA = 1.0  # the paper's factor on the noise
CONSTANT_VARIANCE = 1e-3  # of every relative measurement with weights="constant" [m^2], [rad^2]
SIGHTING_EVERY = 5.0  # [s] from one sighting of a robot by another to the next that counts
JUDGE_AGAIN = 1.25  # times the sightings of the last judgement, from which online fusing judges all anew

Weights = Literal["constant", "paper", "diagonal", "full", "full-scaled", "naive"]
Identities = Literal["known", "unknown"]


@config
class FuseConfig:
    """Settings of fusing landmark maps: weights, evidence for the same place, outlier rejection.

    weights: "full-scaled" takes each map's full covariance, a scale and a variance factor of its own; "full" its
    covariance alone; "constant", "paper", "diagonal" the paper's relative information; "naive" the plain mean.
    A landmark is doubted in one map when the other maps put it further away than `gate` and `gate_sigmas`; a map is
    refused when half its shared landmarks lie further off than `refuse` and as many deviations, or when its landmarks
    are no evidence for the same place (`same_place`).
    """

    weights: Weights = "full-scaled"  # constant, paper, diagonal, full, full-scaled or naive
    identities: Identities = "known"  # whether equal names mean one landmark, or places alone tell
    scale_sigma: float = 0.02  # standard deviation of a map's scale about 1, a priori
    floor: float = 0.01  # [m] independent error of every landmark of every map that no covariance knows of
    repeats: int = 1  # times each relative measurement is fed (the paper's habit); more than 1 is overconfident
    robot_sightings: bool = False  # sightings of robots tie the frames too; worse where tracks err, as on real logs
    matching: IdentityConfig = IdentityConfig()

    def __post_init__(self) -> None:
        if self.scale_sigma <= 0:
            raise ConfigError(f"scale_sigma: expected a number above 0, found {self.scale_sigma}")
        if self.floor < 0:
            raise ConfigError(f"floor: expected 0 or more, found {self.floor}")
