"""A finished result as any tool may show it, whichever job wrote it: trajectories, walls, landmarks, by component."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.errors import ReaderError
from ..core.names import in_order, robot_key, robot_name
from ..core.records import Track
from ..core.truth import NO_SURVEY, Survey
from ..landmarks.landmark_map import LandmarkMap
from ..swarm.moving.result import RobotTrajectory
from .directory import read_json
from .g2o import read_g2o_file
from .landmark_truth import read_robot_truth, read_survey
from .positions import Positions, read_network, read_positions, read_track, track_files
from .ros_map import RosMap, read_ros_map
from .table import Table, read_table
from .team_map import read_landmarks
from .tum import read_result_track


@dataclass(frozen=True, slots=True)
class Closures:
    """Loop closures that were tried, as far as their places are known. ends: (n, 4) x0, y0, x1, y1 [m]."""

    ends: Float[np.ndarray, "n 4"]
    accepted: Bool[np.ndarray, " n"]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FinishedSwarm:
    """A swarm as `locate` wrote it: where everybody is, who sighted whom, and the trajectories of those that move."""

    positions: Positions
    pairs: Int[np.ndarray, "m 2"]
    ways: Mapping[str, RobotTrajectory]


@dataclass(frozen=True, slots=True)
class Finished:
    """What one component's folder holds, all in its frame `map`.

    tracks: robot -> poses, with covariances where they were written; walls, landmarks, closures, swarm: None
    where there are none; decisions: why robots are or are not in the map; true_tracks, true_landmarks: of an
    exploration, whose log is beside.
    """

    folder: Path
    tracks: Mapping[str, Track]
    walls: RosMap | None
    landmarks: LandmarkMap | None
    closures: Closures | None = None
    swarm: FinishedSwarm | None = None
    decisions: tuple[str, ...] = ()
    true_tracks: Mapping[str, Track] = field(default_factory=dict)
    true_landmarks: Survey = NO_SURVEY

    @property
    def empty(self) -> bool:
        """Whether there is nothing in it that has a place."""
        held = (self.walls, self.landmarks, self.swarm)
        return not (self.tracks or self.true_tracks or any(one is not None for one in held))


def read_finished(folder: Path) -> tuple[Finished, ...]:
    """The components of the result in `folder`, that at the top first.

    Raises ReaderError for a file that is damaged.
    """
    parts = sorted((folder / "components").glob("*"), key=lambda p: in_order(p.name))
    return tuple(_part(part) for part in (folder, *parts))


def _part(folder: Path) -> Finished:
    tracks: dict[str, Track] = {}
    home = folder / "trajectories"
    for path in sorted(home.rglob("*.tum"), key=lambda p: in_order(p.as_posix())):
        name = path.relative_to(home).with_suffix("").as_posix()
        tracks[name] = read_result_track(path)
    walls, landmarks, log = folder / "map.yaml", folder / "landmarks.npz", folder / "log"
    truth = {} if tracks or not log.is_dir() else {name: track for name, (track, _) in read_robot_truth(log).items()}
    return Finished(
        folder,
        tracks,
        read_ros_map(walls) if walls.exists() else None,
        read_landmarks(landmarks) if landmarks.exists() else None,
        _closures(folder, tracks),
        _standing(folder),
        _decisions(folder / "metrics.json"),
        truth,
        read_survey(log) if truth else NO_SURVEY,
    )


def _standing(folder: Path) -> FinishedSwarm | None:
    path, network = folder / "positions.csv", folder / "network.npz"
    if not path.exists():
        return None
    positions = read_positions(path)
    files = {name: folder / "trajectories" / file for name, file in track_files(positions.ids).items()}
    ways = {name: read_track(file) for name, file in files.items() if file.exists()}
    n = len(positions.ids)
    pairs = read_network(network, n)[0] if network.exists() else np.zeros((0, 2), np.int64)
    return FinishedSwarm(positions, pairs, ways)


def _closures(folder: Path, tracks: Mapping[str, Track]) -> Closures | None:
    path, graph = folder / "closures.csv", folder / "pose_graph.g2o"
    if not path.exists():
        return None
    table = read_table(path)
    if "stamp_a" in table.columns:
        ends = [_seen_from(tracks, table, end) for end in "ab"]
    else:
        names = ("from", "to") if "from" in table.columns else ("first", "second")
        if not graph.exists() or any(name not in table.columns for name in names):
            return None
        held = read_g2o_file(graph)
        at = dict(zip(held.ids, held.graph.pose[:, :2].tolist(), strict=True))
        ends = [np.array([at.get(k, [np.nan, np.nan]) for k in table.whole(name)]).reshape(-1, 2) for name in names]
    places = np.concatenate(ends, axis=1)
    verdict = table.columns.get("accepted", table.columns.get("used"))
    if verdict is None:
        raise ReaderError(path, f"expected a column accepted, found {','.join(table.columns)}", 1)
    known = np.isfinite(places).all(axis=1)
    accepted = np.array([str(word).strip().lower() in {"1", "true"} for word in verdict], bool)
    reasons = [str(word) for word in table.columns.get("reason", [""] * len(table))]
    return Closures(places[known], accepted[known], tuple(np.array(reasons, dtype=object)[known].tolist()))


def _seen_from(tracks: Mapping[str, Track], table: Table, end: str) -> Float[np.ndarray, "n 2"]:
    """Where the robots of a table's column were at its stamps; NaN for those whose trajectory is not here."""
    out = np.full((len(table), 2), np.nan)
    for k, (robot, stamp) in enumerate(
        zip(table.names(f"robot_{end}"), table.numbers(f"stamp_{end}").tolist(), strict=True)
    ):
        track = tracks.get(robot_name(robot), tracks.get(robot))
        if track is not None and len(track.t):
            out[k] = track.pose[min(int(np.searchsorted(track.t, stamp)), len(track.t) - 1), :2]
    return out


def _decisions(path: Path) -> tuple[str, ...]:
    """Who was merged with whom or not, and why, as `metrics.json` tells it."""
    rows: Any = read_json(path).get("fusion") if path.is_file() else None
    out = []
    for row in rows if isinstance(rows, list) else ():
        if isinstance(row, dict) and isinstance(row.get("reason"), str):
            who = [str(row[key]) for key in ("robot", "a", "b") if key in row]
            out.append(f"{' and '.join(f'robot {robot_key(name)}' for name in who)}: {row['reason']}")
    return tuple(out)
