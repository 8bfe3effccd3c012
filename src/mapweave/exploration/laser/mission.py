"""One exploration with lasers, step by step: what a planner knows, choose, drive, scan, map; deaths, lost messages."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ...core import se2
from ...core.records import Scan
from ...evaluation.building import Building, known_at
from ...kernels.walls.segments import sight_on_raster
from ...laser.occupancy_mapper import Occupancy, of_grid
from ...mapping.keyframe_graph import START_SD
from ...mapping.laser_team import LaserTeam
from ...mapping.merge import Merge, merge_maps
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
MOVED = 0.15  # [m] that an earlier scan went on behind a point for something to have moved there,
MOVED_SCANS = 10  # scans that are asked: five seconds
MEETING_KEYFRAMES = 12  # of a robot, from which on it is looked for in others' maps: some seven metres of way
MEETING_VIEWS = 10  # scans in which they would see each other; of so many
MEETING_SEEN = 0.8  # must show them. With less, a wrong meeting being what spoils all that comes after,
MEETING_UNSEEN_KEYFRAMES = 24  # of either robot are asked, some 14 metres of way, and
MEETING_UNSEEN_WRONG = 0.02  # probability at most that their maps do not lie so
MEETING_GROWN = 1.25  # times the keyframes of both after which they are tried on each other again
MISSION_FRONTIER_CHECK_EVERY = 10  # [steps] between looks for frontiers where the planner never says it has finished


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserBelief(TeamBelief):
    """grid: the merged map; scans: for each robot the points (k, 2) [m] of its present scan in its own frame, other
    robots among them; moving: those of them that lie where it saw floor before: robots that it does not know. A planner
    that sets memory["finished"] ends the run.
    """

    grid: Occupancy
    scans: tuple[np.ndarray, ...]
    moving: tuple[np.ndarray, ...]


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


def planner_home(memory: Mapping[str, Any], poses: np.ndarray) -> Float[np.ndarray, "k 2"]:
    """Where robots set out by a planner's memory; where they are at `poses` (k, 3) if it has not planned yet."""
    state = memory.get("planner_state")
    return np.array(poses[:, :2] if state is None or state.home is None else state.home)


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
    """One step. commands (M, 2); true and estimated poses (M, 3) in the map's frame, NaN of robots that have not met
    the first one's crew; scans: each robot's, None of the dead; explored: share of the reachable area known to be free;
    closures: loops closed so far; maps: how many there are; seconds: what the decision took.
    """

    step: int
    t: float
    commands: np.ndarray
    true_poses: np.ndarray
    poses: np.ndarray
    scans: tuple[Scan | None, ...]
    explored: float
    closures: int
    maps: int
    seconds: float
    decisions: int


@dataclass(slots=True)
class Crew:
    """Robots that have one map and plan together. grid: that map; memory: their planner's; finished: nothing is left
    for them to do until they meet others.
    """

    robots: Int[np.ndarray, " k"]
    memory: dict[str, Any] = field(default_factory=dict)
    grid: Occupancy = field(init=False)
    finished: bool = False


class Meeting(NamedTuple):
    """The latest decision on two robots that did not know how their maps lie.

    wrong: probability that they do not lie as was decided; seen, through: how often a robot of either crew was in view
    of one of the other where their maps would put it, and was seen, and how often what is behind was.
    """

    step: int
    robots: tuple[str, str]
    joined: bool
    reason: str
    wrong: float | None = None
    seen: int = 0
    through: int = 0


