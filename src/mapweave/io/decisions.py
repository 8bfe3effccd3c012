"""`decisions.toml`: what was decided on pairs of robots and on places, to be edited and given again."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ..core.errors import ReaderError
from ..laser.laser_map import LaserMap
from ..mapping.decisions import APART, CELLS, TOGETHER, WORDS, Decisions, Key, MaskRow, PairRow, PlaceRow, keyframe_at
from ..mapping.merge import Merge

NAME = "decisions.toml"
HEAD = """\
# What was decided. To have the last word, set the `decision` of a row to "together", "apart" or "undecided" (mapweave
# decides), and give the file back: mapweave map LOGS --decisions decisions.toml
# `found` is what the scans say: rows whose decision is the same are left to them. Further rows may be added.
# pose: of the second in the frame of the first, x, y [m] and theta [rad].
# A row of [[masks]] has `robot`, `box` = [x0, y0, x1, y1] [m] in that robot's own map, and `cells`: "free" erases the
# walls there, "unknown" forgets whatever was seen there.
"""
PAIR = {"a": str, "b": str, "decision": str, "found": str, "pose": list}
PLACE = {
    "robot_a": str,
    "stamp_a": float,
    "robot_b": str,
    "stamp_b": float,
    "decision": str,
    "found": str,
    "pose": list,
}
MASK = {"robot": str, "box": list, "cells": str}
MAY = {"found", "pose"}


def decisions_text(maps: Sequence[LaserMap], merges: Sequence[Merge], said: Decisions | None) -> str:
    """What stands in `decisions.toml` of a result. said: the rows that somebody gave, as they were honoured."""
    out = [HEAD, "[logs]"]
    out += [f"{_quoted(m.robot)} = {_quoted(m.scan_hash)}" for m in maps]
    for m in merges:
        found = (TOGETHER if m.scans else APART) if m.said else TOGETHER if m.merged else APART
        out += ["", "[[pairs]]", *_pair(m, said), f"decision = {_quoted(m.said or found)}", f"found = {_quoted(found)}"]
    words: dict[Key, PlaceRow] = {} if said is None else {row.key: row for row in said.places if row.edited}
    for row in _places(maps, merges):
        told = words.get(row.key, row)
        out += ["", "[[places]]", f"robot_a = {_quoted(row.robot_a)}", f"stamp_a = {row.stamp_a!r}"]
        out += [f"robot_b = {_quoted(row.robot_b)}", f"stamp_b = {row.stamp_b!r}"]
        out += (
            [f"decision = {_quoted(told.decision)}", f"found = {_quoted(told.found)}"]
            if told.found
            else [f"decision = {_quoted(told.decision)}"]
        )
        if told.edited and not told.found and told.pose is not None:
            out.append(_exact(told.pose))
        else:
            out += [] if row.pose is None else [_pose(row.pose)]
    for mask in () if said is None else said.masks:
        box = ", ".join(map(repr, mask.box))
        out += ["", "[[masks]]", f"robot = {_quoted(mask.robot)}", f"box = [{box}]", f"cells = {_quoted(mask.cells)}"]
    return "\n".join(out) + "\n"


def _pair(m: Merge, said: Decisions | None) -> list[str]:
    """Which two, and where the second lies: as somebody said it, to the last digit, else as it was found."""
    edited = () if said is None else (row for row in said.pairs if row.edited and {row.a, row.b} == {m.a, m.b})
    word = next((row for row in edited if row.pose is not None and row.decision == m.said), None)
    if word is not None and word.pose is not None:
        return [f"a = {_quoted(word.a)}", f"b = {_quoted(word.b)}", _exact(word.pose)]
    pose = m.best if m.transform is None else m.transform
    return [f"a = {_quoted(m.a)}", f"b = {_quoted(m.b)}", *([] if pose is None else [_pose(pose.tolist())])]


def _places(maps: Sequence[LaserMap], merges: Sequence[Merge]) -> list[PlaceRow]:
    """Every place that was tried: within the robots in their order, then between them."""
    graphs = {m.robot: m.graph for m in maps if m.graph is not None}
    rows = [
        (robot, float(g.t[c.first]), robot, float(g.t[c.second]), c.accepted, c.measured)
        for robot, g in graphs.items()
        for c in g.closures
    ]
    rows += [
        (m.a, float(graphs[m.a].t[c.first]), m.b, float(graphs[m.b].t[c.second]), m.merged and c.accepted, c.measured)
        for m in merges
        if m.a in graphs and m.b in graphs
        for c in m.closures
    ]
    out = []
    for a, s, b, t, accepted, measured in rows:
        word = TOGETHER if accepted else APART
        x, y, theta = measured.tolist()
        out.append(PlaceRow(a, s, b, t, word, word, (x, y, theta)))
    return out


def read_decisions(path: Path) -> Decisions:
    """The rows of a file. Raises ReaderError, with all that is wrong in it, where it is none."""
    try:
        held = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ReaderError(path, f"expected a file of decisions: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ReaderError(path, f"expected TOML: {error}") from None
    except RecursionError:
        raise ReaderError(path, "expected tables and lists, found them nested too deeply to read") from None
    return decisions_of(held, path)


def decisions_of(held: Mapping[str, Any], path: object = "decisions") -> Decisions:
    """The rows of tables as the file holds them. Raises ReaderError with all that is wrong with them."""
    unknown = [name for name in held if name not in {"logs", "pairs", "places", "masks"}]
    wrong = [f"unknown table {name!r}, expected logs, pairs, places or masks" for name in unknown]
    logs = held.get("logs", {})
    if not isinstance(logs, Mapping) or not all(isinstance(v, str) for v in logs.values()):
        wrong.append("logs: expected a text a robot")
        logs = {}
    pairs = tuple(PairRow(**row) for row in _rows(held, "pairs", PAIR, wrong))
    places = tuple(PlaceRow(**row) for row in _rows(held, "places", PLACE, wrong))
    masks = tuple(MaskRow(**row) for row in _rows(held, "masks", MASK, wrong))
    seen: dict[object, str] = {}
    words = [(frozenset({row.a, row.b}), row.decision) for row in pairs]
    for key, decision in (*words, *((row.key, row.decision) for row in places)):
        if seen.setdefault(key, decision) != decision:
            wrong.append(f"two decisions on one pair: {seen[key]} and {decision}")
    wrong += [
        f"a place at {row.stamp_b} s that is added: expected a pose"
        for row in places
        if row.decision == TOGETHER and not row.found and row.pose is None
    ]
    wrong += [f"pairs: robot {row.a} beside itself" for row in pairs if row.a == row.b]
    if wrong:
        more = f"; and {len(wrong) - MOST} more" if len(wrong) > MOST else ""
        raise ReaderError(path, "; ".join(wrong[:MOST]) + more)
    return Decisions(dict(logs), pairs, places, masks)


LARGEST = 1e6  # [m] of a pose or a rectangle
MOST = 10  # mistakes that are told at once


def _rows(held: Mapping[str, Any], table: str, fields: Mapping[str, type], wrong: list[str]) -> list[dict[str, Any]]:
    """The rows of one table that are right; what is wrong with the others is added to `wrong`."""
    rows = held.get(table, [])
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        wrong.append(f"{table}: expected [[{table}]]")
        return []
    out = []
    for k, row in enumerate(rows, 1):
        mistakes = [f"no {name}" for name in fields if name not in row and name not in MAY]
        mistakes += [f"unknown key {name!r}" for name in row if name not in fields]
        mistakes += [m for name, value in row.items() if name in fields and (m := _mistake(name, value, fields[name]))]
        if mistakes:
            wrong += [f"{table} {k}: {m}" for m in mistakes]
            continue
        made = dict(row)
        for name in ("stamp_a", "stamp_b"):
            if name in made:
                made[name] = float(made[name])
        if "pose" in made:
            made["pose"] = tuple(map(float, made["pose"]))
        if "box" in made:
            made["box"] = tuple(map(float, made["box"]))
        out.append(made)
    return out


def _mistake(name: str, value: object, kind: type) -> str:
    if kind is float:
        right = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        return "" if right else f"{name}: expected a stamp in seconds, found {value!r:.40}"
    if kind is list:
        told = "x0, y0, x1, y1" if name == "box" else "x, y, theta"
        many = told.count(",") + 1
        right = isinstance(value, list) and len(value) == many and not any(_mistake(name, v, float) for v in value)
        numbers = right and all(abs(v) < LARGEST for v in cast("list[float]", value))
        return "" if numbers else f"{name}: expected {told}, found {value!r:.40}"
    if not isinstance(value, str):
        return f"{name}: expected a text, found {value!r:.40}"
    known = {"decision": WORDS, "found": (TOGETHER, APART, ""), "cells": CELLS}.get(name)
    return "" if known is None or value in known else f"{name}: expected one of {', '.join(known)}, found {value!r:.40}"


def expect_of(decisions: Decisions, maps: Sequence[LaserMap], path: object) -> None:
    """Raises ReaderError unless the rows are of these robots, and the edited ones of keyframes that they have."""
    there = {m.robot: m for m in maps}
    for robot, digest in decisions.logs.items():
        if robot in there and digest != there[robot].scan_hash:
            raise ReaderError(
                path, f"it is of another result: the scans of robot {robot} are not those of {there[robot].source}"
            )
    edited = [place for place in decisions.places if place.edited]
    named = [robot for row in decisions.pairs if row.edited for robot in (row.a, row.b)]
    named += [robot for place in edited for robot in (place.robot_a, place.robot_b)]
    for robot in (*named, *(mask.robot for mask in decisions.masks)):
        if robot not in there:
            raise ReaderError(path, f"there is no robot {robot} among {', '.join(there)}")
    for mask in decisions.masks:
        left, right, low, high = there[mask.robot].grid.extent
        x, y = sorted(mask.box[::2]), sorted(mask.box[1::2])
        if x[1] < left or x[0] > right or y[1] < low or y[0] > high:
            raise ReaderError(path, f"masks: {list(mask.box)} lies outside the map of robot {mask.robot}")
    for place in edited:
        ends = [(robot, _keyframe(there[robot], t, path)) for robot, t in _ends(place)]
        if ends[0] == ends[1]:
            raise ReaderError(path, f"places: the moment {place.stamp_a} s of robot {place.robot_a} beside itself")


def _ends(place: PlaceRow) -> tuple[tuple[str, float], tuple[str, float]]:
    return (place.robot_a, place.stamp_a), (place.robot_b, place.stamp_b)


def _keyframe(m: LaserMap, t: float, path: object) -> int:
    """The keyframe of a map at `t` [s]. Raises ReaderError where there is none."""
    k = None if m.graph is None else keyframe_at(m.graph, t)
    if k is None:
        raise ReaderError(path, f"robot {m.robot} has no keyframe at {t} s")
    return k


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _exact(pose: Sequence[float]) -> str:
    return f"pose = [{', '.join(repr(float(v)) for v in pose)}]"


def _pose(pose: Sequence[float]) -> str:
    return f"pose = [{', '.join(repr(round(float(v), 6) + 0.0) for v in pose)}]"
