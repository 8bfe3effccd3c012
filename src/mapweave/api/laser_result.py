"""What `map` and `fuse` give for laser logs: every robot's own map, and the maps of connected robots.

They differ in where the maps come from; how these are woven to a result is the same.
"""

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..core import se2
from ..core.errors import DataError, UsageError
from ..core.findings import Finding, Verdict, of_robot, shortly, unused_by_all, verdict, verdict_line
from ..core.names import robot_key, robot_name
from ..core.records import Track
from ..core.version import __version__
from ..core.workers import Progress, no_progress, worker_pool
from ..io.decisions import NAME as DECISIONS
from ..io.decisions import decisions_of, decisions_text, expect_of, read_decisions
from ..io.directory import write_json
from ..io.laser_map import write_closure_rows, write_laser_map, write_woven_map, write_woven_tracks
from ..io.laser_state import write_laser_states
from ..io.tum import read_tum, write_track_covariance, write_tum
from ..laser.beam import STEERING
from ..laser.laser_map import LaserMap
from ..laser.log_warnings import copies_found
from ..mapping.config import LaserConfig
from ..mapping.decisions import Decisions
from ..mapping.georeference import georeferenced, starts_of
from ..mapping.merge import Merge
from ..mapping.merge_search import LEAST_ALIKE, MergeConfig, Start
from ..mapping.redecide import redecided
from ..mapping.segments import still_apart
from ..mapping.weave import weave
from ..mapping.woven_map import WovenMap, contradictions, own_map, woven_maps
from ..report.html import told_list
from ..report.laser import robot_scene, write_laser_report
from ..report.result import ResultBase, Rows
from ..report.style import Target
from ..report.team_figures import headline_scores
from ..report.woven import component_scene, told_component, told_merge
from .evaluate import Evaluation, judged

DecisionsGiven = Path | Mapping[str, Any] | Decisions


