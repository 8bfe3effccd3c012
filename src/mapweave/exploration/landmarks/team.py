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
from scipy.sparse.csgraph import connected_components

from ...core import se2
from ...core.errors import DataError
from ...core.se2 import wrap_angle
from ...core.walls import Walls
from ...fusion.handover import PairingConfig, join_maps
from ...fusion.identities import IdentityConfig, Match, match_maps, match_names
from ...kernels.exploration.objective import map_uncertainty, mark_half_disc
from ...kernels.walls.segments import Sector
from ...kernels.walls.sight import mark_in_sight
from ...landmarks.landmark_map import GlobalMap, Submap, known_starts
from ...landmarks.submap_slam import Observations, empty, in_view, move, predict, predicted_observation, update
from ...sim.landmarks import Field
from ..planner_interface import query_planner
from .belief import Carried, Explored, Handed, LandmarkBelief, LandmarkCrew, Planner, parted, united
from .config import ExploreConfig
from .floor_plan import FloorPlan, survey_floor
from .objective import is_lost, steer

MEETING = IdentityConfig(scale_sigma=1e-3)  # two maps of one camera's ranges have one scale, but for rounding
MEETING_ODDS = np.log(1000.0)  # against chance: a wrong meeting is what spoils all that comes after
MEETING_RIVAL = np.log(10.0)  # against chance, from which on another alignment says that the place repeats itself
RENDEZVOUS_REACHED = 3.0  # [m] from where all meet at which a robot waits
RENDEZVOUS_PATIENCE = 100  # [steps] for which it waits: as long as a robot takes there from the paper's field's corner
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
class Truth:
    """What only the simulator and the score know: true poses (M, 3), and of each robot, for the submap that is not
    handed over yet, the landmarks seen in it and, submap landmark -> how many of its sightings were of which of them.
    """

    poses: Float[np.ndarray, "r 3"]
    pending: list[set[int]] = field(default_factory=list)
    origin: list[dict[str, Counter[int]]] = field(default_factory=list)


