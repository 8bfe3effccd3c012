"""What a planner is given, and how a planner is found: `choose(maps, poses, cfg) -> commands`."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from ..core.config import config
from ..core.errors import UsageError
from ..estimate.submap_slam import SubmapConfig
from ..maps.explored import Explored
from ..maps.global_map import GlobalMap
from ..maps.submap import Submap

if TYPE_CHECKING:
    from .ground import Ground


@config
class ExploreConfig:
    """Weights, thresholds and discretisation of one exploration."""

    submap: SubmapConfig = SubmapConfig()
    speeds: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)  # [m/s]
    turns: tuple[float, ...] = tuple(float(k) * np.pi / 8 for k in range(-4, 5))  # [rad/s]
    w_accuracy: float = 1 / 3
    w_area: float = 1 / 3
    w_apart: float = 1 / 3
    escape_uncertainty: float = 0.3  # C_t
    negligible_gain: int | None = None  # cells; a control that would see no more gains no area; see `gain_threshold`
    stall_steps: int = 10  # steps without gain after which the robot escapes whatever its uncertainty
    lost: float = 6.0  # [m], standard deviation of a robot's place in the map beyond which it looks for known landmarks
    literal_escape: bool = False  # the printed rule alone: deadlocks under the stated noise
    apart_distance: float = 20.0  # [m], d_t
    cell: float = 1.0  # [m]
    fuse_after: int = 10  # steps, n_s
    fuse_uncertainty: float = 0.3  # C_f
    fuse_by: int = 60  # steps after which a submap is handed over whatever its uncertainty
    fusion_gate: float = 18.42
    fusion_sure: float = 0.9  # probability above which two landmarks of unknown identity become one
    fusion_density: float = 4e-4  # [1/m^2] landmarks expected, times the chance that one beside a new one went unseen
    max_steps: int = 1500
    cover_radius: float = 10.0  # [m], discs of the coverage planner
    replan_every: int = 4  # steps
    gain_weight: float = 0.12  # [m] a newly seen cell is worth to the coverage planner
    loop_radius: float = 13.0  # [m], discs of the loop planner: fewer, so that a lap closes in time
    loop_rate: float = 20.5  # [m^2] of field a robot and step: how long the loop planner goes on to close loops
    loop_rate_alone: float = 17.0  # the same for one robot, whose lap is longer
    joint_rate: float = 23.5  # [m^2] of field a robot and step: how long the joint planner's laps take
    joint_rate_alone: float = 20.0  # the same for one robot
    joint_density: float = 1 / 275  # landmarks a square metre that the joint planner expects
    joint_error_weight: float = 60.0  # steps that a metre of expected map error is worth to it
    joint_tries: int = 1500  # plans it tries before the first step

    robot_radius: float = 0.3  # [m]
    wall_margin: float = 0.4  # [m] beyond the radius that planned ways and offered controls keep from walls
    wall_comfort: float = 1.2  # [m] beyond the radius that robots keep where nothing draws them nearer
    path_cell: float = 0.4  # [m], raster on which ways round walls are found
    put_off_after: int = 60  # steps after which a target among walls that was not seen is put off
    contact_steps: int = 40  # for so long the place where a robot met a wall unexpectedly is kept clear of

    @property
    def gain_threshold(self) -> int:
        """Cells that gain no area. None chosen: 12 as part of the area term, the printed 0 where there is no such term.

        The printed rule (no cell at all) keeps the paper's robots at specks which their area term is too weak to fetch.
        """
        if self.negligible_gain is not None:
            return self.negligible_gain
        return 12 if self.w_area else 0

    @property
    def controls(self) -> Float[np.ndarray, "m 2"]:
        """All (v, w) offered, slow and right-turning first."""
        return np.array([(v, w) for v in self.speeds for w in self.turns])


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
    ground: "Ground | None" = None
    contacts: Float[np.ndarray, "k 2"] = field(default_factory=lambda: np.zeros((0, 2)))


Planner = Callable[[TeamView, Float[np.ndarray, "r 3"], ExploreConfig], Float[np.ndarray, "r 2"]]

BUILT_IN = {
    "paper": "mapweave.explore.objective:choose",
    "area": "mapweave.explore.objective:choose_area",
    "coverage": "mapweave.explore.coverage:choose",
    "loop": "mapweave.explore.loop:choose",
    "joint": "mapweave.explore.joint:choose",
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
