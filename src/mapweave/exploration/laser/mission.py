"""One exploration with lasers, step by step: what a planner knows, choose, drive, scan, map; deaths, lost messages."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core import se2
from ...core.records import Scan
from ...evaluation.building import Building, known_at
from ...kernels.walls.segments import sight_on_raster
from ...laser.occupancy import Occupancy, of_grid
from ...mapping.laser_team import LaserTeam
from ...sim.laser import stream
from ...sim.laser_team import LaserTeamSim
from ..ground import CostToGo, Ground
from ..planner_interface import TeamBelief, query_planner
from .config import ARCS_APART, OCCUPIED_SHARE, LaserMissionConfig, LaserPlace, LaserPlan
from .frontiers import MappedGround, disc_mask, frontiers, mapped_ground

WAY_LEFT_PLACE = 0.6  # [m] from where a robot was beyond which it has left that place
PLAN_GIVE_UP = 3  # times a goal was put off, then it is given up
MISSION_NEW_GROUND = 12  # samples on beams in unknown cells from which on a scan showed something new
GOALS_SAME = 0.8  # [m] between places below which they are one goal: two robots' width
WAY_STANDING = 0.03  # [m] a step, up to which a robot stands still
SHARED_PARKED_COST = 12  # what a metre of path where a robot stands counts: one goes round it if one can
GOALS_PUT_OFF = 100  # [steps] for which a goal is put off; twice as long every time
MISSION_BEAM_STRIDE = 4  # every so many beams are looked along for that
MISSION_FRONTIER_CHECK_EVERY = 10  # [steps] between looks for frontiers where the planner never says it has finished


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserBelief(TeamBelief):
    """grid: the merged map; scans: for each robot the points (k, 2) [m] of its present scan in its own frame, other
    robots among them. A planner that sets memory["finished"] ends the run.
    """

    grid: Occupancy
    scans: tuple[np.ndarray, ...]


LaserPlanner = Callable[[LaserBelief, Float[np.ndarray, "r 3"], LaserPlan], Float[np.ndarray, "r 2"]]


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

    def given_up(self) -> Float[np.ndarray, "n 2"]:
        """Places that nobody tries to reach any more."""
        return np.array([p for p, _, times in self.put_off if times >= PLAN_GIVE_UP]).reshape(-1, 2)

    def barred(self, place: np.ndarray, step: int, *, waiting: bool = True) -> bool:
        """Whether `place` was given up, or (`waiting`) was put off until later than `step`."""
        return any(
            np.hypot(*(place - p)) < GOALS_SAME and (times >= PLAN_GIVE_UP or (waiting and step < until))
            for p, until, times in self.put_off
        )

    def defer(self, place: np.ndarray, step: int) -> None:
        """`place` is not tried for a while, longer every time."""
        for k, (p, _, times) in enumerate(self.put_off):
            if np.hypot(*(place - p)) < GOALS_SAME:
                self.put_off[k] = (p, step + GOALS_PUT_OFF * 2**times, times + 1)
                return
        self.put_off.append((place.copy(), step + GOALS_PUT_OFF, 1))


@dataclass(slots=True)
class YieldPlace:
    """Where robot `whom` is let pass, or, by oneself, where one tries again from. until: when waiting ends anyway."""

    place: np.ndarray
    route: ClearCostToGo
    whom: int
    until: int


def planner_state_of(belief: LaserBelief, poses: np.ndarray) -> PlannerState:
    """The state in the planner's memory, made at the first call, brought up to date with `poses` (M, 3)."""
    state: PlannerState = belief.memory.setdefault("planner_state", PlannerState())
    M = len(poses)
    if state.last is None:
        state.home = poses[:, :2].copy() if state.home is None else state.home
        state.priority = np.arange(M, dtype=float)
        state.still = np.zeros(M, dtype=np.int64)
        state.about = np.column_stack([poses[:, :2], np.full(M, belief.step)])
    else:
        moving = np.hypot(*(poses[:, :2] - state.last[:, :2]).T) > WAY_STANDING
        state.still = np.where(moving, 0, state.still + 1)
        left = np.hypot(*(poses[:, :2] - state.about[:, :2]).T) > WAY_LEFT_PLACE
        state.about[left] = np.column_stack([poses[left, :2], np.full(int(left.sum()), belief.step)])
    state.last = poses.copy()
    return state


