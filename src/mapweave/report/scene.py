"""The map of a page as something to move about in: layers, ellipses, what a thing is, where robots were when.

It needs no network: the data and the script are inside the page, and without scripts a picture stands in its place.
"""

import base64
import json
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from jaxtyping import Bool, Float, Int
from PIL import Image

from ..core.findings import Finding
from ..core.gaussian import ellipse
from ..core.names import robot_key
from ..core.records import Track
from ..core.se2 import act, interpolate, inverse
from ..io.web import viewport
from ..landmarks.landmark_map import LandmarkMap
from ..mapping.woven_map import Georeference
from ..team.team_map import TeamMap
from .elements import NOTHING, Html, tag
from .style import (
    LANDMARK,
    MUTED,
    SEQUENTIAL,
    Target,
    as_map,
    colour,
    draw_ellipses,
    draw_lines,
    figure,
    gaps,
    larger,
    legend_beside,
    name_points,
    shades,
)

if TYPE_CHECKING:
    from .style import Axes

MOST_POSES = 800  # of a trajectory: enough to draw it and to point at
MOST_OF_ALL = 40_000  # poses of all trajectories of a page, and lines of a layer: about 3 MB of either
MOST_CELLS = 1600  # along the longer side of a grid: finer cells are joined, a wall stays a wall
MOST_CORNERS = 4000  # of a path that nobody drives
MOST_FIXES = 2000  # of a layer of position fixes, evenly apart
FOUND = "#B25400"  # of findings, seen on white and on black
KINDS = (0, 127, 255)  # grey of what is unknown, free and wall in a grid's picture, which the page colours
LEVELS = 254  # steps of time in which cells become known; one more is never


SHAPES = {"dot": "o", "ring": "o", "star": "*", "cross": "X", "triangle": "^"}  # Matplotlib's markers
CELLS = ("#DBDBDB", "#FFFFFF", "#24292F")  # of unknown, free and wall in a picture
MOST_NAMED = 60  # points of a layer from which names would cover a picture
ELLIPSE_AT_MOST = 1e3  # times the points' span that a half axis is drawn: more looks the same, and takes for ever
WIDER = 0.15  # of its longer side that a picture grows by at most at each, to show ellipses whole
FEW_POINTS = 1500  # up to which each is drawn with its ellipse; of more the colour tells how sure they are

Shape = Literal["dot", "ring", "star", "cross", "triangle"]


