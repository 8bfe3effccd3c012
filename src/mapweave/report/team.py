"""The report of a team's map: what came out, how sure it is, why every robot was or was not merged, and the truth.

Of a mixed team too: one map of walls, landmarks and paths, and how everybody was tied in.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.findings import Finding, shortly
from ..core.names import in_order, robot_key
from ..evaluation.consistency import mean_or_none
from ..evaluation.landmarks import exchanges_told
from ..fusion.result import APART
from ..landmarks.landmark_map import LocalMap
from ..laser.laser_map import GridMap
from ..team.mixed import MixedMap
from ..team.online import OnlineRun
from ..team.robot_part import PARAMETERS
from ..team.smooth import Smoothed, is_observed
from ..team.team_map import TeamMap
from . import style, team_figures
from .html import Page, sentence_case, told_list
from .laser_figures import MOST_LAYERS, median_deviation, walls
from .scene import Scene, landmark_points
from .style import colour
from .team_figures import TeamStory, add_growth, growth, landmark_errors, nees_name, track_errors
from .woven import told_merge

MOST_NAMED = 12  # robots in the page's first sentence, and with a switch of their own below the map
CALIBRATED = ("speed scale", "turn scale", "lag [s]", "bearing bias [rad]", "range scale")  # heads of PARAMETERS
KINDS = {
    "landmark": "sightings of landmarks",
    "robot": "sightings of robots",
    "scan": "ties between keyframes of a laser",
    "crossing": "ties between keyframes of two lasers",
}


def write_team_report(folder: Path, story: TeamStory) -> None:
    """`report.html` and `figures/*.png` in `folder`."""
    team = story.maps[0]
    count = "One map" if len(story.maps) == 1 else f"{len(story.maps)} maps"
    page = Page(story.title.replace("One map", count, 1), _lead(story))
    page.verdict(story.findings)
    page.cards(_headline(story), len(story.findings))
    for sentence in _left_out(story):
        page.text(sentence, warn=True)
    figures = folder / "figures"
    page.section("Map" if len(story.maps) == 1 else f"Component 1: {named(team.robots)}")
    _map(page, figures / "fused_map.png", story, team)
    page.warnings(shortly(story.findings, named=True))
    for k, other in enumerate(story.maps[1:], 2):
        page.section(f"Component {k}: {named(other.robots)}")
        _map(page, figures / f"component_{k}.png", story, other)
    if story.score is not None:
        _truth(page, figures, story)
    if story.smoothed:
        _smoothing(page, story)
    if story.run is not None and len(story.run.seconds):
        _online(page, story.run)
    _fusion(page, figures, story)
    _robots(page, figures, story)
    if len(story.growth) > 1:
        page.section("How the map grew")
        _add(page, figures / "growth.png", growth(figures / "growth.png", story.growth))
    page.write(folder / "report.html")


def _add(page: Page, png: Path, caption: str) -> None:
    if caption:
        page.figure(png, caption)


def _map(page: Page, png: Path, story: TeamStory, team: TeamMap) -> None:
    """One component to move about in, its picture kept beside."""
    legend = (
        "Landmarks with the 95 % ellipses of the map's shape, and where the robots drove: a ring where each began, an "
        "arrow with its 95 % ellipse where it was at the time shown."
    )
    page.scene(team_scene(story, team), legend, png)


def team_scene(story: TeamStory, team: TeamMap) -> Scene:
    """The landmarks of one component with the ellipses of its shape, and where its robots drove."""
    scene = Scene("Map of landmarks and of where the robots drove")
    many = len(team.robots) > MOST_NAMED
    for robot in team.robots:
        if robot in team.tracks:
            name = f"robot {robot_key(robot)}"
            scene.track("robots" if many else name, name, team.tracks[robot], style.colour(story.colour_of(robot)))
    landmark_points(scene, team, team_figures.shape(team.landmarks))
    return scene


def _lead(story: TeamStory) -> str:
    tied, of = len(story.maps[0].robots), len(story.robots)
    who = f"{sentence_case(named(story.robots)) if of <= MOST_NAMED else f'{of} robots'}, "
    if len(story.maps) == 1:
        return f"{who}{'all' if tied == of else f'{tied} of {of}'} in one map."
    return f"{who}in {len(story.maps)} maps that nothing ties together; {tied} of {of} in the first."


def _left_out(story: TeamStory) -> list[str]:
    """Which robots are not in the first map and why, those of one reason together."""
    where = {robot: k for k, team in enumerate(story.maps, 1) for robot in team.robots}
    reasons: dict[str, list[str]] = {}
    for d in story.fusion.decisions:
        if where.get(d.robot) != 1:
            why = d.reason.partition(";")[0] if d.decision == "refused" else "shares too few landmarks with it"
            reasons.setdefault(why, []).append(d.robot)
    out = []
    for why, robots in reasons.items():
        first = "the map" if len(story.maps) == 1 else "the first map"
        sentence = f"Not in {first}: {named(robots)}. Why: {why.removesuffix(APART)}."
        parts = sorted({where[r] for r in robots if r in where})
        if parts:
            sentence += f" Below: component{'s' * (len(parts) > 1)} {told_list([str(k) for k in parts])}."
        if why.endswith(APART):
            sentence += " Where a robot is known to have started, the option --start ties it in."
        out.append(sentence)
    return out


def named(robots: Sequence[str]) -> str:
    """`robot 1`, `robots 1, 2 and 3`."""
    keys = [robot_key(robot) for robot in robots]
    return f"robot{'s' * (len(keys) > 1)} {told_list(keys)}"


def _headline(story: TeamStory) -> list[tuple[str, str]]:
    team = story.maps[0]
    cards = [
        ("robots in the map", f"{len(team.robots)} of {len(story.robots)}"),
        ("landmarks", str(len(team.landmarks))),
        ("sightings", f"{sum(sum(m.sightings.values()) for m in story.local):,}"),
    ]
    if len(team.landmarks) > 1:
        sd = np.median(list(team_figures.deviations(team_figures.shape(team.landmarks)).values()))
        cards.append(("median sd of a landmark", f"{sd:.3f} m"))
    if story.score is not None and story.score.landmarks.rmse is not None:
        cards.append(("landmark RMSE", f"{story.score.landmarks.rmse:.3f} m"))
        if story.score.landmarks.nees_per_dof is not None:
            cards.append((nees_name(story.score.landmarks.dof), f"{story.score.landmarks.nees_per_dof:.2f}"))
    if story.score is not None:
        ates = [r.ate for r in story.score.robots.values() if r.ate is not None]
        if ates:
            cards.append(("mean ATE", f"{sum(ates) / len(ates):.3f} m"))
    return cards


def _truth(page: Page, figures: Path, story: TeamStory) -> None:
    score = story.score
    assert score is not None  # noqa: S101  (the caller looked)
    page.section("Against the truth")
    for sentence in exchanges_told(score.exchanges):
        page.text(sentence, warn=True)
    if score.landmarks.alignment is not None:
        name = figures / "landmark_errors.png"
        _add(page, name, landmark_errors(name, story, score))
        head = ["map", "landmark RMSE [m]", "NEES / dof", "against fused"]
        rows: list[list[object]] = [["fused", score.landmarks.rmse, score.landmarks.nees_per_dof, None]]
        for label, value in (("naive average", score.naive_rmse), ("mean single robot", score.mean_single_rmse)):
            against = f"{value / score.landmarks.rmse:.2f} times" if value and score.landmarks.rmse else None
            rows.append([label, value, None, against])
        if score.landmarks_exchanged is not None:
            mended = score.landmarks_exchanged
            rows.append(["fused, labels exchanged back", mended.rmse, mended.nees_per_dof, None])
        page.table(head, rows)
    page.table(
        ["robot", "ATE [m]", "poses", "truth used", "own map RMSE [m]", "drift in 10 s [m]"],
        [[robot_key(n), r.ate, r.n, r.truth, r.single_map_rmse, r.rpe_trans] for n, r in score.robots.items()],
        [_tint(story, n) for n in score.robots],
    )
    name = figures / "track_errors.png"
    _add(page, name, track_errors(name, story, score))


def measured(used: Mapping[str, int]) -> str:
    """How many measurements of each kind a problem had."""
    return ", ".join(f"{n:,} {KINDS.get(kind, kind)}" for kind, n in sorted(used.items()))


def _smoothing(page: Page, story: TeamStory) -> None:
    """What the whole team's one problem was, and what it found of every robot."""
    page.section("The whole team at once")
    for k, s in enumerate(story.smoothed, 1):
        where = "" if len(story.smoothed) == 1 else f"Component {k}: "
        if s.refused:
            page.text(f"{where}the map is the fused filters': {s.refused}.", warn=bool(s.used))
            continue
        page.text(
            f"{where}{s.poses:,} poses, all landmarks and every robot's calibration in one least-squares problem, "
            f"started at the fused filters; {measured(s.used)}. {s.iterations} iterations, {s.status}."
        )
    if story.filter_score is not None and story.score is not None:
        scores = (("fused filters", story.filter_score), ("smoothed", story.score))
        rows: list[list[object]] = []
        for name, score in scores:
            ate = mean_or_none([r.ate for r in score.robots.values()])
            rows.append([name, score.landmarks.rmse, ate, score.landmarks.nees_per_dof])
        page.table(["map", "landmark RMSE [m]", "mean ATE [m]", "NEES / dof"], rows)
    calibrations(page, story.smoothed, {robot: _tint(story, robot) for robot in story.robots})


