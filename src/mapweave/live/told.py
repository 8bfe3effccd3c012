"""What map processes and planners tell a team: the map, where everybody is in it, where a robot is to drive."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition
from time import monotonic
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from ..core.errors import DataError
from ..core.records import frozen
from ..laser.occupancy_mapper import FREE, OCCUPIED, UNKNOWN, Occupancy
from .door import decode
from .messages import EVERY, LEVEL, GoalMessage, MapState, RefusedError, Tile, Topics, square
from .tiles import SIDE, UNSEEN
from .transport import Callback, Sample, Session, ask

MOST_MAPS = 16  # map processes, or planners, that are heard; a new one takes the place of the one silent for longest
MOST_GOALS = 1_000  # of robots and planners; a new one takes the place of the one told longest ago
MOST_TILE_BYTES = 128 << 20  # of all squares; the oldest ones go
TILE_OVERHEAD = 500  # [bytes] of a square beside its cells
MOST_CELLS = 1 << 26  # of a grid that is put together: 64 squares each way
STALE = 5.0  # [s] after which what is told once a second holds no more


class Squares:
    """The newest of each square by a name of its own, with a version; those that are gone without cells.

    let_go: how many were for want of room.
    """

    def __init__(self) -> None:
        self.kept: dict[str, tuple[int, Tile]] = {}
        self.let_go = 0
        self._size = 0

    def put(self, version: int, tile: Tile) -> None:
        key = f"{tile.map}/{tile.component}/{tile.level}/{tile.i}/{tile.j}"
        before = self.kept.pop(key, None)
        self.kept[key] = version, tile
        self._size += TILE_OVERHEAD + len(tile.cells)
        self._size -= 0 if before is None else TILE_OVERHEAD + len(before[1].cells)
        while self._size > MOST_TILE_BYTES:
            self._size -= TILE_OVERHEAD + len(self.kept.pop(next(iter(self.kept)))[1].cells)
            self.let_go += 1


@runtime_checkable
class Follower(Protocol):
    """Who hears map processes. states: the newest of each that was taken."""

    @property
    def states(self) -> dict[str, MapState]: ...
    def take(self, state: MapState) -> None: ...
    def take_tile(self, tile: Tile) -> None: ...


def follow(session: Session, topics: Topics, follower: Follower, level: int | None = None) -> list[object]:
    """`follower` hears every map process of the team for as long as what is returned is held.

    level: the squares of this level alone.
    """
    question = "" if level is None else f"{LEVEL}={level}"

    def take(payload: bytes, name: str | None = None) -> None:
        try:
            message = decode(payload)
        except RefusedError:
            return
        if isinstance(message, MapState) and message.map == name:
            new = name not in follower.states
            follower.take(message)
            if new:  # what it has drawn so far is asked for
                ask(session, topics.tiles(name), question, take, lambda: None)
        elif isinstance(message, Tile) and name in {None, message.map} and level in {None, message.level}:
            follower.take_tile(message)

    def hear(sample: Sample) -> None:
        take(sample.payload.to_bytes(), topics.map_of(str(sample.key_expr)))

    callback = Callback(hear)
    return [session.declare_subscriber(key, callback) for key in (topics.map_state(), topics.tile(level=level))]


@dataclass(frozen=True, slots=True)
class TeamRobot:
    """A robot as a map process has it. there: whether it is on the network; finished: whether its drive has ended.

    sensor: `laser` or `landmarks`, empty before it told.
    part: of the map in which it stands, 1 the largest, 0 none; the rest None then. pose: (3,) `T_map_robot`
    [m, m, rad] and cov: (3, 3) of it; frame: (3,) `T_map_local`, where the frame of its own estimate stands.
    """

    name: str
    there: bool
    finished: bool
    part: int
    pose: Float[np.ndarray, "3"] | None
    cov: Float[np.ndarray, "3 3"] | None
    frame: Float[np.ndarray, "3"] | None
    sensor: str


@dataclass(frozen=True, slots=True)
class TeamGrid:
    """A part of the map in square cells.

    resolution: cell side [m]; origin: (2,) lower left corner [m]; cells: (rows, cols) uint8, the row of lowest y first:
    0 unseen, 1 free to 255 occupied.
    """

    part: int
    resolution: float
    origin: Float[np.ndarray, "2"]
    cells: UInt8[np.ndarray, "rows cols"]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.cells.shape

    def occupancy(self) -> Float[np.ndarray, "rows cols"]:
        """The probability that a cell is occupied; 1/2 where nothing was seen."""
        return np.where(self.cells == UNSEEN, 0.5, (self.cells.astype(np.float32) - 1) / 254)

    def planned_on(self, above: float) -> Occupancy:
        """The map as a planner takes it: occupied where the probability is over `above`."""
        state = np.where(self.occupancy() > above, OCCUPIED, FREE)
        return Occupancy(self.resolution, self.origin, np.where(self.cells == UNSEEN, UNKNOWN, state).astype(np.int8))


@dataclass(frozen=True, slots=True)
class TeamGoal:
    """Where a robot is to drive: (3,) `T_map_robot` [m, m, rad] in this part of the map. number: counts its goals."""

    part: int
    pose: Float[np.ndarray, "3"]
    number: int


class LiveTeam:
    """What a team knows, as it was told last; any thread may ask at any time, and nothing waits but `wait`.

    Of several map processes the first by name counts that told something within the last five seconds, and likewise of
    several planners. Frames are those of the parts of its map: part 1 is the largest, and robots that nothing ties to
    these have parts of their own. Where the map process learns better, a robot's place and the map move, and all that
    is asked for at one time fits together again.

    Parameters
    ----------
    clock
        Of what is stale [s].
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self.states: dict[str, MapState] = {}
        self._clock = clock
        self._heard: dict[str, float] = {}
        self._goals: dict[tuple[str, str], tuple[float, GoalMessage]] = {}  # by planner and robot
        self._squares = Squares()
        self._version = self._seen = 0
        self._changed = Condition()

    def take(self, state: MapState) -> None:
        """What a map process says."""
        with self._changed:
            if state.map not in self.states and len(self.states) >= MOST_MAPS:
                silent = min(self._heard, key=self._heard.__getitem__)
                del self.states[silent], self._heard[silent]
            self.states[state.map], self._heard[state.map] = state, self._clock()
            self._news()

    def take_tile(self, tile: Tile) -> None:
        """A square as a map process has it."""
        with self._changed:
            self._squares.put(self._version, tile)
            self._news()

    def take_goal(self, goal: GoalMessage) -> None:
        """Where a planner sends a robot."""
        with self._changed:
            key = goal.map, goal.robot
            if key not in self._goals and len(self._goals) >= MOST_GOALS:
                del self._goals[min(self._goals, key=lambda one: self._goals[one][0])]
            self._goals[key] = self._clock(), goal
            self._news()

    def wait(self, timeout: float) -> bool:
        """Whether anything was told since this was asked last; waits for it for `timeout` [s] at most."""
        with self._changed:
            news = self._changed.wait_for(lambda: self._version > self._seen, timeout)
            self._seen = self._version
            return news

    @property
    def map(self) -> str:
        """The map process that counts; empty while none is heard."""
        with self._changed:
            fresh = [name for name, when in self._heard.items() if self._clock() <= when + STALE]
            return min(fresh, default="")

    def robots(self) -> dict[str, TeamRobot]:
        """All robots by their names; none while no map process is heard."""
        state = self.states.get(self.map)
        out = {}
        for r in () if state is None else state.robots:
            placed = r.component > 0 and len(r.pose) == len(r.frame) == 3
            pose, frame = (frozen(r.pose), frozen(r.frame)) if placed else (None, None)
            cov = frozen(square(r.cov)) if placed else None
            part = r.component if placed else 0
            out[r.robot] = TeamRobot(r.robot, r.there, r.finished, part, pose, cov, frame, r.sensor)
        return out

    def grid(self, part: int = 1, level: int = 0) -> TeamGrid | None:
        """The map that lasers made of a part; None where there is none.

        level: 0 is as fine as the map is made, each further one four times coarser, its cells as occupied as the most
        occupied of their sixteen. Raises DataError for a map whose squares are too far apart for a grid.
        """
        name = self.map
        with self._changed:
            kept = [tile for _, tile in self._squares.kept.values()]
        mine = [t for t in kept if (t.map, t.component, t.level) == (name, part, level) and t.cells]
        if not mine:
            return None
        at = np.array([(t.j, t.i) for t in mine])
        low, across = at.min(axis=0), np.ptp(at, axis=0) + 1
        if int(across[0]) * int(across[1]) * SIDE**2 > MOST_CELLS:
            raise DataError(f"map process {name} tells of a map of {across[1]} x {across[0]} squares")
        cells = np.zeros(across * SIDE, np.uint8)
        for (j, i), tile in zip((at - low) * SIDE, mine, strict=True):
            cells[j : j + SIDE, i : i + SIDE] = np.frombuffer(zlib.decompress(tile.cells), np.uint8).reshape(SIDE, SIDE)
        cell = mine[-1].cell
        return TeamGrid(part, cell, frozen(low[::-1] * SIDE * cell), frozen(cells, np.uint8))

    def goal(self, robot: str) -> TeamGoal | None:
        """Where a planner sends the robot; None where none does, or it may stand."""
        name = self.map
        with self._changed:
            fresh = [goal for when, goal in self._goals.values() if self._clock() <= when + STALE]
        mine = [goal for goal in fresh if (goal.robot, goal.of) == (robot, name)]
        first = min(mine, key=lambda goal: goal.map, default=None)
        if first is None or not first.pose:
            return None
        return TeamGoal(first.component, frozen(first.pose), first.number)

    def _news(self) -> None:
        self._version += 1
        self._changed.notify_all()


def hear_team(
    session: Session, topics: Topics, team: LiveTeam, robot: str = EVERY, level: int | None = None
) -> list[object]:
    """`team` hears map processes, and the goals of a robot or of all, for as long as what is returned is held.

    level: the squares of this level alone.
    """

    def goal(sample: Sample) -> None:
        try:
            message = decode(sample.payload.to_bytes())
        except RefusedError:
            return
        key = str(sample.key_expr)
        if isinstance(message, GoalMessage) and key == topics.goal(message.robot, message.map):
            team.take_goal(message)

    return [*follow(session, topics, team, level), session.declare_subscriber(topics.goal(robot), Callback(goal))]