def with_parked(ground: MappedGround, parked: np.ndarray, cfg: LaserPlan) -> Ground:
    """`ground` that is dear where robots stand at `parked` (k, 2): one goes round them if one can."""
    if not len(parked):
        return ground
    taken = disc_mask(ground.grid, parked, 2 * cfg.radius + ARCS_APART) & ground.free
    weight = np.where(taken, np.uint8(SHARED_PARKED_COST), ground.weight)
    return Ground(np.ascontiguousarray(weight), ground.lower, ground.cell, ground.snap)


def route_to(
    ground: MappedGround, place: np.ndarray, parked: np.ndarray, cfg: LaserPlan, far: float = np.inf
) -> ClearCostToGo:
    """Paths to `place` from everywhere on the ground that is at most `far` [m] away, round robots `parked` (k, 2)."""
    priced = with_parked(ground, parked, cfg)
    source = priced.cells(place[None])
    ways = priced.cost_to_go(source[source[:, 0] >= 0], far)
    return ClearCostToGo(priced, ways.cost, clear=priced.free & (priced.weight < SHARED_PARKED_COST))


@dataclass(frozen=True, slots=True)
class LaserStepRecord:
    """One step. commands (M, 2); true and estimated poses (M, 3) in the map's frame; scans: each robot's, None of the
    dead; explored: share of the reachable area known to be free; closures: loops closed so far; seconds: what the
    decision took.
    """

    step: int
    t: float
    commands: np.ndarray
    true_poses: np.ndarray
    poses: np.ndarray
    scans: tuple[Scan | None, ...]
    explored: float
    closures: int
    seconds: float
    decisions: int


