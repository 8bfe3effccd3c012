"""Robots of a live team told where to drive, until nothing is left to see."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np

from ..core.errors import DataError, UsageError
from ..core.paths import checked_arguments
from ..exploration.laser.config import LaserPlan
from ..exploration.laser.mission import GOALS_SAME, LaserBelief, PlannerState
from ..exploration.laser.planners import by_tours, choose_goals
from ..live.messages import GoalMessage, Numbers, Topics, check_name, encode
from ..live.told import LiveTeam, TeamRobot, hear_team
from ..live.transport import LISTENING, Network, put, session, told_on

LEVEL = 1  # of the squares that are planned on: 0.2 m
WALL = 0.35  # how likely the most occupied of a cell's sixteen is occupied where a robot keeps off
TOLD = 1.0  # [s] from telling all goals to telling them again
NOTHING_LEFT = 10.0  # [s] without a goal for anybody until nothing is left to see
NO_POINTS = np.zeros((0, 2))


@dataclass(slots=True)
class PartPlanner:
    """What is kept in mind of the robots of one part of the map between two looks."""

    robots: tuple[str, ...]
    memory: dict[str, Any] = field(default_factory=dict)

    def goals(self, team: LiveTeam, robots: list[TeamRobot], step: int, cfg: LaserPlan) -> dict[str, Numbers]:
        """Robot -> `T_map_robot` where it is to drive; none for those who may stand."""
        grid = team.grid(robots[0].part, LEVEL)
        if grid is None:
            return {}
        poses = np.array([robot.pose for robot in robots])
        belief = LaserBelief(
            step=step,
            robots=self.robots,
            alive=np.array([robot.there and not robot.finished for robot in robots]),
            stalled=np.zeros(len(robots), dtype=int),
            memory=self.memory,
            grid=grid.planned_on(WALL),
            scans=(NO_POINTS,) * len(robots),
            moving=(NO_POINTS,) * len(robots),
        )
        if not belief.alive.any():
            return {}
        state = choose_goals(belief, poses, cfg, by_tours)
        return {self.robots[j]: _facing(state, j) for j in state.goals}


def _facing(state: PlannerState, j: int) -> Numbers:
    """The goal of robot j, looking to where there is something to see."""
    goal = state.goals[j]
    ahead = (goal.unknown.mean(axis=0) if len(goal.unknown) else goal.place) - goal.place
    return (*goal.place.tolist(), float(np.arctan2(ahead[1], ahead[0])))


@dataclass(slots=True)
class Explorer:
    """The goals of a team as it stands; `look` brings them up to date.

    goals: robot -> part, `T_map_robot`, and the number that counts the robot's goals; new_of: how far a goal moves
    before it is another [m].
    """

    cfg: LaserPlan
    goals: dict[str, tuple[int, Numbers, int]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    _parts: list[PartPlanner] = field(default_factory=list)
    _numbers: dict[str, int] = field(default_factory=dict)

    def look(self, team: LiveTeam, step: int) -> None:
        """Each part of the map by itself: laser robots of one share out what is left to see there."""
        parts: dict[int, list[TeamRobot]] = {}
        for robot in team.robots().values():
            if robot.part and robot.sensor == "laser":
                parts.setdefault(robot.part, []).append(robot)
        before, self._parts = {planner.robots: planner for planner in self._parts}, []
        goals: dict[str, tuple[int, Numbers, int]] = {}
        for part, robots in sorted(parts.items()):
            names = tuple(robot.name for robot in robots)
            planner = before.get(names) or PartPlanner(names)  # robots that are tied anew plan anew
            self._parts.append(planner)
            try:
                found = planner.goals(team, robots, step, self.cfg)
            except DataError as error:
                self.left_out[f"part {part}"] = str(error)
                continue
            for name, pose in found.items():
                goals[name] = part, pose, self._number(name, part, pose)
        self.goals = goals

    def _number(self, name: str, part: int, pose: Numbers) -> int:
        old = self.goals.get(name)
        same = old is not None and old[0] == part and np.hypot(*np.subtract(old[1], pose)[:2]) < GOALS_SAME
        self._numbers[name] = self._numbers.get(name, 0) + (not same)
        return self._numbers[name]


@checked_arguments
def live_explore(
    *,
    name: str = "explore",
    radius: float = 0.2,
    network: Network | None = None,
    stop: Event | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Send the robots of a live team where something is left to see, shared out by how far each has to drive.

    Goals are on ground that is known to be free, a robot's radius and 0.1 m off walls, at the edge of what is known.
    How a robot gets there is its own business. Robots that nothing ties to others yet explore by themselves. It ends
    when nothing is left to see that a robot gets to, or when `stop` is set.

    Parameters
    ----------
    name
        What this process is called, where a team has several; with certificates one of `--maps` (explore).
    radius
        Of the largest robot [m] (0.2).
    network
        How to reach the team (those on this network find each other).
    stop
        Ends it as soon as it is set.
    say
        Called with a line where something happens.

    Raises
    ------
    UsageError
        For a radius or a name that cannot be, an endpoint that is none.
    """
    network, stop = network or Network(), stop or Event()
    check_name(name)
    check_name(network.team, "--team")
    if not 0 < radius <= 2:
        raise UsageError(f"--radius: expected metres above 0, at most 2, found {radius}")
    cfg = LaserPlan(radius=radius)
    team, topics, explorer = LiveTeam(), Topics(network.team), Explorer(cfg)
    told: dict[str, int] = {}
    with session(told_on(network), lambda at: say(f"{name}: {LISTENING}{at}")) as opened:
        held = hear_team(opened, topics, team, name, LEVEL)
        say(f"{name}: team {network.team}")
        begin = last_goal = time.monotonic()
        tell = float("-inf")
        sent: set[str] = set()
        while not stop.wait(cfg.period):
            now = time.monotonic()
            explorer.look(team, int((now - begin) / cfg.period))
            for robot, (part, pose, number) in explorer.goals.items():
                if told.get(robot) != number:
                    told[robot], tell = number, float("-inf")
                    say(f"{robot}: goal {number} at {pose[0]:.1f}, {pose[1]:.1f} of part {part}")
            if now >= tell + TOLD:
                tell, sent = now, sent | explorer.goals.keys()
                for robot in sent:
                    part, pose, number = explorer.goals.get(robot, (0, (), told.get(robot, 0)))
                    goal = GoalMessage(
                        map=name, of=team.map or name, robot=robot, component=part, number=number, pose=pose
                    )
                    put(opened, topics.goal(robot, name), encode(goal))
            if explorer.goals or not sent:
                last_goal = now
            elif now > last_goal + NOTHING_LEFT:
                say(f"{name}: nothing is left to see that a robot gets to")
                break
        del held
