"""One exploration, step by step: choose, drive, see, map, hand over, meet; deaths and lost messages included.

Where a robot's true motion meets a wall, it stops short of it, and the team remembers the place.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...core import se2
from ...core.errors import DataError
from ...core.se2 import wrap_angle
from ...core.walls import Walls
from ...fusion.handover import Handover, hand_over, join_maps
from ...fusion.identities import IdentityConfig, Match, match_maps, match_names
from ...kernels.exploration.objective import map_uncertainty, mark_half_disc
from ...kernels.walls.segments import Sector
from ...kernels.walls.sight import mark_in_sight
from ...landmarks.landmark_map import GlobalMap, Submap, known_starts
from ...landmarks.submap_slam import Observations, empty, in_view, move, predict, predicted_observation, update
from ...sim.landmarks import Field
from ..planner_interface import query_planner
from .belief import Explored, LandmarkBelief, Planner
from .config import ExploreConfig
from .floor_plan import FloorPlan, survey_floor
from .steering import is_lost

MEETING = IdentityConfig(scale_sigma=1e-3)  # two maps of one camera's ranges have one scale, but for rounding
MEETING_ODDS = np.log(1000.0)  # against chance: a wrong meeting is what spoils all that comes after
MEETING_RIVAL = np.log(10.0)  # against chance, from which on another alignment says that the place repeats itself
WALLS_CONTACT_STEPS = 40  # [steps] for which the place where a robot met a wall unexpectedly is kept clear of


@dataclass(slots=True)
class Bumper:
    """collisions: how often a wall stopped a robot, one that lasts counting once; contacts: step and place (2,)."""

    walls: Walls | None
    radius: float  # [m]
    collisions: int = 0
    contacts: list[tuple[int, np.ndarray]] = field(default_factory=list)
    touching: set[int] = field(default_factory=set)  # robots stopped in the last step

    def stop(self, j: int, here: Float[np.ndarray, "2"], pose: Float[np.ndarray, "3"], command: np.ndarray) -> bool:
        """Whether a wall stopped robot j between the true place `here` and `pose`.

        Then `pose` is where it stands, and `command` what it carried out, both in place.
        """
        if self.walls is None:
            return False
        share = self.walls.free_share(here, pose[:2], self.radius)
        if share == 1.0:
            self.touching.discard(j)
            return False
        pose[:2] = here + share * (pose[:2] - here)
        if command[0] == 0.0:  # it turned on the spot and slipped
            return False
        command[0] *= share
        self.collisions += j not in self.touching
        self.touching.add(j)
        return True

    def remember(self, step: int, pose: Float[np.ndarray, "3"], heading: float) -> None:
        """A robot at the estimated `pose` in the map, driving along `heading`, met a wall: a radius ahead of it."""
        ahead = self.radius * np.array([np.cos(heading), np.sin(heading)])
        self.contacts.append((step, pose[:2] + ahead))

    def forget(self, before: int) -> None:
        """Contacts of step `before` and earlier are gone."""
        self.contacts = [c for c in self.contacts if c[0] > before]

    def places(self) -> Float[np.ndarray, "k 2"]:
        """Where walls were met."""
        return np.array([p for _, p in self.contacts]).reshape(-1, 2)


@dataclass(slots=True)
class MapTruth:
    """Which landmarks are in a map, and of which true landmark how many sightings of each of its estimates were.

    An estimate is of the landmark that most of its sightings were of: where two landmarks close together were exchanged
    after a first sighting, it comes to lie on the other one.
    """

    safe: set[int] = field(default_factory=set)
    sightings: dict[str, Counter[int]] = field(default_factory=dict)
    misassociations: int = 0

    @property
    def source(self) -> dict[str, int]:
        """Global landmark -> true landmark."""
        return {name: _mostly(sightings) for name, sightings in self.sightings.items()}

    def hand_over(self, origin: dict[str, Counter[int]], ids: tuple[str, ...], done: Handover) -> None:
        """What a submap's landmarks `ids` were of is told of the map's; matches that are wrong are counted.

        origin: submap landmark -> sightings. Wrong: a sighting of another landmark than most of its estimate's, and two
        estimates made one that were not.
        """
        for local, name in zip(ids, done.names, strict=True):
            sightings = origin.get(local)
            if not sightings:
                continue
            self.misassociations += sightings.total() - max(sightings.values())
            if name is not None:
                self._join(name, sightings)
        self._merge(done.merged)

    def meet(self, other: "MapTruth", renamed: dict[str, str], merged: tuple[tuple[str, str], ...]) -> None:
        """The other map, whose landmarks are called as `renamed` says, is part of this one; `merged`: kept, gone."""
        self.safe |= other.safe
        self.misassociations += other.misassociations
        for name, sightings in other.sightings.items():
            self._join(renamed[name], sightings)
        self._merge(merged)

    def _merge(self, merged: tuple[tuple[str, str], ...]) -> None:
        for kept, gone in merged:
            if gone in self.sightings:
                self._join(kept, self.sightings.pop(gone))

    def _join(self, name: str, sightings: Counter[int]) -> None:
        known = self.sightings.setdefault(name, Counter())
        self.misassociations += bool(known) and _mostly(known) != _mostly(sightings)
        known.update(sightings)


@dataclass(slots=True)
class Truth:
    """What only the simulator and the score know: true poses (M, 3), and of each robot, for the submap that is not
    handed over yet, the landmarks seen in it and, submap landmark -> how many of its sightings were of which of them.
    """

    poses: Float[np.ndarray, "r 3"]
    pending: list[set[int]] = field(default_factory=list)
    origin: list[dict[str, Counter[int]]] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Crew:
    """Robots that have one map and plan together. G: that map, its robots in the order of `robots`; lower, upper: (2,)
    corners [m] in it of the field as they know it; memory: their planner's; truth: whose landmarks those of G are.
    """

    robots: Int[np.ndarray, " k"]
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    G: GlobalMap
    explored: Explored
    memory: dict[str, Any] = field(default_factory=dict)
    truth: MapTruth = field(default_factory=MapTruth)

    def at(self, j: int) -> int:
        """Which of the crew's robots robot j is."""
        return int(np.flatnonzero(self.robots == j)[0])


