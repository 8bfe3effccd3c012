"""`compare`: what changed between two laser maps of one place, or which decisions of two runs over one log differ."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.errors import DataError, UsageError
from ..core.names import robot_name
from ..core.paths import checked_arguments, path_of
from ..core.version import __version__
from ..core.workers import Progress, no_progress, one_blas_thread
from ..io.directory import check_target, write_json
from ..laser.laser_map import GridMap
from ..mapping.changes import Change, Changes, cells_at, changes_between
from ..mapping.map_overlap import KeyframeMap
from ..mapping.merge import merge_maps
from ..mapping.merge_search import MergeConfig, Start
from ..mapping.woven_map import WovenMap
from ..report.html import Page
from ..report.laser_figures import walls
from ..report.result import ResultBase, Rows, written
from ..report.scene import Scene
from ..report.style import Target, colour
from .laser_result import LaserResult
from .result import load

KINDS = {"new": (colour(2), "walls that are new"), "gone": (colour(5), "walls that are gone")}
MOST_TOLD = 12  # changes or decisions in the summary
SAID = 0.25  # probability that will do of maps said to be of one place, where things were moved: odds of 27 for 9
DECISION = ("what", "before", "after", "why before", "why after")


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(ResultBase):
    """Two results of one place, or of the same logs.

    metrics: as in `metrics.json`; grid: the map before, in whose frame all is; transform: where the frame of the map
    after lies in it; found: what changed, None of two runs over the same logs; decisions: rows of `DECISION`, those on
    pairs of robots and on places that differ, of two runs over the same logs.
    """

    metrics: dict[str, Any]
    grid: GridMap
    transform: Float[np.ndarray, "3"]
    found: Changes | None
    decisions: tuple[tuple[str, ...], ...] = ()

    @property
    def changes(self) -> tuple[Change, ...]:
        """What changed, the largest first; nothing of two runs over the same logs."""
        return () if self.found is None else self.found.changes

    def lines(self) -> list[str]:
        if self.found is None:
            many = len(self.decisions)
            told = [f"{row[0]}: {row[1]} before, {row[2]} after: {row[4]}" for row in self.decisions]
            return [f"the same logs, {many} decisions differ", *_cut(told)]
        kinds = [c.kind for c in self.changes]
        x, y, turn = self.transform.tolist()
        head = f"{kinds.count('new')} walls are new, {kinds.count('gone')} are gone"
        return [
            f"{head}; {100 * self.found.share:.0f} % of the area is in both maps",
            f"the map after lies at {x:.2f} m, {y:.2f} m, {np.degrees(turn):.1f} degrees in the one before",
            *(
                f"the map {which} is {said} itself, and what is told may be its own mistake"
                for which in ("before", "after")
                if (said := self.metrics[f"verdict_{which}"]) != "good"
            ),
            *_cut([_told(c) for c in self.changes]),
        ]

    def headline(self) -> Rows:
        if not self.changes and not self.decisions:
            return ("what", "how many"), [("changes" if self.found is not None else "decisions that differ", 0)]
        if self.found is None:
            return DECISION, self.decisions
        rows = []
        for c in self.changes:
            (x, y), (wide, deep) = np.round(0.5 * (c.lower + c.upper), 2), np.round(c.upper - c.lower, 2)
            rows.append((c.kind, float(x), float(y), float(wide), float(deep), c.cells, round(c.sd, 3)))
        return ("change", "x [m]", "y [m]", "wide [m]", "deep [m]", "cells", "sd [m]"), rows

    def draw(self, target: Target) -> None:
        """The map before with what is new and what is gone."""
        self._scene().draw(target)

    def _changed(self) -> Mapping[str, Float[np.ndarray, "n 2"]]:
        return {} if self.found is None else {kind: self.found.walls[kind] for kind in KINDS}

    def _scene(self) -> Scene:
        scene = Scene("The map before, with what is new and what is gone")
        walls(scene, self.grid)
        for kind, at in self._changed().items():
            tint, layer = KINDS[kind]
            scene.points(layer, [kind] * len(at), at, tint, [kind] * len(at), named=False)
        return scene

    def write_into(self, folder: Path) -> None:
        """metrics.json, report.html, new.pgm and gone.pgm with their .yaml, as ROS navigation reads a map."""
        write_json(folder / "metrics.json", self.metrics)
        lines = self.lines()
        page = Page("What changed" if self.found is not None else "What was decided otherwise", lines[0] + ".")
        for kind, at in self._changed().items():
            self._layer(at).save(folder / f"{kind}.yaml")
        caption = "Walls of the map before; what is new, and what is gone."
        page.scene(self._scene(), caption, folder / "figures" / "changes.png")
        for line in lines[1 : len(lines) - len(_cut(self.changes))] if self.found is not None else []:
            page.text(line[0].upper() + line[1:] + ".", warn="itself" in line)
        if self.changes or self.decisions:
            page.table(*self.headline())
        page.write(folder / "report.html")

    def _layer(self, at: Float[np.ndarray, "n 2"]) -> GridMap:
        """A map of these places alone: walls there, free floor wherever the map before knows anything."""
        cell, inside = cells_at(self.grid, at)
        wall: Bool[np.ndarray, "rows cols"] = np.zeros(self.grid.shape, dtype=bool)
        wall[tuple(cell[inside].T)] = True
        known = (self.grid.hits > 0) | (self.grid.passes > 0)
        many = 9  # beams: enough for either
        none = np.zeros(self.grid.shape)
        return GridMap(
            self.grid.resolution, self.grid.origin, many * wall, many * (known & ~wall),
            np.zeros((*self.grid.shape, 2)), none, none,
        )  # fmt: skip


@checked_arguments
@one_blas_thread()
def compare(
    before: Path | str | LaserResult,
    after: Path | str | LaserResult,
    out: Path | str | None = None,
    *,
    start: Sequence[float] | None = None,
    force: bool = False,
    on_progress: Progress = no_progress,
) -> Comparison:
    """Tell what changed between two laser maps of one place, or, of the same logs, which decisions differ and why.

    The map of most robots of each is compared. Where one lies in the other is found as `map` finds where robots lie; a
    wall is new or gone where the other map saw free floor, and nothing near it within the uncertainty of both.

    Parameters
    ----------
    before
        A result of `map` or `fuse` from laser logs, made with the graph method, in memory or its folder.
    after
        Another one.
    start
        Where the frame of the map after lies in that of the map before, about, as x, y, theta [m, m, rad]: where rooms
        look alike it decides (it is searched everywhere).

    Raises
    ------
    ReaderError
        For a folder that holds no result, or a damaged one.
    DataError
        For maps neither of which is found in the other.
    UsageError
        For a result that is no laser map of the graph method, or an `out` that cannot be written.

    Examples
    --------
    >>> drive = simulate_laser("drive.mcap", CorridorConfig(distance=4.0), seed=1)
    >>> made = map("drive.mcap", "out")
    >>> compare(made, "out").decisions
    ()
    """
    given = [
        one if isinstance(one, LaserResult) else path_of(one, name, "a folder or a result in memory")
        for one, name in ((before, "before"), (after, "after"))
    ]
    check_target(out, force=force, reads=given)
    first, second = (_read(one, name) for one, name in zip(given, ("before", "after"), strict=True))
    if {m.scan_hash for m in first.maps} == {m.scan_hash for m in second.maps}:
        made = _same_logs(first, second)
    else:
        on_progress("aligning", 0, 1)
        made = _one_place(first, second, _start(start))
        on_progress("aligning", 1, 1)
    return written(made, out, force=force)


def _read(given: Path | LaserResult, name: str) -> LaserResult:
    result = given if isinstance(given, LaserResult) else load(given, LaserResult)
    if not result.components:
        raise UsageError(f"{name}: expected laser maps of the graph method, found none")
    return result


def _start(given: Sequence[float] | None) -> Start | None:
    if given is None:
        return None
    pose = np.asarray(given, dtype=float)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise UsageError(f"start: expected x, y, theta, found {given!r:.60}")
    cfg = MergeConfig()
    return Start(pose, np.array([cfg.start_sd, cfg.start_sd, cfg.start_turn_sd]))


def _one_place(before: LaserResult, after: LaserResult, start: Start | None) -> Comparison:
    one, other = before.components[0], after.components[0]
    cfg = MergeConfig(sure=SAID)
    merge = merge_maps(_keyframes(before, one, "before"), _keyframes(after, other, "after"), cfg, start)
    if merge.transform is None or merge.covariance is None:
        raise DataError(f"the two maps are not found to be of one place: {merge.reason}")
    found = changes_between(one, other, merge.transform, merge.covariance)
    metrics = {
        "version": __version__,
        "same_logs": False,
        "transform": merge.transform.tolist(),
        "alignment": merge.reason,
        "alike": merge.alike,
        "verdict_before": before.verdict,
        "verdict_after": after.verdict,
        "share_compared": found.share,
        "changes": [
            {"kind": c.kind, "lower": c.lower.tolist(), "upper": c.upper.tolist(), "cells": c.cells, "sd": c.sd}
            for c in found.changes
        ],
    }
    return Comparison(metrics, one.grid, merge.transform, found)


def _keyframes(result: LaserResult, woven: WovenMap, name: str) -> KeyframeMap:
    """All keyframes of a component as one map."""
    graphs = {m.robot: m.graph for m in result.maps if m.graph is not None}
    inside = [graphs[robot] for robot in woven.robots]
    points = [g.points[g.rows(k)] for g in inside for k in range(len(g))]
    border = [why or ("another robot" if k == 0 else "") for g in inside for k, why in enumerate(g.border)]
    return KeyframeMap(name, woven.graph.pose, points, border=border)


def _same_logs(before: LaserResult, after: LaserResult) -> Comparison:
    """Robots go by their scans: their names may differ."""
    name = {m.robot: m.scan_hash for m in (*before.maps, *after.maps)}
    called = {m.scan_hash: robot_name(m.robot) for m in before.maps}
    rows: list[tuple[str, ...]] = []
    one, other = (
        {frozenset((name[m.a], name[m.b])): ("one map" if m.merged else "apart", m.reason) for m in result.merges}
        for result in (before, after)
    )
    for pair in one:
        if pair in other and one[pair][0] != other[pair][0]:
            who = " and ".join(sorted(called[h] for h in pair))
            rows.append((who, one[pair][0], other[pair][0], one[pair][1], other[pair][1]))
    here, there = _places(before, name), _places(after, name)
    for key in [*here, *(key for key in there if key not in here)]:
        old, new = here.get(key, ("not tried", "")), there.get(key, ("not tried", ""))
        if old[0] != new[0]:
            ends = ", ".join(f"{called[h]} at {t:.1f} s" for h, t in (key[:2], key[2:]))
            rows.append((ends, old[0], new[0], old[1], new[1]))
    grid = before.components[0].grid
    metrics = {
        "version": __version__,
        "same_logs": True,
        "decisions": [dict(zip(("what", "before", "after", "why_before", "why_after"), r, strict=True)) for r in rows],
    }
    return Comparison(metrics, grid, se2.IDENTITY, None, tuple(rows))


Place = tuple[str, float, str, float]


def _places(result: LaserResult, name: dict[str, str]) -> dict[Place, tuple[str, str]]:
    """Every place tried, and what became of it."""
    rows = (c for woven in result.components for c in woven.closures)
    return {
        (name[c.robot_a], round(c.stamp_a, 3), name[c.robot_b], round(c.stamp_b, 3)): (
            "believed" if c.accepted else "refused",
            c.reason,
        )
        for c in rows
    }


def _told(c: Change) -> str:
    (x, y), (wide, deep) = 0.5 * (c.lower + c.upper), c.upper - c.lower
    return f"{c.kind}: at ({x:.2f}, {y:.2f}) m, {wide:.1f} x {deep:.1f} m, +- {c.sd:.2f} m"


def _cut(lines: Iterable[Any]) -> list[Any]:
    every = list(lines)
    return every if len(every) <= MOST_TOLD else [*every[:MOST_TOLD], f"and {len(every) - MOST_TOLD} more"]
