"""`fuse` of laser results: the graphs of all their robots woven into one map."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..core.config import load
from ..core.errors import DataError
from ..core.findings import Finding
from ..core.names import robot_name
from ..core.paths import AnyConfig
from ..core.workers import Progress
from ..io.laser_state import holds_state, laser_homes, read_laser_states
from ..laser.laser_map import LaserMap
from .laser_result import DecisionsGiven, LaserResult, same_logs, woven_result
from .map_laser import LaserMapConfig


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
    for k, (folder, name) in enumerate(zip(folders, names, strict=True)):
        on_progress("reading", k, len(folders))
        maps += [
            _renamed(local_map, f"{name}/{robot_name(local_map.robot)}") for local_map in read_laser_states(folder).maps
        ]
    findings = []
    while (twice := same_logs(maps)) is not None:
        first, again = twice
        maps = [local_map for local_map in maps if local_map is not again]
        findings.append(Finding("log-twice", again.robot, value=first.robot, action="it counts once"))
    if config is None:
        cfg = replace(cfg, resolution=maps[0].grid.resolution)
    return woven_result(
        maps,
        cfg,
        seed=seed,
        truth=truth,
        findings=findings,
        decisions=decisions,
        on_progress=on_progress,
    )


def _renamed(local_map: LaserMap, robot: str) -> LaserMap:
    graph = None if local_map.graph is None else replace(local_map.graph, robot=robot)
    return replace(local_map, robot=robot, graph=graph)