@dataclass(frozen=True, slots=True, repr=False)
class LaserResult(ResultBase):
    """What `map` and `fuse` give for laser logs: every robot's map, and the maps in which robots were joined.

    metrics: as in `metrics.json`; evaluation: the score, where truth was given; maps: each robot's own, in the frame
    of its first pose; components: the graph method's maps of the robots that were joined, that of most robots first;
    merges: every pair of robots tried, with the decision and its reason; starts: robot -> x, y, theta[, sigma] that
    were told; said: what somebody said of robots and places; notes: what `summary` says beside; whole: findings that
    are of no robot alone. config: what the robots were woven by; before: every robot's map as its log alone made it,
    where what others saw or somebody said changed one.
    """

    maps: tuple[LaserMap, ...]
    metrics: dict[str, Any]
    evaluation: Evaluation | None = None
    truth: Mapping[str, Track] = field(default_factory=dict)
    components: tuple[WovenMap, ...] = ()
    merges: tuple[Merge, ...] = ()
    starts: Mapping[str, Sequence[float]] = field(default_factory=dict)
    said: Decisions | None = None
    notes: tuple[str, ...] = ()
    whole: tuple[Finding, ...] = ()
    config: LaserConfig | None = None
    before: tuple[LaserMap, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Of every robot, and of the whole."""
        return (*_own(self.maps), *self.whole)

    @property
    def verdict(self) -> Verdict:
        """What the findings make of the result."""
        return verdict(self.findings)

    def size(self) -> dict[str, Any]:
        """How many robots the largest map holds, how many maps there are, of how many keyframes, and the verdict."""
        parts = [len(woven.robots) for woven in self.components] or [1] * len(self.maps)
        keyframes = sum(0 if m.graph is None else len(m.graph) for m in self.maps)
        return {"robots": max(parts), "maps": len(parts), "keyframes": keyframes, "verdict": self.verdict}

    def draw(self, target: Target) -> None:
        """The map of most robots with their trajectories."""
        if self.components and self.components[0].joint:
            places = {local_map.robot: k for k, local_map in enumerate(self.maps)}
            component_scene(self.components[0], self.truth, places).draw(target)
        else:
            robot_scene(self.maps[0], self.truth.get(self.maps[0].robot)).draw(target)

    def headline(self) -> Rows:
        head = ("robot", "scans", "method", "feature", "map [m]")
        rows = []
        for local_map in self.maps:
            x0, x1, y0, y1 = local_map.grid.extent
            rows.append(
                (
                    local_map.robot,
                    len(local_map.scans),
                    local_map.method,
                    local_map.feature,
                    f"{x1 - x0:.0f} x {y1 - y0:.0f}",
                )
            )
        return head, rows

    def write_into(self, folder: Path) -> None:
        """All files of the contract; a robot alone in its component has its own map's files there too."""
        write_laser_data(folder, self)
        lines = [] if self.evaluation is None else self.evaluation.lines()
        doubts = self.metrics.get("warnings", ())
        top = [] if self.evaluation is None else headline_scores(self.evaluation.as_json())
        write_laser_report(
            *(folder, self.maps, self.truth, lines, self.components, self.merges, self.notes, doubts, top),
            findings=self.findings,
            growth=self.metrics.get("online", ()),
        )
        if not self.components and len(self.maps) == 1:
            _copied(folder, folder, self.maps[0].robot)
        for part, woven in _parts(folder, self.components):
            if len(woven.robots) == 1:
                _copied(part, folder, woven.robots[0])
                write_closure_rows(part / "closures.csv", woven.closures)

    def write_data(self, folder: Path) -> None:
        write_laser_data(folder, self)

    def lines(self) -> list[str]:
        lines = []
        for local_map in self.maps:
            refused = Counter(local_map.scans.decision)["odometry"]
            x0, x1, y0, y1 = local_map.grid.extent
            lines.append(
                f"{robot_name(local_map.robot)}: {len(local_map.scans)} scans, {local_map.method}, "
                f"feature {local_map.feature}{_light(local_map)}, "
                f"map {x1 - x0:.0f} x {y1 - y0:.0f} m, {refused} matches refused"
            )
            lines += [f"{robot_name(local_map.robot)}: {text}" for text in shortly(local_map.findings)]
        lines += [told_merge(merge) for merge in self.merges]
        if len(self.maps) > 1 and self.components:
            lines += [told_component(woven) for woven in self.components]
        lines += self.notes
        lines += [f"warning: {text}" for text in self.metrics.get("warnings", ())]
        lines += [] if self.evaluation is None else self.evaluation.lines()
        return [*lines, verdict_line(self.findings)]


def laser_metrics(
    maps: Sequence[LaserMap],
    seed: int,
    components: Sequence[WovenMap] = (),
    merges: Sequence[Merge] = (),
    timing: Mapping[str, float] | None = None,
    findings: Sequence[Finding] = (),
) -> dict[str, Any]:
    """What stands in `metrics.json`, without a score. findings: of the whole, beside those of the robots."""
    every = [*_own(maps), *findings]
    spent = {f"{robot_name(m.robot)} {stage}": spent for m in maps for stage, spent in m.timing.items()}
    return {
        "version": __version__,
        "seed": seed,
        "verdict": verdict(every),
        "findings": [found.row() for found in every],
        "unused": [left.row() for left in unused_by_all((m.source, m.unused) for m in maps)],
        "robots": {local_map.robot: _robot_metrics(local_map, every) for local_map in maps},
        "components": [list(c.robots) for c in components] or [[local_map.robot] for local_map in maps],
        "fusion": [merge.row() for merge in merges],
        "timing": {**spent, **(timing or {})},
        **(
            {"georeference": placed}
            if (placed := [None if c.georeference is None else c.georeference.row() for c in components])
            and any(placed)
            else {}
        ),
    }


def _own(maps: Sequence[LaserMap]) -> tuple[Finding, ...]:
    """The findings of all robots, each under the name its robot has now."""
    return tuple(found for m in maps for found in of_robot(m.findings, m.robot))


def _light(local_map: LaserMap) -> str:
    """What light counts in matching, beside the alpha that is set, in words; empty where it does not steer."""
    c = local_map.calibration
    steers = c is not None and local_map.feature in STEERING
    return f" at {c.weight:.0%} of alpha" if c is not None and steers else ""


def _robot_metrics(local_map: LaserMap, findings: Sequence[Finding]) -> dict[str, Any]:
    decisions = Counter(local_map.scans.decision)
    c, wheels = local_map.calibration, local_map.odometry_calibration
    light: dict[str, Any] = {}
    if c is not None:
        names = ("exponent", "exponent_sd", "scale", "residual", "samples", "weight")
        light = {name: getattr(c, name) for name in names} | ({} if len(c.gain_sd) else {"exponent_sd": None})
    metrics: dict[str, Any] = {
        "source": local_map.source,
        "verdict": verdict(found for found in findings if found.robot == robot_key(local_map.robot)),
        "odometry": local_map.odometry,
        "sightings": len(local_map.scans),
        "dropped": dict(local_map.dropped),
        "down_weighted": decisions["odometry"],
        "nis_median": None,
        "warnings": list(local_map.warnings),
        "method": local_map.method,
        "feature": local_map.feature,
        "particles": local_map.particles,
        "log_hash": local_map.log_hash,
        "decisions": dict(sorted(decisions.items())),
        "calibration": {**light, **({} if wheels is None else wheels.row())} or None,
    }
    return {**metrics, "name": local_map.called} if local_map.called else metrics


def write_laser_data(folder: Path, result: LaserResult) -> None:
    """Every file but the report and the copies of lone robots' maps: what scores and what goes on is read from."""
    maps, components = result.maps, result.components
    write_json(folder / "metrics.json", result.metrics)
    for local_map in maps:
        write_laser_map(folder / "local" / robot_name(local_map.robot), local_map)
        if not components:
            write_tum(folder / "trajectories" / f"{robot_name(local_map.robot)}.tum", local_map.track)
            write_track_covariance(folder / "trajectories" / f"{robot_name(local_map.robot)}.cov.csv", local_map.track)
    for part, woven in _parts(folder, components):
        if not woven.joint:
            write_woven_tracks(part, woven)
        else:
            write_woven_map(part, woven)
    if components:
        write_laser_states(folder, maps, result.starts)
        text = decisions_text(maps, result.merges, result.said)
        (folder / DECISIONS).write_text(text, encoding="utf-8")


def _parts(folder: Path, components: Sequence[WovenMap]) -> list[tuple[Path, WovenMap]]:
    """Where each component stands: the first at the top."""
    return [(folder if k == 1 else folder / "components" / str(k), woven) for k, woven in enumerate(components, 1)]


def _copied(part: Path, folder: Path, robot: str) -> None:
    part.mkdir(parents=True, exist_ok=True)
    for path in sorted((folder / "local" / robot_name(robot)).iterdir()):
        if path.is_file() and not (part / path.name).exists():
            (part / path.name).write_bytes(path.read_bytes())


LEAST_WAY = 1.0  # [m] driven: less, and a map is what was seen from one place


def same_logs(maps: Sequence[LaserMap]) -> tuple[LaserMap, LaserMap] | None:
    """The first two robots whose logs hold the same scans."""
    seen: dict[str, LaserMap] = {}
    for local_map in maps:
        other = seen.setdefault(local_map.scan_hash, local_map)
        if local_map.scan_hash and other is not local_map:
            return other, local_map
    return None


def woven_result(
    maps: Sequence[LaserMap],
    cfg: LaserConfig,
    *,
    seed: int,
    starts: Mapping[str, Sequence[float]] | None = None,
    merge: bool = True,
    truth: Sequence[Path] = (),
    findings: Sequence[Finding] = (),
    notes: Sequence[str] = (),
    jobs: int = 1,
    executor: Executor | None = None,
    decisions: DecisionsGiven | None = None,
    on_progress: Progress = no_progress,
) -> LaserResult:
    """The maps of all robots that can be tied together. starts: robot -> x, y, theta[, sigma] of its first pose; jobs:
    processes that pairs of robots are tried in, or `executor`; decisions: what somebody says of robots and places.

    Raises DataError where two logs hold the same scans, UsageError for a start of a robot that is not there.
    """
    if (twice := same_logs(maps)) is not None:
        a, b = twice
        raise DataError(
            f"{robot_name(a.robot)} ({a.source}) and {robot_name(b.robot)} ({b.source}) hold the same scans: "
            "expected every log once"
        )
    stored = [_storable(m) for m in maps]
    before = tuple(stored)
    stored, said, overruled = _as_said(stored, decisions, cfg)
    known_starts = {**starts_of(stored), **starts_among([m.robot for m in stored], starts or {}, cfg.merge)}
    began = perf_counter()
    if len(stored) > 1:
        on_progress("weave", 0, 1)
    pairs = len(stored) * (len(stored) - 1) // 2 if merge else 0
    with worker_pool(jobs, pairs, executor if pairs else None) as pool:
        components, merges, stored = _woven(stored, cfg, known_starts, pool, merge=merge, said=said)
    placed = georeferenced(components, stored, cfg.resolution, cfg.graph.unsure)
    components = placed.components
    if said is not None and said.masks:
        components, stored = _masked(components, stored, said)
    if len(stored) > 1:
        on_progress("weave", 1, 1)
    timing = {"weave": perf_counter() - began} if len(stored) > 1 else {}
    whole = [
        *findings,
        *overruled,
        *placed.findings,
        *(found for m in merges for found in _told_of(m)),
        *copies_found([m.graph for m in stored if m.graph is not None], [woven.tracks for woven in components]),
        *(found for woven in components for found in contradictions(stored, woven)),
        *(_apart(components) if merge else ()),
    ]
    metrics = laser_metrics(stored, seed, components, merges, timing, whole)
    if whole:
        metrics["warnings"] = [found.told for found in whole]
    if said is not None and decisions_text(stored, merges, said) == decisions_text(stored, merges, None):
        said = None  # what was decided all the same: a file given back as it is changes nothing
    result = LaserResult(
        tuple(stored),
        metrics,
        components=components,
        merges=merges,
        starts=starts or {},
        said=said,
        notes=tuple(notes),
        whole=tuple(whole),
        config=cfg,
        before=before if any(map(_changed, before, stored)) else (),
    )
    return scored(result, truth)


def _changed(before: LaserMap, after: LaserMap) -> bool:
    changed = before.graph is not after.graph or before.grid is not after.grid
    return changed or before.findings != after.findings


def _masked(
    components: Sequence[WovenMap], maps: Sequence[LaserMap], said: Decisions
) -> tuple[tuple[WovenMap, ...], list[LaserMap]]:
    """The maps, each robot's own too, as somebody says they are within rectangles."""
    out, own = list(components), list(maps)
    for row in said.masks:
        out = [
            replace(c, grid=row.on(c.grid, c.tracks[row.robot].pose[0])) if row.robot in c.robots else c for c in out
        ]
        own = [replace(m, grid=row.on(m.grid, m.track.pose[0])) if m.robot == row.robot else m for m in own]
    return tuple(out), own


def _woven(
    maps: list[LaserMap],
    cfg: LaserConfig,
    starts: Mapping[int, Start],
    executor: Executor | None,
    *,
    merge: bool,
    said: Decisions | None,
) -> tuple[tuple[WovenMap, ...], tuple[Merge, ...], list[LaserMap]]:
    """The components of the maps, every pair tried, and the maps without the findings that other robots settle.

    A robot that is the only one keeps its map as it is.
    """
    if len(maps) == 1:
        return (own_map(maps[0]),), (), maps
    graphs = [m.graph for m in maps if m.graph is not None]
    woven = weave(graphs, cfg.merge, starts, merge=merge, last=cfg.graph.joint, executor=executor, said=said)
    settled = [replace(m, findings=still_apart(m.findings, graphs[k], woven.held[k])) for k, m in enumerate(maps)]
    return woven_maps(settled, woven, cfg.resolution, cfg.graph.unsure), woven.merges, settled


def _as_said(
    maps: list[LaserMap], given: DecisionsGiven | None, cfg: LaserConfig
) -> tuple[list[LaserMap], Decisions | None, list[Finding]]:
    """The maps with the places in them that somebody says are so, and what is said, each place with what was found.

    What scans say of a pair is told beside when it is written: rows of a file and rows in memory are the same.
    """
    if given is None:
        return maps, None, []
    path: object = given if isinstance(given, Path) else "decisions"
    if isinstance(given, Decisions):
        said = given
    else:
        said = read_decisions(given) if isinstance(given, Path) else decisions_of(given)
    expect_of(said, maps, path)
    out: list[LaserMap] = []
    findings: list[Finding] = []
    places = [row for row in said.places if row.robot_a != row.robot_b]
    for local_map in maps:
        rows = said.within(local_map.robot)
        if not rows or local_map.graph is None:
            out.append(local_map)
            continue
        made = redecided(local_map, rows, cfg)
        out.append(_storable(made.map))
        findings += made.findings
        places += made.used
    logs = {m.robot: m.scan_hash for m in maps}
    pairs = sorted((replace(row, found="") for row in said.pairs if row.edited), key=lambda row: (row.a, row.b))
    kept = sorted((row for row in places if row.edited), key=lambda row: row.key)
    masks = tuple(sorted(said.masks, key=lambda row: (row.robot, row.box, row.cells)))
    return out, Decisions(logs, tuple(pairs), tuple(kept), masks), findings


def _told_of(merge: Merge) -> list[Finding]:
    """Where somebody's word on two robots is not what their scans say."""
    pair = f"{robot_name(merge.a)} and {robot_name(merge.b)}"
    if merge.said == "together" and (merge.alike or 0.0) < LEAST_ALIKE:
        told: dict[str, float | str] = {"pair": pair, "alike": 100.0 * (merge.alike or 0.0)}
        return [Finding("merge-contradicted", None, None, told, "they are merged as it was said")]
    if merge.said == "apart" and merge.scans:
        return [Finding("merge-forbidden", None, None, pair, "they are left apart as it was said")]
    return []


def _apart(components: Sequence[WovenMap]) -> tuple[Finding, ...]:
    """A finding where there are several maps."""
    names = [robot_name(robot) for woven in components[1:] for robot in woven.robots]
    return (Finding("robots-apart", value=told_list(names)),) if names else ()


def _storable(local_map: LaserMap) -> LaserMap:
    """The map as it is read back, with a finding where the robot hardly moved."""
    if local_map.graph is None:
        return local_map
    way = float(local_map.graph.path[-1])
    still = () if way >= LEAST_WAY else (Finding("robot-still", local_map.robot, value=way),)
    findings = tuple(f for f in still if f not in local_map.findings)
    return replace(local_map, graph=local_map.graph.stored(), findings=(*local_map.findings, *findings))


def scored(result: LaserResult, truth: Sequence[Path]) -> LaserResult:
    """The result with its score against `truth`; as it is without truth."""
    if not truth:
        return result
    metrics = result.metrics
    with tempfile.TemporaryDirectory() as folder:
        result.write_data(Path(folder))
        score = judged(Path(folder), truth)
    known = {local_map.robot: _true_track(truth, k) for k, local_map in enumerate(result.maps)}
    tracks = {robot: track for robot, track in known.items() if track is not None}
    whole = result.whole
    if score.unscored:
        left = Finding("truth-unscored", value=score.unscored)
        whole = (*whole, left)
        metrics = {
            **metrics,
            "findings": [*metrics["findings"], left.row()],
            "warnings": [*metrics.get("warnings", ()), left.text],
        }
    metrics = {**metrics, "evaluation": score.as_json()}
    return replace(result, metrics=metrics, evaluation=score, truth=tracks, whole=whole)


def starts_among(robots: Sequence[str], given: Mapping[str, Sequence[float]], cfg: MergeConfig) -> dict[int, Start]:
    """Where robots start in the frame of the first, by place among them; raises UsageError for one that is not."""
    if missing := [robot for robot in given if robot not in robots]:
        there = ", ".join(robot_name(r) for r in robots)
        raise UsageError(f"--start: there is no {robot_name(missing[0])}; there are {there}")
    home = np.asarray(given.get(robots[0], (0.0, 0.0, 0.0)), dtype=float)[:3]
    out = {}
    for robot, numbers in given.items():
        if robot == robots[0]:
            continue
        sd = float(numbers[3]) if len(numbers) > 3 else cfg.start_sd
        place = se2.between(home, np.asarray(numbers[:3], dtype=float))
        out[robots.index(robot)] = Start(place, np.array([sd, sd, cfg.start_turn_sd]))
    return out


def _true_track(paths: Sequence[Path], k: int) -> Track | None:
    """The k-th of several TUM files, or the only one for the only robot; None for other kinds of truth."""
    tum = [path for path in paths if path.suffix.lower() in (".tum", ".txt")]
    return read_tum(tum[k], "truth") if k < len(tum) else None
