"""The report of a localisation: where the robot was in the map, and since when that is known."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core.records import Track
from ..laser.laser_map import GridMap
from ..laser.localise import Localisation
from .html import Page
from .laser_figures import READABLE, walls
from .scene import Scene
from .style import colour, figure


def write_localisation_report(folder: Path, localisation: Localisation, grid: GridMap, lines: Sequence[str]) -> None:
    """`report.html` and `figures/` in `folder`."""
    page = Page("Localisation", f"{Path(localisation.source).name}, followed in a finished map.")
    page.cards(
        [
            ("trusted", "yes" if localisation.trusted else "no"),
            ("returns explained", f"{100 * localisation.matched:.0f} %"),
            ("start", localisation.start),
            ("scans", f"{len(localisation.scans):,}"),
            ("particles", str(localisation.particles)),
            ("returned light", "not used" if localisation.feature == "none" else localisation.feature),
        ]
    )
    for line in lines:
        page.text(line, warn=not localisation.trusted)
    where, scans = folder / "figures" / "where.png", folder / "figures" / "scans.png"
    page.scene(localisation_scene(localisation, grid), "The finished map and the robot in it.", where)
    page.figure(
        scans,
        "How much of every scan the map explains, and how many hypotheses still count.",
        _draw_scans,
        localisation,
    )
    page.write(folder / "report.html")


def localisation_scene(localisation: Localisation, grid: GridMap) -> Scene:
    """The finished map, and the robot's way before its start was found and since."""
    t = localisation.track.t
    known = t >= (np.inf if localisation.found_t is None else localisation.found_t)
    ways = {"before the start was found": ~known, "robot": known}
    scene = Scene("The finished map and the robot in it")
    walls(scene, grid)
    for shade, (layer, rows) in zip((1, 0), ways.items(), strict=True):
        cov = None if localisation.track.cov is None else localisation.track.cov[rows]
        way = Track(t[rows], localisation.track.pose[rows], cov)
        scene.track(layer, layer, way, colour(shade), leaves=shade == 1)
    return scene


def _draw_scans(path: Path, localisation: Localisation) -> None:
    scans = localisation.scans
    t = scans.t - scans.t[0]
    with figure(path, 9.0, 4.2, nrows=2, sharex=True) as (_, (share, count)):
        asked = np.array(scans.decision) == "matched"
        part = scans.matches / np.maximum(scans.beams, 1)
        share.plot(t[asked], 100 * part[asked], ".", color=colour(0), markersize=3)
        share.set_ylim(-3, 103)
        share.set_ylabel("returns explained [%]")
        known = np.isfinite(scans.n_eff)
        count.plot(t[known], scans.n_eff[known], color=colour(0), label="effective particles")
        count.set_yscale("log")
        count.set_ylabel("N_eff")
        count.set_xlabel("time [s]")
        if localisation.found_t is not None:
            for ax in (share, count):
                ax.axvline(localisation.found_t - scans.t[0], color=colour(5), linestyle="--", label="start found")
        count.legend(loc="upper right", **READABLE)