def calibrations(page: Page, smoothed: Sequence[Smoothed], tints: Mapping[str, str]) -> None:
    """The table of what was found of every robot's wheels and camera; tints: robot -> its colour, in order."""
    every = {robot: known for s in smoothed for robot, known in s.calibration.items() if known}
    told = {robot: every[robot] for robot in tints if robot in every}
    if told:
        rows = [[robot_key(r), *(_found(known, p, smoothed[0]) for p in PARAMETERS)] for r, known in told.items()]
        page.table(["robot", *CALIBRATED], rows, [tints[robot] for robot in told])
        page.text("With one standard deviation. An asterisk: the data added little to what was assumed.")


def _found(known: Mapping[str, tuple[float, float]], name: str, smoothed: Smoothed) -> str:
    if name not in known:
        return ""
    value, sd = known[name]
    return f"{value:.3f} ± {sd:.3f}{'' if is_observed(name, sd, smoothed.prior) else ' *'}"


def _online(page: Page, run: OnlineRun) -> None:
    """What smoothing took while the logs played, and what was left to do at their end."""
    page.section("While the logs played")
    page.text(
        f"{len(run.seconds):,} steps of {run.step:g} s; in each {run.linearised.mean():.1f} of {run.stretches} "
        f"stretches of time were linearised, {run.renewed} times an older one that had moved. Robots or landmarks "
        f"were added {len(run.laid_out)} times, and the whole problem was set up again. Nothing was marginalised for "
        "good: a stretch is linearised again when its poses, landmarks or calibrations have moved."
    )
    timing = run.timing()
    names = (("a step", "step"), ("lag: oldest row to map", "lag"))
    page.table(
        ["", "mean [s]", "99 % [s]", "longest [s]"],
        [[label, *(timing[f"{key}_{which}"] for which in ("mean", "p99", "max"))] for label, key in names],
    )
    if run.landmarks_moved is not None:
        ways = "" if run.ways_moved is None else f", trajectories by {run.ways_moved:.4f} m"
        page.text(
            f"When the logs ended, smoothing everything to the end took {run.closing:.2f} s and moved landmarks by "
            f"{run.landmarks_moved:.4f} m{ways} (root mean square)."
        )


