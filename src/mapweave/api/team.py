"""Local maps woven into a team's result: shared by `map` and `fuse`, which differ in where local maps come from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..core import se2
from ..core.findings import Finding, Unused, Verdict, of_robot, shortly, verdict, verdict_line
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order, robot_key
from ..core.records import Track
from ..core.truth import NO_SURVEY, Survey
from ..core.version import __version__
from ..core.workers import Progress
from ..evaluation.consistency import mean_or_none
from ..evaluation.landmarks import GrowthPoint, find_exchanges, growth_point
from ..evaluation.team import TeamScore, as_json, score_team
from ..fusion.config import FuseConfig
from ..fusion.online import OnlineFuser
from ..fusion.result import Component, Fusion
from ..io.directory import write_json
from ..io.fixes import write_georeferenced
from ..io.local_map import write_local_map
from ..io.team_map import told_gaps, write_calibration, write_landmark_arrays, write_landmarks, write_tracks
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..landmarks.mapping import Growth
from ..mapping.woven_map import Georeference
from ..report.html import told_list
from ..report.result import ResultBase, Rows
from ..report.style import Target
from ..report.team import team_scene, write_team_report
from ..report.team_figures import TeamStory
from ..team.online import OnlineMap, OnlineRun
from ..team.smooth import Smoothed
from ..team.team_map import TeamMap
from .evaluate import TeamTruth, read_team_truth, team_lines, unscored


def times_of(logs: Sequence[LandmarkLog], every: float) -> list[float]:
    """When [s] each robot hands over its map: every `every` seconds after the first row of all, before the last."""
    first, last = _span(logs)
    return [float(t) for t in np.arange(first + every, last, every)]


def fuse_online(
    logs: Sequence[LandmarkLog],
    grown: Sequence[Growth],
    cfg: FuseConfig,
    times: Sequence[float],
    on_progress: Progress,
) -> tuple[Fusion, tuple[OnlineMap, ...]]:
    """The fusion of all whole maps, and the global map at `times` [s] until then.

    grown: each log's maps at `times`; a robot's map at a time is its filter's by then, and the last is
    the one that the whole log gives.
    """
    first, last = _span(logs)
    fuser = OnlineFuser(cfg, {log.robot: log.source for log in logs})
    out = []
    for k, t in enumerate(times):
        on_progress("fusing online", k, len(times))
        fresher = [m for m in (g.maps[k] for g in grown) if m is not None]
        if fresher:
            fuser = fuser.update(*fresher)
        if fuser.largest is not None:
            out.append(OnlineMap(float(t - first), fuser.tied_in, fuser.largest.map))
    fuser = OnlineFuser(cfg, fuser.recordings, {g.whole.robot: g.whole for g in grown}).converged()
    if fuser.largest is not None:
        out.append(OnlineMap(float(last - first), fuser.tied_in, fuser.largest.map))
    on_progress("fusing online", len(times), len(times))
    return fuser.fusion, tuple(out)


def _span(logs: Sequence[LandmarkLog]) -> tuple[float, float]:
    spans = [log.span for log in logs if len(log)]
    return min(a for a, _ in spans), max(b for _, b in spans)


def growth(grown: Sequence[OnlineMap], survey: Survey) -> tuple[GrowthPoint, ...]:
    """Trace, log-determinant, error and consistency of every online map."""
    return tuple(growth_point(g.t, g.robots, g.landmarks, survey) for g in grown)


def run_metrics(run: OnlineRun, survey: Survey) -> dict[str, Any]:
    """What `metrics.json` tells of smoothing online, beside timing."""
    points = growth(run.growth, survey)
    return {
        "step": run.step,
        "steps": len(run.seconds),
        "stretches": run.stretches,
        "marginalised": 0,
        "linearised_per_step": round(float(run.linearised.mean()), 3) if len(run.linearised) else None,
        "renewed": run.renewed,
        "laid_out": list(run.laid_out),
        "landmarks_moved_at_the_end": run.landmarks_moved,
        "ways_moved_at_the_end": run.ways_moved,
        "growth": [{"t": p.t, "robots": p.robots, "landmarks": p.landmarks, "landmark_rmse": p.rmse} for p in points],
    }


NOTHING = LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))


@dataclass(frozen=True, slots=True, repr=False)
class TeamResult(ResultBase):
    """What `map` and `fuse` give for landmark logs: one map of the team and how it came about.

    maps: components, the largest first; local: what each robot handed over; growth: the global map over time, where
    it was fused while the logs played; score: against truth, where truth was given; smoothed: what smoothing the whole
    team found, a component each (none where it was not asked for, or where there are no logs); filter_score: of the
    map it began from; run: how smoothing went while the logs played, where it was asked for.
    """

    title: str
    seed: int
    maps: tuple[TeamMap, ...]
    local: tuple[LocalMap, ...]
    fusion: Fusion
    growth: tuple[GrowthPoint, ...] = ()
    score: TeamScore | None = None
    truth: TeamTruth | None = None
    smoothed: tuple[Smoothed, ...] = ()
    filter_score: TeamScore | None = None
    findings: tuple[Finding, ...] = ()
    timing: dict[str, float] = field(default_factory=dict)
    run: OnlineRun | None = None
    unused: tuple[Unused, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' sentences, each with its robot."""
        return tuple(f.told for f in self.findings)

    @property
    def verdict(self) -> Verdict:
        """What the findings make of the result."""
        return verdict(self.findings)

    @property
    def metrics(self) -> dict[str, Any]:
        """What stands in `metrics.json`."""
        metrics: dict[str, Any] = {
            "version": __version__,
            "seed": self.seed,
            "verdict": self.verdict,
            "findings": [f.row() for f in self.findings],
            "unused": [left.row() for left in self.unused],
            "robots": {robot_key(m.robot): _robot(m, self.findings) for m in self.local},
            "components": [[robot_key(r) for r in m.robots] for m in self.maps],
            "fusion": [
                {
                    "robot": robot_key(d.robot),
                    "shared": d.shared,
                    "decision": d.decision,
                    "reason": d.reason,
                    "scale": d.scale,
                    "variance_factor": d.variance_factor,
                    "renamed": dict(self.fusion.labels.get(d.robot, {})),
                }
                for d in self.fusion.decisions
            ],
            "warnings": [f.told for f in self.findings],
        }
        if gaps := told_gaps(self.maps):
            metrics["left_out"] = gaps
        if placed := georeferences(self.smoothed):
            metrics["georeference"] = placed
        if self.growth:
            metrics["online"] = [
                {
                    "t": p.t,
                    "robots": p.robots,
                    "landmarks": p.landmarks,
                    "trace": p.trace,
                    "log_det": p.log_det,
                    "landmark_rmse": p.rmse,
                    "nees_per_dof": p.nees_per_dof,
                }
                for p in self.growth
            ]
        if self.run is not None:
            metrics["online_smoothing"] = run_metrics(self.run, self._survey)
        if self.smoothed:
            metrics["refined"] = {**_errors(self.score), "components": [_smoothing(s) for s in self.smoothed]}
            metrics["filters"] = _errors(self.filter_score)
        if self.score is not None:
            metrics["evaluation"] = as_json(self.score)
        metrics["timing"] = {stage: round(s, 4) for stage, s in self.timing.items()}
        if self.run is not None:
            metrics["timing"]["smoothing_online"] = {k: round(s, 4) for k, s in self.run.timing().items()}
        return metrics

    @property
    def _survey(self) -> Survey:
        """Where the landmarks are truly, labels that look exchanged put back."""
        known = NO_SURVEY if self.truth is None else self.truth.survey
        return find_exchanges(self.maps[0].landmarks, known)[1] if self.truth is not None else known

    @property
    def story(self) -> TeamStory:
        """What the report is told from."""
        return TeamStory(
            title=self.title,
            maps=self.maps,
            local=self.local,
            fusion=self.fusion,
            growth=self.growth,
            score=self.score,
            survey=NO_SURVEY if self.truth is None else self.truth.survey,
            truths={} if self.truth is None else self.truth.robots,
            smoothed=self.smoothed,
            filter_score=self.filter_score,
            findings=self.findings,
            run=self.run,
        )

    def headline(self) -> Rows:
        scores = {} if self.score is None else self.score.robots
        head = ("robot", "sightings", "landmarks", "component", "ATE [m]")
        rows = [
            (robot_key(m.robot), sum(m.sightings.values()), len(m.submap.ids), self._component(m.robot), ate)
            for m in self.local
            for ate in [scores[m.robot].ate if m.robot in scores else None]
        ]
        return head, rows

    def _component(self, robot: str) -> int | None:
        return next((k for k, team in enumerate(self.maps, 1) if robot in team.robots), None)

    def draw(self, target: Target) -> None:
        """The fused map with its robots' trajectories."""
        team_scene(self.story, self.maps[0]).draw(target)

    def write_into(self, folder: Path) -> None:
        """Everything into `folder`, `metrics.json` last."""
        write_team(folder, self.story, self.metrics)

    def write_data(self, folder: Path) -> None:
        write_team_data(folder, self.story)
        write_json(folder / "metrics.json", self.metrics)

    def lines(self) -> list[str]:
        """What came out, in a few lines for people."""
        first = self.maps[0]
        out = [
            f"{len(first.robots)} of {len(self.local)} robots in one map of {len(first.landmarks)} landmarks",
            f"{sum(sum(m.sightings.values()) for m in self.local)} sightings",
        ]
        out += [f"robot {robot_key(d.robot)}: {d.decision}, {d.reason}" for d in self.fusion.decisions]
        out += [f"warning: {text}" for text in shortly(self.findings, named=True)]
        out += [] if self.score is None else team_lines(self.score)
        return [*out, verdict_line(self.findings)]


