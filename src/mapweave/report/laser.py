"""The report of laser maps: what the robots' surroundings look like, and why to believe it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.findings import Finding, shortly
from ..core.names import robot_name
from ..core.records import Track
from ..laser.laser_map import LaserMap
from ..mapping.merge import Merge
from ..mapping.woven_map import ClosureRow, WovenMap
from .html import Page
from .laser_figures import (
    SHADES,
    aligned,
    draw_calibration,
    draw_intensity,
    draw_scans,
    draw_tracks,
    laser_scene,
    median_deviation,
)
from .scene import Scene
from .style import colour
from .team_figures import add_growth
from .woven import not_in_first, robot_colour, write_maps, write_pairs

MOST_NAMED = 4  # logs in the title
MOST_PARTS = 8  # robots that have a part of their own on the page of a team
PANE = 0.1  # [m] between the points of glass that are drawn
ROBOTS_HEAD = (
    *("robot", "log", "scans", "driven [m]", "matches refused", "left out", "warnings"),
    *("odometry corrected by [m]", "median sd [m]"),
)
WHY = {
    "first": "the first scan: the map begins with it",
    "matched": "the match was taken",
    "odometry": "the gate or too few matches refused the match: odometry was taken",
    "skipped": "the robot had hardly moved: nothing was added to the map",
    "empty": "the scan had no return",
    "unseen": "the robot looked where it had not looked before: odometry was taken",
}

ODOMETRY = {"poses": "as poses", "ticks": "from wheel ticks", "tf": "from tf"}


def write_laser_report(
    folder: Path,
    maps: Sequence[LaserMap],
    truth: Mapping[str, Track],
    evaluation: Sequence[str],
    components: Sequence[WovenMap] = (),
    merges: Sequence[Merge] = (),
    notes: Sequence[str] = (),
    warnings: Sequence[str] = (),
    scores: Sequence[tuple[str, str]] = (),
    findings: Sequence[Finding] = (),
    growth: Sequence[Mapping[str, Any]] = (),
) -> None:
    """`report.html` and `figures/` in `folder`, and each robot's `intensity.png` in `local/robotK/`.

    truth: robot -> its true trajectory, in any frame; evaluation: lines to show; notes: what else there is to say;
    warnings: of the whole, those of each robot stand in its own part; scores: headline figures against the truth;
    findings: which make the verdict; growth: what the maps on the way held.
    """
    several = len(maps) > 1 and bool(components)
    places = {local_map.robot: k for k, local_map in enumerate(maps)}
    page = Page(_title(maps, components), _lead(maps, components))
    page.verdict(findings)
    if several:
        page.cards([*_shared(maps, components), *scores], len(warnings))
        for sentence in not_in_first(components, merges):
            page.text(sentence, warn=True)
        write_maps(page, folder, components, truth, places, findings)
    if len(maps) == 1:
        closures = components[0].closures if components else ()
        _robot(page, folder, maps[0], truth.get(maps[0].robot), 0, scores, closures, findings)
    page.warnings(warnings)
    for line in notes:
        page.text(line)
    if evaluation:
        page.section("Against the truth")
        for line in evaluation:
            page.text(line)
    if several:
        write_pairs(page, folder, maps, components, merges, places)
    if len(maps) > 1:
        _robots(page, folder, maps, truth)
    add_growth(page, folder, growth)
    page.write(folder / "report.html")


def _title(maps: Sequence[LaserMap], components: Sequence[WovenMap]) -> str:
    names = [Path(local_map.source).name for local_map in maps]
    logs = ", ".join(names) if len(names) <= MOST_NAMED else f"{len(names)} logs"
    count = len(components) or len(maps)
    return f"{'One map' if count == 1 else f'{count} maps'} from {logs}"


def _lead(maps: Sequence[LaserMap], components: Sequence[WovenMap]) -> str:
    if len(maps) > 1 and components:
        tied = len(components[0].robots)
        if len(components) == 1:
            return f"{len(maps)} robots, all in one map."
        return f"{len(maps)} robots, {len(components)} maps that nothing ties together; {tied} of them in the first."
    if len(maps) == 1:
        return f"One robot with a laser scanner, mapped with the {maps[0].method} method."
    return f"{len(maps)} logs, each mapped on its own, in the frame of its own first pose."


def _shared(maps: Sequence[LaserMap], components: Sequence[WovenMap]) -> list[tuple[str, str]]:
    """Headline figures of the first map."""
    woven = components[0]
    x0, x1, y0, y1 = woven.grid.extent
    cards = [
        ("robots in the map", f"{len(woven.robots)} of {len(maps)}"),
        ("size", f"{x1 - x0:.0f} x {y1 - y0:.0f} m"),
        ("closures between robots", str(sum(c.accepted and c.robot_a != c.robot_b for c in woven.closures))),
    ]
    sd = [d for robot in woven.robots if (d := median_deviation(woven.tracks[robot])) is not None]
    return [*cards, ("median sd of a position", f"{np.median(sd):.3f} m")] if sd else cards


def _robots(page: Page, folder: Path, maps: Sequence[LaserMap], truth: Mapping[str, Track]) -> None:
    """A row for every robot, a part for some; the pictures of all."""
    page.section("Robots")
    page.table(ROBOTS_HEAD, [_row(local_map) for local_map in maps], [robot_colour(k) for k in range(len(maps))])
    if len(maps) > MOST_PARTS:
        page.text(f"Below are the first {MOST_PARTS} robots; the pictures of all are in figures/ and local/.")
    for k, local_map in enumerate(maps):
        part = page if k < MOST_PARTS else Page("")
        with part.folded(f"Robot {local_map.robot}: {Path(local_map.source).name}", shut=page.scenes > 0):
            _robot(part, folder, local_map, truth.get(local_map.robot), k)


def _row(local_map: LaserMap) -> list[object]:
    counts = Counter(local_map.scans.decision)
    off = None
    if local_map.dead_reckoning is not None:
        off = float(np.hypot(*(local_map.track.pose[-1, :2] - local_map.dead_reckoning.pose[-1, :2])))
    return [
        *(
            robot_name(local_map.robot),
            Path(local_map.source).name,
            len(local_map.scans),
            f"{_driven(local_map.track):.0f}",
        ),
        *(
            counts["odometry"],
            sum(local_map.dropped.values()),
            len(local_map.warnings),
            off,
            median_deviation(local_map.track),
        ),
    ]


def _driven(track: Track) -> float:
    steps = np.diff(track.pose[:, :2], axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _robot(
    page: Page,
    folder: Path,
    local_map: LaserMap,
    truth: Track | None,
    k: int,
    scores: Sequence[tuple[str, str]] = (),
    closures: Sequence[ClosureRow] = (),
    findings: Sequence[Finding] = (),
) -> None:
    """The part of one robot, the `k`-th of all; closures, findings: where they are not those of a map of several."""
    name = robot_name(local_map.robot)
    figures = folder / "figures"
    page.cards([*_headline(local_map), *scores])
    seen = None if truth is None else aligned(truth, local_map.track)
    scene = robot_scene(local_map, truth, k, closures, findings)
    page.scene(
        scene,
        SHADES,
        figures / f"{name}_map.png",
    )
    for warning in shortly(local_map.findings):
        page.text(warning, warn=True)
    for reason, count in local_map.dropped.items():
        page.text(f"Left out: {count:,} x {reason}.")
    light = folder / "local" / name / "intensity.png"
    draw_intensity(light, local_map.grid, local_map.feature, f"robot {local_map.robot}")
    if local_map.feature != "none":
        page.figure(light, "How bright every occupied cell is; grid.npz holds the same as numbers.")
    tracks = {"estimate": local_map.track}
    if local_map.dead_reckoning is not None:
        tracks["odometry"] = local_map.dead_reckoning
    if seen is not None:
        tracks["truth"] = seen
    page.figure(
        figures / f"{name}_trajectory.png",
        "The estimate against odometry alone, from the same first pose.",
        draw_tracks,
        tracks,
        robot_colour(k),
    )
    page.figure(
        figures / f"{name}_scans.png",
        "Innovation: the matched pose seen from the one odometry predicted. scans.csv holds every number.",
        draw_scans,
        local_map,
    )
    counts = Counter(local_map.scans.decision)
    page.table(["decision", "scans", "meaning"], [[d, counts[d], why] for d, why in WHY.items() if counts[d]])
    if local_map.calibration is not None and local_map.feature == "normalised":
        page.figure(
            figures / f"{name}_calibration.png",
            f"Estimated from this log itself, from {local_map.calibration.samples} returns; the residual is what "
            "range, incidence and place leave unexplained.",
            draw_calibration,
            local_map.calibration,
        )


def robot_scene(
    local_map: LaserMap, truth: Track | None, k: int = 0, closures: Sequence[ClosureRow] = (),
    findings: Sequence[Finding] = (),
) -> Scene:  # fmt: skip
    """The map of one robot, the `k`-th of all, beside odometry alone and the truth, which may be in any frame."""
    others = {} if local_map.dead_reckoning is None else {"odometry alone": local_map.dead_reckoning}
    others |= {} if truth is None else {"truth": aligned(truth, local_map.track)}
    tracks, colours = {local_map.robot: local_map.track}, {local_map.robot: robot_colour(k)}
    scene = laser_scene(local_map.grid, tracks, colours, closures, others, findings or local_map.findings)
    if local_map.graph is not None:
        at = PANE * np.unique(np.round(local_map.graph.panes() / PANE), axis=0)
        scene.points("glass", ["glass"] * len(at), at, colour(0), named=False)
    return scene


def _headline(local_map: LaserMap) -> list[tuple[str, str]]:
    x0, x1, y0, y1 = local_map.grid.extent
    cards = [
        ("scans", f"{len(local_map.scans):,}"),
        ("driven", f"{_driven(local_map.track):.0f} m"),
        ("size", f"{x1 - x0:.0f} x {y1 - y0:.0f} m"),
        ("method", local_map.method + (f", {local_map.particles} particles" if local_map.method == "particle" else "")),
        ("returned light", {"none": "not used"}.get(local_map.feature, local_map.feature)),
        ("odometry", ODOMETRY.get(local_map.odometry, local_map.odometry)),
    ]
    if (sd := median_deviation(local_map.track)) is not None:
        cards.append(("median sd of a position", f"{sd:.3f} m"))
    if local_map.dead_reckoning is not None:
        off = local_map.track.pose[-1, :2] - local_map.dead_reckoning.pose[-1, :2]
        cards.append(("odometry corrected by", f"{np.hypot(*off):.2f} m at the end"))
    return cards
