"""`fuse` of laser results: the graphs of all their robots woven into one map."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..core.config import load
from ..core.errors import DataError, UsageError
from ..core.findings import Finding
from ..core.names import in_order, robot_name
from ..core.paths import AnyConfig, checked_arguments
from ..core.workers import Progress, no_progress, one_blas_thread
from ..fusion.compared_logs import scales_apart
from ..fusion.config import FuseConfig
from ..fusion.join import fuse as join_maps
from ..io.directory import check_target, no_result
from ..io.laser_state import holds_state, laser_homes
from ..io.local_map import read_local_map
from ..io.saved_result import expect_whole
from ..landmarks.landmark_map import LocalMap
from ..laser.laser_map import LaserMap
from ..mapping.decisions import Decisions
from ..report.result import written
from .evaluate import expect_truth
from .in_memory import Truths, decisions_of_argument, result_folders, truth_files
from .laser_result import DecisionsGiven, LaserResult, same_logs, woven_result
from .map_laser import LaserMapConfig, state_before
from .map_options import expect_there
from .result import MapResult
from .team import TeamResult, Watch, team_result


def are_laser_results(folders: Sequence[Path]) -> bool:
    """Whether these are results of laser logs; raises DataError where some are and others are not."""
    laser = [holds_state(folder) or bool(laser_homes(folder)) for folder in folders]
    if any(laser) and not all(laser):
        one, other = folders[laser.index(True)], folders[laser.index(False)]
        raise DataError(f"{one} is a result of laser logs and {other} is none: only results of one kind are fused")
    return all(laser)


def fuse_laser(
    folders: Sequence[Path],
    names: Sequence[str],
    *,
    config: AnyConfig | None,
    seed: int,
    truth: Sequence[Path],
    decisions: DecisionsGiven | None,
    on_progress: Progress,
) -> LaserResult:
    """One result of all robots of `folders`, called NAME/robotK; a log that several hold counts once and is told."""
    cfg = load(LaserMapConfig, config).laser
    cfg.check()
    maps: list[LaserMap] = []
    held: list[Decisions] = []
    for k, (folder, name) in enumerate(zip(folders, names, strict=True)):
        on_progress("reading", k, len(folders))
        state = state_before(folder)
        names_now = {local_map.robot: f"{name}/{robot_name(local_map.robot)}" for local_map in state.maps}
        maps += [_renamed_laser(local_map, names_now[local_map.robot]) for local_map in state.maps]
        held += [] if state.said is None else [state.said.renamed(names_now)]
    if config is None:
        cfg = replace(cfg, resolution=min(local_map.grid.resolution for local_map in maps))
    findings = []
    while (twice := same_logs(maps)) is not None:
        first, again = twice
        maps = [local_map for local_map in maps if local_map is not again]
        findings.append(Finding("log-twice", again.robot, value=first.robot, action="it counts once"))
    return woven_result(
        maps,
        cfg,
        seed=seed,
        truth=truth,
        findings=findings,
        decisions=_said_of(held, maps) if decisions is None else decisions,
        on_progress=on_progress,
    )


def _said_of(held: Sequence[Decisions], maps: Sequence[LaserMap]) -> Decisions | None:
    """What was decided by hand on the results, of robots whose maps are fused; None where nothing was."""
    there = {local_map.robot: local_map.robot for local_map in maps}
    said = [one.renamed(there) for one in held]
    if not said:
        return None
    return Decisions(
        {robot: of for one in said for robot, of in one.logs.items()},
        tuple(row for one in said for row in one.pairs),
        tuple(row for one in said for row in one.places),
        tuple(row for one in said for row in one.masks),
    )


def _renamed_laser(local_map: LaserMap, robot: str) -> LaserMap:
    graph = None if local_map.graph is None else replace(local_map.graph, robot=robot)
    return replace(local_map, robot=robot, graph=graph)


@checked_arguments
@one_blas_thread()
def fuse(
    directories: Path | str | MapResult | Sequence[Path | str | MapResult],
    out: Path | str | None = None,
    *,
    weights: str | None = None,
    identities: str | None = None,
    truth: Truths = (),
    config: AnyConfig | None = None,
    seed: int = 0,
    decisions: Path | str | Mapping[str, Any] | None = None,
    force: bool = False,
    on_progress: Progress = no_progress,
) -> TeamResult | LaserResult:
    """Fuse the local maps of several results into one map; written to `out` if given.

    Robots are called `DIR/robotK`, of results in memory `result1/robotK` and so on by their place. Every decision
    (merged or refused) has its reason in the result; the same log given twice counts once, and is told.

    Parameters
    ----------
    directories
        Results of `map` or `fuse`, in memory or their folders, all of landmark logs or all of laser logs (of the graph
        method).
    weights
        How much each map counts: constant, paper, diagonal, full, full-scaled or naive (full-scaled). Landmarks alone.
    identities
        `known`: equal ids are one landmark, where the places agree; `unknown`: found out from the places (known).
        Landmarks alone.
    truth
        What `evaluate` takes; used for scoring alone.
    config
        Settings, in a file or in memory as for `map`: as `configuration("fuse")` prints them, `configuration("fuse",
        laser=True)` for laser maps (the tables `merge` and `graph.joint`, and `resolution`, without a configuration the
        finest of theirs); options here win.
    seed
        Kept in the metrics; the result does not depend on it (0).
    decisions
        What is said of pairs of robots and of places: a `decisions.toml` of this result, edited, or what it holds
        (nothing). Laser results alone.

    Raises
    ------
    ReaderError
        For a result that is missing or damaged.
    DataError
        For one without local maps, and where laser results stand beside others.
    UsageError
        For options that cannot be; ConfigError for a configuration that is refused. Nothing is written then.

    Examples
    --------
    >>> team = simulate_landmarks("team", robots=2, landmarks=12, minutes=1.5, seed=8)
    >>> one, two = map("team", "one", robots=["1"]), map("team", "two", robots=["2"])
    >>> fuse(["one", "two"]).maps[0].robots
    ('one/robot1', 'two/robot2')
    >>> fuse([one, two]).maps[0].robots
    ('result1/robot1', 'result2/robot2')
    """
    said = decisions_of_argument(decisions)
    with result_folders(directories, "directories") as given, truth_files(truth) as scores:
        if not given:
            raise UsageError("expected a result of map, found none")
        if out is not None:
            inside = [path for path in given if path.resolve() != Path(out).resolve()]  # itself it may be replaced
            check_target(Path(out), force=force, reads=(*inside, *scores, config))
        for folder in given:
            if not folder.is_dir():
                raise no_result(folder)
            expect_whole(folder)
        if scores:
            expect_there(scores)
            expect_truth(scores)
        result: TeamResult | LaserResult
        if are_laser_results(given):
            idle = {"--weights": weights, "--identities": identities}
            if asked := [name for name, value in idle.items() if value is not None]:
                raise UsageError(f"{', '.join(asked)}: only for landmark results, found {given[0]}")
            names = distinct_names(given)
            result = fuse_laser(
                given, names, config=config, seed=seed, truth=scores, decisions=said, on_progress=on_progress
            )
        else:
            if decisions is not None:
                raise UsageError(f"--decisions: only for laser results, found {given[0]}")
            cfg = load(FuseConfig, config, {"weights": weights, "identities": identities})
            result = _fuse_landmarks(given, cfg, seed, scores, on_progress)
    return written(result, out, force=force)


def _fuse_landmarks(
    given: Sequence[Path], cfg: FuseConfig, seed: int, truth: Sequence[Path], on_progress: Progress
) -> TeamResult:
    """One result of all robots in the folders `given`, called NAME/robotK."""
    watch = Watch()
    local: list[LocalMap] = []
    recordings: dict[str, str] = {}
    names = distinct_names(given)
    for k, (path, label) in enumerate(zip(given, names, strict=True)):
        on_progress("reading", k, len(given))
        read = _read_all(path, label)
        recordings |= {m.robot: f"{m.robot.rpartition('/')[0]}:{m.source}" for m in read}
        local += read
    watch.lap("read")
    title = f"One map fused from {', '.join(names)}"
    fusion = join_maps(local, cfg, recordings)
    apart = scales_apart(local, [c.robots for c in fusion.components])
    fusion = replace(fusion, findings=(*fusion.findings, *apart))
    return team_result(title, seed, local, fusion, truth, (), watch)


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """As much of the end of every path as tells it from the others: `a/run` and `b/run`, else `run`."""
    parts = [path.resolve().parts for path in paths]
    if len(set(parts)) < len(parts):
        twice = next(str(p) for k, p in enumerate(paths) if parts[k] in parts[:k])
        raise UsageError(f"{twice}: given twice")
    deep = 1
    while len({p[-deep:] for p in parts}) < len(parts):
        deep += 1
    return ["/".join(p[-deep:]) for p in parts]


def _read_all(path: Path, label: str) -> list[LocalMap]:
    folders = [p.parent for p in (path / "local").rglob("local_map.json")]
    homes = sorted(folders, key=lambda p: in_order(p.as_posix()))
    if not homes:
        raise DataError(f"{path}: expected a result with local maps, found none")
    return [_renamed(read_local_map(home), f"{label}/{home.relative_to(path / 'local').as_posix()}") for home in homes]


def _renamed(m: LocalMap, name: str) -> LocalMap:
    fleet = name.removesuffix(m.robot)
    seen = replace(m.robot_sightings, target=tuple(f"{fleet}{target}" for target in m.robot_sightings.target))
    return replace(m, robot=name, submap=replace(m.submap, robot=name), robot_sightings=seen)
