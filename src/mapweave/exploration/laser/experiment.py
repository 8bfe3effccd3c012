"""Many explorations with lasers: a run is a scenario, a seed and a team."""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from time import perf_counter
from typing import Any

import numpy as np

from ...core.laser_log import LaserLog
from ...core.records import Track
from ...evaluation.building import Building, known_at, survey_building
from ...laser.closures import Closure
from ...laser.grid import GridMap
from ...laser.occupancy import Occupancy, of_grid, without_gaps
from ...laser.pose_graph import PoseGraph
from ...sim.office_floor import LEAST
from .frontiers import pockets, survey
from .mission import LaserMissionConfig, LaserMoment, LaserRun
from .scenario import LaserPlace, LaserScenarioConfig, make_place
from .score import LaserScore, score
from .view import BUILT_IN, find_laser_planner

STILLS = 48  # moments kept as pictures, about
SEEN_EVERY = 5  # steps between looks at what is known


@dataclass(frozen=True, slots=True)
class LaserMission:
    """One experiment's settings. kills: robot index -> step at whose start it dies; drop: share of messages lost."""

    scenario: LaserScenarioConfig
    robots: int | None = None
    planner: str = "coverage"
    until: str | int = "field"
    kills: Mapping[int, int] | None = None
    drop: float = 0.0
    cfg: LaserMissionConfig = field(default_factory=LaserMissionConfig)


@dataclass(frozen=True, slots=True)
class Still:
    """The map as it was at one step, for pictures."""

    step: int
    grid: Occupancy
    poses: np.ndarray
    explored: float


@dataclass(frozen=True, slots=True)
class LaserRecord:
    """What one run did, for figures, logs and tables: its world, every moment, the final map and how it came about.

    map: `grid` as free, occupied and unknown cells, the one that is written and scored; seen_at: for each reached cell
    of `building`, the step at which the map first knew it (NaN: never); tracks, truths: a robot each, in the map's
    frame; pockets: (p, 2) ground the map shows and no robot gets to; given_up: (g, 2) places that were not reached
    though they should be; status: per robot, what the front end made of its scans.
    """

    place: LaserPlace
    building: Building
    robots: tuple[str, ...]
    moments: tuple[LaserMoment, ...]
    stills: tuple[Still, ...]
    seen_at: np.ndarray
    grid: GridMap
    map: Occupancy
    tracks: tuple[Track, ...]
    truths: tuple[Track, ...]
    logs: tuple[LaserLog, ...]
    graph: PoseGraph
    owner: np.ndarray
    covariances: np.ndarray
    closures: tuple[Closure, ...]
    pockets: np.ndarray
    given_up: np.ndarray
    status: tuple[dict[str, int], ...]
    collisions: tuple[int, ...]
    timing: dict[str, float]


def explore_laser_once(
    mission: LaserMission, seed: int, run: int = 0, on_progress: Any = None
) -> tuple[LaserScore, LaserRecord]:
    """One run: the office and all noise follow from `seed`."""
    began = perf_counter()
    made, building = start(mission, seed)
    moments: list[LaserMoment] = []
    stills: list[Still] = []
    each = 1
    places = building.places()
    seen_at = np.full(len(places), np.nan)
    for moment in made.play():
        moments.append(moment)
        if moment.step % SEEN_EVERY == 0:
            _note_seen(seen_at, places, made.grid, moment.step)
        if moment.step % each == 0:
            stills.append(Still(moment.step, made.grid, moment.poses, moment.explored))
            if len(stills) > 2 * STILLS:
                stills, each = stills[::2], 2 * each
        if on_progress is not None:
            on_progress(moment.step, moment.explored)
    _note_seen(seen_at, places, made.grid, made.step)
    if moments and stills[-1].step != made.step:
        stills.append(Still(made.step, made.grid, moments[-1].poses, moments[-1].explored))
    grid = made.team.grid(mission.cfg.map_resolution)
    merged = without_gaps(of_grid(grid))
    told = score(made, moments, merged, run, perf_counter() - began)
    M = len(made.robots)
    record = LaserRecord(
        place=made.place,
        building=building,
        robots=made.robots,
        moments=tuple(moments),
        stills=tuple(stills),
        seen_at=seen_at,
        grid=grid,
        map=merged,
        tracks=tuple(made.team.trajectory(j) for j in range(M)),
        truths=tuple(_truth(moments, j) for j in range(M)),
        logs=tuple(_log(moments, j, f"explored {made.place.world.name}, seed {seed}") for j in range(M)),
        graph=made.team.graph(),
        owner=made.team.owner,
        covariances=made.team.covariances(),
        closures=made.team.closures,
        pockets=_pockets(made),
        given_up=np.array(made.memory.get("given_up", ()), dtype=float).reshape(-1, 2),
        status=tuple(made.status),
        collisions=tuple(made.sim.collisions.tolist()),
        timing=dict(made.timing),
    )
    return told, record


