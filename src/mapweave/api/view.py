"""A result in the browser: looked at, or decided on by hand; and its map in the Rerun viewer."""

import hashlib
import json
import os
import pickle
import sys
import webbrowser
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import mkdtemp
from threading import Event, Lock
from time import perf_counter
from typing import Any

import numpy as np

from ..core import se2
from ..core.errors import EstimateError, ReaderError, UsageError
from ..core.names import robot_name
from ..core.paths import checked_arguments, is_path, path_of
from ..core.rows import spread
from ..core.workers import one_blas_thread
from ..io.decisions import LARGEST, NAME, decisions_text, expect_of, read_decisions
from ..io.directory import check_target, result_file
from ..io.finished import read_finished
from ..io.saved_result import expect_whole
from ..io.team_map import read_metrics
from ..io.web import Answer, served_pages
from ..mapping.decisions import CELLS, TOGETHER, UNDECIDED, WORDS, PairRow, PlaceRow
from ..mapping.woven_map import WovenMap
from ..report.laser_figures import laser_scene
from ..report.result import ResultBase, written
from ..report.small_pages import editing_page
from ..report.woven import robot_colour, told_component
from .in_memory import result_folder
from .laser_result import LaserResult, woven_result
from .result import load


@checked_arguments
def view(
    directory: Path | str | ResultBase, *, browser: bool = True, rerun: bool = False, save: Path | str | None = None
) -> list[str]:
    """Open the report of a result in the browser, or its map in the Rerun viewer; returns what was done, a line each.

    Parameters
    ----------
    directory
        The result of any job, in memory or its folder. The report of one in memory is written to a folder among the
        system's temporary ones, which stays: a browser may ask for it long after.
    browser
        Open the report, unless there is no display (True).
    rerun
        Show walls, landmarks, closures, decisions and robots along time in the Rerun viewer (False): the extra
        `[viewer]`.
    save
        Write what Rerun would show to this .rrd file instead (nothing).

    Raises
    ------
    ReaderError
        Where `directory` holds no result, or a damaged one.
    UsageError
        Where Rerun is asked for and not installed, or has nothing to show.
    EstimateError
        Where the viewer cannot start.
    """
    if rerun or save is not None:
        with result_folder(directory, "directory") as folder:
            if is_path(directory):
                expect_whole(folder)
            read_metrics(folder)
            return [_in_rerun(folder, None if save is None else Path(save))]
    if isinstance(directory, ResultBase):
        folder = Path(mkdtemp(prefix="mapweave-")) / "result"
        directory.write(folder)
    else:
        folder = path_of(directory, "directory", "a folder or a result in memory")
        expect_whole(folder)
    read_metrics(folder)
    report = folder / "report.html"
    if not report.is_file():
        raise ReaderError(folder, "expected report.html, found none")
    if not (browser and _has_display()):
        return [f"report: {report}"]
    webbrowser.open(report.resolve().as_uri())
    return [f"opened {report}"]


def _in_rerun(folder: Path, save: Path | None) -> str:
    if find_spec("rerun") is None:
        raise UsageError("--rerun: the viewer is not installed: install mapweave with the extra [viewer]")
    parts = read_finished(folder)
    if all(part.empty for part in parts):
        raise UsageError(f"{folder}: expected trajectories, walls, landmarks or positions to show, found none")
    if save is None and not _has_display():
        raise EstimateError("--rerun: no display to open the viewer on; --save FILE.rrd writes what it would show")
    from ..viewer import show_in_rerun  # noqa: PLC0415  (an extra)

    try:
        show_in_rerun(folder.resolve().name, parts, save)
    except (RuntimeError, OSError) as error:
        raise EstimateError(f"the Rerun viewer: {error}") from None
    return "opened the map in Rerun" if save is None else f"wrote {save}"


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


UNTURNED = 1e-6  # [rad] by which the first robot's map may be turned in its part for a rectangle to stay one
OUTLINE = 3000  # points of a map that is laid on another by hand
Row = dict[str, Any]
Say = Callable[[str], None]


