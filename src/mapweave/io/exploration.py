"""What an exploration leaves: a row a run, metrics, and the first run's log in the layout `map` reads."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ..core.recording import RobotRecording, TeamRecording
from .directory import plain, write_json
from .mrclam_writer import write_mrclam

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


def write_table(path: Path, rows: list[Mapping[str, Any]]) -> None:
    """`path` as CSV with the contract's columns; numbers to six digits, nothing where a figure does not exist."""
    lines = [",".join(COLUMNS)]
    lines += [",".join(cell(row[name]) for name in COLUMNS) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_runs(folder: Path, runs: tuple[Any, ...], metrics: Mapping[str, Any], first: Any) -> None:
    """runs.csv, metrics.json and log/ in `folder`."""
    write_table(folder / "runs.csv", [asdict(r) for r in runs])
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
                np.array(barcodes),
                np.array(seen).reshape(-1, 2),
                np.array(truth),
            )
        )
    marks = {M + 1 + k: (float(x), float(y)) for k, (x, y) in enumerate(first.world.landmarks)}
    return TeamRecording(codes, marks, tuple(robots))


def cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