def _fusion(page: Page, figures: Path, story: TeamStory) -> None:
    page.section("Fusion")
    rows = [
        [robot_key(d.robot), d.shared, d.decision, d.scale, d.variance_factor, d.reason] for d in story.fusion.decisions
    ]
    head = ["robot", "landmarks shared", "decision", "scale", "variance factor", "reason"]
    page.table(head, rows, [_tint(story, d.robot) for d in story.fusion.decisions])
    page.text(
        "Scale: found for each robot's own map. Variance factor: by how much its covariance was multiplied so that the "
        "maps agree as well as they should; below 1 it was too cautious."
    )
    if len(story.maps[0].landmarks):
        name = figures / "local_maps.png"
        _add(page, name, team_figures.local_against_fused(name, story))
        name = figures / "uncertainty.png"
        _add(page, name, team_figures.uncertainty(name, story))


def _robots(page: Page, figures: Path, story: TeamStory) -> None:
    page.section("Robots")
    page.table(
        ["robot", "odometry", "sightings", "landmarks", "robots seen", "dropped", "down-weighted", "median NIS"],
        [_robot_row(m) for m in sorted(story.local, key=lambda m: story.colour_of(m.robot))],
        [_tint(story, robot) for robot in story.robots],
    )
    page.text(
        "Median NIS per degree of freedom: near 1 where innovations are as large as the filter expects, well below 1 "
        "when variances are widened for errors that last for seconds, above 3 when something is wrong."
    )
    name = figures / "calibration.png"
    _add(page, name, team_figures.calibration(name, story))


def _tint(story: TeamStory, robot: str) -> str:
    return style.colour(story.colour_of(robot)) if robot in story.robots else style.MUTED


def _robot_row(m: LocalMap) -> list[object]:
    seen = sum(m.sightings.values())
    dropped = sum(m.dropped.values())
    reasons = "; ".join(f"{n} {reason}" for reason, n in m.dropped.items())
    return [
        robot_key(m.robot),
        m.odometry,
        seen,
        len(m.submap.ids),
        len(m.robot_sightings.t),
        f"{dropped} ({reasons})" if dropped else 0,
        f"{100 * m.down_weighted / seen:.1f} %" if seen else None,
        m.nis_median,
    ]


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
            page.warnings(shortly(story.findings, named=True))
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
