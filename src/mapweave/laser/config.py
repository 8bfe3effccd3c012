"""Everything that can be set about laser maps: of one log, and of a team that explores."""

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.errors import ConfigError
from .beam import FEATURES, BeamConfig, CalibrationConfig
from .icp import IcpConfig
from .joint_pass import JointPassConfig
from .keyframe_graph import KeyframeGraphConfig
from .keyframes import KeyframeConfig, StepNoise
from .known_places import KnownPlacesConfig
from .log_warnings import CopyCheck, JumpCheck, LagCheck, WheelCheck
from .merge_search import MergeConfig
from .motion_agreement import MotionCheck
from .moving import MovingConfig
from .occupancy_mapper import LayingConfig
from .particle_grid import CellConfig
from .scan_matching import FrontEndConfig
from .submap_loops import SubmapLoopConfig

METHODS = ("particle", "graph", "gated", "icp")
LIKELIHOODS = ("matched", "paper")


@config
class FilterConfig:
    """The particle filter; a single map refined the same way is the `gated` method's.

    proposal "front end": particles move as scan matching says and every particle is refined against its own map;
    "odometry": they move as odometry says and are not refined, which is the paper's filter.
    """

    proposal: str = "front end"  # "front end": particles move as matching says and are refined; "odometry": the paper's
    update_distance: float = 0.4  # [m] moved, or
    update_turn: float = 0.4  # [rad] moved before weights and maps change
    sd_xy: float = 0.02  # [m] + sd_xy_per_m d: spread of the particles' moves
    sd_xy_per_m: float = 0.05  # and so much more a metre driven
    sd_turn: float = 0.005  # [rad] + sd_turn_per_m d
    sd_turn_per_m: float = 0.0  # [rad] and so much more a metre driven
    refine_iterations: int = 3  # Gauss-Newton steps of refining; 0: none
    refine_neff: float = 60.0  # independent returns in a scan, for refining
    refine_sigma: float = 0.02  # [m] of each
    refine_kappa: float = 0.1  # [m] width of the robust kernel
    refine_tangent: float = 0.1  # weight of the error along the line, with a feature and
    refine_bare_tangent: float = 0.03  # and without a feature
    refine_sd_xy: float = 0.05  # [m] a particle may be moved by refining and
    refine_sd_turn: float = 0.01  # [rad] turned
    neff: float = 30.0  # independent returns in a scan, for weighing, with a feature and
    bare_neff: float = 10.0  # and without a feature
    sigma: float = 0.05  # [m] of each
    shared: float = 0.5  # a beam counts when matched in this share of the particles
    paper_sigma2: float = 7e-4  # [m^2] sigma_z of the paper's likelihood
    least_beams: int = 10  # scans with fewer returns change no weights


DRIFTING = StepNoise(wheels_xy=0.1, wheels_turn_per_m=0.03, wheels_turn=0.1, drift_xy=0.005, drift_turn=0.001)
"""Steps of any robot's log: wheels that may be poor, front ends that see half the circle."""


@config
class GraphConfig:
    """The graph method: keyframes, loops, and the last pass over everything. lineage: the noise of steps along the best
    particle's trajectory, which light holds where walls do not.
    """

    hypotheses: int = 100  # particles that find the trajectory where light tells places apart; 0: scan odometry alone
    loops: bool = True  # whether loops are looked for
    unfound: int = 6  # searches for old places in a row that find none, from which it is a warning
    unsure: float = 3.0  # times the graph's covariances are those told: errors of scans one after the other are alike
    last_pass: bool = True  # whether all keyframes are matched jointly in the end, and every scan laid on them
    keyframe_graph: KeyframeGraphConfig = KeyframeGraphConfig(
        resolve_share=0.05, keyframes=KeyframeConfig(distance=0.4, turn=0.4, noise=DRIFTING)
    )
    lineage: StepNoise = StepNoise(wheels_xy=0.015, drift_xy=0.005, drift_turn=0.001)
    loop_search: SubmapLoopConfig = SubmapLoopConfig()
    known_places: KnownPlacesConfig = KnownPlacesConfig()
    joint: JointPassConfig = JointPassConfig()


@config
class MomentConfig:
    """When rows of a log are of one moment, and when they contradict each other: their stamps are wrong then."""

    within: float = 0.002  # [s] in which a robot hardly moves
    apart: float = 0.02  # [m] by which such rows contradict each other
    turned: float = 0.05  # [rad] the same of headings
    scan_counts: int = 2  # rows of odometry that a scan's pose, which was matched, outweighs


