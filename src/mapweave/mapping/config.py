"""Everything that can be set about laser maps: of logs, and of a team that explores."""

from ..core.config import config, expect_positive
from ..core.errors import ConfigError
from ..laser.beam import BeamConfig
from ..laser.config import LaserTrackingConfig
from ..laser.joint_pass import JointPassConfig
from ..laser.keyframes import KeyframeConfig, StepNoise
from ..laser.occupancy_mapper import LayingConfig
from ..laser.scan_matching import FrontEndConfig
from .keyframe_graph import KeyframeGraphConfig
from .known_places import KnownPlacesConfig
from .merge_search import MergeConfig

DRIFTING = StepNoise(wheels_xy=0.1, wheels_turn_per_m=0.03, wheels_turn=0.1, drift_xy=0.005, drift_turn=0.001)
"""Steps of any robot's log: wheels that may be poor, front ends that see half the circle."""


@config
class GraphConfig:
    """The graph method: keyframes, loops, and the last pass over everything."""

    hypotheses: int = 100  # particles that find the trajectory where light tells places apart; 0: scan odometry alone
    loops: bool = True  # whether loops are looked for
    unsure: float = 3.0  # times the graph's covariances are those told: errors of scans one after the other are alike
    last_pass: bool = True  # whether all keyframes are matched jointly in the end, and every scan laid on them
    keyframe_graph: KeyframeGraphConfig = KeyframeGraphConfig(
        resolve_share=0.15, keyframes=KeyframeConfig(distance=0.4, turn=0.4, noise=DRIFTING)
    )
    known_places: KnownPlacesConfig = KnownPlacesConfig()
    joint: JointPassConfig = JointPassConfig()


@config
class LaserConfig(LaserTrackingConfig):
    """Settings of laser SLAM, table `[laser]`: method, particle filter, matching, occupancy, pose graph, merging."""

    graph: GraphConfig = GraphConfig()
    merge: MergeConfig = MergeConfig()

    def check(self) -> None:
        """As of one log's trackers, and of what weaves their maps."""
        LaserTrackingConfig.check(self)
        expect_positive(self, "laser", "graph.unsure", "graph.joint.widths", "merge.start_sd", "merge.start_turn_sd")
        if not 0.0 < self.merge.sure <= 1.0:
            raise ConfigError(f"merge.sure: expected a probability above 0 and up to 1, found {self.merge.sure}")


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
    beams: BeamConfig = BeamConfig()
    front_end: FrontEndConfig = ALL_ROUND
    graph: KeyframeGraphConfig = KeyframeGraphConfig()
    map: LayingConfig = LayingConfig(near=6.0)
