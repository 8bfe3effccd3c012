"""Many explorations with lasers: a run is a scenario, a seed and a team; and the score of each."""

import re
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.laser_log import LaserLog
from ...core.records import Track
from ...evaluation.building import Building, known_at, share_free, survey_building, wall_scores
from ...laser.closures import Closure
from ...laser.laser_map import GridMap
from ...laser.occupancy_mapper import Occupancy, of_grid, without_gaps
from ...laser.pose_graph import PoseGraph
from ...sim.laser_worlds import LEAST
from ..mission import ExplorationResult, Mission, RunScore, run_seeds
from ..planner_interface import find_planner, is_built_in
from .config import OCCUPIED_SHARE, WALL_TOLERANCE, LaserMissionConfig, LaserPlace, LaserScenarioConfig, make_place
from .frontiers import mapped_ground, pockets
from .mission import LaserRun, LaserStepRecord, Meeting

FALSE_DISTANCE = 0.5  # [m] off the truth beyond which a closure counts as joining places that are two
FALSE_TURN = float(np.radians(8.0))  # [rad] off the truth, the same


@dataclass(frozen=True, slots=True)
class LaserScore(RunScore):
    """map_error: mean distance of the map's occupied cells to the nearest true wall; c_per_n: of keyframe positions.

    nees_per_dof: mean over keyframe poses, each with its own covariance; misassociations: loops closed between places
    that are not the same; duplicates and missed are figures of landmark worlds; area_mapped: share of the reachable
    area known to be free; wall_precision: share of occupied cells at a wall; wall_recall: share of the wall that can be
    seen which the map shows; refused: loop closures tried and not believed.
    """

    robots: int
    reachable_m2: float
    area_mapped: float
    collisions: int
    trajectory_rmse: float | None
    wall_precision: float | None
    wall_recall: float | None
    closures: int
    refused: int
    driven: float
    left_out: int
    maps: int
    seconds: float


def score(
    mission_run: LaserRun, moments: list[LaserStepRecord], merged: Occupancy, run: int, seconds: float
) -> LaserScore:
    """A finished run against the truth. merged: the map at the resolution that is scored."""
    world = mission_run.place.world
    cells = merged.centres(np.argwhere(merged.occupied))
    error, precision, recall = wall_scores(cells, world, mission_run.building, WALL_TOLERANCE)
    graph, _, P, closures = _mapped(mission_run)
    true, pose = true_keyframes(mission_run, moments), graph.pose
    e = np.column_stack([pose[:, :2] - true[:, :2], se2.wrap_angle(pose[:, 2] - true[:, 2])])
    tied = np.flatnonzero(np.linalg.eigvalsh(P)[:, 0] > 1e-7) if len(P) else np.zeros(0, int)  # `map` hangs on one
    nees = [float(e[k] @ np.linalg.solve(P[k], e[k])) / 3.0 for k in tied]
    ellipse = [np.pi * np.sqrt(max(float(np.linalg.det(P[k, :2, :2])), 0.0)) for k in range(len(P))]
    believed = [c for c in closures if c.accepted]
    return LaserScore(
        run=run,
        seed=mission_run.seed,
        finished=mission_run.finished,
        steps=mission_run.step,
        map_error=error,
        c_per_n=float(np.mean(ellipse)) if ellipse else None,
        nees_per_dof=float(np.mean(nees)) if nees else None,
        duplicates=None,
        misassociations=sum(is_false(c, true) for c in believed),
        missed=None,
        ms_per_decision=1e3 * sum(m.seconds for m in moments) / max(sum(m.decisions for m in moments), 1),
        robots=len(mission_run.robots),
        reachable_m2=mission_run.building.area,
        area_mapped=share_free(mission_run.building, merged.free, merged.origin, merged.resolution),
        collisions=int(mission_run.sim.collisions.sum()),
        trajectory_rmse=trajectory_rmse(mission_run, moments),
        wall_precision=precision,
        wall_recall=recall,
        closures=len(believed),
        refused=len(closures) - len(believed),
        driven=driven(moments),
        left_out=len(mission_run.memory.get("given_up", ())),
        maps=len(mission_run.crews),
        seconds=seconds,
    )


class _Mapped(NamedTuple):
    """What the first robot's crew came to: keyframes, whose each is, their covariances, and closures between them."""

    graph: PoseGraph
    owner: np.ndarray
    covariances: np.ndarray
    closures: tuple[Closure, ...]


def _first_crew(mission_run: LaserRun) -> np.ndarray:
    """The keyframes of the first robot's crew, ascending."""
    return np.flatnonzero(np.isin(mission_run.team.owner, mission_run.crews[0].robots))