@config
class LaserConfig:
    """Settings of laser SLAM, table `[laser]`: method, particle filter, matching, occupancy, pose graph, merging."""

    method: str = "particle"  # how a log is mapped: particle, graph, gated or icp
    particles: int = 100  # hypotheses of the particle filter
    feature: str = "normalised"  # light sent back: normalised, raw or none
    likelihood: str = "matched"  # what weighs particles: matched, or as in the paper
    resample: float = 0.5  # when n_eff falls to this share of the particles; 1: always, as the paper does
    gate: float = 3.0  # a match may deviate from odometry by this many standard deviations in x, y and theta,
    gate_sd_xy: float = 0.07  # [m] standard deviation in place and
    gate_sd_turn: float = 0.07  # [rad] being added to those of the front end: odometry and scan may be stamped apart
    matcher: str = "map"  # of the gated method: "map" (Gauss-Newton on lines) or "icp" (the paper's)
    threads: int = 0  # 0: as many as there are free cores; the result is the same
    raw_alpha: float = 0.1  # [m^2 per q^2] what raw intensity counts, which range changes too
    resolution: float = 0.1  # [m] cell of the map handed over
    beam: BeamConfig = BeamConfig()
    moving: MovingConfig = MovingConfig()
    wheels: WheelCheck = WheelCheck()
    motion: MotionCheck = MotionCheck()
    jump: JumpCheck = JumpCheck()
    lag: LagCheck = LagCheck()
    copies: CopyCheck = CopyCheck()
    moment: MomentConfig = MomentConfig()
    cells: CellConfig = CellConfig()
    front_end: FrontEndConfig = FrontEndConfig()
    filter: FilterConfig = FilterConfig()
    icp: IcpConfig = IcpConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    graph: GraphConfig = GraphConfig()
    merge: MergeConfig = MergeConfig()

    def eps(self, sd: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """How far [m, m, rad] a match may deviate from an odometry increment allowed `sd`."""
        return np.asarray(self.gate * (sd + np.array([self.gate_sd_xy, self.gate_sd_xy, self.gate_sd_turn])))

    def check(self) -> None:
        """Raises ConfigError for a word that is not known or a number out of range."""
        for name, known in (
            ("method", METHODS),
            ("feature", FEATURES),
            ("likelihood", LIKELIHOODS),
            ("matcher", ("map", "icp")),
        ):
            if (said := getattr(self, name)) not in known:
                raise ConfigError(f"{name}: expected one of {', '.join(known)}, found {said!r}")
        if self.filter.proposal not in {"front end", "odometry"}:
            raise ConfigError(f"filter.proposal: expected 'front end' or 'odometry', found {self.filter.proposal!r}")
        if self.particles < 1:
            raise ConfigError(f"particles: expected at least 1, found {self.particles}")
        if not 0.0 <= self.resample <= 1.0:
            raise ConfigError(f"resample: expected a share from 0 to 1, found {self.resample}")


PAPER_FILTER = FilterConfig(
    proposal="odometry",
    update_distance=0.0,
    update_turn=0.0,
    sd_xy=0.005,
    sd_xy_per_m=0.04,
    sd_turn=0.002,
    sd_turn_per_m=0.015,
    refine_iterations=0,
    bare_neff=30.0,
)
"""The paper's filter for wheels that are good over a step: odometry proposes, every scan weighs."""


ALL_ROUND = FrontEndConfig(
    size=512,
    keyframes=40,
    keyframe_turn=1.0,
    alpha=0.0,
    neff=20.0,
    sd_xy=0.01,
    sd_xy_per_m=0.06,
    sd_turn=0.01,
    sd_turn_per_m=0.03,
    sd_turn_per_rad=0.06,
)
"""The front end for scanners that see all round, on wheels that are good over a step."""


@config
class LaserTeamConfig:
    """A team whose starts are known: those of all robots but the first err, `map` hangs on the first's."""

    teammate: float = 0.45  # [m] around a teammate: returns from there are not walls
    open_share: float = 0.9  # share of the scanner's range that is free where a beam does not come back
    beams: BeamConfig = BeamConfig()
    front_end: FrontEndConfig = ALL_ROUND
    graph: KeyframeGraphConfig = KeyframeGraphConfig()
    map: LayingConfig = LayingConfig(near=6.0)
