"""Finished results in the Rerun viewer: walls, landmarks, closures, decisions, and every robot along time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Float

from ..core.gaussian import ellipse
from ..core.records import Track
from ..io.finished import Closures, Finished, FinishedSwarm
from ..landmarks.landmark_map import LandmarkMap

AROUND = np.linspace(0.0, 2 * np.pi, 33)
COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0), (240, 228, 66))
WALLS, NAMES, LINES = (60, 60, 60), (122, 128, 136), (201, 206, 214)
BELIEVED, REFUSED = (0, 158, 115), (213, 94, 0)
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
    for truth, tracks in (("", part.tracks), ("true_", part.true_tracks)):
        for k, (robot, track) in enumerate(tracks.items()):
            colour = COLOURS[k % len(COLOURS)]
            rr.log(f"{name}/{truth}{robot}/way", rr.LineStrips2D([track.pose[:, :2]], colors=[colour]), static=True)
            _show_along_time(f"{name}/{truth}{robot}/now", track, colour)
    if len(part.true_landmarks):
        labels = list(part.true_landmarks.ids)
        rr.log(
            f"{name}/true_landmarks", rr.Points2D(part.true_landmarks.xy, labels=labels, colors=[NAMES]), static=True
        )
    if part.closures is not None:
        _show_closures(f"{name}/closures", part.closures)
    if part.swarm is not None:
        _show_swarm(f"{name}/swarm", part.swarm)
    if part.decisions:
        text = "\n".join(f"- {line}" for line in part.decisions)
        rr.log(f"{name}/decisions", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _show_closures(entity: str, closures: Closures) -> None:
    """Believed and refused ones, each with its reason."""
    for word, colour, those in (
        ("believed", BELIEVED, closures.accepted), ("refused", REFUSED, ~closures.accepted),
    ):  # fmt: skip
        if those.any():
            strips = closures.ends[those].reshape(-1, 2, 2)
            labels = [reason for reason, here in zip(closures.reasons, those, strict=True) if here]
            lines = rr.LineStrips2D(strips, colors=[colour], labels=labels, show_labels=False)
            rr.log(f"{entity}/{word}", lines, static=True)


def _show_swarm(entity: str, swarm: FinishedSwarm) -> None:
    """Everybody in the plane or in space, who sighted whom, and robots that move along time."""
    at, flat = swarm.positions.position, swarm.positions.position.shape[1] == 2
    points, strips = (rr.Points2D, rr.LineStrips2D) if flat else (rr.Points3D, rr.LineStrips3D)
    known = np.isfinite(at).all(axis=1)
    colours = [BELIEVED if sure else REFUSED for sure in swarm.positions.localisable[known]]
    labels = [name for name, here in zip(swarm.positions.ids, known, strict=True) if here]
    rr.log(f"{entity}/robots", points(at[known], labels=labels, colors=colours), static=True)
    pairs = swarm.pairs[known[swarm.pairs].all(axis=1)]
    if len(pairs):
        rr.log(f"{entity}/sightings", strips(at[pairs], colors=[LINES]), static=True)
    for k, (name, way) in enumerate(swarm.ways.items()):
        colour = COLOURS[k % len(COLOURS)]
        rr.log(
            rr.new_entity_path([*entity.split("/"), "ways", name]), strips([way.position], colors=[colour]), static=True
        )
        columns = points.columns(positions=way.position, colors=[colour] * len(way.t))
        rr.send_columns(rr.new_entity_path([*entity.split("/"), "now", name]), indexes=[_times(way.t)], columns=columns)


def _show_along_time(entity: str, track: Track, colour: tuple[int, int, int]) -> None:
    """Where the robot is, and where it looks, at every stamp."""
    n = len(track.t)
    ahead = np.column_stack([np.cos(track.pose[:, 2]), np.sin(track.pose[:, 2])])
    columns = rr.Arrows2D.columns(origins=track.pose[:, :2], vectors=0.4 * ahead, colors=[colour] * n)
    rr.send_columns(entity, indexes=[_times(track.t)], columns=columns)


def _times(t: Float[np.ndarray, " n"]) -> rr.TimeColumn:
    return rr.TimeColumn("time", timestamp=t) if t[0] > CALENDAR else rr.TimeColumn("time", duration=t)


def _rings(landmarks: LandmarkMap) -> list[np.ndarray]:
    """The 95 % ellipse of every landmark."""
    rings = []
    for i, mean in enumerate(landmarks.mean):
        a, b, angle = ellipse(landmarks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])
        c, s = np.cos(angle), np.sin(angle)
        rings.append(mean + np.column_stack([a * np.cos(AROUND), b * np.sin(AROUND)]) @ np.array([[c, s], [-s, c]]))
    return rings