def _mapped(mission_run: LaserRun) -> _Mapped:
    team, keep = mission_run.team, _first_crew(mission_run)
    number = np.full(len(team.owner), -1)
    number[keep] = np.arange(len(keep))
    closures = tuple(
        replace(c, first=int(number[c.first]), second=int(number[c.second]))
        for c in team.closures
        if number[c.first] >= 0 and number[c.second] >= 0
    )
    return _Mapped(team.graph().among(keep), team.owner[keep], team.covariances()[keep], closures)


def true_keyframes(mission_run: LaserRun, moments: list[LaserStepRecord]) -> Float[np.ndarray, "n 3"]:
    """Where the robots really were at the keyframes of the first crew's graph."""
    at = {m.t: k for k, m in enumerate(moments)}
    keep = _first_crew(mission_run)
    rows = [at[t] for t in mission_run.team.stamp[keep].tolist()]
    poses = np.array([m.true_poses for m in moments])
    return np.asarray(poses[rows, mission_run.team.owner[keep]]).reshape(-1, 3)


def is_false(closure: Closure, true: Float[np.ndarray, "n 3"]) -> bool:
    """Whether a closure says two places are one that are not."""
    off = se2.between(closure.measured, se2.between(true[closure.first], true[closure.second]))
    return bool(np.hypot(off[0], off[1]) > FALSE_DISTANCE or abs(off[2]) > FALSE_TURN)


def trajectory_rmse(mission_run: LaserRun, moments: list[LaserStepRecord]) -> float | None:
    """Root mean square position error [m] over all robots' trajectories, without alignment."""
    squares: list[np.ndarray] = []
    at = {m.t: k for k, m in enumerate(moments)}
    for j in mission_run.crews[0].robots.tolist():
        track = mission_run.team.trajectory(j)
        rows = [at[t] for t in track.t.tolist()]
        true = np.array([moments[k].true_poses[j] for k in rows]).reshape(-1, 3)
        squares.append(((track.pose[:, :2] - true[:, :2]) ** 2).sum(axis=1))
    every = np.concatenate(squares)
    return float(np.sqrt(every.mean())) if len(every) else None


def driven(moments: list[LaserStepRecord]) -> float:
    """What all robots drove together [m]."""
    steps = np.diff(np.array([m.true_poses[:, :2] for m in moments]), axis=0)
    return float(np.hypot(steps[..., 0], steps[..., 1]).sum())


UNMAPPED = Track(np.zeros(0), np.zeros((0, 3)), frame="map")
SNAPSHOTS = 48  # moments kept as pictures, about
SEEN_EVERY = 5  # steps between looks at what is known


@dataclass(frozen=True, slots=True)
class LaserMission(Mission[LaserScenarioConfig, LaserMissionConfig]):
    """One experiment's settings in a laser world. apart: no robot knows where the others start."""

    robots: int | None = None
    planner: str = "coverage"
    until: str | int = "field"
    kills: Mapping[int, int] | None = None
    drop: float = 0.0
    cfg: LaserMissionConfig = field(default_factory=LaserMissionConfig)
    apart: bool = False


@dataclass(frozen=True, slots=True)
class MapSnapshot:
    """The map as it was at one step, for pictures."""

    step: int
    grid: Occupancy
    poses: np.ndarray
    explored: float


@dataclass(frozen=True, slots=True)
class LaserRunRecord:
    """What one run did, for figures, logs and tables: its world, every moment, the final map and how it came about.

    map: `grid` as free, occupied and unknown cells, the one that is written and scored; seen_at: for each reached cell
    of `building`, the step at which the map first knew it (NaN: never); tracks, truths: a robot each, in the map's
    frame, tracks without poses of robots that were not found in it; pockets: (p, 2) ground the map shows and no robot
    gets to; given_up: (g, 2) places that were not reached though they should be; status: per robot, what the front end
    made of its scans; maps: the robots of each map there was in the end, the map's own first; meetings: the latest
    decision on each two robots whose starts nobody knew.
    """

    place: LaserPlace
    building: Building
    robots: tuple[str, ...]
    moments: tuple[LaserStepRecord, ...]
    snapshots: tuple[MapSnapshot, ...]
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
    maps: tuple[tuple[str, ...], ...]
    meetings: tuple[Meeting, ...]


