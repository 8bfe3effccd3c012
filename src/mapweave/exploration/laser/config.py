"""Everything that can be set about an exploration with lasers: the robots, how the team maps, how it plans."""

from collections.abc import Mapping
from dataclasses import field, replace
from typing import ClassVar

import numpy as np

from ...core.config import config
from ...mapping.config import LaserTeamConfig
from ...sim.laser_team import LaserRobotsConfig

GOAL_ARRIVED = 0.35  # [m] from a goal at which a robot is there: a cell and a half of the planning grid
GOAL_SNAP = 1.0  # [m] within which a place off the ground counts as its nearest cell
GOAL_PROGRESS = 0.2  # [m] nearer that counts as progress: a cell of the planning grid
SEEN_SHARE = 0.8  # of a goal's unknown cells after which it is done: the rest is noise of the walls
SPARE_WAY = 20.0  # [m] farther than needed that paths to a goal are looked for, so that detours are known
PATIENCE_FACTOR = 10  # times `patience` after which a goal is put off however often it came nearer
GOAL_SAME = 0.8  # [m] between places below which they are one goal: two robots' width

RIGHT_OF_WAY_MEETING = 2.5  # [m] apart beyond which robots do not meet
NEXT_WAY = 2.0  # [m] of a robot's path on which another stands in its way
CLEAR_WAY = 6.0  # [m] of the other's path that a waiting robot keeps clear of: through a door and on
WAIT_STEPS = 40  # [steps] that a robot waits aside at most
RIGHT_OF_WAY_BESIDE = 0.1  # [m] beyond what two robots need to pass, where a robot waits
LEFT_PLACE = 0.6  # [m] from where a robot was beyond which it has left that place
STUCK_STEPS = 30  # [steps] about one place after which a robot tries something else
RETRY_FROM = 1.0  # [m] of path at least to the place it tries again from
RETRY_TO = 4.0  # [m] of path at most to that place
RETRY_STEPS = 15  # [steps] that getting there may take
RETRY_ARRIVED = 0.3  # [m] from that place at which it is reached
RIGHT_OF_WAY_PARTED = 1.5  # times `meeting` apart beyond which nobody waits for the other any more
RIGHT_OF_WAY_STANDING = 0.03  # [m] a step, up to which a robot stands still
LEAVING_STEPS = 3  # [steps] of standing still up to which a robot with a goal is about to leave

SAME_PIECE = 1.5  # [m] from the goal that was made of it within which what is left of a piece lies
ON_THE_WAY = 1.0  # [m], a detour that small is none
ALLOCATION_TURN_COST = 0.6  # [m/rad] that turning towards a goal counts as: what the robot would drive meanwhile
WALL_COST = 4  # what a metre of path by a wall counts beside one in the open, 1 to 255
PARKED_COST = 12  # what a metre of path where a robot stands counts: one goes round it if one can
ALLOCATION_BALANCE = 0.3  # what the sum of all tours weighs beside the longest
ALLOCATION_STRETCH = 3  # places of a tour that are moved together to better it, at most

OCCUPIED_SHARE = 0.2  # of a cell's beams that end in it make it a wall: along a wall's face most go through
LASER_EXPLORE_ROOMY = 0.6  # [m] from walls, where a path costs no more than its length
LASER_EXPLORE_SLIVER = 0.15  # [m^2], unknown patches smaller than this are nobody's goal: four cells
LASER_EXPLORE_SPLIT = 2.5  # [m], longest side of a piece of frontier that makes one goal
LASER_EXPLORE_REPLAN_EVERY = 12  # [steps] between plans: six seconds, in which a robot sees a new room
REPLAN_SOONEST = 4  # [steps] between plans at least, when a robot has nothing to do
LASER_EXPLORE_KEEP = 2.0  # [m] that another goal must be nearer before a robot changes its mind
LASER_EXPLORE_SERVICE = 2.0  # [m] that looking round at a goal counts as
LASER_EXPLORE_PATIENCE = 40  # [steps] without coming nearer after which a goal is put off
LASER_EXPLORE_LOOK = 4  # [steps] at a goal that nothing new comes of after which it is put off
PUT_OFF = 100  # [steps] for which a goal is put off; twice as long every time
GIVE_UP = 3  # times a goal was put off, then it is given up
W_ACCURACY = 1 / 3  # weight of known walls around a goal, planners `paper` and `area`
W_AREA = 1 / 3  # weight of unknown ground around a goal
LASER_EXPLORE_W_APART = 1 / 3  # weight of the distance from the others
W_WAY = 0.5  # what 20 m of path cost beside these

