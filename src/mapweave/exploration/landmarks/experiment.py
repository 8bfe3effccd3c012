"""Many explorations with their scores, and what these come to: a run is a scenario, a seed and a team."""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from ...core.gaussian import mahalanobis2
from ...landmarks.landmark_map import GlobalMap
from ...landmarks.submap_slam import SubmapConfig
from ...sim.landmarks import Field
from ..mission import ExplorationResult, Mission, RunScore, run_seeds
from ..planner_interface import find_planner, is_built_in
from .belief import Carried
from .config import ExploreConfig, ScenarioConfig, make_field
from .floor_plan import FloorPlan
from .team import LandmarkMeeting, StepRecord, Team

PRINTED_SD = (0.3, 0.3, 0.05)  # [m], [m], [rad] a step, as the paper prints them
CALIBRATED = 0.05  # the factor on them with which the paper's table comes out


@dataclass(frozen=True, slots=True)
class LandmarkMission(Mission[ScenarioConfig, ExploreConfig]):
    """One experiment's settings in a landmark world.

    apart: no robot knows where the others start; radio: [m] within which robots exchange what they know; kidnaps: robot
    index -> step at whose start it is carried away.
    """

    robots: int | None = None
    planner: str = "paper"
    until: str | int = "field"
    kills: Mapping[int, int] | None = None
    drop: float = 0.0
    cfg: ExploreConfig = field(default_factory=ExploreConfig)
    apart: bool = False
    radio: float = np.inf
    kidnaps: Mapping[int, int] | None = None


@dataclass(frozen=True, slots=True)
class LandmarkRunScore(RunScore):
    """collisions: how often a robot's true motion met a wall; it was stopped short of it.

    hidden: landmarks that walls hide from every place a robot can reach: neither sought nor missed. maps: how many
    there are in the end; met: the step at which two became one, the last time, None where none did; wrong_meetings:
    maps joined by landmarks of which half or more are not the same; in_touch: share of the steps after which all live
    robots had one map, 1 without a limit of the radio's range.
    """

    collisions: int = 0
    hidden: int = 0
    maps: int = 1
    met: int | None = None
    wrong_meetings: int = 0
    in_touch: float = 1.0


@dataclass(frozen=True, slots=True)
class LandmarkRunRecord:
    """What one run did, for figures and logs: its world, every moment, the final map and who is who in it.

    maps: the robots that have each map there was in the end, this one first; meetings: those that joined two, and of
    others the latest decision; carried: what became of robots that were carried away.
    """

    world: Field
    robots: tuple[str, ...]
    moments: tuple[StepRecord, ...]
    first_look: StepRecord
    map: GlobalMap
    source: Mapping[str, int]
    period: float
    submap_borders: tuple[tuple[int, int, np.ndarray], ...]  # (step, robot, corners (k, 2)) at each hand-over
    floor: FloorPlan | None = None
    maps: tuple[tuple[str, ...], ...] = ()
    meetings: tuple[LandmarkMeeting, ...] = ()
    carried: tuple[Carried, ...] = ()


def with_noise(cfg: ExploreConfig, factor: float) -> ExploreConfig:
    """`cfg` with the printed motion noise times `factor`, in the world and in the filter alike."""
    sd = (PRINTED_SD[0] * factor, PRINTED_SD[1] * factor, PRINTED_SD[2] * factor)
    return replace(cfg, submap=replace(cfg.submap, motion_sd=sd))


def noise_factor(cfg: ExploreConfig) -> float | None:
    """The motion noise of `cfg` over the printed one; None where it is not a multiple of it."""
    ratio = np.array(cfg.submap.motion_sd) / PRINTED_SD
    return round(float(ratio[0]), 12) if np.allclose(ratio, ratio[0], rtol=1e-9) else None


