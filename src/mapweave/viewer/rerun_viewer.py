"""Finished results in the Rerun viewer: walls, landmarks, and every robot along time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from ..core.gaussian import ellipse
from ..core.records import Track
from ..io.finished import Finished
from ..landmarks.landmark_map import LandmarkMap

AROUND = np.linspace(0.0, 2 * np.pi, 33)
COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0), (240, 228, 66))
WALLS, NAMES = (60, 60, 60), (122, 128, 136)
CALENDAR = 1e8  # [s] stamps from here on are counted since 1970


def show_in_rerun(title: str, parts: Sequence[Finished], save: Path | None = None) -> None:
    """Every component under a name of its own, in a viewer that is started, or in the recording `save`.

    Raises RuntimeError or OSError where the viewer cannot start or the file cannot be written.
    """
    rr.init(title)
    if save is None:
        rr.spawn()
    else:
        rr.save(save)
    for k, part in enumerate(parts, 1):
        _show(f"component_{k}", part)
    if save is not None:
        rr.disconnect()  # the file is whole


def _show(name: str, part: Finished) -> None:
    if part.walls is not None:
        half = 0.5 * part.walls.resolution
        rr.log(f"{name}/walls", rr.Points2D(part.walls.occupied(), colors=[WALLS], radii=half), static=True)
    if part.landmarks is not None and len(part.landmarks):
        at, labels = part.landmarks.mean, list(part.landmarks.ids)
        rr.log(f"{name}/landmarks", rr.Points2D(at, labels=labels, colors=[NAMES], radii=0.03), static=True)
        rr.log(f"{name}/ellipses", rr.LineStrips2D(_rings(part.landmarks), colors=[NAMES]), static=True)
    for k, (robot, track) in enumerate(part.tracks.items()):
        colour = COLOURS[k % len(COLOURS)]
        rr.log(f"{name}/{robot}/way", rr.LineStrips2D([track.pose[:, :2]], colors=[colour]), static=True)
        _show_along_time(f"{name}/{robot}/now", track, colour)


def _show_along_time(entity: str, track: Track, colour: tuple[int, int, int]) -> None:
    """Where the robot is, and where it looks, at every stamp."""
    n = len(track.t)
    ahead = np.column_stack([np.cos(track.pose[:, 2]), np.sin(track.pose[:, 2])])
    time = (
        rr.TimeColumn("time", timestamp=track.t) if track.t[0] > CALENDAR else rr.TimeColumn("time", duration=track.t)
    )
    columns = rr.Arrows2D.columns(origins=track.pose[:, :2], vectors=0.4 * ahead, colors=[colour] * n)
    rr.send_columns(entity, indexes=[time], columns=columns)


def _rings(landmarks: LandmarkMap) -> list[np.ndarray]:
    """The 95 % ellipse of every landmark."""
    rings = []
    for i, mean in enumerate(landmarks.mean):
        a, b, angle = ellipse(landmarks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])
        c, s = np.cos(angle), np.sin(angle)
        rings.append(mean + np.column_stack([a * np.cos(AROUND), b * np.sin(AROUND)]) @ np.array([[c, s], [-s, c]]))
    return rings