def explore_laser_once(
    mission: LaserMission, seed: int, run: int = 0, on_progress: Any = None
) -> tuple[LaserScore, LaserRunRecord]:
    """One run: the office and all noise follow from `seed`."""
    began = perf_counter()
    mission_run, building = start(mission, seed)
    moments: list[LaserStepRecord] = []
    snapshots: list[MapSnapshot] = []
    each = 1
    places = building.places()
    seen_at = np.full(len(places), np.nan)
    for moment in mission_run.play():
        moments.append(moment)
        if moment.step % SEEN_EVERY == 0:
            _note_seen(seen_at, places, mission_run.grid, moment.step)
        if moment.step % each == 0:
            snapshots.append(MapSnapshot(moment.step, mission_run.grid, moment.poses, moment.explored))
            if len(snapshots) > 2 * SNAPSHOTS:
                snapshots, each = snapshots[::2], 2 * each
        if on_progress is not None:
            on_progress(moment.step, moment.explored)
    _note_seen(seen_at, places, mission_run.grid, mission_run.step)
    if moments and snapshots[-1].step != mission_run.step:
        snapshots.append(MapSnapshot(mission_run.step, mission_run.grid, moments[-1].poses, moments[-1].explored))
    grid = mission_run.team.grid(mission.cfg.map_resolution)
    merged = without_gaps(of_grid(grid, OCCUPIED_SHARE))
    run_score = score(mission_run, moments, merged, run, perf_counter() - began)
    M, first = len(mission_run.robots), mission_run.crews[0].robots
    mapped = _mapped(mission_run)
    record = LaserRunRecord(
        place=mission_run.place,
        building=building,
        robots=mission_run.robots,
        moments=tuple(moments),
        snapshots=tuple(snapshots),
        seen_at=seen_at,
        grid=grid,
        map=merged,
        tracks=tuple(mission_run.team.trajectory(j) if j in first else UNMAPPED for j in range(M)),
        truths=tuple(_truth(moments, j) for j in range(M)),
        logs=tuple(_log(moments, j, f"explored {mission_run.place.world.name}, seed {seed}") for j in range(M)),
        graph=mapped.graph,
        owner=mapped.owner,
        covariances=mapped.covariances,
        closures=mapped.closures,
        pockets=_pockets(mission_run),
        given_up=np.array(mission_run.memory.get("given_up", ()), dtype=float).reshape(-1, 2),
        status=tuple(mission_run.status),
        collisions=tuple(mission_run.sim.collisions.tolist()),
        timing=dict(mission_run.timing),
        maps=tuple(tuple(mission_run.robots[j] for j in crew.robots.tolist()) for crew in mission_run.crews),
        meetings=tuple(sorted(mission_run.meetings.values())),
    )
    return run_score, record


def start(mission: LaserMission, seed: int) -> tuple[LaserRun, Building]:
    """The run of `mission` with `seed`, before its first step, and what can be reached there."""
    place = make_place(mission.scenario, mission.robots, seed)
    robots = mission.cfg.robots
    building = survey_building(place.world, place.lower, place.upper, place.starts, robots.radius, robots.scanner.far)
    planner = find_planner(mission.planner, "laser")
    _compile(mission.planner)
    kills = dict(mission.kills or {})
    mission_run = LaserRun(
        place,
        building,
        mission.cfg,
        planner,
        seed,
        kills=kills,
        drop=mission.drop,
        until=mission.until,
        apart=mission.apart,
    )
    return mission_run, building


@cache
def _compile(planner: str) -> None:
    """Has a built-in planner take a few steps, once a process, so that decisions are timed and not compilation."""
    if not is_built_in(planner, "laser"):
        return
    place = make_place(LaserScenarioConfig(office=LEAST), 2, 0)
    cfg = LaserMissionConfig()
    building = survey_building(place.world, place.lower, place.upper, place.starts, cfg.robots.radius, 1.0)
    for _ in LaserRun(place, building, cfg, find_planner(planner, "laser"), 0, until=3).play():
        pass


def explore_laser_many(
    mission: LaserMission, runs: int, seed: int, executor: Executor | None = None
) -> list[LaserScore]:
    """Scores of `runs` runs with seeds `seed`, `seed` + 1, ...; the same with any executor."""
    return run_seeds(_score_only, mission, runs, seed, executor)


def _score_only(mission: LaserMission, seed: int, run: int) -> LaserScore:
    began = perf_counter()
    team, _ = start(mission, seed)
    moments = [replace(m, scans=()) for m in team.play()]  # scans are many and the score needs none
    merged = without_gaps(of_grid(team.team.grid(mission.cfg.map_resolution), OCCUPIED_SHARE))
    return score(team, moments, merged, run, perf_counter() - began)


def _note_seen(seen_at: np.ndarray, places: np.ndarray, grid: Occupancy, step: int) -> None:
    left = np.flatnonzero(np.isnan(seen_at))
    known = known_at(places[left], grid.free, grid.origin, grid.resolution)
    seen_at[left[known]] = step


def _truth(moments: list[LaserStepRecord], j: int) -> Track:
    mine = [m for m in moments if m.scans[j] is not None]
    poses = np.array([m.true_poses[j] for m in mine]).reshape(-1, 3)
    return Track(np.array([m.t for m in mine]), poses, frame="map")


def _log(moments: list[LaserStepRecord], j: int, source: str) -> LaserLog:
    pairs = [(m.t, s) for m in moments if (s := m.scans[j]) is not None]
    t = np.array([t for t, _ in pairs])
    scans = tuple(s for _, s in pairs)
    odometry = np.array([s.odometry for s in scans], dtype=float).reshape(-1, 3)
    return LaserLog(str(j + 1), source, t, scans, Track(t, odometry, frame="odom"))


