"""What an exploration leaves: a row a run, metrics, and the first run as logs that `map` replays.

With lasers also the merged map, trajectories, the pose graph and the closures that were tried.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..core.landmark_log import RobotRecording, TeamRecording
from .directory import plain, write_json
from .g2o import write_g2o
from .laser_map import NAME, write_grid
from .mcap import write_mcap
from .mrclam import write_mrclam
from .ros_map import write_ros_states
from .table import cell, open_text, quoted, write_table
from .tum import write_tum

COLUMNS = (
    "run",
    "seed",
    "finished",
    "steps",
    "map_error",
    "c_per_n",
    "nees_per_dof",
    "duplicates",
    "misassociations",
    "missed",
    "ms_per_decision",
    "collisions",
    "hidden",
    "maps",
    "met",
    "wrong_meetings",
    "in_touch",
)


def write_scores(path: Path, names: Sequence[str], runs: Sequence[Any]) -> None:
    """`path`: a row a run with the columns `names`; numbers to six digits, nothing where a figure does not exist."""
    rows = (asdict(run) for run in runs)
    write_table(path, names, ((row[name] for name in names) for row in rows), "{:.6g}".format)


def write_runs(folder: Path, runs: tuple[Any, ...], metrics: Mapping[str, Any], first: Any) -> None:
    """runs.csv, metrics.json and log/ in `folder`."""
    write_scores(folder / "runs.csv", COLUMNS, runs)
    write_json(folder / "metrics.json", plain(dict(metrics)))
    write_mrclam(folder / "log", recording(first))


def recording(first: Any) -> TeamRecording:
    """A run as rows of a team's log: `map` replays it.

    The field's robots drive straight and then turn within each period, so a period becomes two rows: twice the speed
    for its first half, twice the turn rate for its second.
    """
    M, n = len(first.robots), len(first.world.landmarks)
    codes = {k + 1: 101 + k for k in range(M + n)}
    moments = [first.first_look, *first.moments]
    robots = []
    for j in range(M):
        rows, stamps, barcodes, seen, truth = [], [], [], [], []
        for moment in moments:
            t = moment.step * first.period
            if moment.step:
                v, w = moment.commands[j]
                rows += [(t - first.period, 2 * v, 0.0), (t - 0.5 * first.period, 0.0, 2 * w)]
            truth.append((t, *moment.true_poses[j]))
            sight = moment.sightings[j]
            stamps += [t] * len(sight.z)
            barcodes += [codes[M + 1 + int(name)] for name in sight.ids]
            seen += list(sight.z)
        rows.append((moments[-1].step * first.period, 0.0, 0.0))
        robots.append(
            RobotRecording(
                j + 1,
                np.array(rows),
                np.array(stamps),
                np.array(barcodes, dtype=np.int64),
                np.array(seen).reshape(-1, 2),
                np.array(truth),
            )
        )
    marks = {M + 1 + k: (float(x), float(y)) for k, (x, y) in enumerate(first.world.landmarks)}
    return TeamRecording(codes, marks, tuple(robots))


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
        if len(track.t):  # none of a robot that was not found in the map
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
