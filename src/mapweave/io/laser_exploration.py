"""What an exploration with lasers leaves: scores, the merged map, trajectories, the pose graph, replayable logs."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from .directory import plain, write_json
from .exploration import COLUMNS, write_scores
from .g2o import write_g2o
from .grid import NAME, write_grid
from .mcap import write_mcap
from .ros_map import write_ros_states
from .rows import open_text
from .table import cell, quoted
from .tum import write_tum

CLOCKS = ("seconds",)  # told by metrics.json under `timing` alone: they differ between equal runs
CLOSURES = "first,second,robot_first,robot_second,accepted,share,nis,dx,dy,dtheta,reason"


def write_laser_runs(folder: Path, runs: tuple[Any, ...], metrics: Mapping[str, Any], first: Any) -> None:
    """runs.csv (the contract's columns, then the laser worlds' own) and metrics.json.

    Of the first run: map.pgm, map.yaml, grid.npz (in which `localize` finds a robot), trajectories/, pose_graph.g2o,
    closures.csv and log/, which `map` replays.
    """
    own = [f.name for f in fields(runs[0]) if f.name not in CLOCKS]
    names = [*(name for name in COLUMNS if name in own), *(name for name in own if name not in COLUMNS)]
    write_scores(folder / "runs.csv", names, runs)
    write_json(folder / "metrics.json", plain(dict(metrics)))
    write_ros_states(folder, first.map)
    write_grid(folder / NAME, first.grid, None, "none")
    write_g2o(folder / "pose_graph.g2o", first.graph)
    write_closures(folder / "closures.csv", first)
    for name, track, log, truth in zip(first.robots, first.tracks, first.logs, first.truths, strict=True):
        write_tum(folder / "trajectories" / f"{name}.tum", track)
        (folder / "log").mkdir(exist_ok=True)
        write_mcap(folder / "log" / f"{name}.mcap", log, truth)
        write_tum(folder / "log" / f"{name}.truth.tum", truth)


def write_closures(path: Path, first: Any) -> None:
    """Every loop closure that was tried, in order: first and second number the vertices of pose_graph.g2o."""
    with open_text(path) as file:
        file.write(CLOSURES + "\n")
        for c in first.closures:
            a, b = (first.robots[k] for k in c.robots)
            values = [c.first, c.second, a, b, c.accepted, c.share, c.nis, *map(float, c.measured)]
            file.write(",".join([*map(cell, values), quoted(c.reason)]) + "\n")
