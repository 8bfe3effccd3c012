"""The report of laser maps: what the robots' surroundings look like, and why to believe it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..core.names import robot_name
from ..core.records import Track
from ..laser.laser_map import LaserMap
from ..laser.merge import Merge
from ..laser.woven_map import WovenMap
from .html import Page
from .laser_figures import (
    aligned,
    draw_calibration,
    draw_intensity,
    draw_map,
    draw_scans,
    draw_tracks,
    laser_scene,
    median_deviation,
)
from .woven import not_in_first, robot_colour, write_maps, write_pairs

MOST_NAMED = 4  # logs in the title
MOST_PARTS = 8  # robots that have a part of their own on the page of a team
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
) -> None:
    """`report.html` and `figures/` in `folder`, and each robot's `intensity.png` in `local/robotK/`.

    truth: robot -> its true trajectory, in any frame; evaluation: lines to show; notes: what else there is to say;
    warnings: of the whole, those of each robot stand in its own part; scores: headline figures against the truth.
    """
    several = len(maps) > 1 and bool(components)
    places = {made.robot: k for k, made in enumerate(maps)}
    page = Page(_title(maps, components), _lead(maps, components))
    if several:
        page.cards([*_shared(maps, components), *scores], len(warnings))
        for sentence in not_in_first(components, merges):
            page.text(sentence, warn=True)
        write_maps(page, folder, components, truth, places)
    if len(maps) == 1:
        _robot(page, folder, maps[0], truth.get(maps[0].robot), 0, scores)
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
    page.write(folder / "report.html")


def _title(maps: Sequence[LaserMap], components: Sequence[WovenMap]) -> str:
    names = [Path(made.source).name for made in maps]
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
    made = components[0]
    x0, x1, y0, y1 = made.grid.extent
    cards = [
        ("robots in the map", f"{len(made.robots)} of {len(maps)}"),
        ("size", f"{x1 - x0:.0f} x {y1 - y0:.0f} m"),
        ("closures between robots", str(sum(c.accepted and c.robot_a != c.robot_b for c in made.closures))),
    ]
    sd = [d for robot in made.robots if (d := median_deviation(made.tracks[robot])) is not None]
    return [*cards, ("median sd of a position", f"{np.median(sd):.3f} m")] if sd else cards


def _robots(page: Page, folder: Path, maps: Sequence[LaserMap], truth: Mapping[str, Track]) -> None:
    """A row for every robot, a part for some; the pictures of all."""
    page.section("Robots")
    page.table(ROBOTS_HEAD, [_row(made) for made in maps], [robot_colour(k) for k in range(len(maps))])
    if len(maps) > MOST_PARTS:
        page.text(f"Below are the first {MOST_PARTS} robots; the pictures of all are in figures/ and local/.")
    for k, made in enumerate(maps):
        _robot(page if k < MOST_PARTS else Page(""), folder, made, truth.get(made.robot), k)


def _row(made: LaserMap) -> list[object]:
    counts = Counter(made.scans.decision)
    off = None
    if made.dead_reckoning is not None:
        off = float(np.hypot(*(made.track.pose[-1, :2] - made.dead_reckoning.pose[-1, :2])))
    return [
        *(robot_name(made.robot), Path(made.source).name, len(made.scans), f"{_driven(made.track):.0f}"),
        *(counts["odometry"], sum(made.dropped.values()), len(made.warnings), off, median_deviation(made.track)),
    ]


def _driven(track: Track) -> float:
    steps = np.diff(track.pose[:, :2], axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _robot(
    page: Page, folder: Path, made: LaserMap, truth: Track | None, k: int, scores: Sequence[tuple[str, str]] = ()
) -> None:
    """The part of one robot, the `k`-th of all."""
    name = robot_name(made.robot)
    figures = folder / "figures"
    page.section(f"Robot {made.robot}: {Path(made.source).name}")
    page.cards([*_headline(made), *scores])
    seen = None if truth is None else aligned(truth, made.track)
    draw_map(figures / f"{name}_map.png", made, seen, robot_colour(k))
    others = {} if made.dead_reckoning is None else {"odometry alone": made.dead_reckoning}
    others |= {} if seen is None else {"truth": seen}
    scene = laser_scene(made.grid, {made.robot: made.track}, {made.robot: robot_colour(k)}, others=others)
    page.scene(
        scene,
        "Walls stand out, known free ground is plain, over unknown ground the grid lines go on.",
        figures / f"{name}_map.png",
    )
    for warning in made.warnings:
        page.text(warning, warn=True)
    for reason, count in made.dropped.items():
        page.text(f"Left out: {count:,} x {reason}.")
    light = folder / "local" / name / "intensity.png"
    draw_intensity(light, made.grid, made.feature, f"robot {made.robot}")
    if made.feature != "none":
        page.figure(light, "How bright every occupied cell is; grid.npz holds the same as numbers.")
    tracks = {"estimate": made.track}
    if made.dead_reckoning is not None:
        tracks["odometry"] = made.dead_reckoning
    if seen is not None:
        tracks["truth"] = seen
    draw_tracks(figures / f"{name}_trajectory.png", tracks, robot_colour(k))
    page.figure(figures / f"{name}_trajectory.png", "The estimate against odometry alone, from the same first pose.")
    draw_scans(figures / f"{name}_scans.png", made)
    page.figure(
        figures / f"{name}_scans.png",
        "Innovation: the matched pose seen from the one odometry predicted. scans.csv holds every number.",
    )
    counts = Counter(made.scans.decision)
    page.table(["decision", "scans", "meaning"], [[d, counts[d], why] for d, why in WHY.items() if counts[d]])
    if made.calibration is not None and made.feature == "normalised":
        draw_calibration(figures / f"{name}_calibration.png", made.calibration)
        page.figure(
            figures / f"{name}_calibration.png",
            f"Estimated from this log itself, from {made.calibration.samples} returns; the residual is what range, "
            "incidence and place leave unexplained.",
        )


def _headline(made: LaserMap) -> list[tuple[str, str]]:
    x0, x1, y0, y1 = made.grid.extent
    cards = [
        ("scans", f"{len(made.scans):,}"),
        ("driven", f"{_driven(made.track):.0f} m"),
        ("size", f"{x1 - x0:.0f} x {y1 - y0:.0f} m"),
        ("method", made.method + (f", {made.particles} particles" if made.method == "particle" else "")),
        ("returned light", {"none": "not used"}.get(made.feature, made.feature)),
        ("odometry", ODOMETRY.get(made.odometry, made.odometry)),
    ]
    if (sd := median_deviation(made.track)) is not None:
        cards.append(("median sd of a position", f"{sd:.3f} m"))
    if made.dead_reckoning is not None:
        off = made.track.pose[-1, :2] - made.dead_reckoning.pose[-1, :2]
        cards.append(("odometry corrected by", f"{np.hypot(*off):.2f} m at the end"))
    return cards
