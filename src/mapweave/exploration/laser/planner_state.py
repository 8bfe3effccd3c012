"""What a team of laser robots keeps in mind between two steps: goals, what was put off, who gave way."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...kernels.exploration.wavefront import NO_LIMIT, STRAIGHT, descend, spread
from ...kernels.walls.segments import sight_on_raster
from ...laser.occupancy import Occupancy
from .frontiers import PARKED, Ground, disc_mask, nearest_cells
from .view import LaserExploreConfig, LaserView

LEFT = 0.6  # [m] from where a robot was, then it has left that place
SAME = 0.8  # [m], places nearer than this are one goal


@dataclass(frozen=True, slots=True)
class Ways:
    """How far every cell of `grid` is from a place.

    cost: (rows, cols) as `kernels.wavefront.spread` makes it of `weight`, which is PARKED where another robot stands;
    clear: (rows, cols) where a robot's disc fits and nobody stands.
    """

    grid: Occupancy
    cost: np.ndarray
    weight: np.ndarray
    clear: np.ndarray

    def metres(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Length of the way from each place, walls' nearness counted as length; infinite where no way leads."""
        cells = nearest_cells(self.grid, self.cost >= 0, places)
        found = np.where(cells[:, 0] >= 0, self.cost[cells[:, 0], cells[:, 1]], -1)
        return np.asarray(np.where(found >= 0, found * self.grid.resolution / STRAIGHT, np.inf))

    def target(self, place: Float[np.ndarray, "2"], ahead: float) -> Float[np.ndarray, "2"] | None:
        """The farthest place on the way, at most `ahead` metres on, to which a straight line stays clear."""
        way = self.down(place, ahead)
        if len(way) == 0:
            return None
        start, *cells = (way - self.grid.origin) / self.grid.resolution
        for k in range(len(way) - 1, 2, -1):
            if sight_on_raster(self.clear, start, cells[k - 1]):
                return np.asarray(way[k])
        return np.asarray(way[min(2, len(way) - 1)])

    def down(self, place: Float[np.ndarray, "2"], metres: float) -> Float[np.ndarray, "n 2"]:
        """The first `metres` of the way from `place`, cell by cell; none where no way leads."""
        cell = nearest_cells(self.grid, self.cost >= 0, place[None])[0]
        if cell[0] < 0:
            return np.zeros((0, 2))
        return self.grid.centres(descend(self.cost, self.weight, cell, int(metres / self.grid.resolution) + 1))


@dataclass(slots=True)
class Goal:
    """Where a robot heads and why. unknown: (k, 2) cells it is to see there; least: the shortest way left so far [m],
    `since` the step when it last grew shorter; done: all is seen, the robot goes on until it gets another goal.
    """

    place: np.ndarray
    unknown: np.ndarray
    ways: Ways
    since: int
    born: int
    least: float = np.inf
    at: int | None = None  # the step when the robot got there
    done: bool = False


@dataclass(slots=True)
class Crew:
    """goals by robot; asides: where robots go to let another pass; put_off: place, until which step, how often."""

    goals: dict[int, Goal] = field(default_factory=dict)
    asides: "dict[int, Aside]" = field(default_factory=dict)
    put_off: list[tuple[np.ndarray, int, int]] = field(default_factory=list)
    rank: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ground: Ground | None = None
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
            np.hypot(*(place - p)) < SAME and (times >= cfg.give_up or (waiting and step < until))
            for p, until, times in self.put_off
        )

    def defer(self, place: np.ndarray, step: int, cfg: LaserExploreConfig) -> None:
        """`place` is not tried for a while, longer every time."""
        for k, (p, _, times) in enumerate(self.put_off):
            if np.hypot(*(place - p)) < SAME:
                self.put_off[k] = (p, step + cfg.put_off * 2**times, times + 1)
                return
        self.put_off.append((place.copy(), step + cfg.put_off, 1))


@dataclass(slots=True)
class Aside:
    """Where robot `whom` is let pass, or, by oneself, where one tries again from. until: when waiting ends anyway."""

    place: np.ndarray
    ways: Ways
    whom: int
    until: int


def crew_of(view: LaserView, poses: np.ndarray) -> Crew:
    """The crew in the planner's memory, made at the first call."""
    crew: Crew = view.memory.setdefault("crew", Crew())
    M = len(poses)
    if crew.last is None:
        crew.home = poses[:, :2].copy() if crew.home is None else crew.home
        crew.rank = np.arange(M, dtype=float)
        crew.still = np.zeros(M, dtype=np.int64)
        crew.about = np.column_stack([poses[:, :2], np.full(M, view.step)])
    else:
        moved = np.hypot(*(poses[:, :2] - crew.last[:, :2]).T) > 0.03
        crew.still = np.where(moved, 0, crew.still + 1)
        left = np.hypot(*(poses[:, :2] - crew.about[:, :2]).T) > LEFT
        crew.about[left] = np.column_stack([poses[left, :2], np.full(int(left.sum()), view.step)])
    crew.last = poses.copy()
    return crew


def priced(ground: Ground, parked: np.ndarray, cfg: LaserExploreConfig) -> np.ndarray:
    """`ground.weight` with PARKED where robots stand at `parked` (k, 2): one goes round them if one can."""
    if not len(parked):
        return ground.weight
    taken = disc_mask(ground.grid, parked, 2 * cfg.radius + cfg.apart) & (ground.weight > 0)
    return np.where(taken, np.uint8(PARKED), ground.weight)


def ways_to(
    ground: Ground, place: np.ndarray, parked: np.ndarray, cfg: LaserExploreConfig, far: float = np.inf
) -> Ways:
    """Ways to `place` from everywhere on the ground that is at most `far` [m] away, round robots `parked` (k, 2)."""
    weight = np.ascontiguousarray(priced(ground, parked, cfg))
    source = nearest_cells(ground.grid, weight > 0, place[None])
    limit = int(min(far / ground.grid.resolution * STRAIGHT, NO_LIMIT))
    cost = spread(weight, source[source[:, 0] >= 0], limit)
    return Ways(ground.grid, cost, weight, (weight > 0) & (weight < PARKED))
