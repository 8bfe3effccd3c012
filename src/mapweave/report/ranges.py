"""The report of robots and beacons placed by ranges: the map, what the radios turned out to be, residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.findings import Finding
from ..core.names import robot_key
from ..mapping.woven_map import Georeference
from ..ranges.estimate import RangeEstimate
from ..ranges.network import RangeNetwork
from ..team.team_map import TeamMap
from .html import Page, told_list
from .scene import Scene, fix_points, landmark_points
from .style import MUTED, Target, colour, figure


@dataclass(frozen=True, slots=True)
class RangeStory:
    """What the page tells: the components, the largest first, with the network and estimate they are of."""

    source: str
    maps: Sequence[TeamMap]
    network: RangeNetwork
    estimate: RangeEstimate
    findings: Sequence[Finding]
    scores: Sequence[tuple[str, str]] = ()
    placed: Sequence[Georeference | None] = ()  # of each map where fixes lay it
    told: Sequence[str] = ()

    def tint(self, robot: str) -> str:
        return colour(self.network.robots.index(robot))


def draw_residuals(target: Target, story: RangeStory) -> None:
    """What every range misses by, pair by pair: those used, and those that went another way."""
    net, e = story.network, story.estimate
    pairs, which = net.pairs()
    with figure(target, 8.4, 0.9 + 0.42 * max(len(pairs), 3)) as (_, ax):
        wide = 1.3 * float(np.nanpercentile(np.abs(e.residual), 99.0)) if np.isfinite(e.residual).any() else 1.0
        rng = np.random.default_rng(0)
        for k in range(len(pairs)):
            for rows, tint in (((which == k) & ~e.far, colour(0)), ((which == k) & e.far, colour(5))):
                x = np.clip(e.residual[rows], -wide, wide)
                ax.plot(x, k + 0.3 * rng.uniform(-1, 1, len(x)), ".", color=tint, ms=2, alpha=0.5, rasterized=True)
        names = [" to ".join(robot_key(net.everybody[i]) for i in pair) for pair in pairs.tolist()]
        ax.axvline(0.0, color=MUTED, lw=0.8)
        ax.set_yticks(range(len(pairs)), names)
        ax.invert_yaxis()
        ax.set_xlabel("range read less bias and distance [m]; orange: rejected, those further off stand at the edge")
        ax.set_title("What every range misses by")


def write_range_report(folder: Path, story: RangeStory) -> None:
    """`report.html` and `figures/*.png` in `folder`."""
    net, e, first = story.network, story.estimate, story.maps[0]
    page = Page("Map from ranges", f"{Path(story.source).name}: robots and beacons placed by ranges and odometry.")
    page.verdict(story.findings)
    cards = [
        ("robots in the map", f"{len(first.robots)} of {len(net.robots)}"),
        ("beacons", f"{len(first.landmarks)} of {len(net.beacons)}"),
        ("ranges", f"{len(net.ranges):,}"),
        ("rejected", f"{100 * float(e.far.mean()):.1f} %"),
    ]
    page.cards([*cards, *story.scores], len(story.findings))
    for k, team in enumerate(story.maps):
        page.section("Map" if k == 0 else f"Component {k + 1}: {told_list([robot_key(r) for r in team.robots])}")
        png = folder / "figures" / ("map.png" if k == 0 else f"component_{k + 1}.png")
        page.scene(
            range_scene(story, team),
            "Where robots drove; beacons and ends with their 95 % ellipses, and position fixes.",
            png,
        )
        if k == 0:
            page.warnings([found.told for found in story.findings])
    for line in story.told:
        page.text(line)
    page.section("Radios")
    page.table(
        ["from", "to", "ranges", "bias [m]", "sd of the bias [m]", "noise [m]", "errors last [ranges]", "rejected"],
        [[robot_key(r.a), robot_key(r.b), r.n, r.bias, r.bias_sd, r.sd, round(r.lasting, 1), r.far] for r in e.radios],
    )
    png = folder / "figures" / "residuals.png"
    page.figure(
        png,
        "Residuals of all ranges, pair by pair; those rejected most likely went round something.",
        draw_residuals,
        story,
    )
    page.write(folder / "report.html")


def range_scene(story: RangeStory, team: TeamMap) -> Scene:
    """Where the robots of one component drove, and its beacons."""
    scene = Scene("Where robots drove and beacons stand")
    for robot in team.robots:
        scene.track(f"robot {robot_key(robot)}", f"robot {robot_key(robot)}", team.tracks[robot], story.tint(robot))
    landmark_points(scene, team, team.landmarks)
    for one, placed in zip(story.maps, story.placed, strict=False):
        if one is team and placed is not None:
            fix_points(scene, placed)
    return scene