@checked_arguments
def edit(
    directory: Path | str,
    *,
    out: Path | str | None = None,
    decisions: Path | str | None = None,
    port: int = 8643,
    browser: bool = False,
    stop: Event | None = None,
    say: Say = print,
) -> None:
    """Serve the map of a laser result on this machine until `stop` is set: to decide on places and robots by hand.

    A click on a place believes or forbids it, two robots are said to be one map or not, a map is dragged onto another.
    Each time all is solved again from the graph that the result holds. What is saved are decisions, which `map` takes
    with the same logs, to the same result. What is not saved when it ends is saved then, and told.

    Parameters
    ----------
    directory
        What `map` or `fuse` wrote of laser logs, mapped with the graph method.
    out
        Where saving writes the whole result too (nowhere).
    decisions
        The file that saving writes decisions to (decisions.toml of the result); editing goes on from what it holds,
        where it is there already, else from those in the result's own. Where somebody else wrote it since, or it cannot
        be written at the end, decisions are kept in another file, and which is told.
    port
        Where the page stands (8643); 0 is any that is free.
    browser
        Open it in a browser.
    say
        Called with a line that names the address, and one that names the file of what was saved at the end.

    Raises
    ------
    ReaderError
        Where `directory` holds no result, or a damaged one.
    UsageError
        For a result that has no graph to decide on, a port that is taken, or an `out` that cannot be written.
    """
    folder = Path(directory)
    check_target(out, reads=(folder,))
    file = folder / NAME if decisions is None else Path(decisions)
    editor = Editor(folder, file, None if out is None else Path(out))
    page = editing_page(f"Decide on {folder.resolve().name}").encode()
    gets: dict[str, Answer] = {
        "/": lambda asked: asked.whole("text/html; charset=utf-8", page),
        "/state.json": lambda asked: asked.whole("application/json", json.dumps(editor.state({})).encode()),
    }
    posts = {"/state": editor.state, "/decide": editor.decide, "/undo": editor.undo, "/save": editor.save}
    with served_pages("127.0.0.1", port, gets, posts) as address:
        say(f"{folder}: {address}")
        if browser:
            webbrowser.open(address)
        try:
            (stop or Event()).wait()
        finally:
            kept = editor.keep()
            if kept is not None:
                say(f"saved what was not: mapweave edit {folder} --decisions {kept} goes on from there")


