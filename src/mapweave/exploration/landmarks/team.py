"""One exploration, step by step: choose, drive, see, map, hand over; deaths and lost messages included.

Where a robot's true motion meets a wall, it stops short of it, and the team remembers the place.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.errors import DataError
from ...core.se2 import wrap_angle
from ...core.walls import Walls
from ...fusion.handover import Handover, hand_over
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
    """What only the simulator and the score know: true poses, who saw what, which landmark an estimate stems from.

    origin: for each robot, submap landmark -> how many of its sightings were of which true landmark; sightings: the
    same of the map's landmarks. An estimate is of the landmark that most of its sightings were of: where two landmarks
    close together were exchanged after a first sighting, it comes to lie on the other one.
    """

    poses: Float[np.ndarray, "r 3"]
    safe: set[int] = field(default_factory=set)  # landmarks in the global map
    pending: list[set[int]] = field(default_factory=list)  # seen in a submap that is not handed over yet
    origin: list[dict[str, Counter[int]]] = field(default_factory=list)
    sightings: dict[str, Counter[int]] = field(default_factory=dict)
    misassociations: int = 0

    def seen(self) -> set[int]:
        return self.safe.union(*self.pending)

    @property
    def source(self) -> dict[str, int]:
        """Global landmark -> true landmark."""
        return {name: _mostly(sightings) for name, sightings in self.sightings.items()}

    def hand_over(self, j: int, ids: tuple[str, ...], done: Handover) -> None:
        """What robot j's submap landmarks `ids` were of is told of the map's; matches that are wrong are counted.

        Wrong: a sighting of another landmark than most of its estimate's, and two estimates made one that were not.
        """
        for local, name in zip(ids, done.names, strict=True):
            sightings = self.origin[j].get(local)
            if not sightings:
                continue
            self.misassociations += sightings.total() - max(sightings.values())
            if name is not None:
                self._join(name, sightings)
        for kept, gone in done.merged:
            if gone in self.sightings:
                self._join(kept, self.sightings.pop(gone))
        self.origin[j] = {}

    def _join(self, name: str, sightings: Counter[int]) -> None:
        known = self.sightings.setdefault(name, Counter())
        self.misassociations += bool(known) and _mostly(known) != _mostly(sightings)
        known.update(sightings)


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
    """A team at work. `play` yields a `StepRecord` a step; afterwards the attributes hold the outcome."""

    world: Field
    cfg: ExploreConfig
    planner: Planner
    rng: np.random.Generator
    kills: dict[int, int] = field(default_factory=dict)  # robot index -> step at whose start it dies
    drop: float = 0.0
    until: str | int = "landmarks"
    true_motion_sd: tuple[float, float, float] | None = None
    robots: tuple[str, ...] = ()
    submaps: list[Submap] = field(default_factory=list)
    ages: list[int] = field(default_factory=list)
    stalled: Any = None
    alive: Any = None
    G: GlobalMap = field(init=False)
    explored: Explored = field(init=False)
    truth: Truth = field(init=False)
    wanted: set[int] = field(init=False)  # landmarks somebody can see
    memory: dict[str, Any] = field(default_factory=dict)
    floor: FloorPlan | None = None
    bumper: Bumper = field(init=False)
    borders: list[tuple[int, int, np.ndarray]] = field(default_factory=list)
    finished: bool = False
    step: int = 0

    def __post_init__(self) -> None:
        M = len(self.world.starts)
        self.robots = tuple(f"robot{k + 1}" for k in range(M))
        self.G = known_starts(self.robots, self.world.starts)
        self.bumper = Bumper(self.world.walls, self.cfg.walls.robot_radius)
        outside = None
        if self.world.walls is not None:
            self.floor = survey_floor(self.world, self.world.walls, self.cfg)
            outside = ~self.floor.field
        self.explored = Explored.over(self.world.lower, self.world.upper, M, self.cfg.mission.cell, outside)
        self.wanted = set(range(len(self.world.landmarks))) - set(self.floor.hidden if self.floor else ())
        if not self.wanted:
            raise DataError("walls hide every landmark from every place a robot can reach: there is nothing to map")
        self.submaps = [empty(name, f"local_{k + 1}") for k, name in enumerate(self.robots)]
        self.ages, self.stalled, self.alive = [0] * M, np.zeros(M, dtype=int), np.ones(M, dtype=bool)
        self.truth = Truth(self.world.starts.copy(), pending=[set() for _ in range(M)], origin=[{} for _ in range(M)])

    def poses(self) -> Float[np.ndarray, "r 3"]:
        """Estimated poses in the map."""
        return np.stack([self.G.pose_in_map(n, m.pose) for n, m in zip(self.robots, self.submaps, strict=True)])

    def belief(self) -> LandmarkBelief:
        return LandmarkBelief(
            step=self.step,
            robots=self.robots,
            alive=self.alive,
            stalled=self.stalled,
            memory=self.memory,
            lower=self.world.lower,
            upper=self.world.upper,
            explored=self.explored,
            submaps=tuple(self.submaps),
            global_map=self.G,
            floor=self.floor,
            contacts=self.bumper.places(),
        )

    def observe_start(self) -> StepRecord:
        """What every robot sees from its start, before the first step."""
        seen = tuple(self._observe(j) for j in range(len(self.robots)))
        still = np.zeros((len(self.robots), 2))
        share = self.explored.seen_share()
        return StepRecord(0, still, self.truth.poses.copy(), self.poses(), seen, (), share, 0.0, 0)

    def play(self) -> Iterator[StepRecord]:
        """Steps until the goal, every robot's death or `max_steps`; then the submaps left are handed over."""
        while not self.reached() and self.step < self.cfg.mission.max_steps and self.alive.any():
            self._deaths()
            if self.until == "landmarks" and not self.wanted <= self.truth.seen():
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
            yield StepRecord(
                self.step,
                commands,
                self.truth.poses.copy(),
                self.poses(),
                seen,
                handed,
                self.explored.seen_share(),
                seconds,
                decisions,
            )
        self.finished = self.reached()
        for j in map(int, np.flatnonzero(self.alive)):
            self._hand_over(j, surely=True)

    def reached(self) -> bool:
        """Whether the goal is reached: all landmarks seen, the field explored, or the steps done."""
        if isinstance(self.until, int):
            return self.step >= self.until
        seen = bool(self.explored.team().all()) if self.until == "field" else self.wanted <= self.truth.seen()
        return seen and self.step >= int(self.memory.get("go_on_until", 0))

    def _sweep_again(self) -> None:
        """All cells count as seen and yet a landmark is missing (poses are estimates): sweep once more."""
        if self.explored.team().all():
            self.explored.again()

    def _deaths(self) -> None:
        for j, when in self.kills.items():
            if self.step >= when and self.alive[j]:
                self.alive[j] = False
                self.explored.lose(j)
                self.truth.pending[j] = set()
                self.truth.origin[j] = {}

    def _commands(self) -> Float[np.ndarray, "r 2"]:
        limits = max(self.cfg.commands.speeds), max(abs(w) for w in self.cfg.commands.turns)
        return query_planner(self.planner, self.belief(), self.poses(), self.cfg, limits)

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
            there = self.G.pose_in_map(self.robots[j], self.submaps[j].pose)
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
        s, ex = self.cfg.submap, self.explored
        sector = Sector(s.reach, s.half_angle)
        known = int(ex.known_to(j).sum())
        pose = self.G.pose_in_map(self.robots[j], self.submaps[j].pose)
        if self.floor is None:
            mark_half_disc(ex.backlog[j], pose, sector, ex.raster)
        else:
            walls = self.floor.walls.segments
            mark_in_sight(ex.backlog[j], pose, sector, ex.raster, walls)
        self.stalled[j] = 0 if int(ex.known_to(j).sum()) > known else self.stalled[j] + 1
        if self._message_arrives():
            ex.deliver(j)

    def _message_arrives(self) -> bool:
        return self.drop <= 0 or self.rng.random() >= self.drop

    def _due(self, j: int) -> bool:
        c, sub = self.cfg, self.submaps[j]
        sure = map_uncertainty(np.asarray(sub.cov)) / (len(sub.ids) + 1) < c.handover.uncertainty
        helps = bool(len(sub.ids)) and is_lost(self.G, sub)  # what it sees now may tell
        return (self.ages[j] > c.handover.after and (sure or helps)) or self.ages[j] >= c.handover.by

    def _hand_over(self, j: int, *, surely: bool = False) -> bool:
        """The submap joins the map and starts anew; a lost message leaves it as it is, to be sent again next step."""
        if not surely and not self._message_arrives():
            return False
        known = self.cfg.submap.association == "known"
        self.borders.append((self.step, j, _corners(self.G, self.submaps[j])))
        done = hand_over(
            self.G,
            self.submaps[j],
            known=known,
            prefix="m",
            cfg=self.cfg.handover.pairing,
        )
        self.truth.hand_over(j, self.submaps[j].ids, done)
        self.G = done.map
        self.submaps[j] = empty(self.robots[j], self.submaps[j].frame)
        self.ages[j] = 0
        self.explored.fuse(j)
        self.truth.safe |= self.truth.pending[j]
        self.truth.pending[j] = set()
        return True


def _mostly(sightings: Counter[int]) -> int:
    """The landmark that most sightings were of, of several the one seen first."""
    return max(sightings, key=sightings.__getitem__)


def _corners(G: GlobalMap, L: Submap) -> np.ndarray:
    """The submap's landmarks and the robot in the map (k, 2): the points whose hull is its border."""
    points = np.vstack([L.mean, L.pose[:2]])
    return se2.act(G.frame_of(L.robot), points)


_NO_SIGHTINGS = Observations(np.zeros((0, 2)), ())