class Meeting(NamedTuple):
    """The latest decision on two crews, named by their first robots, that did not know how their maps lie.

    links: landmarks found to be the same; odds: logarithm, for these links against chance, infinite where names told
    them; wrong: how many of the links are of two landmarks, which the score alone knows.
    """

    step: int
    robots: tuple[str, str]
    joined: bool
    reason: str
    links: int
    odds: float
    wrong: int


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One step of the run, for figures, logs and replay. commands (M, 2), true and estimated poses (M, 3)."""

    step: int
    commands: np.ndarray
    true_poses: np.ndarray
    poses: np.ndarray
    sightings: tuple[Observations, ...]
    handed_over: tuple[int, ...]
    explored: float
    seconds: float
    decisions: int


@dataclass(slots=True)
class Team:
    """A team at work. `play` yields a `StepRecord` a step; afterwards the attributes hold the outcome.

    The map's frame is the world's: the first robot's start is known, and the others' too, or (`apart`) not at all:
    those drive each for itself, in a frame that begins where it does and over as large a field around there, until
    their map is found to be of the same place as another's. crews: robots that share a map, by their first robot; the
    first one's map is the outcome; meetings: the decisions that joined two, and of other pairs the latest.
    """

    world: Field
    cfg: ExploreConfig
    planner: Planner
    rng: np.random.Generator
    kills: dict[int, int] = field(default_factory=dict)  # robot index -> step at whose start it dies
    drop: float = 0.0
    until: str | int = "landmarks"
    true_motion_sd: tuple[float, float, float] | None = None
    apart: bool = False
    robots: tuple[str, ...] = ()
    submaps: list[Submap] = field(default_factory=list)
    ages: list[int] = field(default_factory=list)
    stalled: Any = None
    alive: Any = None
    crews: list[Crew] = field(init=False)
    meetings: list[Meeting] = field(default_factory=list)
    truth: Truth = field(init=False)
    wanted: set[int] = field(init=False)  # landmarks somebody can see
    floor: FloorPlan | None = None
    bumper: Bumper = field(init=False)
    borders: list[tuple[int, int, np.ndarray]] = field(default_factory=list)
    finished: bool = False
    step: int = 0

    def __post_init__(self) -> None:
        M = len(self.world.starts)
        self.robots = tuple(f"robot{k + 1}" for k in range(M))
        self.bumper = Bumper(self.world.walls, self.cfg.walls.robot_radius)
        outside = None
        if self.world.walls is not None:
            self.floor = survey_floor(self.world, self.world.walls, self.cfg)
            outside = ~self.floor.field
        first = np.arange(1 if self.apart else M)
        half = 0.5 * (np.asarray(self.world.upper, float) - self.world.lower)
        self.crews = [self._crew(first, self.world.starts[first], self.world.lower, self.world.upper, outside)]
        for j in range(len(first), M):
            self.crews.append(self._crew(np.array([j]), np.zeros((1, 3)), -half, half))
        self.wanted = set(range(len(self.world.landmarks))) - set(self.floor.hidden if self.floor else ())
        if not self.wanted:
            raise DataError("walls hide every landmark from every place a robot can reach: there is nothing to map")
        self.submaps = [empty(name, f"local_{k + 1}") for k, name in enumerate(self.robots)]
        self.ages, self.stalled, self.alive = [0] * M, np.zeros(M, dtype=int), np.ones(M, dtype=bool)
        self.truth = Truth(self.world.starts.copy(), pending=[set() for _ in range(M)], origin=[{} for _ in range(M)])

    def _crew(
        self,
        robots: Int[np.ndarray, " k"],
        starts: Float[np.ndarray, "k 3"],
        lower: np.ndarray,
        upper: np.ndarray,
        outside: np.ndarray | None = None,
    ) -> Crew:
        """A crew that knows its starts and nothing else yet."""
        G = known_starts(tuple(self.robots[j] for j in robots.tolist()), starts)
        explored = Explored.over(lower, upper, len(robots), self.cfg.mission.cell, outside)
        return Crew(robots, lower, upper, G, explored)

    @property
    def G(self) -> GlobalMap:
        """The map of the first robot's crew."""
        return self.crews[0].G

    @property
    def explored(self) -> Explored:
        """What the first robot's crew has seen."""
        return self.crews[0].explored

    @property
    def memory(self) -> dict[str, Any]:
        """The memory of the planner of the first robot's crew."""
        return self.crews[0].memory

    def crew_of(self, j: int) -> Crew:
        """The crew that robot j belongs to."""
        return next(crew for crew in self.crews if j in crew.robots)

    def poses(self, crew: Crew | None = None) -> Float[np.ndarray, "r 3"]:
        """Estimated poses of a crew's robots, the first one's without one, in its map."""
        crew = crew or self.crews[0]
        return np.stack([self._pose(crew, j) for j in crew.robots.tolist()])

    def _pose(self, crew: Crew, j: int) -> Float[np.ndarray, "3"]:
        return crew.G.pose_in_map(self.robots[j], self.submaps[j].pose)

    def _placed(self) -> Float[np.ndarray, "r 3"]:
        """Estimated poses of all robots in the map, NaN of those that are not known to be in it."""
        out = np.full((len(self.robots), 3), np.nan)
        out[self.crews[0].robots] = self.poses()
        return out

    def belief(self, crew: Crew | None = None) -> LandmarkBelief:
        """What the robots of a crew know, the first one's without one."""
        crew = crew or self.crews[0]
        own = crew.robots.tolist()
        return LandmarkBelief(
            step=self.step,
            robots=tuple(self.robots[j] for j in own),
            alive=self.alive[own],
            stalled=self.stalled[own],
            memory=crew.memory,
            lower=crew.lower,
            upper=crew.upper,
            explored=crew.explored,
            submaps=tuple(self.submaps[j] for j in own),
            global_map=crew.G,
            floor=self.floor,
            contacts=self.bumper.places(),
        )

    def observe_start(self) -> StepRecord:
        """What every robot sees from its start, before the first step."""
        seen = tuple(self._observe(j) for j in range(len(self.robots)))
        still = np.zeros((len(self.robots), 2))
        share = self.explored.seen_share()
        return StepRecord(0, still, self.truth.poses.copy(), self._placed(), seen, (), share, 0.0, 0)

    def play(self) -> Iterator[StepRecord]:
        """Steps until the goal, every robot's death or `max_steps`; then the submaps left are handed over."""
        while not self.reached() and self.step < self.cfg.mission.max_steps and self.alive.any():
            self._deaths()
            self._sweep_again()
            before = perf_counter()
            commands = self._commands()
            seconds, decisions = perf_counter() - before, int(self.alive.sum())
            self.bumper.forget(self.step - WALLS_CONTACT_STEPS)
            seen = tuple(
                self._drive(j, commands[j]) if self.alive[j] else _NO_SIGHTINGS for j in range(len(self.robots))
            )
            self.step += 1
            handed = tuple(j for j in range(len(self.robots)) if self.alive[j] and self._due(j) and self._hand_over(j))
            for j in handed:
                self._meet(j)
            yield StepRecord(
                self.step,
                commands,
                self.truth.poses.copy(),
                self._placed(),
                seen,
                handed,
                self.explored.seen_share(),
                seconds,
                decisions,
            )
        self.finished = self.reached()
        for j in map(int, np.flatnonzero(self.alive)):
            self._hand_over(j, surely=True)
        for crew in self.crews[1:]:
            self._meet(int(crew.robots[0]))

    def seen(self, crew: Crew) -> set[int]:
        """The landmarks that a crew has seen and not lost."""
        return crew.truth.safe.union(*(self.truth.pending[j] for j in crew.robots.tolist()))

    def reached(self) -> bool:
        """Whether the first crew's goal is reached: all landmarks seen, the field explored, or the steps done."""
        if isinstance(self.until, int):
            return self.step >= self.until
        seen = bool(self.explored.team().all()) if self.until == "field" else self.wanted <= self.seen(self.crews[0])
        return seen and self.step >= int(self.memory.get("go_on_until", 0))

    def _sweep_again(self) -> None:
        """A crew to which all cells count as seen and yet a landmark or the others are missing sweeps once more.

        A landmark may be: poses are estimates.
        """
        for crew in self.crews:
            lacks = self.until == "landmarks" and not self.wanted <= self.seen(crew)
            if (lacks or crew is not self.crews[0]) and crew.explored.team().all():
                crew.explored.again()

    def _deaths(self) -> None:
        for j, when in self.kills.items():
            if self.step >= when and self.alive[j]:
                self.alive[j] = False
                crew = self.crew_of(j)
                crew.explored.lose(crew.at(j))
                self.truth.pending[j] = set()
                self.truth.origin[j] = {}

    def _commands(self) -> Float[np.ndarray, "r 2"]:
        limits = max(self.cfg.commands.speeds), max(abs(w) for w in self.cfg.commands.turns)
        out = np.zeros((len(self.robots), 2))
        for crew in self.crews:
            if self.alive[crew.robots].any():
                out[crew.robots] = query_planner(self.planner, self.belief(crew), self.poses(crew), self.cfg, limits)
        return out

    def _drive(self, j: int, command: np.ndarray) -> Observations:
        """Robot j moves and looks; `command` becomes what was carried out, if a wall was in the way."""
        s = self.cfg.submap
        sd = self.true_motion_sd or s.motion_sd
        pose = move(self.truth.poses[j], command, s.period) + self.rng.normal(size=3) * sd
        pose[2] = wrap_angle(pose[2])
        stopped = self.bumper.stop(j, self.truth.poses[j, :2], pose, command)
        self.truth.poses[j] = pose
        self.submaps[j] = predict(self.submaps[j], command, s)
        if stopped:
            there = self._pose(self.crew_of(j), j)
            self.bumper.remember(self.step, there, there[2] - command[1] * s.period)
        return self._observe(j)

    def _observe(self, j: int) -> Observations:
        s = self.cfg.submap
        z = predicted_observation(self.truth.poses[j], self.world.landmarks)
        rows = np.flatnonzero(in_view(z, s))
        if self.floor is not None:
            rows = rows[self.floor.sees(self.truth.poses[j, :2], self.world.landmarks[rows], s.reach)]
        noise = self.rng.normal(size=(len(rows), 2)) * (s.range_sd, s.bearing_sd)
        noisy = z[rows] + noise
        noisy[:, 1] = wrap_angle(noisy[:, 1])
        seen = Observations(noisy, tuple(str(k) for k in rows))
        given = seen if s.association == "known" else Observations(noisy, None)
        self.submaps[j], info = update(self.submaps[j], given, s, name=f"{self.robots[j]}-")
        self.ages[j] += 1
        origin, ids = self.truth.origin[j], self.submaps[j].ids
        for k, a in enumerate(info.assignment):
            if a is None:
                continue
            self.truth.pending[j].add(int(rows[k]))
            origin.setdefault(ids[a], Counter())[int(rows[k])] += 1
        self._mark(j)
        return seen

    def _mark(self, j: int) -> None:
        s, crew = self.cfg.submap, self.crew_of(j)
        ex, k = crew.explored, crew.at(j)
        sector = Sector(s.reach, s.half_angle)
        known = int(ex.known_to(k).sum())
        pose = self._pose(crew, j)
        if self.floor is None:
            mark_half_disc(ex.backlog[k], pose, sector, ex.raster)
        else:
            walls = self.floor.walls.segments
            mark_in_sight(ex.backlog[k], pose, sector, ex.raster, walls)
        self.stalled[j] = 0 if int(ex.known_to(k).sum()) > known else self.stalled[j] + 1
        if self._message_arrives():
            ex.deliver(k)

    def _message_arrives(self) -> bool:
        return self.drop <= 0 or self.rng.random() >= self.drop

    def _due(self, j: int) -> bool:
        c, sub = self.cfg, self.submaps[j]
        sure = map_uncertainty(np.asarray(sub.cov)) / (len(sub.ids) + 1) < c.handover.uncertainty
        helps = bool(len(sub.ids)) and is_lost(self.crew_of(j).G, sub)  # what it sees now may tell
        return (self.ages[j] > c.handover.after and (sure or helps)) or self.ages[j] >= c.handover.by

    def _hand_over(self, j: int, *, surely: bool = False) -> bool:
        """The submap joins the map and starts anew; a lost message leaves it as it is, to be sent again next step."""
        if not surely and not self._message_arrives():
            return False
        crew, sub = self.crew_of(j), self.submaps[j]
        if crew is self.crews[0]:
            self.borders.append((self.step, j, _corners(crew.G, sub)))
        done = hand_over(crew.G, sub, known=self._named, prefix="m", cfg=self.cfg.handover.pairing)
        crew.truth.hand_over(self.truth.origin[j], sub.ids, done)
        crew.G = done.map
        self.submaps[j] = empty(self.robots[j], sub.frame)
        self.ages[j] = 0
        crew.explored.fuse(crew.at(j))
        crew.truth.safe |= self.truth.pending[j]
        self.truth.pending[j], self.truth.origin[j] = set(), {}
        return True

    @property
    def _named(self) -> bool:
        return self.cfg.submap.association == "known"

    def _meet(self, j: int) -> None:
        """Robot j's crew, whose map has grown, and any other of which that shows how it lies are one from now on."""
        while True:
            mine = self.crew_of(j)
            for other in self.crews:
                first, second = (mine, other) if self.crews.index(mine) < self.crews.index(other) else (other, mine)
                if other is not mine and self._tried_on(first, second):
                    break
            else:
                return

    def _tried_on(self, first: Crew, second: Crew) -> bool:
        """Whether the two maps are found to be of one place; then the crews are one."""
        a, b = first.G.landmarks, second.G.landmarks
        match = match_names(b, a, MEETING) if self._named else match_maps(b, a, MEETING)
        reason = match.reason
        if not reason and not self._named and match.evidence < MEETING_ODDS:
            reason = "too few landmarks in common to be sure"
        elif not reason and match.rival_evidence >= MEETING_RIVAL:
            reason = f"landmarks lie alike in several parts: {match.rival} fit in another alignment"
        joined = not reason
        whose = [(second.truth.source.get(b.ids[i]), first.truth.source.get(a.ids[k])) for i, k in match.links.tolist()]
        robots = (first.G.robots[0], second.G.robots[0])
        wrong = sum(one != two for one, two in whose)
        self.meetings = [m for m in self.meetings if m.joined or m.robots != robots]
        self.meetings.append(
            Meeting(self.step, robots, joined, reason or "one place", len(match.links), match.evidence, wrong)
        )
        if joined:
            self._join(first, second, match)
        return joined

    def _join(self, first: Crew, second: Crew, match: Match) -> None:
        """Two crews are one, in the first one's map, of whose landmarks `match` says which are the second's."""
        pairing = None if self._named else self.cfg.handover.pairing
        done = join_maps(first.G, second.G, match.links, match.T_target_source, prefix="m", cfg=pairing)
        renamed = dict(zip(second.G.ids, done.names, strict=True))
        first.truth.meet(second.truth, renamed, done.merged)
        explored = first.explored.joined(second.explored, done.T_map_other)
        robots = np.concatenate([first.robots, second.robots])
        crew = Crew(robots, first.lower, first.upper, done.map, explored, truth=first.truth)
        self.crews = [crew if c is first else c for c in self.crews if c is not second]


def _mostly(sightings: Counter[int]) -> int:
    """The landmark that most sightings were of, of several the one seen first."""
    return max(sightings, key=sightings.__getitem__)


def _corners(G: GlobalMap, L: Submap) -> np.ndarray:
    """The submap's landmarks and the robot in the map (k, 2): the points whose hull is its border."""
    points = np.vstack([L.mean, L.pose[:2]])
    return se2.act(G.frame_of(L.robot), points)


_NO_SIGHTINGS = Observations(np.zeros((0, 2)), ())
