"""Laser maps of several robots woven: shared by `map` and `fuse`, which differ in where the maps come from."""

import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from ..core import se2
from ..core.errors import DataError, UsageError
from ..core.names import robot_name
from ..core.records import Track
from ..core.workers import Progress, no_progress, worker_pool
from ..io.tum import read_tum
from ..laser.config import LaserConfig
from ..laser.copied_scans import copies_told
from ..laser.laser_map import LaserMap
from ..laser.merge import Merge
from ..laser.merge_search import MergeConfig, Start
from ..laser.weave import weave
from ..laser.woven_map import WovenMap, own_map, woven_maps
from .evaluate import judged
from .laser_result import LaserResult, laser_metrics, write_laser_data

LEAST_WAY = 1.0  # [m] driven: less, and a map is what was seen from one place


def same_logs(maps: Sequence[LaserMap]) -> tuple[LaserMap, LaserMap] | None:
    """The first two robots whose logs hold the same scans."""
    seen: dict[str, LaserMap] = {}
    for made in maps:
        other = seen.setdefault(made.scan_hash, made)
        if made.scan_hash and other is not made:
            return other, made
    return None


def woven_result(
    maps: Sequence[LaserMap],
    cfg: LaserConfig,
    *,
    seed: int,
    starts: Mapping[str, Sequence[float]] | None = None,
    merge: bool = True,
    truth: Sequence[Path] = (),
    warnings: Sequence[str] = (),
    notes: Sequence[str] = (),
    jobs: int = 1,
    executor: Executor | None = None,
    on_progress: Progress = no_progress,
) -> LaserResult:
    """The maps of all robots that can be tied together. starts: robot -> x, y, theta[, sigma] of its first pose; jobs:
    processes that pairs of robots are tried in, or `executor`.

    Raises DataError where two logs hold the same scans, UsageError for a start of a robot that is not there.
    """
    if (twice := same_logs(maps)) is not None:
        a, b = twice
        raise DataError(
            f"{robot_name(a.robot)} ({a.source}) and {robot_name(b.robot)} ({b.source}) hold the same scans: "
            "expected every log once"
        )
    made = [_storable(m, alone=len(maps) == 1) for m in maps]
    told = starts_among([m.robot for m in made], starts or {}, cfg.merge)
    began = perf_counter()
    if len(made) > 1:
        on_progress("weave", 0, 1)
    pairs = len(made) * (len(made) - 1) // 2 if merge else 0
    with worker_pool(jobs, pairs, executor if pairs > 1 else None) as pool:
        components, merges = _woven(made, cfg, told, pool, merge=merge)
    if len(made) > 1:
        on_progress("weave", 1, 1)
    timing = {"weave": perf_counter() - began} if len(made) > 1 else {}
    metrics = laser_metrics(made, seed, components, merges, timing)
    copies = copies_told([m.graph for m in made if m.graph is not None], cfg.copies)
    if warnings or copies:
        metrics["warnings"] = [*warnings, *copies]
    result = LaserResult(
        tuple(made), metrics, components=components, merges=merges, starts=starts or {}, notes=tuple(notes)
    )
    return scored(result, truth)


def _woven(
    maps: Sequence[LaserMap], cfg: LaserConfig, starts: Mapping[int, Start], executor: Executor | None, *, merge: bool
) -> tuple[tuple[WovenMap, ...], tuple[Merge, ...]]:
    """The components of the maps, and every pair tried; a robot that is the only one keeps its map as it is."""
    if len(maps) == 1:
        return (own_map(maps[0]),), ()
    graphs = [m.graph for m in maps if m.graph is not None]
    woven = weave(graphs, cfg.merge, starts, merge=merge, last=cfg.graph.joint, executor=executor)
    return woven_maps(maps, woven, cfg.resolution, cfg.graph.unsure), woven.merges


def _storable(made: LaserMap, *, alone: bool) -> LaserMap:
    """The map as it is read back, with a word where there is too little of it to be tied to another."""
    if made.graph is None:
        return made
    n, way = len(made.graph), float(made.graph.path[-1])
    still = (
        () if alone or way >= LEAST_WAY else (f"the robot hardly moved: {n} keyframe{'s' * (n > 1)} on {way:.1f} m",)
    )
    told = tuple(w for w in still if w not in made.warnings)
    return replace(made, graph=made.graph.stored(), warnings=(*made.warnings, *told))


def scored(result: LaserResult, truth: Sequence[Path]) -> LaserResult:
    """The result with its score against `truth`; as it is without truth."""
    if not truth:
        return result
    metrics = result.metrics
    with tempfile.TemporaryDirectory() as folder:
        write_laser_data(Path(folder), result)
        score = judged(Path(folder), truth)
    known = {made.robot: _true_track(truth, k) for k, made in enumerate(result.maps)}
    tracks = {robot: track for robot, track in known.items() if track is not None}
    if score.unscored:
        metrics = {
            **metrics,
            "warnings": [*metrics.get("warnings", ()), f"the truth: nothing to score: {score.unscored}"],
        }
    return replace(result, metrics={**metrics, "evaluation": score.as_json()}, evaluation=score, truth=tracks)


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