class LandmarkMeeting(NamedTuple):
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

    radio: range [m] within which two robots exchange what they know, directly or over others; the others have what they
    last heard. The middle of their starts is where they meet again: a robot to which all is seen waits there for the
    others, and all of them (`rendezvous` > 0) come there so many steps after they were last together.

    kidnaps: robot index -> step at whose start it is lifted and set down anywhere in the field. Its wheels hang in the
    air meanwhile: it knows that it was carried, not where to, and is a crew of its own, as if nobody had told it where
    it begins, until its map is found to be of the same place. carried: what came of it.
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
    radio: float = np.inf
    rendezvous: int = 0
    kidnaps: dict[int, int] = field(default_factory=dict)
    robots: tuple[str, ...] = ()
    submaps: list[Submap] = field(default_factory=list)
    ages: list[int] = field(default_factory=list)
    stalled: Any = None
    alive: Any = None
    crews: list[LandmarkCrew] = field(init=False)
    meetings: list[LandmarkMeeting] = field(default_factory=list)
    truth: Truth = field(init=False)
    wanted: set[int] = field(init=False)  # landmarks somebody can see
    floor: FloorPlan | None = None
    bumper: Bumper = field(init=False)
    borders: list[tuple[int, int, np.ndarray]] = field(default_factory=list)
    finished: bool = False
    step: int = 0
    carried: list[Carried] = field(default_factory=list)
    together: int = 0  # steps at whose end all live robots had one map

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
    ) -> LandmarkCrew:
        """A crew that knows its starts and nothing else yet."""
        G = known_starts(tuple(self.robots[j] for j in robots.tolist()), starts)
        explored = Explored.over(lower, upper, len(robots), self.cfg.mission.cell, outside)
        return LandmarkCrew(robots, lower, upper, G, explored, np.ones(len(robots), dtype=bool))

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

    def crew_of(self, j: int) -> LandmarkCrew:
        """The crew that robot j belongs to."""
        return next(crew for crew in self.crews if j in crew.members)

    def poses(self, crew: LandmarkCrew | None = None) -> Float[np.ndarray, "r 3"]:
        """Estimated poses of a crew's robots, the first one's without one, in its map."""
        crew = crew or self.crews[0]
        return np.stack([self._pose(crew, j) for j in crew.robots.tolist()])

    def _pose(self, crew: LandmarkCrew, j: int) -> Float[np.ndarray, "3"]:
        return crew.G.pose_in_map(self.robots[j], self._submap(crew, j).pose)

    def _submap(self, crew: LandmarkCrew, j: int) -> Submap:
        """What a crew knows of robot j's submap: nothing of one that is out of touch, but where it began."""
        return self.submaps[j] if j in crew.members else empty(self.robots[j], self.submaps[j].frame)

    def _placed(self) -> Float[np.ndarray, "r 3"]:
        """Estimated poses of all robots in the map, NaN of those that are not known to be in it."""
        out = np.full((len(self.robots), 3), np.nan)
        present = self.crews[0].present
        out[self.crews[0].members] = self.poses()[present]
        return out

    def belief(self, crew: LandmarkCrew | None = None) -> LandmarkBelief:
        """What the robots of a crew know, the first one's without one."""
        crew = crew or self.crews[0]
        own = crew.robots.tolist()
        return LandmarkBelief(
            step=self.step,
            robots=tuple(self.robots[j] for j in own),
            alive=self.alive[own] & crew.present,
            stalled=self.stalled[own],
            memory=crew.memory,
            lower=crew.lower,
            upper=crew.upper,
            explored=crew.explored,
            submaps=tuple(self._submap(crew, j) for j in own),
            global_map=crew.G,
            floor=self.floor,
            contacts=self.bumper.places(),
            away=~crew.present & (crew.waited <= RENDEZVOUS_PATIENCE) & np.isfinite(self.radio),
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
            self._kidnap()
            self._sweep_again()
            before = perf_counter()
            commands = self._commands()
            seconds, decisions = perf_counter() - before, int(self.alive.sum())
            self.bumper.forget(self.step - WALLS_CONTACT_STEPS)
            seen = tuple(
                self._drive(j, commands[j]) if self.alive[j] else _NO_SIGHTINGS for j in range(len(self.robots))
            )
            self.step += 1
            self._exchange()
            handed = tuple(j for j in range(len(self.robots)) if self.alive[j] and self._due(j) and self._hand_over(j))
            for j in handed if np.isinf(self.radio) else ():
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
        if np.isinf(self.radio):
            for j in map(int, np.flatnonzero(self.alive)):
                self._meet(j)

    def seen(self, crew: LandmarkCrew) -> set[int]:
        """The landmarks that a crew has seen and not lost."""
        return crew.truth.safe.union(*(self.truth.pending[j] for j in crew.members.tolist()))

    def reached(self) -> bool:
        """Whether the first crew's goal is reached: all landmarks seen, the field explored, or the steps done."""
        if isinstance(self.until, int):
            return self.step >= self.until
        seen = bool(self.explored.team().all()) if self.until == "field" else self.wanted <= self.seen(self.crews[0])
        if self.until == "field" and self._waits(self.crews[0]):
            return False
        return seen and self.step >= int(self.memory.get("go_on_until", 0))

    def _sweep_again(self) -> None:
        """A crew to which all cells count as seen and yet a landmark or the others are missing sweeps once more.

        A landmark may be: poses are estimates.
        """
        for crew in self.crews:
            lacks = self.until == "landmarks" and not self.wanted <= self.seen(crew)
            alone = np.isinf(self.radio) and crew is not self.crews[0]
            if (lacks or alone) and crew.explored.team().all() and not self._waits(crew):
                crew.explored.again()

    def _waits(self, crew: LandmarkCrew) -> bool:
        """Whether robots of a crew are to go where all meet: since all is seen, or they agreed to.

        Not for ever: the others may be dead. Nor while a plan made together holds, whose laps end side by side.
        """
        if np.isinf(self.radio) or crew.present.all() or crew.waited > RENDEZVOUS_PATIENCE:
            return False
        since = max(crew.complete + self.rendezvous, int(crew.memory.get("go_on_until", 0)))
        due = self.rendezvous > 0 and self.step >= since
        return bool(due or crew.explored.team().all())

    def _exchange(self) -> None:
        """Robots within the radio's range of each other, directly or over others, have one map; those apart part."""
        live = np.flatnonzero(self.alive)
        if np.isinf(self.radio) or not len(live):
            return
        d = np.linalg.norm(self.truth.poses[live, None, :2] - self.truth.poses[None, live, :2], axis=-1)
        _, part = connected_components(d <= self.radio, directed=False)
        self.together += int(part.max() == 0)
        crews = []
        for k in range(int(part.max()) + 1):
            present = np.isin(np.arange(len(self.robots)), live[part == k])
            before = [crew for crew in self.crews if (crew.present & present).any()]
            if len(before) > 1:
                crew = united(before, present, self._pairing)
            elif (before[0].present & self.alive != present).any():
                crew = parted(before[0], present)
            else:
                crew = before[0]
                crew.present = present
            if present[self.alive].all() and present.sum() > 1:
                crew.complete = self.step
            crews.append(crew)
        self.crews = sorted(crews, key=lambda crew: int(crew.members[0]))

    def _deaths(self) -> None:
        for j, when in self.kills.items():
            if self.step >= when and self.alive[j]:
                self.alive[j] = False
                crew = self.crew_of(j)
                crew.explored.lose(crew.at(j))
                if not np.isinf(self.radio):
                    crew.present = crew.present & (crew.robots != j)
                self.truth.pending[j] = set()
                self.truth.origin[j] = {}

    def _kidnap(self) -> None:
        """Robots whose time it is hand over what they have, are set down elsewhere, and begin anew, each by itself."""
        half = 0.5 * (np.asarray(self.world.upper, float) - self.world.lower)
        for j in [j for j, when in self.kidnaps.items() if when == self.step and self.alive[j]]:
            self._hand_over(j, surely=True)
            place = self.rng.uniform(self.world.lower, self.world.upper)
            self.truth.poses[j] = [*place, self.rng.uniform(-np.pi, np.pi)]
            crew = self.crew_of(j)
            crew.present = crew.present & (crew.robots != j)
            self.crews.append(self._crew(np.array([j]), np.zeros((1, 3)), -half, half))
            self.carried.append(Carried(self.robots[j], self.step))

    def _commands(self) -> Float[np.ndarray, "r 2"]:
        limits = max(self.cfg.commands.speeds), max(abs(w) for w in self.cfg.commands.turns)
        out = np.zeros((len(self.robots), 2))
        for crew in self.crews:
            if self.alive[crew.members].any():
                belief, poses = self.belief(crew), self.poses(crew)
                told = query_planner(self.planner, belief, poses, self.cfg, limits)
                out[crew.members] = told[crew.present]
                if self._waits(crew):
                    self._gather(crew, belief, poses, out)
        return out

    def _gather(self, crew: LandmarkCrew, belief: LandmarkBelief, poses: np.ndarray, out: np.ndarray) -> None:
        """Robots of a crew go where all meet, and wait there; their rows of `out` become so."""
        place = self.world.starts[:, :2].mean(axis=0)
        near = True
        for j in crew.members[self.alive[crew.members]].tolist():
            there = np.hypot(*(poses[crew.at(j), :2] - place)) < RENDEZVOUS_REACHED
            out[j] = 0.0 if there else steer(belief, poses[crew.at(j)], place, self.cfg)
            near &= bool(there)
        crew.waited += near

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
        handed = Handed(sub, self.truth.origin[j], frozenset(self.truth.pending[j]))
        crew.hand_over(self.step, j, handed, self._pairing, keep=not np.isinf(self.radio))
        self.submaps[j] = empty(self.robots[j], sub.frame)
        self.ages[j] = 0
        crew.explored.fuse(crew.at(j))
        self.truth.pending[j], self.truth.origin[j] = set(), {}
        return True

    @property
    def _named(self) -> bool:
        return self.cfg.submap.association == "known"

    @property
    def _pairing(self) -> PairingConfig | None:
        """How landmarks are taken for one; None where their names tell."""
        return None if self._named else self.cfg.handover.pairing

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

    def _tried_on(self, first: LandmarkCrew, second: LandmarkCrew) -> bool:
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
            LandmarkMeeting(self.step, robots, joined, reason or "one place", len(match.links), match.evidence, wrong)
        )
        if joined:
            self._join(first, second, match)
        return joined

    def _join(self, first: LandmarkCrew, second: LandmarkCrew, match: Match) -> None:
        """Two crews are one, in the first one's map, of whose landmarks `match` says which are the second's."""
        for crew, other in ((first, second), (second, first)):
            crew.leave([int(j) for j in crew.robots[~crew.present] if j in other.members])
        done = join_maps(first.G, second.G, match.links, match.T_target_source, prefix="m", cfg=self._pairing)
        renamed = dict(zip(second.G.ids, done.names, strict=True))
        first.truth.meet(second.truth, renamed, done.merged)
        explored = first.explored.joined(second.explored, done.T_map_other)
        robots = np.concatenate([first.robots, second.robots])
        present = np.concatenate([first.present, second.present])
        crew = LandmarkCrew(robots, first.lower, first.upper, done.map, explored, present, truth=first.truth)
        self.crews = [crew if c is first else c for c in self.crews if c is not second]
        for told in self.carried if crew is self.crews[0] else ():
            if told.back is None and told.robot in (self.robots[j] for j in crew.members):
                told.back = self.step


def _corners(G: GlobalMap, L: Submap) -> np.ndarray:
    """The submap's landmarks and the robot in the map (k, 2): the points whose hull is its border."""
    points = np.vstack([L.mean, L.pose[:2]])
    return se2.act(G.frame_of(L.robot), points)


_NO_SIGHTINGS = Observations(np.zeros((0, 2)), ())