LASER_MISSION_TOLERANCE = 0.1  # [m] from a wall up to which a cell of the map shows it: two cells
NEW_GROUND = 12  # samples on beams in unknown cells from which on a scan showed something new
BEAM_STRIDE = 4  # every so many beams are sampled for it
FRONTIER_CHECK_EVERY = 10  # [steps] between looks for frontiers where the planner never says it has finished
FALSE_DISTANCE = 0.5  # [m] off the truth beyond which a closure counts as joining places that are two
FALSE_TURN = float(np.radians(8.0))  # [rad] off the truth, the same


@config
class FollowerConfig:
    """How the next command along a path is chosen."""

    reverse_speed: float = 1 / 3  # of the top speed backwards, to leave a tight spot
    reverse_cost: float = 0.25  # [m] that driving backwards counts as: turning round is better where there is room


@config
class LaserExploreConfig:
    """The robots' limits and how they plan. Limits and reach are taken from the robots when a run begins."""

    period: float = 0.5  # [s], a step
    radius: float = 0.2  # [m] of a robot
    speed: float = 0.6  # [m/s], the fastest; robots drive backwards a third as fast
    turn: float = 1.0  # [rad/s], the fastest
    reach: float = 12.0  # [m] of the scanner
    resolution: float = 0.2  # [m], cells of the grid that is planned on: a robot's radius
    margin: float = 0.1  # [m] beyond the radius that planned paths keep from walls: half a cell
    guard: float = 0.04  # [m] beyond the radius that a driven arc keeps from every point of the present scan
    apart: float = 0.12  # [m] beyond two radii that a driven arc keeps from the path another robot just chose
    most_goals: int = 40  # considered at once; longer frontiers are cut into larger pieces
    max_steps: int = 20000  # [steps] after which a run ends unfinished
    follower: FollowerConfig = FollowerConfig()


@config
class LaserMissionConfig:
    """Settings of `explore` with lasers: robots, mapping, planning. The planner's limits are taken from the robots."""

    MOVED: ClassVar[Mapping[str, str]] = {"team.near": "team.map.near"}  # old keys and where they are now

    robots: LaserRobotsConfig = field(default_factory=LaserRobotsConfig)
    team: LaserTeamConfig = field(default_factory=LaserTeamConfig)
    plan: LaserExploreConfig = field(default_factory=LaserExploreConfig)
    map_resolution: float = 0.05  # [m], of the map that is written and scored

    def planning(self) -> LaserExploreConfig:
        """The planner's configuration, with the limits and the reach of the robots."""
        r = self.robots
        return replace(self.plan, period=r.period, radius=r.radius, speed=r.speed, turn=r.turn, reach=r.scanner.far)


def with_odometry_noise(cfg: LaserMissionConfig, factor: float) -> LaserMissionConfig:
    """`cfg` with all odometry errors times `factor`, in the world and in the estimator alike."""
    odometry = replace(cfg.robots.odometry, factor=cfg.robots.odometry.factor * factor)
    noise = cfg.team.graph.keyframes.noise
    noise = replace(
        noise,
        wheels_xy=noise.wheels_xy * factor,
        wheels_turn=noise.wheels_turn * factor,
        wheels_turn_per_m=noise.wheels_turn_per_m * factor,
    )
    keyframes = replace(cfg.team.graph.keyframes, noise=noise)
    f, worse = cfg.team.front_end, max(1.0, factor)
    front_end = replace(
        f,
        sd_xy=f.sd_xy * worse,
        sd_xy_per_m=f.sd_xy_per_m * worse,
        sd_turn=f.sd_turn * worse,
        sd_turn_per_m=f.sd_turn_per_m * worse,
        sd_turn_per_rad=f.sd_turn_per_rad * worse,
    )
    team = replace(cfg.team, front_end=front_end, graph=replace(cfg.team.graph, keyframes=keyframes))
    return replace(cfg, robots=replace(cfg.robots, odometry=odometry), team=team)
