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
from .laser_figures import aligned, draw_calibration, draw_intensity, draw_map, draw_scans, draw_tracks, laser_scene
from .style import colour
from .woven import write_woven

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
) -> None:
    """`report.html` and `figures/` in `folder`, and each robot's `intensity.png` in `local/robotK/`.

    truth: robot -> its true trajectory, in any frame; evaluation: lines to show; notes: what else there is to say.
    """
    page = Page("Laser map", _lead(maps, components))
    for line in notes:
        page.text(line)
    if evaluation:
        page.section("Against the truth")
        for line in evaluation:
            page.text(line)
    if len(maps) > 1 and components:
        write_woven(page, folder, maps, components, merges, truth)
    for made in maps:
        _robot(page, folder, made, truth.get(made.robot))
    page.write(folder / "report.html")


def _lead(maps: Sequence[LaserMap], components: Sequence[WovenMap]) -> str:
    if len(maps) > 1 and components:
        count = "one map" if len(components) == 1 else f"{len(components)} maps that nothing ties together"
        return f"{len(maps)} robots, {count}."
    if len(maps) == 1:
        return f"{Path(maps[0].source).name}, mapped with the {maps[0].method} method."
    return f"{len(maps)} logs, each mapped on its own, in the frame of its own first pose."


def _robot(page: Page, folder: Path, made: LaserMap, truth: Track | None) -> None:
    name = robot_name(made.robot)
    figures = folder / "figures"
    page.section(f"Robot {made.robot}: {Path(made.source).name}")
    page.cards(_headline(made))
    for warning in made.warnings:
        page.text(warning, warn=True)
    for reason, count in made.dropped.items():
        page.text(f"left out: {count} x {reason}")
    seen = None if truth is None else aligned(truth, made.track)
    draw_map(figures / f"{name}_map.png", made, seen)
    others = {} if made.dead_reckoning is None else {"odometry alone": made.dead_reckoning}
    others |= {} if seen is None else {"truth": seen}
    scene = laser_scene(made.grid, {made.robot: made.track}, {made.robot: colour(0)}, others=others)
    page.scene(
        scene,
        "Walls stand out, known free ground is plain, over unknown ground the grid lines go on.",
        figures / f"{name}_map.png",
    )
    light = folder / "local" / name / "intensity.png"
    draw_intensity(light, made.grid, made.feature, f"robot {made.robot}")
    if made.feature != "none":
        page.figure(light, "How bright every occupied cell is; grid.npz holds the same as numbers.")
    tracks = {"estimate": made.track}
    if made.dead_reckoning is not None:
        tracks["odometry"] = made.dead_reckoning
    if seen is not None:
        tracks["truth"] = seen
    draw_tracks(figures / f"{name}_trajectory.png", tracks)
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
    steps = np.diff(made.track.pose[:, :2], axis=0)
    x0, x1, y0, y1 = made.grid.extent
    cards = [
        ("scans", str(len(made.scans))),
        ("driven", f"{np.hypot(steps[:, 0], steps[:, 1]).sum():.0f} m"),
        ("map", f"{x1 - x0:.0f} x {y1 - y0:.0f} m"),
        ("method", made.method + (f", {made.particles} particles" if made.method == "particle" else "")),
        ("returned light", {"none": "not used"}.get(made.feature, made.feature)),
        ("odometry", ODOMETRY.get(made.odometry, made.odometry)),
    ]
    if made.dead_reckoning is not None:
        off = made.track.pose[-1, :2] - made.dead_reckoning.pose[-1, :2]
        cards.append(("odometry corrected by", f"{np.hypot(*off):.2f} m at the end"))
    if "ms_per_scan" in made.timing:
        cards.append(("a scan took", f"{made.timing['ms_per_scan']:.1f} ms"))
    return cards