def explore_once(mission: LandmarkMission, seed: int, run: int = 0) -> tuple[LandmarkRunScore, LandmarkRunRecord]:
    """One run: the landmarks' layout and all noise follow from `seed`."""
    world = make_field(mission.scenario, mission.robots, seed)
    _compile(mission.planner, mission.cfg.submap.association, walled=world.walls is not None)
    rng = np.random.default_rng([seed, 1])
    team = Team(
        world,
        mission.cfg,
        find_planner(mission.planner, "landmarks"),
        rng,
        kills=dict(mission.kills or {}),
        drop=mission.drop,
        until=mission.until,
        apart=mission.apart,
        radio=mission.radio,
        kidnaps=dict(mission.kidnaps or {}),
        rendezvous=mission.cfg.mission.rendezvous,
    )
    first = team.observe_start()
    moments = tuple(team.play())
    record = LandmarkRunRecord(
        world,
        team.robots,
        moments,
        first,
        team.G,
        dict(team.crews[0].truth.source),
        mission.cfg.submap.period,
        tuple(team.borders),
        team.floor,
        tuple(tuple(team.robots[j] for j in crew.members) for crew in team.crews),
        tuple(team.meetings),
        tuple(team.carried),
    )
    return score(team, run, seed, moments), record


@cache
def _compile(planner: str, association: str, *, walled: bool) -> None:
    """Has a built-in planner take a few steps, once a process, so that decisions are timed and not compilation."""
    searching = planner == "joint" or (planner == "coverage" and not walled)  # before the first step: no compilation
    if not is_built_in(planner, "landmarks") or searching:
        return
    walls = ((0.0, 4.0, 0.0, 12.0),) if walled else None
    scenario = ScenarioConfig(
        lower=(-12.0, -12.0), upper=(12.0, 12.0), landmarks=((3.0, 3.0), (-3.0, -3.0)), walls=walls
    )
    cfg = ExploreConfig(submap=SubmapConfig(association=association))
    team = Team(make_field(scenario, 2, 0), cfg, find_planner(planner, "landmarks"), np.random.default_rng(0), until=3)
    team.observe_start()
    for _ in team.play():
        pass


def explore_many(
    mission: LandmarkMission, runs: int, seed: int, executor: Executor | None = None
) -> list[LandmarkRunScore]:
    """Scores of `runs` runs with seeds `seed`, `seed` + 1, ...; the same with any executor."""
    return run_seeds(_score_only, mission, runs, seed, executor)


def _score_only(mission: LandmarkMission, seed: int, run: int) -> LandmarkRunScore:
    return explore_once(mission, seed, run)[0]


def score(team: Team, run: int, seed: int, moments: tuple[StepRecord, ...]) -> LandmarkRunScore:
    """A finished run against the truth: mean landmark distance, mean ellipse area, NEES a degree of freedom."""
    source = team.crews[0].truth.source
    known = [i for i, name in enumerate(team.G.ids) if name in source]
    marks = team.G.landmarks.select([team.G.ids[i] for i in known])
    true = np.array([source[name] for name in marks.ids], dtype=int)
    decisions = sum(m.decisions for m in moments)
    seconds = sum(m.seconds for m in moments)
    error = marks.mean - team.world.landmarks[true] if known else np.zeros((0, 2))
    blocks = [marks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(len(known))]
    return LandmarkRunScore(
        run=run,
        seed=seed,
        finished=team.finished,
        steps=team.step,
        map_error=float(np.linalg.norm(error, axis=1).mean()) if known else None,
        c_per_n=float(np.mean([np.pi * np.sqrt(max(np.linalg.det(b), 0.0)) for b in blocks])) if known else None,
        nees_per_dof=mahalanobis2(error.ravel(), marks.cov) / error.size if known else None,
        duplicates=len(known) - len(set(true.tolist())),
        misassociations=team.crews[0].truth.misassociations,
        missed=len(team.wanted - set(true.tolist())),
        ms_per_decision=1e3 * seconds / max(decisions, 1),
        collisions=team.bumper.collisions,
        hidden=len(team.world.landmarks) - len(team.wanted),
        maps=len(team.crews),
        met=max((m.step for m in team.meetings if m.joined), default=None),
        in_touch=1.0 if np.isinf(team.radio) else team.together / max(team.step, 1),
        wrong_meetings=sum(m.joined and 2 * m.wrong >= m.links for m in team.meetings),
    )


