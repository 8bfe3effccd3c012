"""What a planner knows of a laser world, the planners by name, and what the team keeps in mind between two steps."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from ...kernels.walls.segments import sight_on_raster
from ...laser.occupancy import Occupancy
from ..ground import CostToGo, Ground
from ..planner_interface import TeamBelief
from .config import LaserExploreConfig
from .frontiers import MappedGround, disc_mask


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserBelief(TeamBelief):
    """grid: the merged map; scans: for each robot the points (k, 2) [m] of its present scan in its own frame, other
    robots among them. A planner that sets memory["finished"] ends the run.
    """

    grid: Occupancy
    scans: tuple[np.ndarray, ...]


LaserPlanner = Callable[[LaserBelief, Float[np.ndarray, "r 3"], LaserExploreConfig], Float[np.ndarray, "r 2"]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClearCostToGo(CostToGo):
    """The paths to one place from everywhere, going round robots that stand where there is room to.

    clear: (rows, cols) where a robot's disc fits and nobody stands.
    """

    clear: Bool[np.ndarray, "rows cols"]

    def target(self, place: Float[np.ndarray, "2"], ahead: float) -> Float[np.ndarray, "2"] | None:
        """The farthest place on the way, at most `ahead` metres on, to which a straight line stays clear."""
        way = self.along(place, ahead)
        if len(way) == 0:
            return None
        start, *cells = (way - self.ground.lower) / self.ground.cell
        for k in range(len(way) - 1, 2, -1):
            if sight_on_raster(self.clear, start, cells[k - 1]):
                return np.asarray(way[k])
        return np.asarray(way[min(2, len(way) - 1)])

    def along(self, place: Float[np.ndarray, "2"], metres: float) -> Float[np.ndarray, "n 2"]:
        """The first `metres` of the path from `place`, cell by cell; none where no path leads."""
        cell = self.cells(place[None])[0]
        if cell[0] < 0:
            return np.zeros((0, 2))
        return self.ground.centres(self.descend(cell, int(metres / self.ground.cell) + 1))


@dataclass(slots=True)
class Goal:
    """Where a robot heads and why. unknown: (k, 2) cells it is to see there; least: the shortest path left so far [m],
    `since` the step when it last grew shorter; done: all is seen, the robot goes on until it gets another goal.
    """

    place: np.ndarray
    unknown: np.ndarray
    route: ClearCostToGo
    since: int
    born: int
    least: float = np.inf
    at: int | None = None  # the step when the robot got there
    done: bool = False


@dataclass(slots=True)
class PlannerState:
    """goals by robot; yielding: where robots go to let another pass; put_off: place, until which step, how often."""

    goals: dict[int, Goal] = field(default_factory=dict)
    yielding: "dict[int, YieldPlace]" = field(default_factory=dict)
    put_off: list[tuple[np.ndarray, int, int]] = field(default_factory=list)
    priority: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (M,), the lowest goes first
    ground: MappedGround | None = None
    planned: int = -10_000
    planned_for: tuple[int, ...] = ()
    still: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # steps without moving
    about: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # x, y, and since when a robot is near there
    last: np.ndarray | None = None  # poses a step ago
    home: np.ndarray | None = None

    def given_up(self, cfg: LaserExploreConfig) -> Float[np.ndarray, "n 2"]:
        """Places that nobody tries to reach any more."""
        return np.array([p for p, _, times in self.put_off if times >= cfg.give_up]).reshape(-1, 2)

    def barred(self, place: np.ndarray, step: int, cfg: LaserExploreConfig, *, waiting: bool = True) -> bool:
        """Whether `place` was given up, or (`waiting`) was put off until later than `step`."""
        return any(
            np.hypot(*(place - p)) < cfg.goals.same and (times >= cfg.give_up or (waiting and step < until))
            for p, until, times in self.put_off
        )

    def defer(self, place: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
        """`place` is not tried for a while, longer every time."""
        for k, (p, _, times) in enumerate(self.put_off):
            if np.hypot(*(place - p)) < cfg.goals.same:
                self.put_off[k] = (p, step + cfg.put_off * 2**times, times + 1)
                return
        self.put_off.append((place.copy(), step + cfg.put_off, 1))


@dataclass(slots=True)
class YieldPlace:
    """Where robot `whom` is let pass, or, by oneself, where one tries again from. until: when waiting ends anyway."""

    place: np.ndarray
    route: ClearCostToGo
    whom: int
    until: int


def planner_state_of(belief: LaserBelief, poses: np.ndarray, cfg: LaserExploreConfig) -> PlannerState:
    """The state in the planner's memory, made at the first call, brought up to date with `poses` (M, 3)."""
    state: PlannerState = belief.memory.setdefault("planner_state", PlannerState())
    M = len(poses)
    if state.last is None:
        state.home = poses[:, :2].copy() if state.home is None else state.home
        state.priority = np.arange(M, dtype=float)
        state.still = np.zeros(M, dtype=np.int64)
        state.about = np.column_stack([poses[:, :2], np.full(M, belief.step)])
    else:
        moving = np.hypot(*(poses[:, :2] - state.last[:, :2]).T) > cfg.right_of_way.standing
        state.still = np.where(moving, 0, state.still + 1)
        left = np.hypot(*(poses[:, :2] - state.about[:, :2]).T) > cfg.right_of_way.left_place
        state.about[left] = np.column_stack([poses[left, :2], np.full(int(left.sum()), belief.step)])
    state.last = poses.copy()
    return state


def with_parked(ground: MappedGround, parked: np.ndarray, cfg: LaserExploreConfig) -> Ground:
    """`ground` that costs `parked_cost` where robots stand at `parked` (k, 2): one goes round them if one can."""
    if not len(parked):
        return ground
    taken = disc_mask(ground.grid, parked, 2 * cfg.radius + cfg.apart) & ground.free
    weight = np.where(taken, np.uint8(cfg.allocation.parked_cost), ground.weight)
    return Ground(np.ascontiguousarray(weight), ground.lower, ground.cell, ground.snap)


def route_to(
    ground: MappedGround, place: np.ndarray, parked: np.ndarray, cfg: LaserExploreConfig, far: float = np.inf
) -> ClearCostToGo:
    """Paths to `place` from everywhere on the ground that is at most `far` [m] away, round robots `parked` (k, 2)."""
    priced = with_parked(ground, parked, cfg)
    source = priced.cells(place[None])
    ways = priced.cost_to_go(source[source[:, 0] >= 0], far)
    return ClearCostToGo(priced, ways.cost, clear=priced.free & (priced.weight < cfg.allocation.parked_cost))
