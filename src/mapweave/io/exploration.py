"""What an exploration leaves: a row a run, metrics, and the first run's log in the layout `map` reads."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..core.landmark_log import RobotRecording, TeamRecording
from .directory import plain, write_json
from .mrclam import write_mrclam
from .table import write_table

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
