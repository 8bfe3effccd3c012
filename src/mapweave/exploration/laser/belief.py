"""What a planner knows of a laser world, and the planners by name: `choose(maps, poses, cfg) -> commands`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...laser.occupancy import Occupancy
from ..planner_interface import TeamBelief
from .config import LaserExploreConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserBelief(TeamBelief):
    """grid: the merged map; scans: for each robot the points (k, 2) [m] of its present scan in its own frame, other
    robots among them. A planner that sets memory["finished"] ends the run.
    """

    grid: Occupancy
    scans: tuple[np.ndarray, ...]


LaserPlanner = Callable[[LaserBelief, Float[np.ndarray, "r 3"], LaserExploreConfig], Float[np.ndarray, "r 2"]]

PLANNERS = {
    "coverage": "mapweave.exploration.laser.planners:coverage",
    "paper": "mapweave.exploration.laser.planners:paper",
    "area": "mapweave.exploration.laser.planners:area",
    "loop": "mapweave.exploration.laser.planners:loop",
    "nearest": "mapweave.exploration.laser.planners:nearest",
}
