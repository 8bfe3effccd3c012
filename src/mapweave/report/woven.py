"""The part of a laser report that tells how robots are connected, and why two of them do or do not."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..core.names import robot_name
from ..core.records import Track
from ..laser.laser_map import LaserMap
from ..laser.merge import Merge
from ..laser.woven_map import WovenMap
from .html import Page, told_list
from .laser_figures import draw_intensity, laser_scene
from .woven_figures import draw_closures, draw_component, draw_pair, robot_colour, truths_in

MOST_REASONS = 1  # pairs by which the head of the page says why a robot is not in the first map
MOST_PICTURES = 12  # of pairs of robots


def told_merge(merge: Merge) -> str:
    """The decision on a pair of robots, for people."""
    words = merge.reason if merge.merged else f"not merged: {merge.reason}"
    return f"{robot_name(merge.a)} and {robot_name(merge.b)}: {words}"


def told_component(made: WovenMap) -> str:
    """Which robots are connected, for people."""
    x0, x1, y0, y1 = made.grid.extent
    names = [robot_name(r) for r in made.robots]
    who = f"{', '.join(names[:-1])} and {names[-1]} in one map" if len(names) > 1 else f"{names[0]} alone"
    return f"{who}: {x1 - x0:.0f} x {y1 - y0:.0f} m, in the frame of {names[0]}'s first pose"


def not_in_first(components: Sequence[WovenMap], merges: Sequence[Merge]) -> list[str]:
    """Which robots the first map lacks and why none of its robots could be merged with them, a sentence a map."""
    inside, out = set(components[0].robots), []
    for made in components[1:]:
        there = {*made.robots}
        tried = [m for m in merges if (m.a in inside and m.b in there) or (m.b in inside and m.a in there)]
        why = "; ".join(f"{robot_name(m.a)} and {robot_name(m.b)}: {m.reason}" for m in tried[:MOST_REASONS])
        more = f"; {len(tried) - MOST_REASONS} more in the table of pairs" if len(tried) > MOST_REASONS else ""
        names = told_list([robot_name(r) for r in made.robots])
        why = f"{why}{more}" if tried else "no pair of robots could be tried"
        out.append(f"Not in the first map: {names}. Why: {why}.")
    return out


def write_maps(
    page: Page,
    folder: Path,
    components: Sequence[WovenMap],
    truth: Mapping[str, Track],
    places: Mapping[str, int],
) -> None:
    """The maps of several robots on `page`, their figures in `folder/figures`, and intensity.png of each."""
    for k, made in enumerate(components, 1):
        if len(made.robots) > 1:
            _component(page, folder, made, k, truth, places)


def write_pairs(
    page: Page,
    folder: Path,
    maps: Sequence[LaserMap],
    components: Sequence[WovenMap],
    merges: Sequence[Merge],
    places: Mapping[str, int],
) -> None:
    """On `page` which robots hang together, and of every pair why it was merged or not."""
    page.section("Which robots are in one map")
    for made in components:
        page.text(f"{told_component(made)}.")
    if merges:
        _pairs(page, merges)
    graphs = {made.robot: made.graph for made in maps if made.graph is not None}
    shown = [m for m in merges if m.best is not None and m.a in graphs and m.b in graphs]
    if shown:
        page.section("Pairs of maps on top of each other")
    for merge in shown[:MOST_PICTURES]:
        path = folder / "figures" / f"pair_{_file(merge.a)}_{_file(merge.b)}.png"
        tints = robot_colour(places[merge.a]), robot_colour(places[merge.b])
        draw_pair(path, merge, graphs[merge.a], graphs[merge.b], tints)
        page.figure(path, f"{told_merge(merge)}.")
    if len(shown) > MOST_PICTURES:
        page.text(f"{len(shown) - MOST_PICTURES} more pairs are in the table only.")


def _pairs(page: Page, merges: Sequence[Merge]) -> None:
    head = ["robots", "decision", "why", "overlap", "score", "second", "agreeing", "chi-square", "alike"]
    rows = []
    for m in merges:
        decision = "merged" if m.merged else "not merged"
        overlap, second, alike = (None if v is None else f"{100 * v:.0f} %" for v in (m.overlap, m.second, m.alike))
        name = f"{robot_name(m.a)}, {robot_name(m.b)}"
        rows.append([name, decision, m.reason, overlap, m.score, second, m.agreeing, m.chi2, alike])
    page.table(head, rows)
    page.text(
        "Overlap: share of the walls of one map that lie on those of the other. Score: of the submaps of one searched "
        "for in the other, 0 to 1; second: that of the next best place, over it. Agreeing: submaps that confirm the "
        "place; chi-square: of their closures. Alike: of what both robots saw, the share on which they agree."
    )


def _component(
    page: Page, folder: Path, made: WovenMap, k: int, truth: Mapping[str, Track], places: Mapping[str, int]
) -> None:
    names = told_list([robot_name(r) for r in made.robots])
    page.section(f"The map of {names}")
    accepted = sum(c.accepted for c in made.closures)
    driven = [f"{robot_name(r)} {_way(made.tracks[r]):.0f} m" for r in made.robots]
    figures = folder / "figures"
    draw_component(figures / f"component{k}_map.png", made, truth, places)
    colours = {robot: robot_colour(places[robot]) for robot in made.robots}
    seen = [robot for robot in made.robots if robot in truth]
    others = {f"truth of {robot_name(r)}": t for r, t in zip(seen, truths_in(made, truth), strict=False)}
    scene = laser_scene(made.grid, made.tracks, colours, made.closures, others)
    page.scene(
        scene,
        "Walls stand out, known free ground is plain, over unknown ground the grid lines go on.",
        figures / f"component{k}_map.png",
    )
    page.text(
        f"Driven: {', '.join(driven)}. {len(made.graph):,} keyframes; of {len(made.closures):,} loop closures tried "
        f"{accepted:,} are believed. The frame is the first pose of {robot_name(made.robots[0])}."
    )
    draw_closures(figures / f"component{k}_closures.png", made)
    page.figure(
        figures / f"component{k}_closures.png",
        "From keyframe to keyframe; closures.csv says why each was accepted or refused.",
    )
    if made.feature != "none":
        light = (folder if k == 1 else folder / "components" / str(k)) / "intensity.png"
        draw_intensity(light, made.grid, made.feature, names)
        page.figure(light, "How bright every occupied cell is; grid.npz holds the same as numbers.")


def _way(track: Track) -> float:
    steps = track.pose[1:, :2] - track.pose[:-1, :2]
    return float(((steps**2).sum(axis=1) ** 0.5).sum())


def _file(robot: str) -> str:
    return robot_name(robot).replace("/", "_")
