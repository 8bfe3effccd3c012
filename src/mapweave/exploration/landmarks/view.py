"""What a planner is given, and how a planner is found: `choose(maps, poses, cfg) -> commands`."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import UsageError
from ...landmarks.global_map import GlobalMap
from ...landmarks.submap import Submap
from .config import ExploreConfig
from .explored import Explored
from .ground import Ground


@dataclass(frozen=True, slots=True)
class TeamView:
    """What the team knows at one step; arrays are the run's own: read, never write.

    alive: (M,); explored: cells by who knows of them; submaps and the global map with their covariances; stalled: (M,)
    steps since a robot last saw new ground; memory: a planner's scratch pad, kept between the calls of one run;
    ground: what the plan of the walls tells, None in an open field; contacts: (k, 2) places in the map where a robot
    lately met a wall that it thought farther away.
    """

    step: int
    robots: tuple[str, ...]
    alive: Bool[np.ndarray, " r"]
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    explored: Explored
    submaps: tuple[Submap, ...]
    global_map: GlobalMap
    stalled: np.ndarray
    memory: dict[str, Any]
    ground: Ground | None = None
    contacts: Float[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))


Planner = Callable[[TeamView, Float[np.ndarray, "r 3"], ExploreConfig], Float[np.ndarray, "r 2"]]

BUILT_IN = {
    "paper": "mapweave.exploration.landmarks.objective:choose",
    "area": "mapweave.exploration.landmarks.objective:choose_area",
    "coverage": "mapweave.exploration.landmarks.coverage:choose",
    "loop": "mapweave.exploration.landmarks.loop:choose",
    "joint": "mapweave.exploration.landmarks.joint:choose",
}


def find_planner(name: str) -> Planner:
    """A built-in planner by name, or a user's own by dotted name `package.module:function`."""
    return find_function(name, BUILT_IN)


def find_function(name: str, built_in: dict[str, str]) -> Callable[..., Any]:
    """The planner that `built_in` knows by `name`, or the one at the dotted name `package.module:function`."""
    where = built_in.get(name, name)
    module, _, attribute = where.partition(":")
    if not attribute:
        module, _, attribute = where.rpartition(".")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as error:  # whatever a module does when it is imported
        raise UsageError(
            f"planner {name!r}: not one of {', '.join(built_in)} and not an importable module:function "
            f"({type(error).__name__}: {error})"
        ) from error
    if not callable(found):
        raise UsageError(f"planner {name!r} is not a function choose(maps, poses, cfg)")
    return found  # type: ignore[no-any-return]