@dataclass(slots=True)
class LaserRun:
    """A team at work. `play` yields a `LaserStepRecord` a step, the first before any drive; then the attributes hold
    the outcome. The map's frame is the world's: the first robot's start is known, the others' with the team's start
    errors, or (`apart`) not at all: those drive for themselves until they are found in another's map.

    crews: robots that share a map, by their first robot; the first one's map is the outcome; meetings: the latest
    decision on each two robots that were tried on each other.
    """

    place: LaserPlace
    building: Building
    cfg: LaserMissionConfig
    planner: LaserPlanner
    seed: int
    kills: Mapping[int, int] = field(default_factory=dict)  # robot index -> step at whose start it dies
    drop: float = 0.0
    until: str | int = "field"
    apart: bool = False
    robots: tuple[str, ...] = ()
    sim: LaserTeamSim = field(init=False)
    team: LaserTeam = field(init=False)
    crews: list[Crew] = field(init=False)
    meetings: dict[tuple[int, int], Meeting] = field(default_factory=dict)
    plan: LaserPlan = field(init=False)
    alive: Any = None
    stalled: Any = None
    finished: bool = False
    step: int = 0
    status: list[dict[str, int]] = field(default_factory=list)
    timing: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("decide", "drive", "look", "map"), 0.0))
    _tried: dict[tuple[int, int], int] = field(default_factory=dict)  # keyframes of both, by pairs of robots
    _messages: Any = None
    _sample: Any = None
    _points: list[np.ndarray] = field(default_factory=list)
    _seen: list[deque[tuple[np.ndarray, Scan]]] = field(default_factory=list)  # local pose and scan, the latest ones

    def __post_init__(self) -> None:
        starts = self.place.starts
        M = len(starts)
        self.sim = LaserTeamSim(self.place.world, starts, self.cfg.robots, self.seed)
        believed = starts.copy()
        believed[1:] += stream(self.seed, "starts").standard_normal((M, 3))[1:] * START_SD
        if self.apart:
            believed[1:] = 0.0
        self.team = LaserTeam(self.cfg.team, believed, apart=self.apart)
        self.crews = [Crew(np.array([j])) for j in range(M)] if self.apart else [Crew(np.arange(M))]
        self.plan = self.cfg.planning()
        self.robots = tuple(f"robot{k + 1}" for k in range(M))
        self.alive, self.stalled = np.ones(M, dtype=bool), np.zeros(M, dtype=int)
        self.status = [{} for _ in range(M)]
        self._messages = stream(self.seed, "messages")
        places = self.building.places()
        self._sample = places[:: max(1, len(places) // 20_000)]
        self._points = [np.zeros((0, 2)) for _ in range(M)]
        self._seen = [deque(maxlen=MOVED_SCANS) for _ in range(M)]

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
            if all(crew.finished for crew in self._living()) and not self._meet(last=True):
                self.finished = len(self._living()) == 1
                break
            commands[~self.alive] = 0.0
            self._timed("drive", lambda u=commands: self.sim.step(u))
            self.step += 1
            yield self._moment(commands, self._scan(), seconds, decisions)
        for j in map(int, np.flatnonzero(self.alive)):
            self.team.deliver(j)
        self._timed("map", lambda: self.team.optimise(force=True))

    @property
    def grid(self) -> Occupancy:
        """The map of the first robot's crew, as it is planned on."""
        return self.crews[0].grid

    @property
    def memory(self) -> dict[str, Any]:
        """The memory of the planner of the first robot's crew."""
        return self.crews[0].memory

    def belief(self, crew: Crew) -> LaserBelief:
        """What the robots of a crew know."""
        own = crew.robots.tolist()
        return LaserBelief(
            step=self.step,
            robots=tuple(self.robots[j] for j in own),
            alive=self.alive[own],
            stalled=self.stalled[own],
            memory=crew.memory,
            grid=crew.grid,
            scans=tuple(self._points[j] for j in own),
            moving=tuple(self._moving(j, crew) for j in own),
        )

    def _moving(self, j: int, crew: Crew) -> np.ndarray:
        """The points of robot j's scan where it saw floor a moment ago, but for robots of its crew."""
        points, seen = self._points[j], self._seen[j]
        if len(self.crews) < 2 or not len(points) or not self.alive[j]:
            return np.zeros((0, 2))
        now, poses = self.team.tracks[j].local, self.team.poses()
        moved = np.zeros(len(points), dtype=bool)
        for local, scan in seen:
            at = se2.act(se2.inverse(se2.compose(se2.between(now, local), scan.T_robot_sensor)), points)
            beam = (np.arctan2(at[:, 1], at[:, 0]) - scan.angle_min) % (2.0 * np.pi) / scan.angle_increment
            beam = np.rint(beam).astype(np.int64)[:, None] + [-1, 0, 1]
            inside = ((beam >= 0) & (beam < len(scan.ranges))).all(axis=1)
            beyond = scan.ranges[np.clip(beam, 0, len(scan.ranges) - 1)].min(axis=1)
            moved |= inside & (beyond > np.hypot(at[:, 0], at[:, 1]) + MOVED)
        for k in crew.robots[crew.robots != j].tolist():
            there = se2.between(poses[j], poses[k])[:2]
            moved &= np.hypot(*(points - there).T) > self.cfg.team.teammate
        if not moved.any():
            return points[moved]
        return points[cKDTree(points[moved]).query(points)[0] <= 2.0 * self.plan.radius]  # the rest of its hull

    def _living(self) -> list[Crew]:
        return [crew for crew in self.crews if self.alive[crew.robots].any()]

    def _reached(self, crew: Crew) -> bool:
        """Whether the planner has finished; of one that never says so, whether no frontier is left to get to."""
        if self.until != "field":
            return False
        if "finished" in crew.memory:
            return bool(crew.memory["finished"])
        if self.step % MISSION_FRONTIER_CHECK_EVERY:
            return crew.finished
        alive = self.alive[crew.robots]
        poses = self.team.poses()[crew.robots, :2]
        return not frontiers(mapped_ground(crew.grid, poses[alive], poses[~alive], self.plan))

    def _commands(self) -> Float[np.ndarray, "r 2"]:
        """What each robot does next; those of a crew that has finished stand still."""
        commands, poses = np.zeros((len(self.robots), 2)), self.team.poses()
        limits = (self.plan.speed, self.plan.turn)
        for crew in self._living():
            told = query_planner(self.planner, self.belief(crew), poses[crew.robots], self.plan, limits)
            crew.finished = self._reached(crew)
            commands[crew.robots] = 0.0 if crew.finished else told
        return commands

    def _meet(self, *, last: bool = False) -> bool:
        """Crews of which one is found in the other's map are one from now on; returns whether any are.

        Robots are tried on each other when they have so many times more keyframes than when they were; last: whenever
        they have more at all, or were too young.
        """
        crew, of = self.team.team.crew, self.team.team.of
        grown, least = (1.0, 1) if last else (MEETING_GROWN, MEETING_KEYFRAMES)
        fresh = []
        for b in range(len(self.robots)):
            for a in range(b):
                size = len(of[a]) + len(of[b])
                if crew[a] != crew[b] and min(len(of[a]), len(of[b])) >= least:
                    before = self._tried.get((a, b), 0)
                    if size > before and size >= grown * before:
                        fresh.append((size, a, b))
        for size, a, b in sorted(fresh, reverse=True):
            self._tried[a, b] = size
            met, merge = self._tried_on(a, b)
            self.meetings[a, b] = met
            if met.joined:
                self._join(a, b, merge)
                return True
        return False

    def _tried_on(self, a: int, b: int) -> tuple[Meeting, Merge]:
        """The maps of robots a and b laid on each other, and whether their crews are to be one.

        Where they were in view of each other as the maps lie, it is that which decides.
        """
        merge = merge_maps(self.team.keyframe_map(a), self.team.keyframe_map(b))
        found = Meeting(self.step, (self.robots[a], self.robots[b]), False, merge.reason, merge.probability_wrong)
        if merge.transform is None or merge.probability_wrong is None:
            return found, merge
        seen, through = self.team.in_view(a, b, merge.transform)
        found = found._replace(seen=seen, through=through)
        if (asked := seen + through) >= MEETING_VIEWS:
            if seen >= MEETING_SEEN * asked:
                why = f"{merge.reason}; they saw each other there {seen} times of {asked}"
                return found._replace(joined=True, reason=why), merge
            why = f"they would have seen each other there {asked} times, and did {seen}; else: {merge.reason}"
            return found._replace(reason=why), merge
        fewest = min(len(self.team.team.of[j]) for j in (a, b))
        if fewest >= MEETING_UNSEEN_KEYFRAMES and merge.probability_wrong <= MEETING_UNSEEN_WRONG:
            return found._replace(joined=True), merge
        sure = f"{100.0 * (1.0 - merge.probability_wrong):.1f} % sure after {fewest} keyframes"
        wanted = f"{100.0 * (1.0 - MEETING_UNSEEN_WRONG):.0f} % after {MEETING_UNSEEN_KEYFRAMES} are asked"
        return found._replace(reason=f"they were not in view of each other, and {sure}; {wanted}"), merge

    def _join(self, a: int, b: int, merge: Merge) -> None:
        """The crews of robots a and b are one; its planner begins anew, but that it knows where they set out."""
        first, second = sorted((c for c in self.crews if {a, b} & set(c.robots.tolist())), key=lambda c: c.robots[0])
        homes = [planner_home(c.memory, self.team.poses()[c.robots]) for c in (first, second)]
        moved = self.team.poses()[second.robots[0]]
        self.team.meet(a, b, merge)
        T = se2.compose(self.team.poses()[second.robots[0]], se2.inverse(moved))
        order = np.argsort(robots := np.concatenate([first.robots, second.robots]))
        home = np.concatenate([homes[0], se2.act(T, homes[1])])[order]
        joined = Crew(robots[order], {"planner_state": PlannerState(home=home)})
        joined.grid = self._drawn(joined)
        self.crews = [joined if c is first else c for c in self.crews if c is not second]

    def _drawn(self, crew: Crew) -> Occupancy:
        return of_grid(self.team.grid(self.plan.resolution, int(crew.robots[0])), OCCUPIED_SHARE)

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
                grid = next(crew.grid for crew in self.crews if j in crew.robots)
                self.stalled[j] = 0 if self._shows_new(grid, scan, pose) else self.stalled[j] + 1
            if self._messages.random() >= self.drop:
                self.team.deliver(j)
            self._points[j] = points_of(scan)
            self._seen[j].append((self.team.tracks[j].local, scan))
            scans.append(scan)
        middle = perf_counter()
        self.team.optimise()
        while self._meet():
            pass
        for crew in self.crews:
            crew.grid = self._drawn(crew)
        self.timing["look"] += middle - before
        self.timing["map"] += perf_counter() - middle
        return tuple(scans)

    def _shows_new(self, grid: Occupancy, scan: Scan, pose: Float[np.ndarray, "3"]) -> bool:
        """Whether the scan's beams pass cells that the map did not know before it."""
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
        poses = self.team.poses()
        poses[np.delete(np.arange(len(poses)), self.crews[0].robots)] = np.nan
        return LaserStepRecord(
            self.step,
            self.sim.t,
            commands,
            self.sim.true_poses.copy(),
            poses,
            scans,
            float(known.mean()) if len(known) else 0.0,
            sum(c.accepted for c in self.team.closures),
            len(self.crews),
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
