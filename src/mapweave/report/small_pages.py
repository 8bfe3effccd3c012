"""Pages and pictures of results that are no maps of surroundings: one page, a picture or a few.

Installations, live robots, simulated worlds, the page that edits; robots localised, placed by ranges, solved graphs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.findings import Finding, shortly
from ..core.names import robot_key
from ..core.records import Track
from ..laser.laser_map import GridMap
from ..laser.localise import Localisation
from ..laser.robust_graph import SolvedGraph
from ..mapping.woven_map import Georeference
from ..ranges.estimate import RangeEstimate
from ..ranges.network import RangeNetwork
from ..team.team_map import TeamMap
from .elements import Html
from .html import Page, told_list
from .laser_figures import READABLE, walls
from .scene import Scene, Shape, fix_points, landmark_points, script
from .style import LANDMARK, MUTED, TRUTH, Target, colour, figure
from .team_figures import add_growth

if TYPE_CHECKING:
    from .style import Axes

Check = tuple[str, str, bool | None]  # what is looked at, what was found; None: not there, and not needed
GOOD, BAD = colour(2), colour(5)


def write_small_page(
    folder: Path, title: str, lines: Sequence[str], table: tuple[Sequence[str], Sequence[Sequence[object]]], png: Path
) -> None:
    """`report.html` in `folder`: the lines, the picture `png`, the table."""
    page = Page(title, lines[0] if lines else "")
    for line in lines[1:]:
        page.text(line)
    page.figure(png, title)
    page.table(*table)
    page.write(folder / "report.html")


def draw_checks(target: Target, checks: Sequence[Check], seconds: Sequence[tuple[str, float]]) -> None:
    """Every check with a mark that tells how it came out, and how long calls of a kernel took [s], if any."""
    rows = np.arange(len(checks))[::-1]
    parts: dict[str, Any] = {"ncols": 2, "width_ratios": (3, 2)} if seconds else {}
    with figure(target, 9.0, 0.24 * len(checks) + 0.9, squeeze=False, **parts) as (_, axes):
        left: Axes = axes[0, 0]
        for row, (name, value, good) in zip(rows.tolist(), checks, strict=True):
            tint, shape = (MUTED, "o") if good is None else (GOOD, "o") if good else (BAD, "X")
            left.plot([0.0], [row], shape, color=tint, markersize=8)
            left.text(0.15, row, f"{name}: {value}", va="center")
        left.set_xlim(-0.2, 4.0)
        left.set_ylim(-0.7, len(checks) - 0.3)
        left.set_title("checks")
        left.axis("off")
        if not seconds:
            return
        right: Axes = axes[0, 1]
        right.plot([name for name, _ in seconds], [s for _, s in seconds], "o", color=LANDMARK, markersize=9)
        right.margins(x=0.4, y=0.2)
        right.set_ylabel("time a kernel took [s]")
        if all(s > 0 for _, s in seconds):
            right.set_yscale("log")
        right.grid(visible=False, axis="x")


def draw_messages(target: Target, sizes: Sequence[int], heard_by: int) -> None:
    """How much a robot told its team, message by message [kB]."""
    total = np.concatenate([[0.0], np.cumsum(np.asarray(sizes, dtype=np.float64))]) / 1e3
    with figure(target, 6.4, 3.2) as (_, ax):
        ax.step(np.arange(len(total)), total, where="post", color=colour(0))
        ax.set_xlabel("messages")
        ax.set_ylabel("told in all [kB]")
        ax.set_title(f"all heard by {heard_by} map process{'' if heard_by == 1 else 'es'}")


def draw_world(
    target: Target,
    title: str,
    ways: Mapping[str, Float[np.ndarray, "n 2"]],
    places: Float[np.ndarray, "m 2"] | None = None,
    walls: Float[np.ndarray, "w 4"] | None = None,
    pairs: Sequence[tuple[int, int]] = (),
) -> None:
    """True paths [m] by robot, places (landmarks or robots), walls (x0, y0, x1, y1), and who of `places` sees whom."""
    scene = Scene(title)
    scene.lines("walls", np.zeros((0, 4)) if walls is None else walls, TRUTH)
    if places is not None:
        scene.lines("who sees whom", places[np.array(pairs, int).reshape(-1, 2)].reshape(-1, 4), MUTED)
        shape: Shape = "star" if ways else "dot"
        scene.points("landmarks" if ways else "robots", [""] * len(places), places, TRUTH, named=False, shape=shape)
    for k, (name, way) in enumerate(ways.items()):
        poses = np.column_stack([way, np.zeros(len(way))])
        scene.track(name, name, Track(np.arange(len(way), dtype=float), poses), colour(k))
    scene.draw(target)


_BODY = """
<div id="map"></div>
<p id="told" role="status">reading the map</p>
<div class="bar edit"><label id="whole" hidden>map <select id="part"></select></label>
<label id="other" hidden>lay on it <select id="lay"></select></label><span id="hand" hidden>drag to move, with shift to
turn <label>by <input id="turn" type="range" min="-180" max="180" step="0.5" value="0"></label>
<button id="here">it lies here</button></span>
<label>drag to <select id="cells"><option value="">move</option><option value="free">erase walls</option>
<option value="unknown">forget a region</option></select></label>
<button id="undo">undo</button><button id="save">save</button></div>
<div id="place" class="card" hidden><b></b><span></span><div class="bar">
<button data-word="together">believe it</button><button data-word="apart">forbid it</button>
<button data-word="undecided">as the scans say</button></div></div>
<h2 id="robots" hidden>Robots</h2><table id="pairs" hidden></table>
<h2>What is doubtful</h2><ul id="findings"></ul>
"""


def editing_page(title: str) -> str:
    """The whole page; it asks `/state.json` for what it shows and posts to `/decide`, `/undo`, `/save`."""
    page = Page(
        title,
        "Click a line between two places to believe or forbid it, or drag over walls to erase; all is solved anew.",
    )
    page.parts.append(Html(_BODY))
    return page.html(f"{script()}{_script()}")


@cache
def _script() -> str:
    return (files(__package__) / "editing.js").read_text(encoding="utf-8")


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
    growth: Sequence[Mapping[str, Any]] = ()  # what the maps on the way held

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
            page.warnings(shortly(story.findings, named=True))
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
    add_growth(page, folder, story.growth)
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


MOST_ROWS = 200  # of dropped edges the page lists
MOST_EDGES = 4000  # of a kind in the page's map


def write_solve_report(
    folder: Path, name: str, before: np.ndarray, solved: SolvedGraph, ids: Sequence[int], lines: Sequence[str]
) -> None:
    """`report.html` and `figures/` in `folder`; before: (n, 3) the poses the solve began with."""
    page = Page("Pose graph", f"{name}: the poses that agree best with its edges.")
    page.cards(
        [
            ("poses", f"{len(solved.graph):,}"),
            ("edges", f"{solved.graph.edges:,}"),
            ("chi-square before", f"{solved.chi2_before:.4g}"),
            ("chi-square after", f"{solved.chi2:.4g}"),
            ("degrees of freedom", f"{solved.dof:,}"),
            ("iterations", str(solved.iterations)),
            ("edges dropped", str(len(solved.dropped))),
            ("parts", str(int(solved.component.max()) + 1)),
        ]
    )
    for line in lines[0 if not solved.converged else 1 :]:  # the first one tells what the cards do
        page.text(line, warn=not solved.converged)
    where, squares = folder / "figures" / "graph.png", folder / "figures" / "edges.png"
    caption = "The solved poses and the edges between poses that do not follow each other."
    page.scene(graph_scene(before, solved, ids), caption, where)
    if solved.graph.edges:
        page.figure(
            squares,
            "Squared residual of every edge in standard deviations, and what chance alone would give.",
            _draw_squares,
            solved,
        )
    if solved.dropped:
        page.section("Edges dropped")
        page.table(
            ["edge", "from", "to", "squared sd", "why"],
            [[d.edge, ids[d.first], ids[d.second], f"{d.nis:.4g}", d.reason] for d in solved.dropped[:MOST_ROWS]],
        )
        if len(solved.dropped) > MOST_ROWS:
            page.text(f"and {len(solved.dropped) - MOST_ROWS} more, listed in closures.csv")
    page.write(folder / "report.html")


def graph_scene(before: np.ndarray, solved: SolvedGraph, ids: Sequence[int]) -> Scene:
    """The solved poses to move about in, the edges used and dropped, and where the solve began."""
    graph = solved.graph
    scene = Scene("Pose graph", hidden=["where the solve began"])
    scene.path("where the solve began", before[:, :2], MUTED)
    pose = graph.pose[:, :2]
    step = np.abs(graph.second - graph.first) == 1
    reasons = {d.edge: f"\n{d.reason}" for d in solved.dropped}
    for layer, rows, tint in (
        ("steps", step & solved.used, colour(0)),
        ("closures", ~step & solved.used, colour(2)),
        ("dropped", ~solved.used, colour(5)),
    ):
        every = np.flatnonzero(rows)
        shown = every[np.unique(np.linspace(0, len(every) - 1, min(len(every), MOST_EDGES)).astype(int))]
        left = f" ({len(shown):,} of {len(every):,})" if len(shown) < len(every) else ""
        first, second = graph.first[shown], graph.second[shown]
        labels = [
            f"edge {e}: {ids[i]} to {ids[j]}\nsquared residual {solved.nis[e]:.3g} sd²{reasons.get(e, '')}"
            for e, i, j in zip(shown.tolist(), first.tolist(), second.tolist(), strict=True)
        ]
        ends = np.concatenate([pose[first], pose[second]], axis=1)
        scene.lines(layer + left, ends, tint, () if layer == "steps" else labels, dashed=layer == "dropped")
    held = list(solved.fixed)
    scene.points("held", [str(ids[i]) for i in held], pose[held], colour(1), shape="triangle")
    return scene


def _draw_squares(path: Path, solved: SolvedGraph) -> None:
    nis = np.maximum(solved.nis, 1e-6)
    edges = np.geomspace(1e-3, max(1e3, 1.1 * float(nis.max())), 60)
    with figure(path, 7.0, 3.4) as (_, ax):
        ax.hist(np.clip(nis[solved.used], edges[0], None), edges, color=colour(0), label="used")
        if (~solved.used).any():
            ax.hist(np.clip(nis[~solved.used], edges[0], None), edges, color=colour(5), label="dropped")
        ax.axvline(3.0, color=colour(1), linestyle="--", label="what chance gives on average")
        ax.set_xscale("log")
        ax.set_xlabel("squared residual [sd²]")
        ax.set_ylabel("edges")
        ax.legend()
