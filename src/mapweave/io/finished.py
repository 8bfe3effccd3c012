"""A finished result as any tool may show it, whichever job wrote it: ways, walls, landmarks, component by component."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core.names import in_order
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from .ros_map import RosMap, read_ros_map
from .team_map import read_landmarks
from .tum import read_track_covariance, read_tum


@dataclass(frozen=True, slots=True)
class Finished:
    """What one component's folder holds, all in its frame `map`.

    tracks: name of the file -> poses, with covariances where they were written; walls, landmarks: None where there are
    none.
    """

    folder: Path
    tracks: Mapping[str, Track]
    walls: RosMap | None
    landmarks: LandmarkMap | None


def read_finished(folder: Path) -> tuple[Finished, ...]:
    """The components of the result in `folder`, that at the top first.

    Raises ReaderError for a file that is damaged.
    """
    parts = sorted((folder / "components").glob("*"), key=lambda p: in_order(p.name))
    return tuple(_part(part) for part in (folder, *parts))


def _part(folder: Path) -> Finished:
    tracks: dict[str, Track] = {}
    for path in sorted((folder / "trajectories").glob("*.tum"), key=lambda p: in_order(p.stem)):
        cov = path.with_suffix(".cov.csv")
        track = read_tum(path)
        tracks[path.stem] = read_track_covariance(cov, track) if cov.exists() else track
    walls, landmarks = folder / "map.yaml", folder / "landmarks.npz"
    return Finished(
        folder,
        tracks,
        read_ros_map(walls) if walls.exists() else None,
        read_landmarks(landmarks) if landmarks.exists() else None,
    )