@dataclass(slots=True)
class Scene:
    """What is drawn in one frame [m], in layers that can be switched off; `label` says what it is to who cannot see.

    hidden: layers that are off at first; the picture is as large as the others. busy: those that `draw` leaves out too.
    Later points stand on earlier ones; robots on all. axes: what the picture's corner says of its axes; clock: unit of
    the tracks' stamps. What is drawn black is drawn white on a dark page.
    """

    label: str
    hidden: list[str] = field(default_factory=list)
    busy: Sequence[str] = ()
    axes: str = "x, y in m"
    clock: str = "s"
    _grid: dict[str, object] | None = None
    _cells: tuple[Int[np.ndarray, "rows columns"], tuple[float, float, float, float]] | None = None  # of the grid
    _tracks: list[dict[str, Any]] = field(default_factory=list)
    _points: list[dict[str, Any]] = field(default_factory=list)
    _lines: list[dict[str, Any]] = field(default_factory=list)
    _poses: int = 0  # that all trajectories had
    _corners: list[tuple[str, Float[np.ndarray, "n 2"]]] = field(default_factory=list)  # with their layer

    def grid(
        self, layer: str, known: Bool[np.ndarray, "rows columns"], occupied: Bool[np.ndarray, "rows columns"],
        extent: tuple[float, float, float, float], known_at: Float[np.ndarray, "rows columns"] | None = None,
    ) -> None:  # fmt: skip
        """An occupancy grid, row 0 at the lowest y; extent: x0, x1, y0, y1 [m].

        known_at: when each known cell came to be so, on the tracks' clock; cells of no time (NaN) show at its end.
        """
        join = max(1, -(-max(known.shape) // MOST_CELLS))
        known, occupied = _joined(known, join), _joined(occupied, join)
        kind = known.astype(np.uint8)
        kind[occupied] = 2
        self._cells = kind, extent
        picture = Image.fromarray(kind[::-1], "P")
        picture.putpalette(bytes(grey for grey in KINDS for _ in range(3)))
        x0, x1, y0, y1 = extent
        cell = (x1 - x0) / max(known.shape[1], 1)
        png = _png(picture)
        self._grid = {"layer": layer, "png": png, "extent": list(extent), "cell": cell}
        if known_at is not None and np.isfinite(known_at).any():
            begin, end = float(np.nanmin(known_at)), float(np.nanmax(known_at))
            level = np.ceil(LEVELS * (known_at - begin) / max(end - begin, 1e-9))
            earliest = _earliest(np.where(np.isfinite(known_at), level, LEVELS), join).astype(np.uint8)
            self._grid |= {"since": _png(Image.fromarray(earliest[::-1])), "begin": begin, "end": end, "levels": LEVELS}
        self._corners.append((layer, np.array([[x0, y0], [x1, y1]])))

    def path(self, layer: str, at: Float[np.ndarray, "n 2"], colour: str) -> None:
        """A line through `at` that no robot drives along: always there, whatever the time shown."""
        if len(at):
            at = at[np.unique(np.linspace(0, len(at) - 1, min(len(at), MOST_CORNERS)).astype(int))]
            self._tracks.append(
                {"layer": layer, "name": "", "colour": colour, "t": [], "x": _short(at[:, 0]), "y": _short(at[:, 1])}
            )
            self._corners.append((layer, at))

    def track(
        self, layer: str, name: str, track: Track, colour: str, *, heads: bool = True, leaves: bool = False,
        notes: str = "",
    ) -> None:  # fmt: skip
        """Where a robot was when, no line where nothing is known for long; its 95 % ellipse at the time shown.

        heads: whether its heading is known; leaves: whether it is gone after its last pose; notes: what pointing at it
        tells besides.
        """
        n = len(track.t)
        if n == 0:
            return
        at = _spread(n, MOST_POSES)
        pose = track.pose[at]
        self._poses += n
        broken = np.unique(np.searchsorted(at, gaps(track.t)))
        self._tracks.append({
            "layer": layer, "name": name, "colour": colour, "t": _short(track.t[at], 2),
            "x": _short(pose[:, 0]), "y": _short(pose[:, 1]), "theta": _short(pose[:, 2]) if heads else None,
            "leaves": leaves, "notes": notes, "gaps": broken.tolist(),
            "ellipses": None if track.cov is None else [_ellipse(c[:2, :2]) for c in track.cov[at]],
        })  # fmt: skip
        self._corners.append((layer, pose[:, :2]))

    def points(
        self, layer: str, names: Sequence[str], at: Float[np.ndarray, "n 2"], colour: str, texts: Sequence[str] = (),
        cov: Float[np.ndarray, "n 2 2"] | None = None, *, named: bool = True, shape: Shape = "dot", stray: bool = False,
        sd: Float[np.ndarray, " n"] | None = None, since: Sequence[float | None] = (),
    ) -> None:  # fmt: skip
        """Landmarks, robots or surveyed places; cov: for 95 % ellipses; texts: what pointing at one tells.

        Without texts it tells name, place and `sd` [m], where that is known. stray: they may lie anywhere, and what is
        shown at first need not hold them. since: when each came to be known, on the tracks' clock; all from the
        beginning where nothing is told, and those of None.
        """
        if len(at) == 0:
            return
        self._points.append({
            "layer": layer, "names": list(names), "x": _short(at[:, 0], 4), "y": _short(at[:, 1], 4), "colour": colour,
            "texts": list(texts), "named": named, "shape": shape,
            "sd": None if sd is None else [round(float(v), 4) if np.isfinite(v) else None for v in sd],
            "ellipses": None if cov is None else [_ellipse(c) for c in cov],
            "since": [None if t is None else round(float(t), 2) for t in since] or None,
        })  # fmt: skip
        if not stray:
            self._corners.append((layer, at))

    def lines(
        self,
        layer: str,
        ends: Float[np.ndarray, "n 4"],
        colour: str,
        texts: Sequence[str] = (),
        *,
        dashed: bool = False,
        ids: Sequence[int] = (),
    ) -> None:
        """Segments x0, y0, x1, y1: closures, sightings; texts: what pointing at their middles tells, if anything.

        ids: what an editor's page calls each.
        """
        if len(ends) == 0:
            return
        segments = [_short(row) for row in ends]
        line = {"layer": layer, "colour": colour, "segments": segments, "texts": list(texts), "dashed": dashed}
        self._lines.append({**line, "ids": list(ids)} if len(ids) else line)
        self._corners += [(layer, ends[:, :2]), (layer, ends[:, 2:])]

    def findings(self, findings: Iterable[Finding], tracks: Mapping[str, Track]) -> None:
        """What was found at some time stands where its robot was in the middle of it. tracks: robot -> where it was."""
        placed = [(f, tracks[f.robot], sum(f.span) / 2) for f in findings if f.span and f.robot and f.robot in tracks]
        inside = [(f, track, t) for f, track, t in placed if len(track.t) and track.t[0] <= t <= track.t[-1]]
        if inside:
            at = np.array([interpolate(np.array([t]), track.t, track.pose)[0, :2] for _, track, t in inside])
            texts = [f"{f.severity}: {f.told}" for f, _, _ in inside]
            self.points("findings", [f.code for f, _, _ in inside], at, FOUND, texts, named=False, shape="triangle")

    @property
    def empty(self) -> bool:
        return not self._corners

    def _extent(self, hidden: Container[str]) -> Float[np.ndarray, "4"]:
        """x0, x1, y0, y1 of all that is not hidden [m]."""
        shown = [at for layer, at in self._corners if layer not in hidden] or [at for _, at in self._corners]
        corners = np.concatenate(shown) if shown else np.zeros((1, 2))
        return np.stack([corners.min(axis=0), corners.max(axis=0)], axis=1).ravel()

    def data(self) -> Mapping[str, object]:
        """What the script draws: of many trajectories fewer poses each, of very many lines a part, spread evenly."""
        driven = sum(len(track["t"]) > 0 for track in self._tracks)
        tracks = [_fewer_poses(track, MOST_OF_ALL // driven) if track["t"] else track for track in self._tracks]
        return {
            "label": self.label, "hidden": self.hidden, "axes": self.axes, "clock": self.clock,
            "extent": _short(self._extent(self.hidden)), "grid": self._grid,
            "tracks": tracks, "points": self._points, "lines": [_fewer_lines(one) for one in self._lines],
        }  # fmt: skip

    def _left_out(self, data: Mapping[str, Any]) -> str:
        """In words, how much of what there is stands on the page, where that is not all."""
        counts = [("poses", sum(len(track["t"]) for track in data["tracks"]), self._poses)]
        pairs = zip(data["lines"], self._lines, strict=True)
        counts += [(line["layer"], len(line["segments"]), len(whole["segments"])) for line, whole in pairs]
        told = [f"{shown:,} of {there:,} {name}" for name, shown, there in counts if shown < there]
        return f" Shown: {', '.join(told)}." if told else ""

    def draw(self, target: Target, *beside: "Scene", hidden: Sequence[str] | None = None) -> None:
        """The scene as a picture, at its last moment, and others beside it; hidden: in place of their own."""
        scenes = (self, *beside)
        left = [[*s.hidden, *s.busy] if hidden is None else hidden for s in scenes]
        x0, x1, y0, y1 = self._extent(left[0])
        tall = float(np.clip((y1 - y0) / max(x1 - x0, 1e-9), 0.3, 1.1))
        wide = 8.4 if len(scenes) == 1 else 6.0
        with figure(target, wide * len(scenes), wide * tall + 1.0, ncols=len(scenes), squeeze=False) as (_, axes):
            for ax, scene, off in zip(axes[0], scenes, left, strict=True):
                scene._draw_on(ax, off)  # noqa: SLF001  (one of our own)

    def _draw_on(self, ax: "Axes", hidden: Container[str]) -> None:
        x0, x1, y0, y1 = self._extent(hidden)
        room = 0.04 * max(x1 - x0, y1 - y0, 1e-9)
        ax.set(xlim=(x0 - room, x1 + room), ylim=(y0 - room, y1 + room))
        if self._cells is not None:
            kind, extent = self._cells
            look: Any = {"extent": extent, "origin": "lower", "interpolation": "nearest", "zorder": 0}
            ax.imshow(kind, shades(CELLS), vmin=0, vmax=2, **look)
            ax.grid(visible=False)
        for one in (line for line in self._lines if line["layer"] not in hidden):
            ends, dash = np.reshape(one["segments"], (-1, 2, 2)), ":" if one["dashed"] else "-"
            draw_lines(ax, ends, one["colour"], 0.8, linestyles=dash, label=one["layer"])
        for one in (track for track in self._tracks if track["layer"] not in hidden):
            way = np.column_stack([one["x"], one["y"]])
            if one["t"]:
                ax.plot(*way[0], "o", color=one["colour"], mfc="white", ms=6, zorder=4)
                ax.plot(*way[-1], "s", color=one["colour"], mec="white", ms=7, zorder=4)
                way = np.insert(way, one["gaps"], np.nan, axis=0)
            ax.plot(*way.T, "-" if one["t"] else "--", color=one["colour"], lw=1.3, label=one["layer"])
        for one in (points for points in self._points if points["layer"] not in hidden):
            self._draw_points(ax, one)
        first, second, unit = re.split(r",? ", self.axes, maxsplit=2)
        as_map(ax, self.label)
        ax.set_aspect("equal", adjustable="box")
        ax.set(xlabel=f"{first} [{unit.removeprefix('in ')}]", ylabel=f"{second} [{unit.removeprefix('in ')}]")
        legend_beside(ax, 20)

    def _draw_points(self, ax: "Axes", one: Mapping[str, Any]) -> None:
        at, sd, tint = np.column_stack([one["x"], one["y"]]), one["sd"], one["colour"]
        if len(at) > FEW_POINTS and sd is not None:
            shade = [np.nan if v is None else v for v in sd]
            drawn = ax.scatter(at[:, 0], at[:, 1], 3.0, shade, cmap=SEQUENTIAL, label=one["layer"])
            ax.figure.colorbar(drawn, ax=ax, label="standard deviation [m]", shrink=0.6)
            return
        size, fill = float(np.clip(40.0 / np.sqrt(len(at)), 2.0, 5.0)), "none" if one["shape"] == "ring" else tint
        ax.plot(*at.T, SHAPES[one["shape"]], color=tint, mfc=fill, ms=size, ls="none", label=one["layer"], zorder=5)
        if one["ellipses"] is not None:
            a, b, angle = np.array(one["ellipses"]).T
            span = float(np.ptp(at, axis=0).max())
            grow = larger(float(np.median(a)), span * min(0.035, 0.15 / np.sqrt(len(at))))
            a, b = (np.minimum(axis, ELLIPSE_AT_MOST * span) for axis in (a, b)) if span else (a, b)
            look: Any = {"facecolors": "none", "edgecolors": tint, "linewidths": 0.8, "zorder": 3}
            draw_ellipses(ax, at, grow * np.array([a, b]), angle, **look)
            c, s = np.cos(angle), np.sin(angle)
            reach = grow * np.column_stack([np.hypot(a * c, b * s), np.hypot(a * s, b * c)])
            _widen(ax, (at - reach).min(axis=0), (at + reach).max(axis=0))
            if grow > 1:
                ax.plot([], [], " ", label=f"95 % ellipses {grow} times larger")
        if one["named"] and len(at) <= MOST_NAMED:
            name_points(ax, one["names"], at)

    def html(self, caption: str, still: Html = NOTHING) -> Html:
        """A figure for a page that has the script at its end; `still`: what shows where no script runs."""
        held = self.data()
        data = json.dumps(held, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        how = (
            "Drag to move; click, then wheel or + and − to zoom, 0 for all, m to measure, f for the whole screen; "
            "point at a thing to read what it is."
        )
        told = tag("figcaption", caption, self._left_out(held), " ", tag("span", how))
        shown = tag("script", Html(data), type="application/json")
        return tag("figure", tag("div", still, class_="still"), shown, told, class_="scene")


def _spread(n: int, most: int) -> Int[np.ndarray, " m"]:
    """Places of `n` things, `most` at most, evenly apart, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, max(most, 2))).astype(int))


def _fewer_poses(track: dict[str, Any], most: int) -> dict[str, Any]:
    at = _spread(len(track["t"]), most)
    columns = {name: [track[name][i] for i in at] for name in ("t", "x", "y", "theta", "ellipses") if track[name]}
    return {**track, **columns, "gaps": np.unique(np.searchsorted(at, np.array(track["gaps"], int))).tolist()}


def _fewer_lines(line: dict[str, Any]) -> dict[str, Any]:
    """An editor's are left whole: each can be decided on."""
    if line.get("ids") or len(line["segments"]) <= MOST_OF_ALL:
        return line
    at = _spread(len(line["segments"]), MOST_OF_ALL)
    return {**line, **{name: [line[name][i] for i in at] for name in ("segments", "texts") if line[name]}}


def _widen(ax: "Axes", low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> None:
    """The axes show what lies from `low` to `high` too, as far as they need not grow by much."""
    start, end = np.array([ax.get_xlim(), ax.get_ylim()]).T
    room, most = 0.01 * (end - start).max(), WIDER * (end - start).max()
    start = np.maximum(np.minimum(start, low - room), start - most)
    end = np.minimum(np.maximum(end, high + room), end + most)
    ax.set(xlim=(start[0], end[0]), ylim=(start[1], end[1]))


def landmark_points(scene: Scene, team: TeamMap, landmarks: LandmarkMap) -> None:
    """The layer of `landmarks` of `team`, each with its ellipse, who saw it how often, from when it was first seen."""
    n = len(landmarks)
    blocks = landmarks.cov.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
    texts = []
    for name, (x, y), cov in zip(landmarks.ids, landmarks.mean, blocks, strict=True):
        who = ", ".join(robot_key(r) for r in team.members.get(name, ()))
        seen = f"\nseen {team.sightings[name]} times by {who}" if who and name in team.sightings else ""
        sd = 100 * np.sqrt(np.trace(cov) / 2)
        texts.append(f"landmark {name}\n({x:.3f}, {y:.3f}) m\nsd {sd:.1f} cm an axis{seen}")
    since = [team.first_seen.get(name) for name in landmarks.ids]
    scene.points("landmarks", landmarks.ids, landmarks.mean, LANDMARK, texts, blocks, since=since)


def fix_points(scene: Scene, g: Georeference) -> None:
    """The layers of position fixes, those used and those that were not, where they lie in the map."""
    at = np.asarray(act(inverse(g.T_world_map), g.z))
    for used, layer in ((True, "fixes"), (False, "fixes not used")):
        rows = np.flatnonzero(g.used == used)
        rows = rows[_spread(len(rows), MOST_FIXES)] if len(rows) else rows
        off = np.hypot(*g.residual[rows].T)
        whose = [robot_key(g.robots[k]) for k in g.owner[rows].tolist()]
        texts = [f"fix of robot {r}\n{d:.2f} m off" for r, d in zip(whose, off.tolist(), strict=True)]
        scene.points(
            layer,
            whose,
            at[rows],
            MUTED if used else colour(5),
            texts,
            named=False,
            stray=not used,
            since=g.t[rows].tolist(),
        )


@cache
def script() -> str:
    """What makes a page's scenes move."""
    return viewport() + (files(__package__) / "scene.js").read_text(encoding="utf-8")


def _png(image: Image.Image) -> str:
    file = BytesIO()
    image.save(file, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")


def _earliest(level: Float[np.ndarray, "rows columns"], join: int) -> Float[np.ndarray, "fewer narrower"]:
    """The least of every square of `join` x `join` cells."""
    if join == 1:
        return level
    rows, columns = (-(-size // join) for size in level.shape)
    full = np.full((rows * join, columns * join), float(LEVELS))
    full[: level.shape[0], : level.shape[1]] = level
    return cast("np.ndarray", full.reshape(rows, join, columns, join).min(axis=(1, 3)))


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
