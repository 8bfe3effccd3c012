"""A simulated mixed team as files: one log a laser robot, two tables for all cameras and wheels, the truth beside."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.laser_log import LaserLog
from ..core.records import Track
from .directory import write_json
from .landmark_truth import TABLE
from .mcap import write_mcap
from .table import write_table
from .tum import write_tum

WALLS, CALIBRATION = "walls.csv", "calibration.json"
Row = tuple[float, str, str, float, float]  # t [s], robot, id, range [m] or NaN, bearing [rad]


@dataclass(frozen=True, slots=True)
class TrueTeam:
    """What is true of a team: landmarks by id [m], walls (s, 4) [m], trajectories and calibrations by robot."""

    landmarks: Mapping[str, tuple[float, float]]
    walls: Float[np.ndarray, "s 4"]
    tracks: Mapping[str, Track]
    calibration: Mapping[str, Mapping[str, float]]


def write_mixed_team(
    folder: Path,
    commands: Mapping[str, Float[np.ndarray, "n 3"]],
    sightings: Iterable[Row],
    lasers: Sequence[LaserLog],
    truth: TrueTeam,
) -> None:
    """`folder` holds odometry.csv, sightings.csv (no range where there is none), robotK.mcap and truth/."""
    folder.mkdir(parents=True, exist_ok=True)
    if commands:
        driven = sorted((t, k, v, w) for k, rows in commands.items() for t, v, w in rows.tolist())
        number = ["{:.6f}".format, "{:.6g}".format, "{:.6g}".format, "{:.6g}".format]
        write_table(folder / "odometry.csv", ("t", "robot", "v", "w"), driven, number)
    rows = sorted(sightings, key=lambda row: row[:3])
    number = ["{:.6f}".format] + ["{:.6f}".format] * 4
    write_table(folder / "sightings.csv", ("t", "robot", "id", "range", "bearing"), rows, number)
    for log in lasers:
        write_mcap(folder / f"robot{log.robot}.mcap", log)
    write_truth(folder / "truth", truth)


def write_truth(home: Path, truth: TrueTeam) -> None:
    """`home` holds surveyed landmarks, walls, trajectories and calibrations."""
    home.mkdir()
    write_table(home / TABLE, ("id", "x", "y"), [(name, x, y) for name, (x, y) in truth.landmarks.items()])
    write_table(home / WALLS, ("x0", "y0", "x1", "y1"), truth.walls.tolist())
    for robot, track in truth.tracks.items():
        write_tum(home / f"{robot}.tum", track)
    write_json(
        home / CALIBRATION, {k: {p: {"value": v} for p, v in known.items()} for k, known in truth.calibration.items()}
    )
