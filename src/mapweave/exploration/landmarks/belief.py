"""What a planner knows of a landmark world, and the planners by name: `choose(maps, poses, cfg) -> commands`."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...landmarks.landmark_map import GlobalMap, Submap
from ..planner_interface import TeamBelief
from .config import ExploreConfig
from .explored import Explored
from .floor_plan import FloorPlan


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkBelief(TeamBelief):
    """explored: cells by who knows of them; submaps and the global map with their covariances; floor: what the plan of
    the walls tells, None in an open field; contacts: (k, 2) places in the map where a robot lately met a wall that it
    thought farther away; lower, upper: (2,) corners [m] of the field.
    """

    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    explored: Explored
    submaps: tuple[Submap, ...]
    global_map: GlobalMap
    floor: FloorPlan | None = None
    contacts: Float[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))


Planner = Callable[[LandmarkBelief, Float[np.ndarray, "r 3"], ExploreConfig], Float[np.ndarray, "r 2"]]

PLANNERS = {
    "paper": "mapweave.exploration.landmarks.objective:choose",
    "area": "mapweave.exploration.landmarks.objective:choose_area",
    "coverage": "mapweave.exploration.landmarks.coverage:choose",
    "loop": "mapweave.exploration.landmarks.loop:choose",
    "joint": "mapweave.exploration.landmarks.joint:choose",
}
