"""What a planner for laser worlds is given, and how it is found: `choose(maps, poses, cfg) -> commands`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.config import config
from ...laser.occupancy import Occupancy
from ..landmarks.view import find_function


@config
class LaserExploreConfig:
    """The robots and how they plan. Lengths in metres, times in steps of `period`."""

    period: float = 0.5  # [s], a step
    radius: float = 0.2  # of a robot
    speed: float = 0.6  # [m/s], the fastest; robots do not drive backwards
    turn: float = 1.0  # [rad/s], the fastest
    reach: float = 12.0  # of the scanner
    resolution: float = 0.2  # of the grid that is planned on
    margin: float = 0.1  # beyond the radius that planned ways keep from walls
    guard: float = 0.04  # beyond the radius that a driven arc keeps from every point of the present scan
    apart: float = 0.12  # beyond two radii that a driven arc keeps from the way another robot just chose
    roomy: float = 0.6  # from walls, where a way costs no more than its length
    sliver: float = 0.15  # [m^2], unknown patches smaller than this are nobody's goal
    split: float = 2.5  # longest side of a piece of frontier that makes one goal
    most_goals: int = 40  # considered at once; longer frontiers are cut into larger pieces
    replan_every: int = 12
    replan_soonest: int = 4
    keep: float = 2.0  # what another goal must be nearer before a robot changes its mind
    service: float = 2.0  # what looking round at a goal is taken to cost
    patience: int = 40  # without coming nearer, then a goal is put off
    look: int = 4  # at a goal that nothing new comes of, then it is put off
    put_off: int = 100  # for how long; twice as long every time
    give_up: int = 3  # times a goal was put off, then it is given up
    w_accuracy: float = 1 / 3
    w_area: float = 1 / 3
    w_apart: float = 1 / 3
    w_way: float = 0.5  # what 20 m of way cost beside these, planners `paper` and `area`
    max_steps: int = 20000


@dataclass(frozen=True, slots=True)
class LaserView:
    """What the team knows at one step; arrays are the run's own: read, never write.

    alive: (M,); grid: the merged map; scans: for each robot the points (k, 2) [m] of its present scan in its own
    frame, other robots among them; stalled: (M,) steps since a robot last saw new ground; memory: a planner's scratch
    pad, kept between the calls of one run. A planner that sets memory["finished"] ends the run.
    """

    step: int
    robots: tuple[str, ...]
    alive: Bool[np.ndarray, " r"]
    grid: Occupancy
    scans: tuple[np.ndarray, ...]
    stalled: np.ndarray
    memory: dict[str, Any]


LaserPlanner = Callable[[LaserView, Float[np.ndarray, "r 3"], LaserExploreConfig], Float[np.ndarray, "r 2"]]

BUILT_IN = {
    "coverage": "mapweave.exploration.laser.planners:coverage",
    "paper": "mapweave.exploration.laser.planners:paper",
    "area": "mapweave.exploration.laser.planners:area",
    "loop": "mapweave.exploration.laser.planners:loop",
    "nearest": "mapweave.exploration.laser.planners:nearest",
}


def find_laser_planner(name: str) -> LaserPlanner:
    """A built-in planner for laser worlds by name, or a user's own by dotted name `package.module:function`."""
    return find_function(name, BUILT_IN)
