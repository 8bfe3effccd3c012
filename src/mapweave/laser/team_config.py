"""Everything that can be set about a team's laser map."""

from ..core.config import config
from .beam import BeamConfig
from .scan_matching import FrontEndConfig


@config
class StepNoise:
    """How far a keyframe's step may err: what the lines of the scan and the wheels tell together, and drift.

    Squares grow with the way. A scan's place is told by lines and wheels; its heading is held by long walls, so that
    what one scan errs does not add up: it is jitter, which every keyframe has once and no step inherits.
    """

    wheels_xy: float = 0.033  # [m per sqrt(m)] sd of odometry, whose scale errs for metres on end
    wheels_turn_per_m: float = 0.0075  # [rad per sqrt(m)]
    wheels_turn: float = 0.018  # [rad per sqrt(rad)]
    trust: float = 2.0  # what one scan's information on its place counts, its returns not being independent
    blur: float = 0.02  # share of the information across lines that noise in their normals feigns along them
    hold: float = 100.0  # headings: how many scans' information a step counts, jitter not adding up
    drift_xy: float = 0.002  # [m per sqrt(m)] and
    drift_turn: float = 0.0003  # [rad per sqrt(m)] that the front end drifts where walls tell all
    jitter_xy: float = 0.002  # [m] and
    jitter_turn: float = 0.001  # [rad] of every keyframe


@config
class ClosureConfig:
    """When a keyframe is matched against an old place, and when the match is believed."""

    every: float = 1.0  # [m] between keyframes that are tried
    tries: int = 2  # matches a robot and step, at most
    reach: float = 5.0  # [m] between the keyframes
    far: float = 20.0  # [m] driven since the old keyframe, within one robot: nearer ones are in its local map
    around: int = 5  # keyframes on either side of the old one that its local map is made of
    within: float = 4.0  # [m] from it
    least_share: float = 0.5  # of the returns must match
    least_matches: int = 60
    gate: float = 16.27  # chi-square of the innovation, 3 degrees of freedom, 99.9 %
    search: float = 0.25  # [m] uncertainty of the relative place beyond which a grid of starts is searched
    trust: float = 1.0  # what a match's information counts
    blur: float = 0.02  # as for steps
    floor_xy: float = 0.008  # [m] and
    floor_turn: float = 0.002  # [rad]: error of the old local map, which no match tells
    kernel: float = 3.0  # [sd] width of the robust kernel
    contradiction: float = 16.27  # squared residual after optimising beyond which a closure is dropped


FRONT_END = FrontEndConfig(
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
"""For scanners that see all round, on wheels that are good over a step."""


@config
class LaserTeamConfig:
    """start_xy, start_turn: sd of the starts of all robots but the first, whose start `map` hangs on."""

    start_xy: float = 0.01  # [m]
    start_turn: float = 0.0087  # [rad], half a degree
    keyframe_distance: float = 0.6  # [m] or
    keyframe_turn: float = 1.0  # [rad]: a keyframe of the pose graph beyond either
    least_beams: int = 10  # scans with fewer returns are not matched
    least_share: float = 0.25  # of the returns must match, or odometry is taken
    teammate: float = 0.45  # [m] around a teammate: returns from there are not walls
    near: float = 6.0  # [m] a wall seen from within is not drawn again by returns from beyond
    open_share: float = 0.9  # of the scanner's range is free where a beam does not come back
    resolve_share: float = 0.02  # the graph is solved anew when it has grown by this share, and
    resolve_least: int = 8  # so many keyframes at least, or
    resolve_innovation: float = 2.0  # [sd] when a closure moved a pose by more than this
    beams: BeamConfig = BeamConfig()
    front_end: FrontEndConfig = FRONT_END
    steps: StepNoise = StepNoise()
    closures: ClosureConfig = ClosureConfig()
