"""Everything that can be set about an exploration with lasers: the robots, how the team maps, how it plans."""

from collections.abc import Mapping
from dataclasses import field, replace
from typing import ClassVar

import numpy as np

from ...core.config import config
from ...mapping.config import LaserTeamConfig
from ...sim.laser_team import LaserRobotsConfig


@config
class GoalConfig:
    """When a goal is reached, done, put off or another's."""

    arrived: float = 0.35  # [m] from a goal at which a robot is there: a cell and a half of the planning grid
    snap: float = 1.0  # [m] within which a place off the ground counts as its nearest cell
    progress: float = 0.2  # [m] nearer that counts as progress: a cell of the planning grid
    seen_share: float = 0.8  # of a goal's unknown cells after which it is done: the rest is noise of the walls
    spare_way: float = 20.0  # [m] farther than needed that paths to a goal are looked for, so that detours are known
    patience_factor: int = 10  # times `patience` after which a goal is put off however often it came nearer
    same: float = 0.8  # [m] between places below which they are one goal: two robots' width


@config
class FollowerConfig:
    """How the next command along a path is chosen."""

    lookahead: float = 2.0  # [m] of path that is looked ahead: three seconds at full speed
    reverse_speed: float = 1 / 3  # of the top speed backwards, to leave a tight spot
    heading_cost: float = 0.8  # [m/rad] that a wrong heading counts as,
    heading_near: float = 0.3  # [m] from the place, and less nearer by
    reverse_cost: float = 0.25  # [m] that driving backwards counts as: turning round is better where there is room
    arc_sample: float = 0.02  # [m] between the samples of an arc: half of `guard`
    closeness_cost: float = 0.3  # [m] that a metre of clearance below `roomy` counts as


@config
class RightOfWayConfig:
    """Two robots in one door: who goes first, where the other waits, what a stuck one does."""

    meeting: float = 2.5  # [m] apart beyond which robots do not meet
    next_way: float = 2.0  # [m] of a robot's path on which another stands in its way
    clear_way: float = 6.0  # [m] of the other's path that a waiting robot keeps clear of: through a door and on
    wait_steps: int = 40  # [steps] that a robot waits aside at most
    beside: float = 0.1  # [m] beyond what two robots need to pass, where a robot waits
    left_place: float = 0.6  # [m] from where a robot was beyond which it has left that place
    stuck_steps: int = 30  # [steps] about one place after which a robot tries something else
    retry_from: float = 1.0  # [m] of path at least to the place it tries again from
    retry_to: float = 4.0  # [m] of path at most to that place
    retry_steps: int = 15  # [steps] that getting there may take
    retry_arrived: float = 0.3  # [m] from that place at which it is reached
    parted: float = 1.5  # times `meeting` apart beyond which nobody waits for the other any more
    standing: float = 0.03  # [m] a step, up to which a robot stands still
    leaving_steps: int = 3  # [steps] of standing still up to which a robot with a goal is about to leave


@config
class AllocationConfig:
    """Which robot gets which piece of frontier."""

    same_piece: float = 1.5  # [m] from the goal that was made of it within which what is left of a piece lies
    on_the_way: float = 1.0  # [m], a detour that small is none
    turn_cost: float = 0.6  # [m/rad] that turning towards a goal counts as: what the robot would drive meanwhile
    wall_cost: int = 4  # what a metre of path by a wall counts beside one in the open, 1 to 255
    parked_cost: int = 12  # what a metre of path where a robot stands counts: one goes round it if one can
    balance: float = 0.3  # what the sum of all tours weighs beside the longest
    stretch: int = 3  # places of a tour that are moved together to better it, at most


@config
class LaserExploreConfig:
    """The robots' limits and how they plan. Limits and reach are taken from the robots when a run begins."""

    period: float = 0.5  # [s], a step
    radius: float = 0.2  # [m] of a robot
    speed: float = 0.6  # [m/s], the fastest; robots drive backwards a third as fast
    turn: float = 1.0  # [rad/s], the fastest
    reach: float = 12.0  # [m] of the scanner
    resolution: float = 0.2  # [m], cells of the grid that is planned on: a robot's radius
    occupied_share: float = 0.2  # of a cell's beams that end in it make it a wall: along a wall's face most go through
    margin: float = 0.1  # [m] beyond the radius that planned paths keep from walls: half a cell
    guard: float = 0.04  # [m] beyond the radius that a driven arc keeps from every point of the present scan
    apart: float = 0.12  # [m] beyond two radii that a driven arc keeps from the path another robot just chose
    roomy: float = 0.6  # [m] from walls, where a path costs no more than its length
    sliver: float = 0.15  # [m^2], unknown patches smaller than this are nobody's goal: four cells
    split: float = 2.5  # [m], longest side of a piece of frontier that makes one goal
    most_goals: int = 40  # considered at once; longer frontiers are cut into larger pieces
    replan_every: int = 12  # [steps] between plans: six seconds, in which a robot sees a new room
    replan_soonest: int = 4  # [steps] between plans at least, when a robot has nothing to do
    keep: float = 2.0  # [m] that another goal must be nearer before a robot changes its mind
    service: float = 2.0  # [m] that looking round at a goal counts as
    patience: int = 40  # [steps] without coming nearer after which a goal is put off
    look: int = 4  # [steps] at a goal that nothing new comes of after which it is put off
    put_off: int = 100  # [steps] for which a goal is put off; twice as long every time
    give_up: int = 3  # times a goal was put off, then it is given up
    w_accuracy: float = 1 / 3  # weight of known walls around a goal, planners `paper` and `area`
    w_area: float = 1 / 3  # weight of unknown ground around a goal
    w_apart: float = 1 / 3  # weight of the distance from the others
    w_way: float = 0.5  # what 20 m of path cost beside these
    max_steps: int = 20000  # [steps] after which a run ends unfinished
    goals: GoalConfig = GoalConfig()
    follower: FollowerConfig = FollowerConfig()
    right_of_way: RightOfWayConfig = RightOfWayConfig()
    allocation: AllocationConfig = AllocationConfig()


@config
class LaserMissionConfig:
    """Settings of `explore` with lasers: robots, mapping, planning. The planner's limits are taken from the robots."""

    MOVED: ClassVar[Mapping[str, str]] = {"team.near": "team.map.near"}  # old keys and where they are now

    robots: LaserRobotsConfig = field(default_factory=LaserRobotsConfig)
    team: LaserTeamConfig = field(default_factory=LaserTeamConfig)
    plan: LaserExploreConfig = field(default_factory=LaserExploreConfig)
    map_resolution: float = 0.05  # [m], of the map that is written and scored
    tolerance: float = 0.1  # [m] from a wall up to which a cell of the map shows it: two cells
    new_ground: int = 12  # samples on beams in unknown cells from which on a scan showed something new
    beam_stride: int = 4  # every so many beams are sampled for it
    frontier_check_every: int = 10  # [steps] between looks for frontiers where the planner never says it has finished
    false_distance: float = 0.5  # [m] off the truth beyond which a closure counts as joining places that are two
    false_turn: float = float(np.radians(8.0))  # [rad] off the truth, the same

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