def _pockets(mission_run: LaserRun) -> np.ndarray:
    """MappedGround the final map shows and no robot gets to."""
    first, poses = mission_run.crews[0].robots, mission_run.team.poses()[:, :2]
    alive = mission_run.alive[first]
    ground = mapped_ground(mission_run.grid, poses[first[alive]], poses[first[~alive]], mission_run.plan)
    return pockets(ground)


@dataclass(frozen=True, slots=True)
class LaserExploreResult(ExplorationResult[LaserMission, LaserScore, LaserRunRecord]):
    """noise: the factor on odometry errors."""

    MEANS: ClassVar[Mapping[str, str]] = {
        **ExplorationResult.MEANS,
        "area_mapped": "area_mapped",
        "trajectory_rmse_m": "trajectory_rmse",
        "wall_precision": "wall_precision",
        "wall_recall": "wall_recall",
        "closures": "closures",
        "refused": "refused",
        "driven_m": "driven",
        "maps": "maps",
    }

    def averages(self) -> dict[str, Any]:
        """Counts, and means over the runs; a figure no run has is None."""
        return ExplorationResult.averages(self) | {
            "area_mapped_min": min(r.area_mapped for r in self.runs),
            "collisions": sum(r.collisions for r in self.runs),
        }

    @property
    def metrics(self) -> dict[str, Any]:
        """What metrics.json holds; only `timing` and `ms_per_decision` differ between equal runs."""
        first = self.first
        runs = [asdict(r) for r in self.runs]
        seconds = [r.pop("seconds") for r in runs]
        world = {"sensor": "laser", "unknown_starts": self.mission.apart}
        return self._settings(first.robots, world, {}) | {
            "runs": runs,
            "first_run": {
                "front_end": {
                    name: {"scans": sum(first.status[j].values()), **dict(sorted(first.status[j].items()))}
                    for j, name in enumerate(first.robots)
                },
                "collisions": dict(zip(first.robots, first.collisions, strict=True)),
                "keyframes": len(first.graph),
                "closures": {
                    "accepted": sum(c.accepted for c in first.closures),
                    "between_robots": sum(c.accepted and c.robots[0] != c.robots[1] for c in first.closures),
                    "refused": refusals(first.closures),
                },
                "unreachable": [dict(zip(("x", "y", "m2"), row, strict=True)) for row in first.building.shut.tolist()],
                "pockets": first.pockets.tolist(),
                "given_up": first.given_up.tolist(),
                "maps": [list(robots) for robots in first.maps],
                "meetings": [m._asdict() | {"robots": list(m.robots)} for m in first.meetings],
            },
            "timing": {"runs_s": seconds, "first_run_s": dict(first.timing)},
        }

    def lines(self) -> list[str]:
        """The outcome in a few lines for people."""
        s, first = self.averages(), self.first
        mapped = f"{100 * s['area_mapped']:.2f} % (least {100 * s['area_mapped_min']:.2f} %)"
        lines = [
            self._line_of_steps(),
            f"{mapped} of the reachable area mapped, {s['collisions']} collisions",
        ]
        if s["map_error_m"] is not None and s["trajectory_rmse_m"] is not None:
            lines.append(
                f"map error {s['map_error_m']:.3f} m, trajectory RMSE {s['trajectory_rmse_m']:.3f} m; "
                f"{100 * s['wall_precision']:.1f} % of the map's walls are walls, "
                f"{100 * (s['wall_recall'] or 0.0):.1f} % of the walls are in the map"
            )
        lines.append(
            f"a run: {s['closures']:.1f} loops closed, {s['refused']:.1f} refused, {s['misassociations']:.2f} false; "
            f"{s['driven_m']:.0f} m driven; {s['ms_per_decision']:.2f} ms a decision"
        )
        if self.mission.apart:
            one = sum(r.maps == 1 for r in self.runs)
            lines.append(f"all robots found each other in {one} of {len(self.runs)} runs")
            lines += [
                f"{', '.join(robots)}: not found in the map of {first.robots[0]}, nor is what they mapped"
                for robots in first.maps[1:]
            ]
        lines += [
            f"left out: {area:.1f} m² around ({x:.1f}, {y:.1f}) m, where no robot gets to"
            for x, y, area in self.first.building.shut.tolist()
        ]
        return lines


def refusals(closures: tuple[Closure, ...]) -> dict[str, int]:
    """Why closures were not believed, numbers left out of the reasons, most frequent first."""
    why = Counter(re.sub(r"-?\d+(\.\d+)?", "#", c.reason) for c in closures if not c.accepted)
    return dict(why.most_common())
