"""How a swarm is to be located, and when the answer is doubted."""

from typing import Literal

import numpy as np

from ..core.config import config

Method = Literal["batch", "robust", "distributed", "ekf", "iekf", "fej"]


@config
class ConsistencyConfig:
    """Which sightings cannot be, before anything is located."""

    gate: float = float(6.0 * np.sqrt(2.0))  # standard deviations by which two sightings of one pair may differ
    rounded: float = 4.0  # times as often as rounding explains, equal readings without stamps are copies
    least_pairs: int = 5  # mutual pairs below which nothing is said about axes
    axis_angle: float = 0.5  # [rad] median miss of mutual sightings up to which axes count as common, or
    axis_sigmas: float = 20.0  # standard deviations of it


@config
class RobustConfig:
    """Method `robust`: how wrong sightings are found."""

    reweights: int = 12  # of the start of least unsquared deviations
    cooling: float = 1.6  # by which the kernel's width is divided at each stage
    stage_iterations: int = 4  # of Levenberg-Marquardt at each stage
    reselections: int = 3  # of the sightings that agree, at most
    suspect: float = 0.3  # share of a robot's sightings that disagree from which on it may stand at a wrong place
    relocations: int = 3  # rounds of putting suspects elsewhere, since they may be neighbours
    crossings_of: int = 40  # sightings of one robot whose crossings are tried: 780 pairs


@config
class FallenConfig:
    """Method `robust`: sightings that agree only because robots fell in with them, each left out in turn."""

    hops: int = 3  # sightings away from the two, beyond which robots are held while one sighting is left out
    few: int = 4000  # sightings up to which all are asked, not only those of hardly known length
    promise: float = 0.4  # of the limit: what the linear model must promise for a sighting to be left out at all
    unchecked: float = 0.8  # share of its direction that a sighting alone tells, from which on nothing checks it
    near_miss: float = 70.0  # times the limit, squared residual up to which a sighting called wrong is tried again
    swaps: int = 2  # sightings let go at most for one that is taken in
    undecided: float = 0.5  # of the limit: a loss up to which a sighting called wrong may as well be right
    against: float = 6.0  # standard deviations of their difference beyond which two of a pair are not both right
    likely: float = 0.015  # probability of being wrong from which on a sighting may as well be


@config
class AlternativesConfig:
    """Method `robust`, small networks: other sets of wrong sightings, and how likely they put a robot elsewhere."""

    most: int = 100  # sightings up to which this is asked
    rounds: int = 3  # of steps from the most likely sets to their neighbours
    beam: int = 8  # sets a round whose neighbours are tried
    unlikely: float = 14.0  # log of the odds against a set from which on its neighbours are not
    swaps: int = 4  # sightings called wrong up to which one may stand in place of another
    extent: float = 10.0  # median sighting lengths within which a robot is expected before anything is seen
    gate: float = 1e-5  # probability to lie by chance outside the gate of a covariance
    doubt: float = 0.02  # probability of lying outside from which on a robot's place is doubted


@config
class VerdictConfig:
    """When an answer is doubted."""

    doubt: float = 1e-3  # probability below which a chi-square is called wrong
    many: float = 0.07  # share called wrong beyond which single sightings prove nothing: some wrong ones are not found
    too_many: float = 0.25  # share called wrong beyond which nothing does
    weak_share: float = 0.8  # of all variance in one way to move: anchors hold the shape weakly, if a robot errs by
    weak_deviation: float = 3.0  # times the error of one sighting at that distance


@config
class MessagesConfig:
    """Method `distributed`: what is worth telling."""

    relaxation: float = 0.95  # share of a Jacobi step that is taken towards what the neighbours say
    quiet: float = 1e-4  # of the usual distance; a linear step below this is not told
    relinearise: int = 5  # rounds between new linearisations
    faint: float = 1e-8  # a robot's own prior, of the information of one sighting
    firmer: float = 1e-5  # share of a link's own information below which a change of it is not told


CONSISTENCY, ROBUST, VERDICT = ConsistencyConfig(), RobustConfig(), VerdictConfig()


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
    seldom: int = 4  # a robot with no more sightings than this, made or suffered, is kept apart from its neighbours
    nearest: float = 0.1  # median sighting lengths that it is kept apart
    loose: float = 10.0  # median sighting lengths a robot that nothing determines may stray from its start
    consistency: ConsistencyConfig = ConsistencyConfig()
    robust: RobustConfig = RobustConfig()
    fallen: FallenConfig = FallenConfig()
    alternatives: AlternativesConfig = AlternativesConfig()
    messages: MessagesConfig = MessagesConfig()
    verdict: VerdictConfig = VerdictConfig()
