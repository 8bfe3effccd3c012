"""The part of a laser report that tells how robots are connected, and why two of them do or do not.

With its figures: all robots in one map, closures believed and refused, two maps laid on each other.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.names import robot_name
from ..core.records import Track
from ..laser.laser_map import LaserMap
from ..laser.place_search import gathered
from ..laser.robot_graph import RobotGraph
from ..mapping.merge import Merge
from ..mapping.woven_map import WovenMap
from .html import Page, told_list
from .laser_figures import SHADES, draw_intensity, laser_scene
from .scene import Scene, fix_points
from .style import Target, as_map, colour, figure

ROBOTS = (0, 1, 3, 4, 6, 2, 5)  # places in the palette, those of closures last
WALLS = 0.1  # [m] of the points two maps are drawn with


def robot_colour(k: int) -> str:
    """The colour of the k-th robot of a component."""
    return colour(ROBOTS[k % len(ROBOTS)])


def component_scene(
    woven: WovenMap, truth: Mapping[str, Track], places: Mapping[str, int], findings: Sequence[Finding] = ()
) -> Scene:
    """The map of one component, its robots in the colours of their `places` among all, places found, the truth."""
    colours = {robot: robot_colour(places[robot]) for robot in woven.robots}
    seen = [robot for robot in woven.robots if robot in truth]
    others = {f"truth of {robot_name(r)}": t for r, t in zip(seen, truths_in(woven, truth), strict=False)}
    scene = laser_scene(woven.grid, woven.tracks, colours, woven.closures, others, findings)
    if woven.georeference is not None:
        fix_points(scene, woven.georeference)
    return scene


def draw_pair(
    path: Target, merge: Merge, a: RobotGraph, b: RobotGraph, tints: tuple[str, str] = (colour(0), colour(1))
) -> None:
    """The walls of both robots under the transform looked at, and beside it under the next best one where refused."""
    ways: list[tuple[str, np.ndarray]] = []
    if merge.best is not None:
        name = "merged" if merge.merged else "not merged: the best place"
        ways.append((f"{name[0].upper()}{name[1:]}", merge.best if merge.transform is None else merge.transform))
    if merge.rival is not None and not merge.merged:
        ways.append(("The next best place", merge.rival))
    one, other = _walls(a), _walls(b)
    laid = [se2.act(T, other) for _, T in ways]
    every = np.concatenate([one, *laid])
    low, high = every.min(axis=0) - 1.0, every.max(axis=0) + 1.0
    tall = (high[1] - low[1]) / max(high[0] - low[0], 1e-6)
    wide = 9.0 / max(1, len(ways))
    with figure(path, 9.0, float(np.clip(wide * tall + 0.9, 3.2, 8.0)), ncols=max(1, len(ways)), squeeze=False) as (
        fig,
        axes,
    ):
        for ax, (name, T), points in zip(axes[0], ways, laid, strict=False):
            ax.plot(*one.T, ".", color=tints[0], markersize=1.6, label=robot_name(merge.a))
            ax.plot(*points.T, ".", color=tints[1], markersize=1.6, label=robot_name(merge.b))
            ax.set_xlim(low[0], high[0])
            ax.set_ylim(low[1], high[1])
            as_map(ax, name)
            ax.set_aspect("equal", adjustable="box")
            ax.set_xlabel(f"x [m]; moved {T[0]:.1f}, {T[1]:.1f} m, turned {np.degrees(T[2]):.0f} deg")
        handles, labels = axes[0][0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=2, markerscale=6)


def truths_in(woven: WovenMap, truths: Mapping[str, Track]) -> list[Track]:
    """The true trajectories of the robots of a component, by the one rigid motion that fits them all best."""
    known = [(truths[r], woven.tracks[r]) for r in woven.robots if r in truths]
    pairs = []
    for truth, track in known:
        inside = (truth.t >= track.t[0]) & (truth.t <= track.t[-1])
        pairs.append((truth.pose[inside, :2], se2.interpolate(truth.t[inside], track.t, track.pose)[:, :2]))
    if sum(len(a) for a, _ in pairs) < 2:
        return []
    T = se2.align(np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs]))
    return [Track(truth.t, se2.compose(T, truth.pose)) for truth, _ in known]


def _walls(graph: RobotGraph) -> Float[np.ndarray, "m 2"]:
    clouds = [graph.points[graph.rows(k)] for k in range(len(graph))]
    return gathered(graph.pose, clouds, range(len(graph)), np.zeros(3), WALLS)[0]


MOST_REASONS = 1  # pairs by which the head of the page says why a robot is not in the first map
MOST_PICTURES = 12  # of pairs of robots


def told_merge(merge: Merge) -> str:
    """The decision on a pair of robots, for people."""
    words = merge.reason if merge.merged else f"not merged: {merge.reason}"
    if merge.probability_wrong is not None:
        words += f"; wrong with a probability of {100 * merge.probability_wrong:.2g} %"
    return f"{robot_name(merge.a)} and {robot_name(merge.b)}: {words}"


def told_component(woven: WovenMap) -> str:
    """Which robots are connected, for people."""
    x0, x1, y0, y1 = woven.grid.extent
    names = [robot_name(r) for r in woven.robots]
    who = f"{', '.join(names[:-1])} and {names[-1]} in one map" if len(names) > 1 else f"{names[0]} alone"
    return f"{who}: {x1 - x0:.0f} x {y1 - y0:.0f} m, in the frame of {names[0]}'s first pose"


def not_in_first(components: Sequence[WovenMap], merges: Sequence[Merge]) -> list[str]:
    """Which robots the first map lacks and why none of its robots could be merged with them, a sentence a map."""
    inside, out = set(components[0].robots), []
    for woven in components[1:]:
        there = {*woven.robots}
        tried = [m for m in merges if (m.a in inside and m.b in there) or (m.b in inside and m.a in there)]
        why = "; ".join(f"{robot_name(m.a)} and {robot_name(m.b)}: {m.reason}" for m in tried[:MOST_REASONS])
        more = f"; {len(tried) - MOST_REASONS} more in the table of pairs" if len(tried) > MOST_REASONS else ""
        names = told_list([robot_name(r) for r in woven.robots])
        why = f"{why}{more}" if tried else "no pair of robots could be tried"
        out.append(f"Not in the first map: {names}. Why: {why}.")
    return out


def write_maps(
    page: Page,
    folder: Path,
    components: Sequence[WovenMap],
    truth: Mapping[str, Track],
    places: Mapping[str, int],
    findings: Sequence[Finding] = (),
) -> None:
    """The maps of several robots on `page`, their figures in `folder/figures`, and intensity.png of each."""
    for k, woven in enumerate(components, 1):
        if woven.joint:
            _component(page, folder, woven, k, truth, places, findings)


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
    for woven in components:
        page.text(f"{told_component(woven)}.")
    if merges:
        _pairs(page, merges)
    graphs = {local_map.robot: local_map.graph for local_map in maps if local_map.graph is not None}
    shown = [m for m in merges if m.best is not None and m.a in graphs and m.b in graphs]
    if shown:
        page.section("Pairs of maps on top of each other")
    for merge in shown[:MOST_PICTURES]:
        path = folder / "figures" / f"pair_{_file(merge.a)}_{_file(merge.b)}.png"
        tints = robot_colour(places[merge.a]), robot_colour(places[merge.b])
        page.figure(path, f"{told_merge(merge)}.", draw_pair, merge, graphs[merge.a], graphs[merge.b], tints)
    if len(shown) > MOST_PICTURES:
        page.text(f"{len(shown) - MOST_PICTURES} more pairs are in the table only.")


def _pairs(page: Page, merges: Sequence[Merge]) -> None:
    head = ["robots", "decision", "why", "overlap", "score", "second", "agreeing", "chi-square", "alike", "wrong"]
    rows = []
    for m in merges:
        decision = "merged" if m.merged else "not merged"
        shares = (m.overlap, m.second, m.alike, m.probability_wrong)
        overlap, second, alike, wrong = (None if v is None else f"{100 * v:.2g} %" for v in shares)
        name = f"{robot_name(m.a)}, {robot_name(m.b)}"
        rows.append([name, decision, m.reason, overlap, m.score, second, m.agreeing, m.chi2, alike, wrong])
    page.table(head, rows)
    page.text(
        "Overlap: share of the walls of one map that lie on those of the other. Score: of the submaps of one searched "
        "for in the other, 0 to 1; second: that of the next best place, over it. Agreeing: submaps that confirm the "
        "place; chi-square: of their closures. Alike: of what both robots saw, the share on which they agree. Wrong: "
        "the probability that the decision is."
    )


def _component(
    page: Page,
    folder: Path,
    woven: WovenMap,
    k: int,
    truth: Mapping[str, Track],
    places: Mapping[str, int],
    findings: Sequence[Finding],
) -> None:
    names = told_list([robot_name(r) for r in woven.robots])
    page.section(f"The map of {names}")
    accepted = sum(c.accepted for c in woven.closures)
    driven = [f"{robot_name(r)} {_way(woven.tracks[r]):.0f} m" for r in woven.robots]
    figures = folder / "figures"
    scene = component_scene(woven, truth, places, findings)
    page.scene(
        scene,
        SHADES,
        figures / f"component{k}_map.png",
    )
    page.text(
        f"Driven: {', '.join(driven)}. {len(woven.graph):,} keyframes; of {len(woven.closures):,} loop closures tried "
        f"{accepted:,} are believed. The frame is the first pose of {robot_name(woven.robots[0])}."
    )
    scene.draw(figures / f"component{k}_closures.png", hidden=[f"truth of {robot_name(r)}" for r in woven.robots])
    page.figure(
        figures / f"component{k}_closures.png",
        "From keyframe to keyframe; closures.csv says why each was accepted or refused.",
    )
    if woven.feature != "none":
        light = (folder if k == 1 else folder / "components" / str(k)) / "intensity.png"
        page.figure(
            light,
            "How bright every occupied cell is; grid.npz holds the same as numbers.",
            draw_intensity,
            woven.grid,
            woven.feature,
            names,
        )


def _way(track: Track) -> float:
    steps = track.pose[1:, :2] - track.pose[:-1, :2]
    return float(((steps**2).sum(axis=1) ** 0.5).sum())


def _file(robot: str) -> str:
    return robot_name(robot).replace("/", "_")