def start(mission: LaserMission, seed: int) -> tuple[LaserRun, Building]:
    """The run of `mission` with `seed`, before its first step, and what can be reached there."""
    place = make_place(mission.scenario, mission.robots, seed)
    robots = mission.cfg.robots
    building = survey_building(place.world, place.lower, place.upper, place.starts, robots.radius, robots.scanner.far)
    planner = find_laser_planner(mission.planner)
    _compile(mission.planner)
    kills = dict(mission.kills or {})
    made = LaserRun(place, building, mission.cfg, planner, seed, kills=kills, drop=mission.drop, until=mission.until)
    return made, building


@cache
def _compile(planner: str) -> None:
    """Has a built-in planner take a few steps, once a process, so that decisions are timed and not compilation."""
    if planner not in BUILT_IN:
        return
    place = make_place(LaserScenarioConfig(office=LEAST), 2, 0)
    cfg = LaserMissionConfig()
    building = survey_building(place.world, place.lower, place.upper, place.starts, cfg.robots.radius, 1.0)
    for _ in LaserRun(place, building, cfg, find_laser_planner(planner), 0, until=3).play():
        pass


def explore_laser_many(
    mission: LaserMission, runs: int, seed: int, executor: Executor | None = None
) -> list[LaserScore]:
    """Scores of `runs` runs with seeds `seed`, `seed` + 1, ...; the same with any executor."""
    one = partial(_score_only, mission)
    jobs = [(seed + k, k) for k in range(runs)]
    return [one(job) for job in jobs] if executor is None else list(executor.map(one, jobs))


def _score_only(mission: LaserMission, job: tuple[int, int]) -> LaserScore:
    seed, run = job
    began = perf_counter()
    made, _ = start(mission, seed)
    moments = [replace(m, scans=()) for m in made.play()]  # scans are many and the score needs none
    merged = without_gaps(of_grid(made.team.grid(mission.cfg.map_resolution)))
    return score(made, moments, merged, run, perf_counter() - began)


def _note_seen(seen_at: np.ndarray, places: np.ndarray, grid: Occupancy, step: int) -> None:
    left = np.flatnonzero(np.isnan(seen_at))
    known = known_at(places[left], grid.free, grid.origin, grid.resolution)
    seen_at[left[known]] = step


def _truth(moments: list[LaserMoment], j: int) -> Track:
    mine = [m for m in moments if m.scans[j] is not None]
    poses = np.array([m.true_poses[j] for m in mine]).reshape(-1, 3)
    return Track(np.array([m.t for m in mine]), poses, frame="map")


def _log(moments: list[LaserMoment], j: int, source: str) -> LaserLog:
    pairs = [(m.t, s) for m in moments if (s := m.scans[j]) is not None]
    t = np.array([t for t, _ in pairs])
    scans = tuple(s for _, s in pairs)
    odometry = np.array([s.odometry for s in scans], dtype=float).reshape(-1, 3)
    return LaserLog(str(j + 1), source, t, scans, Track(t, odometry, frame="odom"))


def _pockets(made: LaserRun) -> np.ndarray:
    """Ground the final map shows and no robot gets to."""
    alive = np.flatnonzero(made.alive)
    poses = made.team.poses()[:, :2]
    ground = survey(made.grid, poses[alive], np.delete(poses, alive, axis=0), made.plan)
    return pockets(ground, made.plan)
