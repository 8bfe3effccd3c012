"""One map, with honest uncertainty, from the logs of many robots.

    import mapweave

    result = mapweave.map(["robot1.bag", "robot2.mcap"], "out")  # joins both logs; writes the folder `out`
    print(result.summary())

Verbs, each with its options in `help(mapweave.map)` and so on:

    map, fuse               one map of the logs of a team; of several results
    read                    a log of any format: its robots, events, tables
    load                    a result read back from its folder
    evaluate                the score of a result against what is true
    compare                 what changed between two laser results of one place
    view                    a result in the browser or in the Rerun viewer
    edit                    a laser result in the browser, to decide by hand on places and robots
    localize                a robot found and followed in a finished laser map
    locate                  the positions of a swarm whose robots see each other
    explore                 robots that decide where to drive
    solve_pose_graph, solve_ranges     a pose graph from anywhere; robots and beacons placed by ranges
    live_robot, live_robots, live_map, live_view, live_keys     a team that drives now
    simulate_landmarks, simulate_laser, simulate_team, simulate_swarm     logs with their truth
    reproduce_kojima, reproduce_hamatani, reproduce_hara, reproduce_yuan     the experiments of four papers
    configuration, demo, doctor     all settings; a first result; a check of the installation

`LandmarkSlam` and `LaserSlam` map one robot while it drives. The other names are the results that verbs give, their
options and settings, and the errors they raise. A name is imported when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from .core.version import __version__ as __version__

if TYPE_CHECKING:
    from .api.compare import Comparison as Comparison
    from .api.compare import compare as compare
    from .api.configuration import configuration as configuration
    from .api.demo import demo as demo
    from .api.doctor import Diagnosis as Diagnosis
    from .api.doctor import doctor as doctor
    from .api.edit import edit as edit
    from .api.evaluate import Evaluation as Evaluation
    from .api.evaluate import evaluate as evaluate
    from .api.evaluate_relations import RelationEvaluation as RelationEvaluation
    from .api.evaluate_swarm import SwarmEvaluation as SwarmEvaluation
    from .api.evaluate_team import TeamEvaluation as TeamEvaluation
    from .api.evaluate_tracks import TrackEvaluation as TrackEvaluation
    from .api.explore import LandmarkExploration as LandmarkExploration
    from .api.explore import explore as explore
    from .api.explore_laser import LaserExploration as LaserExploration
    from .api.fuse import fuse as fuse
    from .api.landmark_slam import LandmarkSlam as LandmarkSlam
    from .api.laser_result import LaserResult as LaserResult
    from .api.laser_slam import LaserSlam as LaserSlam
    from .api.live import live_map as live_map
    from .api.live import live_robot as live_robot
    from .api.live_keys import live_keys as live_keys
    from .api.live_result import LiveRobot as LiveRobot
    from .api.live_robots import live_robots as live_robots
    from .api.live_ros2 import RosOptions as RosOptions
    from .api.live_view import live_view as live_view
    from .api.load import load as load
    from .api.localize import LocalizeJobConfig as LocalizeJobConfig
    from .api.localize import LocalizeResult as LocalizeResult
    from .api.localize import localize as localize
    from .api.locate import LocateConfig as LocateConfig
    from .api.locate import locate as locate
    from .api.located import Located as Located
    from .api.map import map as map  # noqa: A004
    from .api.map_landmarks import LandmarkMapConfig as LandmarkMapConfig
    from .api.map_laser import LaserMapConfig as LaserMapConfig
    from .api.map_mixed import MixedMapConfig as MixedMapConfig
    from .api.map_mixed import MixedResult as MixedResult
    from .api.map_options import LaserOptions as LaserOptions
    from .api.moving_result import Moved as Moved
    from .api.ranges import RangeResult as RangeResult
    from .api.ranges import solve_ranges as solve_ranges
    from .api.read import Log as Log
    from .api.read import read as read
    from .api.result import MapResult as MapResult
    from .api.result import Result as Result
    from .api.simulate_landmarks import SimulatedTeam as SimulatedTeam
    from .api.simulate_landmarks import simulate_landmarks as simulate_landmarks
    from .api.simulate_laser import SimulatedDrive as SimulatedDrive
    from .api.simulate_laser import simulate_laser as simulate_laser
    from .api.simulate_swarm import SimulatedSwarm as SimulatedSwarm
    from .api.simulate_swarm import simulate_swarm as simulate_swarm
    from .api.simulate_team import SimulatedMixedTeam as SimulatedMixedTeam
    from .api.simulate_team import simulate_team as simulate_team
    from .api.solve import SolveResult as SolveResult
    from .api.solve import solve_pose_graph as solve_pose_graph
    from .api.team import TeamResult as TeamResult
    from .api.view import view as view
    from .core.bearings import BearingTable as BearingTable
    from .core.errors import ConfigError as ConfigError
    from .core.errors import DataError as DataError
    from .core.errors import EstimateError as EstimateError
    from .core.errors import MapweaveError as MapweaveError
    from .core.errors import ReaderError as ReaderError
    from .core.errors import UsageError as UsageError
    from .core.errors import VerdictError as VerdictError
    from .core.findings import Finding as Finding
    from .core.laser_log import LaserLog as LaserLog
    from .core.records import Track as Track
    from .core.workers import Progress as Progress
    from .exploration.landmarks.config import ExploreConfig as ExploreConfig
    from .exploration.laser.config import LaserMissionConfig as LaserMissionConfig
    from .fusion.config import FuseConfig as FuseConfig
    from .landmarks.config import EkfSlamConfig as EkfSlamConfig
    from .laser.pose_graph import PoseGraph as PoseGraph
    from .laser.scan_odometry import PoseEstimate as PoseEstimate
    from .live.transport import Network as Network
    from .mapping.config import LaserConfig as LaserConfig
    from .papers.hamatani.reproduce import HamataniReproduction as HamataniReproduction
    from .papers.hamatani.reproduce import reproduce_hamatani as reproduce_hamatani
    from .papers.hara.reproduce import HaraReproduction as HaraReproduction
    from .papers.hara.reproduce import reproduce_hara as reproduce_hara
    from .papers.kojima.reproduce import KojimaReproduction as KojimaReproduction
    from .papers.kojima.reproduce import reproduce_kojima as reproduce_kojima
    from .papers.yuan.reproduce import YuanReproduction as YuanReproduction
    from .papers.yuan.reproduce import reproduce_yuan as reproduce_yuan
    from .sim.laser_worlds import CorridorConfig as CorridorConfig
    from .sim.laser_worlds import OfficeConfig as OfficeConfig
    from .sim.laser_worlds import TunnelConfig as TunnelConfig
    from .sim.swarm import SwarmScene as SwarmScene
    from .swarm.moving.result import TrackConfig as TrackConfig

_HOMES: dict[str, str] = {
    # public name: the module that defines it under the same name; keep in step with the block above, which type
    # checkers read
    # verbs
    "configuration": "api.configuration",
    "demo": "api.demo",
    "doctor": "api.doctor",
    "compare": "api.compare",
    "edit": "api.edit",
    "evaluate": "api.evaluate",
    "explore": "api.explore",
    "fuse": "api.fuse",
    "load": "api.load",
    "localize": "api.localize",
    "locate": "api.locate",
    "map": "api.map",
    "read": "api.read",
    "reproduce_hamatani": "papers.hamatani.reproduce",
    "reproduce_hara": "papers.hara.reproduce",
    "reproduce_kojima": "papers.kojima.reproduce",
    "reproduce_yuan": "papers.yuan.reproduce",
    "simulate_landmarks": "api.simulate_landmarks",
    "simulate_laser": "api.simulate_laser",
    "simulate_swarm": "api.simulate_swarm",
    "simulate_team": "api.simulate_team",
    "solve_pose_graph": "api.solve",
    "solve_ranges": "api.ranges",
    "view": "api.view",
    # a team that drives now
    "LiveRobot": "api.live_result",
    "Network": "live.transport",
    "RosOptions": "api.live_ros2",
    "live_keys": "api.live_keys",
    "live_map": "api.live",
    "live_robot": "api.live",
    "live_robots": "api.live_robots",
    "live_view": "api.live_view",
    # estimators fed by hand
    "LandmarkSlam": "api.landmark_slam",
    "LaserSlam": "api.laser_slam",
    "PoseEstimate": "laser.scan_odometry",
    # what verbs return
    "Comparison": "api.compare",
    "Diagnosis": "api.doctor",
    "Evaluation": "api.evaluate",
    "LandmarkExploration": "api.explore",
    "HamataniReproduction": "papers.hamatani.reproduce",
    "HaraReproduction": "papers.hara.reproduce",
    "KojimaReproduction": "papers.kojima.reproduce",
    "LaserExploration": "api.explore_laser",
    "LaserResult": "api.laser_result",
    "LocalizeResult": "api.localize",
    "Located": "api.located",
    "MapResult": "api.result",
    "MixedResult": "api.map_mixed",
    "Moved": "api.moving_result",
    "RelationEvaluation": "api.evaluate_relations",
    "Result": "api.result",
    "SimulatedDrive": "api.simulate_laser",
    "SimulatedSwarm": "api.simulate_swarm",
    "SimulatedMixedTeam": "api.simulate_team",
    "SimulatedTeam": "api.simulate_landmarks",
    "RangeResult": "api.ranges",
    "SolveResult": "api.solve",
    "SwarmEvaluation": "api.evaluate_swarm",
    "TeamEvaluation": "api.evaluate_team",
    "TeamResult": "api.team",
    "TrackEvaluation": "api.evaluate_tracks",
    "YuanReproduction": "papers.yuan.reproduce",
    # options and worlds
    "CorridorConfig": "sim.laser_worlds",
    "LaserOptions": "api.map_options",
    "OfficeConfig": "sim.laser_worlds",
    "SwarmScene": "sim.swarm",
    "TrackConfig": "swarm.moving.result",
    "TunnelConfig": "sim.laser_worlds",
    # configuration
    "EkfSlamConfig": "landmarks.config",
    "ExploreConfig": "exploration.landmarks.config",
    "FuseConfig": "fusion.config",
    "LandmarkMapConfig": "api.map_landmarks",
    "LaserConfig": "mapping.config",
    "LaserMapConfig": "api.map_laser",
    "LocalizeJobConfig": "api.localize",
    "LocateConfig": "api.locate",
    "MixedMapConfig": "api.map_mixed",
    "LaserMissionConfig": "exploration.laser.config",
    # data and progress
    "BearingTable": "core.bearings",
    "LaserLog": "core.laser_log",
    "Log": "api.read",
    "Finding": "core.findings",
    "PoseGraph": "laser.pose_graph",
    "Progress": "core.workers",
    "Track": "core.records",
    # errors
    "ConfigError": "core.errors",
    "DataError": "core.errors",
    "EstimateError": "core.errors",
    "MapweaveError": "core.errors",
    "ReaderError": "core.errors",
    "UsageError": "core.errors",
    "VerdictError": "core.errors",
}

__all__ = (
    "BearingTable",
    "Comparison",
    "ConfigError",
    "CorridorConfig",
    "DataError",
    "Diagnosis",
    "EkfSlamConfig",
    "EstimateError",
    "Evaluation",
    "ExploreConfig",
    "Finding",
    "FuseConfig",
    "HamataniReproduction",
    "HaraReproduction",
    "KojimaReproduction",
    "LandmarkExploration",
    "LandmarkMapConfig",
    "LandmarkSlam",
    "LaserConfig",
    "LaserExploration",
    "LaserLog",
    "LaserMapConfig",
    "LaserMissionConfig",
    "LaserOptions",
    "LaserResult",
    "LaserSlam",
    "LiveRobot",
    "LocalizeJobConfig",
    "LocalizeResult",
    "LocateConfig",
    "Located",
    "Log",
    "MapResult",
    "MapweaveError",
    "MixedMapConfig",
    "MixedResult",
    "Moved",
    "Network",
    "OfficeConfig",
    "PoseEstimate",
    "PoseGraph",
    "Progress",
    "RangeResult",
    "ReaderError",
    "RelationEvaluation",
    "Result",
    "RosOptions",
    "SimulatedDrive",
    "SimulatedMixedTeam",
    "SimulatedSwarm",
    "SimulatedTeam",
    "SolveResult",
    "SwarmEvaluation",
    "SwarmScene",
    "TeamEvaluation",
    "TeamResult",
    "Track",
    "TrackConfig",
    "TrackEvaluation",
    "TunnelConfig",
    "UsageError",
    "VerdictError",
    "YuanReproduction",
    "__version__",
    "compare",
    "configuration",
    "demo",
    "doctor",
    "edit",
    "evaluate",
    "explore",
    "fuse",
    "live_keys",
    "live_map",
    "live_robot",
    "live_robots",
    "live_view",
    "load",
    "localize",
    "locate",
    "map",
    "read",
    "reproduce_hamatani",
    "reproduce_hara",
    "reproduce_kojima",
    "reproduce_yuan",
    "simulate_landmarks",
    "simulate_laser",
    "simulate_swarm",
    "simulate_team",
    "solve_pose_graph",
    "solve_ranges",
    "view",
)

_LIVE = {"zenoh": "eclipse-zenoh", "msgspec": "msgspec", "cryptography": "cryptography"}  # the extra [live]


def _lacking(name: str, module: str) -> object:
    """Stands for a name whose extra is not installed: calling it says so."""

    def lacks(*args: object, **options: object) -> None:  # noqa: ARG001
        from .core.errors import UsageError

        raise UsageError(f"{name} needs {_LIVE[module]}: pip install 'mapweave[live]'")

    return lacks


if not TYPE_CHECKING:  # a checker shall know the names above and no others

    def __getattr__(name: str) -> object:
        home = _HOMES.get(name)
        if home is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        try:
            value = getattr(import_module(f"{__name__}.{home}"), name)
        except ModuleNotFoundError as error:
            if error.name not in _LIVE:
                raise
            return _lacking(name, error.name)
        from .core.signatures import readable

        readable(value)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *_HOMES})
