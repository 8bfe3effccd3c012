# ruff: noqa: I001, A004  (a module a line; `map` is ours)
# Every public name and the module it comes from: type checkers read it, and `__init__.py` imports by it.

from .api.compare import Comparison as Comparison, compare as compare
from .api.configuration import configuration as configuration
from .api.demo import SelfTest as SelfTest, demo as demo, self_test as self_test
from .api.causes import Cause as Cause, Causes as Causes
from .api.doctor import Diagnosis as Diagnosis, doctor as doctor
from .api.view import edit as edit
from .api.evaluate import Evaluation as Evaluation, evaluate as evaluate
from .api.evaluate import RelationEvaluation as RelationEvaluation
from .api.evaluate import SwarmEvaluation as SwarmEvaluation
from .api.evaluate import TeamEvaluation as TeamEvaluation
from .api.evaluate import TrackEvaluation as TrackEvaluation
from .api.explore import LandmarkExploration as LandmarkExploration, explore as explore
from .api.explore import LaserExploration as LaserExploration
from .api.fuse import fuse as fuse
from .api.slam import LandmarkSlam as LandmarkSlam
from .api.laser_result import LaserResult as LaserResult
from .api.slam import LaserSlam as LaserSlam
from .api.live import live_map as live_map, live_robot as live_robot
from .api.live_explore import live_explore as live_explore
from .api.live_laser import live_follow as live_follow
from .api.live import live_keys as live_keys
from .api.live_laser import LiveLaser as LiveLaser, LivePlace as LivePlace
from .api.live import LiveRobot as LiveRobot
from .api.live import live_robots as live_robots
from .api.live_ros2 import RosOptions as RosOptions
from .api.live import live_view as live_view
from .api.result import load as load
from .api.localize import Localizer as Localizer
from .api.localize import LocalizeJobConfig as LocalizeJobConfig, LocalizeResult as LocalizeResult, localize as localize
from .api.locate import LocateConfig as LocateConfig, locate as locate
from .api.located import Located as Located
from .api.map import map as map
from .api.map_landmarks import LandmarkMapConfig as LandmarkMapConfig
from .api.map_laser import LaserMapConfig as LaserMapConfig
from .api.map_mixed import MixedMapConfig as MixedMapConfig, MixedResult as MixedResult
from .api.map_options import LaserOptions as LaserOptions
from .api.located import Moved as Moved
from .api.ranges import RangeResult as RangeResult, solve_ranges as solve_ranges
from .api.read import Log as Log, read as read
from .api.result import MapResult as MapResult, Result as Result
from .api.simulate import SimulatedTeam as SimulatedTeam, simulate_landmarks as simulate_landmarks
from .api.simulate import SimulatedDrive as SimulatedDrive, simulate_laser as simulate_laser
from .api.simulate import SimulatedSwarm as SimulatedSwarm, simulate_swarm as simulate_swarm
from .api.simulate import SimulatedMixedTeam as SimulatedMixedTeam, simulate_team as simulate_team
from .api.solve import SolveResult as SolveResult, solve_pose_graph as solve_pose_graph
from .api.team import TeamResult as TeamResult
from .api.view import view as view
from .core.bearings import BearingTable as BearingTable
from .core.errors import (
    ConfigError as ConfigError,
    DataError as DataError,
    EstimateError as EstimateError,
    MapweaveError as MapweaveError,
    ReaderError as ReaderError,
    UsageError as UsageError,
    VerdictError as VerdictError,
)
from .core.findings import Finding as Finding
from .core.laser_log import LaserLog as LaserLog
from .core.records import Track as Track
from .core.version import __version__ as __version__
from .core.workers import Progress as Progress
from .exploration.landmarks.config import ExploreConfig as ExploreConfig
from .exploration.laser.config import LaserMissionConfig as LaserMissionConfig
from .fusion.config import FuseConfig as FuseConfig
from .landmarks.config import EkfSlamConfig as EkfSlamConfig
from .laser.pose_graph import PoseGraph as PoseGraph
from .laser.scan_odometry import PoseEstimate as PoseEstimate
from .live.told import LiveTeam as LiveTeam, TeamGoal as TeamGoal, TeamGrid as TeamGrid, TeamRobot as TeamRobot
from .live.transport import Network as Network
from .mapping.config import LaserConfig as LaserConfig
from .papers.hamatani.reproduce import (
    HamataniReproduction as HamataniReproduction,
    reproduce_hamatani as reproduce_hamatani,
)
from .papers.hara.reproduce import HaraReproduction as HaraReproduction, reproduce_hara as reproduce_hara
from .papers.kojima.reproduce import KojimaReproduction as KojimaReproduction, reproduce_kojima as reproduce_kojima
from .papers.yuan.reproduce import YuanReproduction as YuanReproduction, reproduce_yuan as reproduce_yuan
from .sim.laser_worlds import (
    CorridorConfig as CorridorConfig,
    OfficeConfig as OfficeConfig,
    TunnelConfig as TunnelConfig,
)
from .sim.swarm import SwarmScene as SwarmScene
from .swarm.moving.result import TrackConfig as TrackConfig