@dataclass(frozen=True, slots=True)
class ExploreResult(ExplorationResult[LandmarkMission, LandmarkRunScore, LandmarkRunRecord]):
    """noise: motion noise over the printed one, None if no multiple."""

    def averages(self) -> dict[str, Any]:
        """Counts, and means over the runs; a figure no run has is None."""
        return ExplorationResult.averages(self) | {"collisions": self._mean("collisions")}

    def left_out(self) -> dict[str, Any] | None:
        """What walls hide from everybody, None in an open field: pockets, and the first run's landmarks."""
        floor = self.first.floor
        if floor is None:
            return None
        return {
            "pockets": len(floor.pockets),
            "area_m2": sum(floor.pockets),
            "pocket_areas_m2": list(floor.pockets),
            "landmarks": [
                {"landmark": k + 1, "x": float(x), "y": float(y)}
                for k, (x, y) in zip(floor.hidden, self.first.world.landmarks[list(floor.hidden)], strict=True)
            ],
        }

    @property
    def metrics(self) -> dict[str, Any]:
        """What metrics.json holds; only `timing` and `ms_per_decision` differ between equal runs."""
        radio = self.mission.radio
        world = {"unknown_starts": self.mission.apart, "radio_m": radio if np.isfinite(radio) else None}
        return self._settings(self.first.robots, world, {"association": self.mission.cfg.submap.association}) | {
            "left_out": self.left_out(),
            "maps": [list(robots) for robots in self.first.maps],
            "meetings": [
                m._asdict() | {"robots": list(m.robots), "odds": m.odds if np.isfinite(m.odds) else None}
                for m in self.first.meetings
            ],
            "kidnapped": [asdict(told) for told in self.first.carried],
            "runs": [asdict(r) for r in self.runs],
        }

    def lines(self) -> list[str]:
        """The outcome in a few lines for people."""
        s = self.averages()
        lines = [self._line_of_steps()]
        if s["map_error_m"] is not None:
            lines.append(
                f"map error {s['map_error_m']:.3f} m, uncertainty C/N {s['c_per_n_m2']:.3f} m², "
                f"NEES per degree of freedom {s['nees_per_dof']:.2f}"
            )
        lines.append(
            f"a run: {s['duplicates']:.2f} duplicates, {s['misassociations']:.2f} misassociations, "
            f"{s['missed']:.2f} landmarks missed; {s['ms_per_decision']:.2f} ms a decision"
        )
        return lines + self.lines_on_team() + self.lines_on_walls()

    def lines_on_team(self) -> list[str]:
        """How robots met that were not told of each other, were out of touch, or were carried away."""
        lines = []
        for told in self.first.carried:
            back = "and never found in the map again" if told.back is None else f"found in the map at step {told.back}"
            lines.append(f"{told.robot}: carried away at step {told.step}, {back} (seed {self.seed})")
        done = {told.robot for told in self.first.carried}
        for robot, step in ((self.first.robots[j], step) for j, step in (self.mission.kidnaps or {}).items()):
            if robot not in done:
                why = "it was dead, or the run over"
                lines.append(f"{robot}: not carried away at step {step}: {why} (seed {self.seed})")
        if np.isfinite(self.mission.radio):
            touch = 100.0 * np.mean([r.in_touch for r in self.runs])
            lines.append(f"radio of {self.mission.radio:g} m: all robots in touch in {touch:.0f} % of the steps")
        if self.mission.apart:
            one, wrong = sum(r.maps == 1 for r in self.runs), sum(r.wrong_meetings for r in self.runs)
            lines.append(f"all robots found each other in {one} of {len(self.runs)} runs, {wrong} times wrongly")
            own = self.first.robots[0]
            there = f"the map of {own}" if own in self.first.maps[0] else f"what {own} mapped before"
            lines += [
                f"{', '.join(robots)}: not found in {there}, nor is what they mapped"
                if robots
                else f"what a robot mapped before it was carried away: not found in {there}"
                for robots in self.first.maps[1:]
            ]
        return lines

    def lines_on_walls(self) -> list[str]:
        out = self.left_out()
        if out is None:
            return []
        met = [r.collisions for r in self.runs]
        lines = [
            f"robots were stopped short of walls {sum(met)} times, in {sum(n > 0 for n in met)} of {len(met)} runs"
        ]
        if out["pockets"]:
            what = "a pocket" if out["pockets"] == 1 else f"{out['pockets']} pockets"
            lines.append(f"left out: {what} no robot can see into, {out['area_m2']:.0f} m²")
        if out["landmarks"]:
            named = ", ".join(f"{m['landmark']} at ({m['x']:.1f}, {m['y']:.1f})" for m in out["landmarks"])
            lines.append(f"left out: landmarks that no robot can see: {named} (seed {self.seed})")
        return lines
