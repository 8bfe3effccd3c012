"""The report of a mixed team: one map of walls, landmarks and paths, how everybody was tied in, what was found."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.findings import Finding
from ..core.names import in_order, robot_key
from ..laser.laser_map import GridMap
from ..team.mixed import MixedMap
from ..team.smooth import Smoothed
from .html import Page, sentence_case
from .laser_figures import MOST_LAYERS, median_deviation, walls
from .scene import Scene, landmark_points
from .score import add_growth
from .style import colour
from .team import calibrations, measured, named
from .woven import told_merge

BY = {"walls": "walls that both saw", "known": "where they are known to be", "fixes": "their position fixes"}
TIES = "How they were tied"


@dataclass(frozen=True, slots=True)
class MixedStory:
    """kinds: robot -> what it carries; grids: one a component, None without a laser; lines, scores: of the score."""

    title: str
    map: MixedMap
    grids: Sequence[GridMap | None]
    kinds: Mapping[str, str]
    lines: Sequence[str]
    findings: Sequence[Finding]
    scores: Sequence[tuple[str, str]] = ()

    @property
    def robots(self) -> tuple[str, ...]:
        return tuple(sorted(self.kinds, key=in_order))


def words(story: MixedStory) -> list[str]:
    """How the robots are connected, in sentences."""
    out = [
        f"{_sorted(tie.a)} and {_sorted(tie.b)} were tied by {BY.get(tie.by, f'{tie.agree} of {tie.of} sightings')}"
        for tie in story.map.layout.ties
    ]
    out += [f"walls: {told_merge(merge)}" for merge in story.map.merges]
    out += [
        f"the clock of robot {robot_key(robot)} was found {clock.ahead:+.3f} ± {clock.sd:.3f} s ahead"
        for robot, clock in story.map.clocks.items()
    ]
    for path in story.map.paths:
        first, last, between = path.robots[0], path.robots[-1], path.robots[1:-1]
        through = f"through {named(between)}" if between else "directly"
        steps = [
            f"{n} sightings" if n else f"{m} landmarks" for n, m in zip(path.sightings, path.landmarks, strict=True)
        ]
        out.append(f"laser robots {robot_key(first)} and {robot_key(last)} hang together {through}: {', '.join(steps)}")
    return out


def mixed_scene(story: MixedStory, k: int) -> Scene:
    """Component `k` to move about in."""
    team, grid = story.map.components[k].map, story.grids[k]
    scene = Scene("Walls, landmarks and where every robot went")
    if grid is not None:
        walls(scene, grid)
    for robot in team.robots:
        name = f"robot {robot_key(robot)}"
        scene.track(
            name if len(team.robots) <= MOST_LAYERS else "robots",
            f"{name}, {story.kinds[robot]}",
            team.tracks[robot],
            colour(story.robots.index(robot)),
        )
    landmark_points(scene, team, team.landmarks)
    return scene


def write_mixed_report(folder: Path, story: MixedStory, growth: Sequence[Mapping[str, Any]] = ()) -> None:
    """`report.html` and `figures/*.png` in `folder`. growth: what the maps on the way held."""
    whole = story.map.components
    tied, of = len(whole[0].map.robots), len(story.robots)
    first = "the map" if len(whole) == 1 else "the first map"
    connected = "all in one map" if tied == of else f"{tied} of {of} in {first}"
    count = "One map" if len(whole) == 1 else f"{len(whole)} maps"
    page = Page(story.title.replace("One map", count, 1), f"{sentence_case(named(story.robots))}, {connected}.")
    cards = [
        ("robots in the map", f"{tied} of {of}"),
        ("landmarks", str(len(whole[0].map.landmarks))),
        ("measurements", f"{sum(whole[0].used.values()):,}"),
    ]
    sd = [d for track in whole[0].map.tracks.values() if (d := median_deviation(track)) is not None]
    cards += [("median sd of a position", f"{np.median(sd):.3f} m")] if sd else []
    page.verdict(story.findings)
    page.cards([*cards, *story.scores], len(story.findings))
    if tied < of:
        left = named([robot for robot in story.robots if robot not in whole[0].map.robots])
        page.text(f"Not in {first}: {left}. The reason is told below it, in the warnings or under {TIES}.", warn=True)
    for k, component in enumerate(whole):
        page.section("Map" if k == 0 else f"Component {k + 1}: {named(component.map.robots)}")
        png = folder / "figures" / ("map.png" if k == 0 else f"component_{k + 1}.png")
        page.scene(mixed_scene(story, k), "Walls as lasers saw them, landmarks, and where every robot went.", png)
        if k == 0:
            page.warnings([found.told for found in story.findings])
    if story.lines:
        page.section("Against the truth")
        for line in story.lines:
            page.text(line)
    page.section(TIES)
    for sentence in words(story) or ["no robots could be connected"]:
        page.text(f"{sentence_case(sentence)}.")
    page.section("The whole team at once")
    for k, component in enumerate(whole, 1):
        page.text(_smoothing_text(component) if len(whole) == 1 else f"Component {k}: {_smoothing_text(component)}")
    page.section("Robots")
    began = min((float(track.t[0]) for s in whole for track in s.map.tracks.values() if len(track.t)), default=0.0)
    page.table(
        ["robot", "carries", "poses", "from [s]", "to [s]", "median sd [m]"],
        [_robot(story, r, began) for r in story.robots],
        [colour(k) for k in range(len(story.robots))],
    )
    page.text("Seconds since the first pose of all robots.")
    calibrations(page, whole, {robot: colour(k) for k, robot in enumerate(story.robots)})
    add_growth(page, folder, growth)
    page.write(folder / "report.html")


def _smoothing_text(s: Smoothed) -> str:
    if s.refused:
        return f"laid out, not smoothed: {s.refused}."
    return f"{s.poses:,} poses; {measured(s.used)}. {s.iterations} iterations, {s.status}."


def _robot(story: MixedStory, robot: str, began: float) -> list[object]:
    track = next((s.map.tracks[robot] for s in story.map.components if robot in s.map.tracks), None)
    if track is None or not len(track.t):
        return [robot_key(robot), story.kinds[robot], 0, None, None, None]
    return [
        robot_key(robot),
        story.kinds[robot],
        len(track.t),
        f"{track.t[0] - began:.1f}",
        f"{track.t[-1] - began:.1f}",
        median_deviation(track),
    ]


def _sorted(robots: Sequence[str]) -> str:
    return named(sorted(robots, key=in_order))