def georeferences(smoothed: Sequence[Smoothed]) -> list[dict[str, Any] | None]:
    """Of each component where it lies in the world; empty where fixes lay none."""
    placed = [None if s.georeference is None else s.georeference.row() for s in smoothed]
    return placed if any(placed) else []


def _errors(score: TeamScore | None) -> dict[str, float | None]:
    """Landmark RMSE and mean ATE, also with labels that look exchanged put back."""
    if score is None:
        return {"landmark_rmse": None, "ate": None}
    errors = {"landmark_rmse": score.landmarks.rmse, "ate": mean_or_none([r.ate for r in score.robots.values()])}
    if score.landmarks_exchanged is not None:
        errors["landmark_rmse_exchanged"] = score.landmarks_exchanged.rmse
    return errors


def _smoothing(s: Smoothed) -> dict[str, Any]:
    clocks = {robot_key(r): {"ahead": c.ahead, "sd": c.sd} for r, c in s.clocks.items()}
    return {
        "status": s.status,
        "iterations": s.iterations,
        "poses": s.poses,
        "factors": dict(s.used),
        "inflation": {robot_key(r): f for r, f in s.inflation.items()},
        "refused": s.refused or None,
        **({"clocks": clocks} if clocks else {}),
    }


class Watch:
    """Seconds spent in each stage, in the order they began."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._at = perf_counter()

    def lap(self, stage: str) -> None:
        """The time since the last lap was spent on `stage`."""
        now = perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._at
        self._at = now


def team_result(
    title: str,
    seed: int,
    local: Sequence[LocalMap],
    fusion: Fusion,
    truth: Sequence[Path],
    online: Sequence[OnlineMap],
    watch: Watch,
    maps: Sequence[TeamMap] | None = None,
    smoothed: Sequence[Smoothed] = (),
    run: OnlineRun | None = None,
) -> TeamResult:
    """The result of fusing `local`; truth is read here, when nothing is left to estimate.

    maps: its components (found here when None); smoothed: what became of them;
    run: smoothing while the logs played.
    """
    if maps is None:
        maps = team_maps(local, fusion)
        watch.lap("fuse")
    filters, maps = maps, tuple(s.map for s in smoothed) or tuple(maps)
    known = score = filter_score = None
    survey = NO_SURVEY
    if truth:
        known = read_team_truth(truth, [m.robot for m in local])
        survey = find_exchanges(maps[0].landmarks, known.survey)[1]
        score = score_team(maps, {m.robot: m.submap.landmarks for m in local}, known.survey, known.robots)
        if smoothed:
            filter_score = score_team(filters, {}, known.survey, known.robots)
        watch.lap("evaluate")
    own = [found for m in local for found in of_robot(m.findings, m.robot)]
    left = unscored(score) if score is not None else ""
    return TeamResult(
        title=title,
        seed=seed,
        maps=maps,
        local=tuple(local),
        fusion=fusion,
        growth=growth(online, survey) if online else (),
        score=score,
        truth=known,
        smoothed=tuple(smoothed),
        filter_score=filter_score,
        findings=(
            *fusion.findings,
            *own,
            *((Finding("truth-unscored", value=left),) if left else ()),
            *(found for s in smoothed for found in s.findings),
            *(() if run is None else run.findings),
            *_apart(maps),
        ),
        timing=watch.seconds,
        run=run,
    )


def _apart(maps: Sequence[TeamMap]) -> tuple[Finding, ...]:
    """A finding where there are several maps."""
    names = [robot for team in maps[1:] for robot in team.robots]
    return (Finding("robots-apart", value=told_list(names)),) if names else ()


def team_maps(local: Sequence[LocalMap], fusion: Fusion) -> tuple[TeamMap, ...]:
    """The components with their robots' trajectories; a robot that mapped nothing stands alone, after the others."""
    by = {m.robot: m for m in local}
    factor = {d.robot: d.variance_factor or 1.0 for d in fusion.decisions}
    maps = [_team_map(c, by, factor, fusion) for c in fusion.components]
    placed = {r for c in fusion.components for r in c.robots}
    once = {m.log_hash for r, m in by.items() if r in placed}
    left = [r for r in sorted(set(by) - placed, key=in_order) if by[r].log_hash not in once]
    return (*maps, *(TeamMap((robot,), NOTHING, {robot: by[robot].track}) for robot in left))