@dataclass(slots=True)
class Editor:
    """A laser result and what is said of it: `result` is always what `map` makes of the logs with these decisions.

    folder: of the result; file: where decisions are saved; out: where the whole result is, or None. rows: by what each
    is about, those that somebody says something of; past: earlier ones, for undoing.
    """

    folder: Path
    file: Path
    out: Path | None = None
    result: LaserResult = field(init=False)
    rows: dict[tuple[Any, ...], Row] = field(default_factory=dict)
    past: list[dict[tuple[Any, ...], Row]] = field(default_factory=list)
    seconds: float = 0.0
    saved: bool = True
    _stood: bytes | None = None  # in the file, as it was last read or written here
    _lock: Any = field(default_factory=Lock)
    _pairs: "Remembering" = field(default_factory=lambda: Remembering())  # noqa: PLW0108  (it stands below)

    def __post_init__(self) -> None:
        self.result = load(self.folder, LaserResult)
        if self.result.config is None or not self.result.components:
            raise UsageError(f"{self.folder}: expected laser maps of the graph method, found none")
        self._stood = self._stands()
        begun = self.file if self.file.is_file() else self.folder / NAME
        if begun.is_file():
            said = read_decisions(begun)
            edited: list[PairRow | PlaceRow] = [row for row in said.pairs if row.edited]
            edited += [row for row in said.places if row.edited]
            self.rows = {_key(row): row for row in ({**asdict(mask), "box": list(mask.box)} for mask in said.masks)}
            for row in edited:
                held = {name: value for name, value in asdict(row).items() if value not in {None, ""}}
                self.rows[_key(held)] = held | ({"pose": list(row.pose)} if row.pose is not None else {})
            expect_of(said, self.result.maps, begun)
        if self.rows:
            self._solve(self.rows)
        said_so_far = list(self.rows.items())
        self.past = [dict(said_so_far[:n]) for n in range(len(said_so_far))]

    def state(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """What the page shows: one part of the result as a scene, every part's outline, pairs and places."""
        parts = self.result.components
        part = _number(asked.get("part", 0), len(parts), "part")
        woven = parts[part]
        places = {m.robot: k for k, m in enumerate(self.result.maps)}
        colours = {robot: robot_colour(places[robot]) for robot in woven.robots}
        scene = laser_scene(
            woven.grid, woven.tracks, colours, woven.closures, {}, self.result.findings, edited=True
        ).data()
        return {
            "scene": scene,
            "part": part,
            "parts": [told_component(one) for one in parts],
            "names": [[robot_name(robot) for robot in one.robots] for one in parts],
            "outlines": [_outline(one) for one in parts],
            "places": [self._place(woven, k) for k in range(len(woven.closures))],
            "pairs": [
                {
                    "robots": [m.a, m.b],
                    "names": [robot_name(m.a), robot_name(m.b)],
                    "merged": m.merged,
                    "reason": m.reason,
                    "said": m.said,
                }
                for m in self.result.merges
            ],
            "edition": self.edition,
            "said": len(self.rows),
            "undo": len(self.past),
            "saved": self.saved,
            "seconds": self.seconds,
            "verdict": self.result.verdict,
            "findings": [f.told for f in self.result.findings if f.severity != "note"],
        }

    def _place(self, woven: WovenMap, k: int) -> dict[str, Any]:
        c = woven.closures[k]
        row = self.rows.get((c.robot_a, c.stamp_a, c.robot_b, c.stamp_b))
        return {
            "names": [robot_name(c.robot_a), robot_name(c.robot_b)],
            "stamps": [c.stamp_a, c.stamp_b],
            "accepted": c.accepted,
            "reason": c.reason,
            "score": c.score,
            "second": c.second,
            "sd": None if c.nis is None else float(np.sqrt(c.nis)),
            "said": "" if row is None else row["decision"],
        }

    def decide(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """The state once something more is said: of a place, of a pair of robots, or where a map lies on another.

        asked: `place`, its number in `part`, or `pair`, two robots, each with `decision`; or `lay`, the part that lies
        on `part` at `pose`, x, y, theta of its frame; or `box`, x0, y0, x1, y1 there, and what its `cells` are to be.
        Where the page shows another `edition` than that of now nothing is decided: its numbers mean other places.
        """
        with self._lock:
            if self._stale(asked):
                return self._now(asked) | {"stale": True}
            row = self._row(asked)
            rows = dict(self.rows)
            rows.pop(_key(row), None)
            if row.get("decision") != UNDECIDED:
                rows[_key(row)] = row
            self._solve(rows)
            self.past.append(self.rows)
            self.rows, self.saved = rows, False
            return self._now(asked)

    def undo(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """The state before the last decision."""
        with self._lock:
            if self._stale(asked):
                return self._now(asked) | {"stale": True}
            if not self.past:
                raise UsageError("there is nothing to undo")
            self._solve(self.past[-1])
            self.rows, self.saved = self.past.pop(), False
            return self._now(asked)

    @property
    def edition(self) -> str:
        """What is said, in short: a page that shows another one numbers other places."""
        return hashlib.sha256(repr(self.rows).encode()).hexdigest()[:16]

    def _stale(self, asked: Mapping[str, Any]) -> bool:
        """Whether the page shows another edition. Raises UsageError where it asks of a part that is not there."""
        stale = bool(asked.get("edition", self.edition) != self.edition)
        if not stale:
            _number(asked.get("part", 0), len(self.result.components), "part")
        return stale

    def _now(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """The state, of the part that is shown where it is there still."""
        part = asked.get("part", 0)
        return self.state({"part": part if type(part) is int and 0 <= part < len(self.result.components) else 0})

    def save(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """The decisions are in their file and, where asked for, the result in its folder; tells where."""
        del asked
        with self._lock:
            try:
                self._write()
                written(self.result, self.out)
            except OSError as error:
                raise UsageError(f"{error.filename}: {error.strerror}") from None
            self.saved = True
        return {"file": str(self.file), "out": None if self.out is None else str(self.out)}

    def keep(self) -> Path | None:
        """The file of what was decided and not saved, which is in one now; None where all was saved."""
        with self._lock:
            if self.saved:
                return None
            try:
                self._write()
            except OSError:
                self.file = Path(mkdtemp(prefix="mapweave-")) / NAME
                self._write()
            return self.file

    def _write(self) -> None:
        """The decisions are in `file`, which is another beside it where somebody else wrote it since."""
        if self._stands() not in {None, self._stood}:
            self.file = self.file.with_stem(f"{self.file.stem}-{self.edition}")
        with result_file(self.file) as work:
            work.write_text(decisions_text(self.result.maps, self.result.merges, self.result.said), encoding="utf-8")
        self._stood = self._stands()

    def _stands(self) -> bytes | None:
        return self.file.read_bytes() if self.file.is_file() else None

    def _solve(self, rows: Mapping[tuple[Any, ...], Row]) -> None:
        began, old = perf_counter(), self.result
        assert old.config is not None  # noqa: S101  (asked for when it was read)
        tables = {"pairs": "a", "places": "robot_a", "masks": "box"}
        said = {table: [row for row in rows.values() if key in row] for table, key in tables.items()}
        with one_blas_thread():
            self.result = woven_result(
                old.before or old.maps,
                old.config,
                seed=old.metrics["seed"],
                starts=old.starts,
                merge=bool(old.merges) or len(old.maps) == 1,
                findings=[found for found in old.whole if found.code == "log-twice"],
                notes=old.notes,
                executor=self._pairs,
                decisions=said if rows else None,
            )
        self.seconds = perf_counter() - began

    def _row(self, asked: Mapping[str, Any]) -> Row:
        """What is said, as a row of the file."""
        parts = self.result.components
        part = _number(asked.get("part", 0), len(parts), "part")
        if "lay" in asked:
            other = parts[_number(asked["lay"], len(parts), "lay")]
            return self._laid(parts[part], other, _numbers(asked.get("pose"), "pose", "x, y, theta"))
        if "box" in asked:
            return self._mask(parts[part], asked["box"], asked.get("cells"))
        decision = asked.get("decision")
        if decision not in WORDS:
            raise UsageError(f"decision: expected one of {', '.join(WORDS)}, found {decision!r:.40}")
        if "place" in asked:
            c = parts[part].closures[_number(asked["place"], len(parts[part].closures), "place")]
            pose = [round(v, 6) + 0.0 for v in c.measured.tolist()]
            ends = {"robot_a": c.robot_a, "stamp_a": c.stamp_a, "robot_b": c.robot_b, "stamp_b": c.stamp_b}
            return {**ends, "decision": decision, "pose": pose}
        pair = asked.get("pair")
        merge = next((m for m in self.result.merges if [m.a, m.b] == pair), None)
        if merge is None:
            raise UsageError(f"expected a place or a pair of robots, found {pair!r:.40}")
        row: Row = {"a": merge.a, "b": merge.b, "decision": decision}
        found = merge.best if merge.transform is None else merge.transform
        if decision == TOGETHER:
            if found is None:
                raise UsageError("no place of one is found in the other: drag its map to where it lies")
            row["pose"] = [round(v, 6) + 0.0 for v in found.tolist()]
        return row

    def _mask(self, here: WovenMap, box: object, cells: object) -> Row:
        """The row of a rectangle of a part's frame, in the map of its first robot."""
        x0, y0, turn = here.tracks[here.robots[0]].pose[0].tolist()
        given = _numbers(box, "box", "x0, y0, x1, y1") - (x0, y0, x0, y0)
        if cells not in CELLS:
            raise UsageError(f"cells: expected one of {', '.join(CELLS)}, found {cells!r:.40}")
        if abs(turn) > UNTURNED:
            raise UsageError("a map that lies in the world by fixes is turned: write its box into the file by hand")
        return {"robot": here.robots[0], "box": [round(v, 3) + 0.0 for v in given.tolist()], "cells": cells}

    def _laid(self, here: WovenMap, other: WovenMap, pose: np.ndarray) -> Row:
        """The row of the first robots of two parts, the frame of the other of which lies at `pose` in this one's."""
        a, b = here.robots[0], other.robots[0]
        if here is other:
            raise UsageError("lay: expected another map than the one it is laid on")
        laid = se2.compose(pose, other.tracks[b].pose[0])
        between = se2.between(here.tracks[a].pose[0], laid)
        order = [m.robot for m in self.result.maps]
        if order.index(a) > order.index(b):
            a, b, between = b, a, se2.inverse(between)
        return {"a": a, "b": b, "decision": TOGETHER, "pose": [round(v, 6) + 0.0 for v in np.asarray(between).tolist()]}


class Remembering(Executor):
    """Runs a task when its result is asked for, and not again where the same was asked before."""

    def __init__(self) -> None:
        self.known: dict[bytes, Any] = {}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return _Later(self.known, hashlib.sha256(pickle.dumps((fn, args, kwargs))).digest(), fn, args, kwargs)


class _Later(Future[Any]):
    def __init__(self, known: dict[bytes, Any], name: bytes, *task: Any) -> None:
        super().__init__()
        self.known, self.name, self.task = known, name, task

    def result(self, timeout: float | None = None) -> Any:
        del timeout
        if self.name not in self.known:
            fn, args, kwargs = self.task
            self.known[self.name] = fn(*args, **kwargs)
        return self.known[self.name]


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """What a row is about."""
    if "box" in row:
        return (row["robot"], *row["box"])
    names = ("a", "b") if "a" in row else ("robot_a", "stamp_a", "robot_b", "stamp_b")
    return tuple(row[name] for name in names)


def _outline(woven: WovenMap) -> list[list[float]]:
    """Some of the points of a map's walls [m]."""
    cells = woven.grid.cells()[:, :2]
    solid = woven.grid.occupancy()[woven.grid.weight > 0] > 0.5  # a wall, as the map draws it
    cells = cells[solid]
    return [[round(x, 2), round(y, 2)] for x, y in cells[spread(len(cells), OUTLINE)].tolist()]


def _number(given: object, end: int, name: str) -> int:
    if not isinstance(given, int) or isinstance(given, bool) or not 0 <= given < end:
        raise UsageError(f"{name}: expected a number from 0 to {end - 1}, found {given!r:.40}")
    return given


def _numbers(given: object, name: str, told: str) -> np.ndarray:
    numbers = isinstance(given, list) and all(type(v) in {int, float} and abs(v) < LARGEST for v in given)
    if isinstance(given, list) and numbers and len(given) == told.count(",") + 1:
        return np.array(given, dtype=float)
    raise UsageError(f"{name}: expected {told}, found {given!r:.40}")
