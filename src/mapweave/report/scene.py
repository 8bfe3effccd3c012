"""The map of a page as something to move about in: layers, ellipses, what a thing is, where robots were when.

It needs no network: the data and the script are inside the page, and without scripts a picture stands in its place.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
from io import BytesIO
from typing import cast

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image

from ..core.gaussian import ellipse
from ..core.names import robot_key
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..team.team_map import TeamMap
from .style import LANDMARK

MOST_POSES = 800  # of a trajectory: enough to draw it and to point at
MOST_CELLS = 1600  # along the longer side of a grid: finer cells are joined, a wall stays a wall
INK, PAPER = (27, 31, 36, 255), (255, 255, 255, 255)


@dataclass(slots=True)
class Scene:
    """What is drawn in one frame [m], in layers that can be switched off; `label` says what it is to who cannot see.

    Later points stand on earlier ones; robots on all.
    """

    label: str
    hidden: list[str] = field(default_factory=list)
    _grid: dict[str, object] | None = None
    _tracks: list[dict[str, object]] = field(default_factory=list)
    _points: list[dict[str, object]] = field(default_factory=list)
    _lines: list[dict[str, object]] = field(default_factory=list)
    _corners: list[Float[np.ndarray, "n 2"]] = field(default_factory=list)

    def grid(
        self, layer: str, known: Bool[np.ndarray, "rows columns"], occupied: Bool[np.ndarray, "rows columns"],
        extent: tuple[float, float, float, float],
    ) -> None:  # fmt: skip
        """An occupancy grid, row 0 at the lowest y; extent: x0, x1, y0, y1 [m]."""
        join = max(1, -(-max(known.shape) // MOST_CELLS))
        known, occupied = _joined(known, join), _joined(occupied, join)
        pixels = np.zeros((*known.shape, 4), np.uint8)
        pixels[known] = PAPER
        pixels[occupied] = INK
        file = BytesIO()
        Image.fromarray(pixels[::-1]).quantize(4).save(file, "PNG", optimize=True)
        png = "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
        x0, x1, y0, y1 = extent
        cell = (x1 - x0) / max(known.shape[1], 1)
        self._grid = {"layer": layer, "png": png, "extent": list(extent), "cell": cell}
        self._corners.append(np.array([[x0, y0], [x1, y1]]))

    def track(self, layer: str, name: str, track: Track, colour: str) -> None:
        """Where a robot was when; with covariances, its 95 % ellipse at the time shown."""
        n = len(track.t)
        if n == 0:
            return
        at = np.unique(np.linspace(0, n - 1, min(n, MOST_POSES)).astype(int))
        pose = track.pose[at]
        self._tracks.append({
            "layer": layer, "name": name, "colour": colour, "t": _short(track.t[at], 2),
            "x": _short(pose[:, 0]), "y": _short(pose[:, 1]), "theta": _short(pose[:, 2]),
            "ellipses": None if track.cov is None else [_ellipse(c[:2, :2]) for c in track.cov[at]],
        })  # fmt: skip
        self._corners.append(pose[:, :2])

    def points(
        self, layer: str, names: Sequence[str], at: Float[np.ndarray, "n 2"], colour: str, texts: Sequence[str],
        cov: Float[np.ndarray, "n 2 2"] | None = None, *, named: bool = True,
    ) -> None:  # fmt: skip
        """Landmarks, robots or surveyed places; cov: for 95 % ellipses; texts: what pointing at one tells."""
        if len(at) == 0:
            return
        self._points.append({
            "layer": layer, "names": list(names), "x": _short(at[:, 0], 4), "y": _short(at[:, 1], 4), "colour": colour,
            "texts": list(texts), "named": named, "ellipses": None if cov is None else [_ellipse(c) for c in cov],
        })  # fmt: skip
        self._corners.append(at)

    def lines(
        self, layer: str, ends: Float[np.ndarray, "n 4"], colour: str, texts: Sequence[str], *, dashed: bool = False
    ) -> None:
        """Segments x0, y0, x1, y1: closures, sightings."""
        if len(ends) == 0:
            return
        segments = [_short(row) for row in ends]
        self._lines.append(
            {"layer": layer, "colour": colour, "segments": segments, "texts": list(texts), "dashed": dashed}
        )
        self._corners += [ends[:, :2], ends[:, 2:]]

    @property
    def empty(self) -> bool:
        return not self._corners

    def data(self) -> Mapping[str, object]:
        """What the script draws."""
        corners = np.concatenate(self._corners) if self._corners else np.zeros((1, 2))
        low, high = corners.min(axis=0), corners.max(axis=0)
        return {
            "label": self.label, "hidden": self.hidden, "extent": _short(np.array([low[0], high[0], low[1], high[1]])),
            "grid": self._grid, "tracks": self._tracks, "points": self._points, "lines": self._lines,
        }  # fmt: skip

    def html(self, caption: str, still: str = "") -> str:
        """A figure for a page that has the script at its end; `still`: what shows where no script runs."""
        data = json.dumps(self.data(), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        how = "Drag to move; click, then wheel or + and − to zoom; point at a thing to read what it is."
        return (
            f'<figure class="scene"><div class="still">{still}</div><script type="application/json">{data}</script>'
            f"<figcaption>{escape(caption)} <span>{how}</span></figcaption></figure>"
        )


def landmark_points(scene: Scene, team: TeamMap, landmarks: LandmarkMap) -> None:
    """The layer of `landmarks` of `team`, each with its ellipse, and who saw it how often."""
    n = len(landmarks)
    blocks = landmarks.cov.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
    texts = []
    for name, (x, y), cov in zip(landmarks.ids, landmarks.mean, blocks, strict=True):
        who = ", ".join(robot_key(r) for r in team.members.get(name, ()))
        seen = f"\nseen {team.sightings[name]} times by {who}" if who and name in team.sightings else ""
        sd = 100 * np.sqrt(np.trace(cov) / 2)
        texts.append(f"landmark {name}\n({x:.3f}, {y:.3f}) m\nsd {sd:.1f} cm an axis{seen}")
    scene.points("landmarks", landmarks.ids, landmarks.mean, LANDMARK, texts, blocks)


@cache
def script() -> str:
    """What makes a page's scenes move."""
    return (files(__package__) / "scene.js").read_text(encoding="utf-8")


def _joined(cells: Bool[np.ndarray, "rows columns"], join: int) -> Bool[np.ndarray, "fewer narrower"]:
    """Squares of `join` x `join` cells as one, true where any is."""
    if join == 1:
        return cells
    rows, columns = (-(-size // join) for size in cells.shape)
    full = np.zeros((rows * join, columns * join), bool)
    full[: cells.shape[0], : cells.shape[1]] = cells
    return cast("np.ndarray", full.reshape(rows, join, columns, join).any(axis=(1, 3)))


def _short(values: Float[np.ndarray, " n"], digits: int = 3) -> list[float]:
    """Millimetres are enough for a page; what is not finite stands at zero."""
    return [round(float(v), digits) for v in np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)]


def _ellipse(cov: Float[np.ndarray, "2 2"]) -> list[float]:
    """Half axes [m] and angle [rad] of the 95 % region."""
    return [round(float(v), 4) for v in ellipse(cov)]