def carried(track: Track, T: np.ndarray, T_cov: np.ndarray, scale: float, factor: float) -> Track:
    """A local track in the map's frame: shrunk by `scale`, moved by `T_map_local`; their errors independent."""
    small = track.pose / np.array([scale, scale, 1.0])
    pose = se2.compose(T, small)
    if track.cov is None:
        return Track(track.t, pose)
    shrink = np.diag([1 / scale, 1 / scale, 1.0])
    cov = se2.composed_covariance(T, T_cov, small, factor * (shrink @ track.cov @ shrink))
    return Track(track.t, pose, 0.5 * (cov + cov.transpose(0, 2, 1)))


def _team_map(component: Component, by: Mapping[str, LocalMap], factor: Mapping[str, float], fusion: Fusion) -> TeamMap:
    tracks = {
        r: carried(
            by[r].track, component.frames[r], component.frame_cov[r], component.scales.get(r, 1.0), factor.get(r, 1.0)
        )
        for r in component.robots
    }
    seen = {
        name: sum(by[r].sightings.get(fusion.own_name(r, name), 0) for r in robots)
        for name, robots in component.members.items()
    }
    first: dict[str, float] = {}
    for name, robots in component.members.items():
        known = [t for r in robots if (t := by[r].first_seen.get(fusion.own_name(r, name))) is not None]
        if known:
            first[name] = min(known)
    return TeamMap(component.robots, component.map, tracks, component.members, seen, first_seen=first)


