"""What the robots of a landmark log (MRCLAM, or a folder of CSV files) saw of each other, by bearing alone."""

from pathlib import Path

import numpy as np

from ..core.bearings import BearingTable, unit
from ..core.errors import DataError
from ..core.records import Odometry
from .landmark_logs import read_landmark_logs
from .landmark_truth import read_robot_truth
from .sightings import SwarmTruth


def read_team_bearings(path: Path) -> tuple[BearingTable, dict[str, Odometry]]:
    """Stamped sightings of robots by robots, in each observer's own frame, and every robot's odometry, by number.

    Ranges and landmarks are left aside; sigma is not said. Raises DataError when no robot sighted another.
    """
    logs = read_landmark_logs(path)
    ids = tuple(str(log.number) for log in logs)
    place = {f"robot{name}": k for k, name in enumerate(ids)}
    observer, target, bearing, t = [], [], [], []
    for k, log in enumerate(logs):
        seen = log.sightings
        other = np.array([place.get(name, -1) for name in seen.ids], dtype=np.int64)
        rows = other[seen.what] >= 0 if len(seen) else np.zeros(0, dtype=bool)
        observer.append(np.full(int(rows.sum()), k))
        target.append(other[seen.what[rows]])
        bearing.append(seen.bearing[rows])
        t.append(seen.t[rows])
    stamps = np.concatenate(t)
    if not len(stamps):
        raise DataError(f"{path}: no robot sighted another")
    order = np.argsort(stamps, kind="stable")
    table = BearingTable(
        ids,
        np.concatenate(observer)[order],
        np.concatenate(target)[order],
        unit(np.concatenate(bearing)[order]),
        np.full(len(order), np.nan),
        stamps[order],
        axis=False,
    )
    return table, {name: log.odometry for name, log in zip(ids, logs, strict=True) if log.odometry is not None}


def read_team_truth(path: Path) -> SwarmTruth:
    """The true poses of all robots of an MRCLAM data set, by number. Raises DataError when it has none."""
    tracks = read_robot_truth(path)
    if not tracks:
        raise DataError(f"{path}: no true poses of robots here")
    names = [robot.removeprefix("robot") for robot in tracks]
    ids = tuple(name for name, (track, _) in zip(names, tracks.values(), strict=True) for _ in track.t)
    pose = np.concatenate([track.pose for track, _ in tracks.values()])
    return SwarmTruth(ids, pose[:, :2], np.concatenate([track.t for track, _ in tracks.values()]), pose[:, 2])