@dataclass(slots=True)
class LaserRun:
    """A team at work. `play` yields a `LaserStepRecord` a step, the first before any drive; then the attributes hold
    the outcome. The map's frame is the world's: the first robot's start is known, the others' with the team's start
    errors.
    """

    place: LaserPlace
    building: Building
    cfg: LaserMissionConfig
    planner: LaserPlanner
    seed: int
    kills: Mapping[int, int] = field(default_factory=dict)  # robot index -> step at whose start it dies
    drop: float = 0.0
    until: str | int = "field"
    robots: tuple[str, ...] = ()
    sim: LaserTeamSim = field(init=False)
    team: LaserTeam = field(init=False)
    grid: Occupancy = field(init=False)
    plan: LaserPlan = field(init=False)
    alive: Any = None
    stalled: Any = None
    memory: dict[str, Any] = field(default_factory=dict)
    finished: bool = False
    step: int = 0
    status: list[dict[str, int]] = field(default_factory=list)
    timing: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("decide", "drive", "look", "map"), 0.0))
    _messages: Any = None
    _sample: Any = None
    _points: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        starts = self.place.starts
        M = len(starts)
        self.sim = LaserTeamSim(self.place.world, starts, self.cfg.robots, self.seed)
        believed = starts.copy()
        sd = [self.cfg.team.graph.start_xy, self.cfg.team.graph.start_xy, self.cfg.team.graph.start_turn]
        believed[1:] += stream(self.seed, "starts").standard_normal((M, 3))[1:] * sd
        self.team = LaserTeam(self.cfg.team, believed)
        self.plan = self.cfg.planning()
        self.robots = tuple(f"robot{k + 1}" for k in range(M))
        self.alive, self.stalled = np.ones(M, dtype=bool), np.zeros(M, dtype=int)
        self.status = [{} for _ in range(M)]
        self._messages = stream(self.seed, "messages")
        places = self.building.places()
        self._sample = places[:: max(1, len(places) // 20_000)]
        self._points = [np.zeros((0, 2)) for _ in range(M)]

    def play(self) -> Iterator[LaserStepRecord]:
        """A look around, then steps until the planner has finished, `until` steps are done or every robot is dead."""
        still = np.zeros((len(self.robots), 2))
        yield self._moment(still, self._scan(), 0.0, 0)
        while self.alive.any() and self.step < self.plan.max_steps:
            if isinstance(self.until, int) and self.step >= self.until:
                self.finished = True
                break
            self._deaths()
            before = perf_counter()
            commands = self._commands()
            seconds, decisions = perf_counter() - before, int(self.alive.sum())
            self.timing["decide"] += seconds
            if self._reached():
                self.finished = True
                break
            commands[~self.alive] = 0.0
            self._timed("drive", lambda u=commands: self.sim.step(u))
            self.step += 1
            yield self._moment(commands, self._scan(), seconds, decisions)
        for j in map(int, np.flatnonzero(self.alive)):
            self.team.deliver(j)
        self._timed("map", lambda: self.team.optimise(force=True))

    def belief(self) -> LaserBelief:
        return LaserBelief(
            step=self.step,
            robots=self.robots,
            alive=self.alive,
            stalled=self.stalled,
            memory=self.memory,
            grid=self.grid,
            scans=tuple(self._points),
        )

    def _reached(self) -> bool:
        """Whether the planner has finished; of one that never says so, whether no frontier is left to get to."""
        if self.until != "field":
            return False
        if "finished" in self.memory:
            return bool(self.memory["finished"])
        if self.step % MISSION_FRONTIER_CHECK_EVERY:
            return False
        poses = self.team.poses()[:, :2]
        return not frontiers(mapped_ground(self.grid, poses[self.alive], poses[~self.alive], self.plan))

    def _commands(self) -> Float[np.ndarray, "r 2"]:
        return query_planner(
            self.planner, self.belief(), self.team.poses(), self.plan, (self.plan.speed, self.plan.turn)
        )

    def _deaths(self) -> None:
        for j, when in self.kills.items():
            if self.step >= when and self.alive[j]:
                self.alive[j] = False
                self.team.remove_robot(j)
                self._points[j] = np.zeros((0, 2))

    def _scan(self) -> tuple[Scan | None, ...]:
        """Every live robot scans, tells the team unless its message is lost, and the map is brought up to date."""
        scans: list[Scan | None] = []
        before = perf_counter()
        for j in range(len(self.robots)):
            if not self.alive[j]:
                scans.append(None)
                continue
            scan = self.sim.scan(j)
            pose = self.team.add_scan(j, self.sim.t, scan)
            status = self.team.tracks[j].status
            self.status[j][status] = self.status[j].get(status, 0) + 1
            if self.step:
                self.stalled[j] = 0 if self._shows_new(scan, pose) else self.stalled[j] + 1
            if self._messages.random() >= self.drop:
                self.team.deliver(j)
            self._points[j] = points_of(scan)
            scans.append(scan)
        middle = perf_counter()
        self.team.optimise()
        self.grid = of_grid(self.team.grid(self.plan.resolution), OCCUPIED_SHARE)
        self.timing["look"] += middle - before
        self.timing["map"] += perf_counter() - middle
        return tuple(scans)

    def _shows_new(self, scan: Scan, pose: Float[np.ndarray, "3"]) -> bool:
        """Whether the scan's beams pass cells that the map did not know before it."""
        grid = self.grid
        angle = (scan.angles() + pose[2])[::MISSION_BEAM_STRIDE]
        r = np.minimum(scan.ranges[::MISSION_BEAM_STRIDE], self.plan.reach)
        along = np.arange(0.5, self.plan.reach / grid.resolution) * grid.resolution
        kept = along[None] < r[:, None] - grid.resolution
        points = pose[:2] + along[None, :, None] * np.column_stack([np.cos(angle), np.sin(angle)])[:, None]
        known = known_at(points[kept], grid.state != -1, grid.origin, grid.resolution)
        return int((~known).sum()) >= MISSION_NEW_GROUND

    def _moment(
        self, commands: np.ndarray, scans: tuple[Scan | None, ...], seconds: float, decisions: int
    ) -> LaserStepRecord:
        g = self.grid
        known = known_at(self._sample, g.free, g.origin, g.resolution)
        return LaserStepRecord(
            self.step,
            self.sim.t,
            commands,
            self.sim.true_poses.copy(),
            self.team.poses(),
            scans,
            float(known.mean()) if len(known) else 0.0,
            sum(c.accepted for c in self.team.closures),
            seconds,
            decisions,
        )

    def _timed(self, what: str, work: Any) -> None:
        before = perf_counter()
        work()
        self.timing[what] += perf_counter() - before


def points_of(scan: Scan) -> Float[np.ndarray, "k 2"]:
    """The returns in the robot's frame."""
    angle, r = scan.angles()[scan.hit], scan.ranges[scan.hit]
    return np.asarray(se2.act(scan.T_robot_sensor, r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])))