def _robot(m: LocalMap, findings: Sequence[Finding]) -> dict[str, Any]:
    mine = [found for found in findings if found.robot == robot_key(m.robot)]
    return {
        "source": m.source,
        "verdict": verdict(mine),
        "odometry": m.odometry,
        "sightings": sum(m.sightings.values()),
        "landmarks": len(m.submap.ids),
        "robot_sightings": len(m.robot_sightings.t),
        "dropped": dict(m.dropped),
        "down_weighted": m.down_weighted,
        "nis_median": m.nis_median,
        "calibration": {name: {"value": v, "sd": sd} for name, (v, sd) in m.calibration.items()},
        "warnings": [found.text for found in mine],
    }


def write_team(folder: Path, story: TeamStory, metrics: Mapping[str, Any]) -> None:
    """Landmarks and trajectories of every component, local maps, report and, last, `metrics.json`."""
    began = perf_counter()
    write_team_data(folder, story)
    wrote = perf_counter()
    write_team_report(folder, story)
    timing = dict(metrics["timing"])
    parts = {k: timing.pop(k) for k in ("smoothing_online",) if k in timing}  # of a stage that is told already
    timing |= {"write": wrote - began, "report": perf_counter() - wrote}
    timing["total"] = sum(timing.values())
    write_json(folder / "metrics.json", {**metrics, "timing": {**{k: round(v, 4) for k, v in timing.items()}, **parts}})


def write_team_data(folder: Path, story: TeamStory) -> None:
    """Landmarks and trajectories of every component, local maps and the calibration found."""
    placed = [s.georeference for s in story.smoothed] or [None] * len(story.maps)
    for k, (team, where) in enumerate(zip(story.maps, placed, strict=True), 1):
        _write_component(folder if k == 1 else folder / "components" / str(k), team, where)
    for local in story.local:
        home = folder / "local" / local.robot
        write_local_map(home, local)
        write_landmark_arrays(home, local.submap.landmarks)
    if story.smoothed:
        calibrations = {robot: known for s in story.smoothed for robot, known in s.calibration.items()}
        write_calibration(folder / "calibration.json", calibrations, story.smoothed[0].prior)


def _write_component(folder: Path, team: TeamMap, placed: Georeference | None) -> None:
    write_landmarks(folder, team)
    write_tracks(folder, team)
    if placed is not None:
        write_georeferenced(folder, placed, team.tracks, landmarks=team.landmarks)
