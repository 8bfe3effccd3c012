"""Figures of a team's map: the whole, each robot's part, how sure it is, what robots found out of themselves.

All are drawn from a `TeamStory`. And a score as a page and figures: what was measured against the truth, and how the
map grew towards it.
"""

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.gaussian import chi2_quantile, ellipse
from ..core.names import in_order, robot_key
from ..core.records import Track
from ..core.truth import NO_SURVEY, Survey
from ..evaluation.consistency import shape_covariance
from ..evaluation.landmarks import GrowthPoint
from ..evaluation.team import RobotTruth, TeamScore
from ..evaluation.trajectory import paired
from ..fusion.result import Fusion
from ..io.directory import result_file
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..report import style
from ..team.online import OnlineRun
from ..team.smooth import Smoothed
from ..team.team_map import TeamMap
from .html import Page
from .style import Target, figure, larger, legend_beside


@dataclass(frozen=True, slots=True)
class TeamStory:
    """The fused components (largest first), what each robot handed over, why each was merged or not, and the scores."""

    title: str
    maps: Sequence[TeamMap]
    local: Sequence[LocalMap]
    fusion: Fusion
    growth: Sequence[GrowthPoint] = ()
    score: TeamScore | None = None
    survey: Survey = NO_SURVEY
    truths: Mapping[str, RobotTruth] = field(default_factory=dict)
    smoothed: Sequence[Smoothed] = ()
    filter_score: TeamScore | None = None
    findings: Sequence[Finding] = ()
    run: OnlineRun | None = None

    @property
    def robots(self) -> tuple[str, ...]:
        """All robots in order; the place in it gives a robot its colour."""
        return tuple(sorted((m.robot for m in self.local), key=in_order))

    def colour_of(self, robot: str) -> int:
        return self.robots.index(robot)


def thinned(track: Track, most: int = 3000) -> np.ndarray:
    """At most `most` poses of a track, its ends among them, and one of NaN in each gap: no line goes through."""
    at = np.unique(np.linspace(0, len(track.t) - 1, min(len(track.t), most)).astype(int))
    return np.asarray(np.insert(track.pose[at], np.unique(np.searchsorted(at, style.gaps(track.t))), np.nan, axis=0))


MOST_PANELS = 12
MANY = 40  # landmarks from which labels would cover the map
# parameter, its name, and the value that changes nothing
CALIBRATION = (
    ("turn_scale", "turn scale", 1.0),
    ("speed_scale", "speed scale", 1.0),
    ("range_scale", "range scale", 1.0),
    ("lag", "command lag [s]", 0.0),
    ("bearing_bias", "bearing bias [rad]", 0.0),
)


def shape(landmarks: LandmarkMap) -> LandmarkMap:
    """The map with the covariance of its shape alone, its frame left free: what one wants to see."""
    if len(landmarks) < 2:
        return landmarks
    return LandmarkMap(landmarks.ids, landmarks.mean, shape_covariance(landmarks.mean, landmarks.cov), landmarks.frame)


def half_axis(landmarks: LandmarkMap) -> float:
    """The larger half axis of the 95 % ellipse of a typical landmark [m]."""
    blocks = (landmarks.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(len(landmarks)))
    return float(np.median([ellipse(block)[0] for block in blocks]))


def local_against_fused(path: Path, story: TeamStory) -> str:
    """Every robot's own landmarks laid over the fused ones. The caption is returned."""
    team = story.maps[0]
    own = {m.robot: m.submap.landmarks for m in story.local}
    there = [r for r in team.robots if r in own]
    robots = there[:MOST_PANELS]
    columns = 2 if len(robots) == 4 else min(3, max(1, len(robots)))
    rows = -(-len(robots) // columns)
    scales = {r: c.scales.get(r, 1.0) for c in story.fusion.components for r in c.robots}
    laid = {r: _laid_over(own[r], scales.get(r, 1.0), team.landmarks) for r in robots}  # 1: a robot placed afterwards
    size = float(np.ptp(team.landmarks.mean, axis=0).max())
    typical = float(np.median(np.concatenate([np.hypot(*(p - q).T) for p, q in laid.values()])))
    grow = style.larger(typical, 0.04 * size)
    with style.figure(path, 3.3 * columns + 0.4, 2.9 * rows + 0.3, nrows=rows, ncols=columns, squeeze=False) as (
        _,
        axes,
    ):
        for ax in axes.ravel()[len(robots) :]:
            ax.set_axis_off()
        for ax, robot in zip(axes.ravel(), robots, strict=False):
            placed, fused = laid[robot]
            ax.plot(*team.landmarks.mean.T, ".", color=style.MUTED, ms=4, zorder=1)
            k = story.colour_of(robot)
            for p, q in zip(placed, fused, strict=True):
                end = q + grow * (p - q)
                ax.plot([q[0], end[0]], [q[1], end[1]], color=style.colour(k), lw=1.1, zorder=2)
                ax.plot(*end, style.marker(k), color=style.colour(k), ms=3.5, mfc="white", mew=1.1, zorder=3)
            far = f", {100 * np.sqrt(np.mean(np.sum((placed - fused) ** 2, axis=1))):.1f} cm off" if len(placed) else ""
            style.as_map(ax, f"robot {robot_key(robot)}\n{len(own[robot])} landmarks{far}")
    apart = f"; differences drawn {grow} times larger" if grow > 1 else ""
    some = (
        f" Robots {robot_key(robots[0])} to {robot_key(robots[-1])} of {len(there)}."
        if len(robots) < len(there)
        else ""
    )
    return f"Each robot's own landmarks beside the fused ones (grey dots), aligned{apart}." + some


def uncertainty(path: Path, story: TeamStory) -> str:
    """Standard deviations of every landmark, fused and in each robot's own map. The caption is returned."""
    team = story.maps[0]
    fused = deviations(shape(team.landmarks))
    names = sorted(fused, key=in_order)
    at = {name: i for i, name in enumerate(names)}
    with style.figure(path, 8.4, 3.4) as (_, ax):
        many = len(team.robots) > MOST_PANELS
        for m in story.local:
            if m.robot in team.robots:
                own = {name: sd for name, sd in deviations(shape(m.submap.landmarks)).items() if name in at}
                k = story.colour_of(m.robot)
                marks: Any = {"color": style.colour(k), "mfc": "none", "ms": 5, "label": f"robot {robot_key(m.robot)}"}
                if many:
                    marks = {"color": style.MUTED, "ms": 2.5, "mew": 0, "label": None if ax.lines else "a robot alone"}
                ax.plot([at[n] for n in own], list(own.values()), "o" if many else style.marker(k), ls="none", **marks)
        ax.plot(range(len(names)), [fused[n] for n in names], "_", color=style.INK, ms=11, mew=2.2, label="fused")
        ax.set_yscale("log")
        ax.set_ylabel("standard deviation of position [m]")
        ax.set_xlabel("landmark")
        if len(names) <= MANY:
            ax.set_xticks(
                range(len(names)), [*map(style.brief, names)], rotation=90 if max(map(len, names), default=0) > 3 else 0
            )
        ax.grid(visible=False, axis="x")
        ax.set_title("What fusing gains")
        style.legend_beside(ax, 10)
    return (
        "Standard deviation of each landmark's position, in the frame left free: every robot alone, and all together."
    )


def calibration(path: Path, story: TeamStory) -> str:
    """What each robot estimated about its own wheels and camera. The caption is returned."""
    there = [c for c in CALIBRATION if any(m.calibration.get(c[0], (0.0, 0.0))[1] > 0 for m in story.local)]
    if not there:
        return ""
    robots = story.robots
    by = {m.robot: m.calibration for m in story.local}
    height = 0.9 + 0.28 * len(robots)
    with style.figure(path, 2.3 * len(there) + 0.6, height, ncols=len(there), squeeze=False, sharey=True) as (_, axes):
        for ax, (name, label, neutral) in zip(axes[0], there, strict=True):
            ax.axvline(neutral, color=style.MUTED, lw=1.0, ls="--")
            for k, robot in enumerate(robots):
                value, sd = by[robot].get(name, (np.nan, np.nan))
                if sd > 0:
                    ax.errorbar(value, k, xerr=2 * sd, fmt=style.marker(k), color=style.colour(k), capsize=2.5, ms=5)
            ax.set_yticks(range(len(robots)), [style.brief(f"robot {robot_key(r)}") for r in robots])
            ax.set_ylim(len(robots) - 0.5, -0.5)
            ax.set_xlabel(label)
            ax.locator_params(axis="x", nbins=4)
    return "What each robot found out about its wheels and camera, with two standard deviations; dashed: perfect."


def _laid_over(own: LandmarkMap, scale: float, fused: LandmarkMap) -> tuple[np.ndarray, np.ndarray]:
    """A robot's landmarks that are in the fused map, rigidly aligned to it, and their places there."""
    where = {name: i for i, name in enumerate(fused.ids)}
    both = [i for i, name in enumerate(own.ids) if name in where]
    there = fused.mean[[where[own.ids[i]] for i in both]].reshape(-1, 2)
    mine = own.mean[both].reshape(-1, 2) / scale
    return (se2.act(se2.align(mine, there), mine) if len(both) > 1 else there), there


def deviations(landmarks: LandmarkMap) -> dict[str, float]:
    """Standard deviation of every landmark's position along one axis [m]: the root mean square over both."""
    variance = np.diag(landmarks.cov).reshape(-1, 2).sum(axis=1)
    return dict(zip(landmarks.ids, np.sqrt(0.5 * variance).tolist(), strict=True))


MOST = 40  # errors drawn one by one
WORDS = {
    "landmark_rmse": "landmark RMSE [m]",
    "landmark_n": "landmarks scored",
    "landmark_unsurveyed": "landmarks without a survey",
    "nees_per_dof": "NEES per degree of freedom (honest: 1)",
    "dof": "degrees of freedom",
    "mean_single_rmse": "landmark RMSE of one robot alone, mean [m]",
    "naive_rmse": "landmark RMSE of the plain average [m]",
    "ratio_to_naive": "of the plain average's RMSE",
    "ratio_to_mean_single": "of one robot's RMSE",
    "mean_ate": "mean ATE [m]",
    "rmse": "RMSE [m]",
    "crlb_rmse": "Cramér-Rao bound of the RMSE [m]",
    "rmse_over_crlb": "RMSE over the bound",
    "distance_error": "distance error [m]",
    "angle_error_deg": "angle error [°]",
}


def nees_name(dof: int | None) -> str:
    """What NEES per degree of freedom is called: with the values between which 95 % of honest maps lie."""
    if not dof:
        return "NEES per degree of freedom (honest: 1)"
    low, high = (chi2_quantile(share, float(dof)) / dof for share in (0.025, 0.975))
    return f"NEES per degree of freedom (honest: {low:.1f} to {high:.1f})"


def _in_words(rows: Sequence[Sequence[object]]) -> list[Sequence[object]]:
    """Rows of a score under names for people."""
    return [(WORDS.get(str(name), str(name).replace("_", " ")), *values) for name, *values in rows]


def headline_scores(score: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The figures of a score, as `metrics.json` holds it, that belong on top of a page."""
    figures = (
        ("landmark RMSE", score.get("landmark_rmse"), "{:.3f} m"),
        ("RMSE", score.get("rmse"), "{:.3g} m"),
        (nees_name(score.get("dof")), score.get("nees_per_dof"), "{:.2f}"),
        ("mean ATE", score.get("mean_ate"), "{:.3f} m"),
        ("mean error of relations", (score.get("relations") or {}).get("trans_mean"), "{:.3f} m"),
    )
    return [(name, form.format(value)) for name, value, form in figures if value is not None]


def write_score_report(
    folder: Path, lines: Sequence[str], rows: Sequence[Sequence[object]], draw: Callable[[Target], object]
) -> None:
    """`report.html` and `figures/errors.png` in `folder`."""
    page = Page("Score against the truth", lines[0] if lines else "")
    for line in lines[1:]:
        page.text(line)
    draw(folder / "figures" / "errors.png")
    page.figure(folder / "figures" / "errors.png", "Errors against the truth.")
    page.table(("what", "value"), _in_words(rows))
    page.write(folder / "report.html")


def add_score(
    report: Path,
    truth: Sequence[str],
    lines: Sequence[str],
    rows: Sequence[Sequence[object]],
    draw: Callable[[Target], object],
    score: Mapping[str, Any],
) -> None:
    """The page `report` tells the score against `truth` on top and before its files, in place of the one before.

    score: the score as `metrics.json` holds it. The picture stands beside too, as `figures/score.png`. Each file is
    replaced whole.
    """
    page = Page("")
    page.section(f"Score against {', '.join(truth)}")
    for line in lines:
        page.text(line)
    with tempfile.TemporaryDirectory() as name:
        png = Path(name) / "score.png"
        draw(png)
        page.figure(png, "Errors against the truth.")
        with result_file(report.parent / "figures" / png.name) as work:
            shutil.copyfile(png, work)
    page.table(("what", "value"), _in_words(rows))
    text = page.put_into(report.read_text(encoding="utf-8", errors="replace"), "score")
    top = Page("")
    if figures := headline_scores(score):
        said = ", ".join(f"{name.partition(' (')[0]} {value}" for name, value in figures)
        top.text(f"Against {', '.join(truth)}: {said}.")
    text = top.put_into(text, "score-top", top=True)
    with result_file(report) as work:
        work.write_text(text, encoding="utf-8", errors="backslashreplace")


def draw_team_score(target: Target, score: TeamScore) -> None:
    """Every landmark's error, largest first, and every robot's absolute trajectory error [m]."""
    far = np.hypot(*score.landmarks.errors.T) if len(score.landmarks.ids) else np.zeros(0)
    order = np.argsort(-far)[:MOST]
    landmarks = {score.landmarks.ids[k]: float(far[k]) for k in order.tolist()}
    robots = {f"robot {robot_key(name)}": r.ate for name, r in score.robots.items() if r.ate is not None}
    draw_bars(target, {"landmark error [m]": landmarks, "trajectory error, RMS [m]": robots})


def draw_tracks(target: Target, estimate: Track, truth: Track, T: Float[np.ndarray, "4 4"]) -> None:
    """Two trajectories from above; T: motion of the estimate into the truth's frame."""
    at = np.column_stack([estimate.pose[:, :2], np.zeros((len(estimate.t), 1)), np.ones(len(estimate.t))]) @ T.T
    with figure(target) as (_, ax):
        ax.plot(*truth.pose[:, :2].T, color=style.TRUTH, lw=1.0, label="truth")
        ax.plot(*at[:, :2].T, color=style.PALETTE[0], label="estimate, aligned")
        ax.legend()
        style.as_map(ax)


def draw_bars(target: Target, groups: Mapping[str, Mapping[str, float]]) -> None:
    """Horizontal bars, one panel a group (its name with the unit), empty groups left out."""
    shown = {name: bars for name, bars in groups.items() if bars} or {"nothing was scored": {}}
    most = max(1, *(len(bars) for bars in shown.values()))
    with figure(target, 4.2 * len(shown) + 0.4, 0.22 * most + 1.1, ncols=len(shown), squeeze=False) as (_, axes):
        for ax, (name, bars) in zip(axes[0], shown.items(), strict=True):
            ax.barh(list(bars)[::-1], list(bars.values())[::-1], color=style.LANDMARK, height=0.7)
            ax.set_xlabel(name)
            ax.grid(visible=False, axis="y")


def landmark_errors(path: Path, story: TeamStory, score: TeamScore) -> str:
    """Errors as arrows beside ellipses drawn as many times larger. The caption is returned."""
    landmarks = story.maps[0].landmarks.select(score.landmarks.ids)
    T = score.landmarks.alignment
    if T is None:
        return ""
    aligned, back = shape(landmarks), se2.inverse(T)  # all in the map's frame, as the rest of the page
    true = se2.act(back, se2.act(T, aligned.mean) - score.landmarks.errors)
    errors = aligned.mean - true
    size = float(np.ptp(true, axis=0).max())
    typical = float(np.median(np.hypot(*errors.T)))
    grow = min(larger(typical, 0.04 * size), larger(half_axis(aligned), 0.06 * size))
    times, both = (f", {grow} times", f", both drawn {grow} times larger") if grow > 1 else ("", "")
    with style.figure(path, 8.4, 6.0) as (_, ax):
        for robot in story.maps[0].robots:
            if robot in story.truths and robot in story.maps[0].tracks:
                pose = se2.act(back, thinned(story.truths[robot].track)[:, :2])
                line = "-" if story.truths[robot].kind == "Groundtruth" else "."
                ax.plot(
                    pose[:, 0], pose[:, 1], line, color=style.colour(story.colour_of(robot)), lw=0.6, ms=1, alpha=0.35
                )
        ax.plot(*true.T, "x", color=style.TRUTH, ms=5, mew=1.2, label="surveyed")
        for i, (p, e) in enumerate(zip(true, errors, strict=True)):
            P = aligned.cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            style.draw_ellipse(ax, p, P, style.colour(0), grow, zorder=2)
            ax.annotate("", p + grow * e, p, arrowprops={"arrowstyle": "-|>", "color": style.colour(5), "lw": 1.4})
        if len(true) <= MANY:
            style.name_points(ax, aligned.ids, true)
        ax.plot([], [], color=style.colour(5), label=f"error{times}")
        ax.plot([], [], color=style.colour(0), label=f"95 % ellipse{times}")
        style.as_map(ax, "The fused map beside the survey")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return (
        f"Errors (arrows) and 95 % ellipses{both}, at the surveyed places: in an honest map "
        "about one arrow in twenty leaves its ellipse. Faint: where the robots truly drove."
    )


def track_errors(path: Path, story: TeamStory, score: TeamScore) -> str:
    """Position error of every robot over time. The caption is returned."""
    team = story.maps[0]
    known = [r for r in team.robots if r in story.truths and r in team.tracks]
    if score.alignment is None or not known:
        return ""
    start = min(team.tracks[r].t[0] for r in known)
    with style.figure(path, 8.4, 3.2) as (_, ax):
        for robot in known:
            truth = story.truths[robot]
            ours, true, t = paired(team.tracks[robot], truth.track, dense=truth.dense)
            if len(t):
                error = np.hypot(*(se2.act(score.alignment, ours[:, :2]) - true[:, :2]).T)
                line = "-" if truth.dense else style.marker(story.colour_of(robot))
                k, ate = story.colour_of(robot), score.robots[robot].ate
                label = f"robot {robot_key(robot)}: ATE {ate:.3f} m"
                ax.plot((t - start) / 60, error, line, color=style.colour(k), lw=0.9, ms=2.5, label=label)
        ax.set_ylim(bottom=0)
        ax.set_xlabel("time since the first row [min]")
        ax.set_ylabel("position error [m]")
        ax.set_title("Where each robot thought it was, against the truth")
        legend_beside(ax, 10)
    return "Distance between estimated and true position, under the alignment fitted to the landmarks."


def growth(path: Path, points: Sequence[GrowthPoint]) -> str:
    """The global map over time: trace, log-determinant, error, consistency, robots tied in. The caption is returned."""
    t = np.array([p.t for p in points]) / 60
    scored = any(p.rmse is not None for p in points)
    panels = [
        ("trace of covariance [m²]", [p.trace for p in points], True),
        ("log det of covariance", [p.log_det for p in points], False),
    ]
    if scored:
        panels += [
            ("landmark RMSE [m]", [p.rmse for p in points], True),
            ("NEES per degree of freedom", [p.nees_per_dof for p in points], True),
        ]
    panels += [("landmarks in the map", [p.landmarks for p in points], False)]
    panels += [("robots tied in", [p.robots for p in points], False)]
    rows = len(panels) // 2
    with style.figure(path, 8.4, 2.0 * rows + 0.3, nrows=rows, ncols=2, sharex=True) as (_, axes):
        for ax, (label, values, log) in zip(np.ravel(axes), panels, strict=True):
            y = np.array([np.nan if v is None else v for v in values], dtype=float)
            if log and np.isfinite(y).any() and (y[np.isfinite(y)] > 0).all():
                ax.set_yscale("log")
            whole = label.startswith(("landmarks", "robots"))
            ax.plot(t, y, color=style.colour(0), drawstyle="steps-post" if whole else "default", marker=".", ms=4)
            ax.set_ylabel(label)
            if whole:
                ax.set_ylim(bottom=0)
                ax.yaxis.get_major_locator().set_params(integer=True)
            if label.startswith("NEES"):
                _band(ax, t, points)
        for ax in np.ravel(axes)[-2:]:
            ax.set_xlabel("time since the first row [min]")
    honest = " Shaded: where 95 % of honest maps would lie." if scored else ""
    return f"The global map while the logs played: every robot's fresher map replaces its older one.{honest}"


def add_growth(page: Page, folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """A section on how many robots the largest map holds, and how many maps there are, over time.

    rows: with `t` [s], `robots` and `maps`; of fewer than two nothing is told.
    """
    if len(rows) < 2:
        return
    path = folder / "figures" / "growth.png"
    t = [row["t"] / 60 for row in rows]
    with style.figure(path, 8.4, 2.3) as (_, ax):
        for k, (key, label) in enumerate((("robots", "robots in the largest map"), ("maps", "maps"))):
            values = [row[key] for row in rows]
            ax.plot(t, values, color=style.colour(k), drawstyle="steps-post", marker=".", ms=4, lw=2.2 - k, label=label)
        ax.set_ylim(bottom=0)
        ax.yaxis.get_major_locator().set_params(integer=True)
        ax.set_xlabel("time since the first row [min]")
        legend_beside(ax, 10)
    page.section("How the map grew")
    page.figure(path, "The map of what the logs held until then, made anew each time.")


def _band(ax: object, t: np.ndarray, points: Sequence[GrowthPoint]) -> None:
    dof = np.array([max(1, 2 * p.landmarks - 3) for p in points], dtype=float)
    low = np.array([chi2_quantile(0.025, d) / d for d in dof])
    high = np.array([chi2_quantile(0.975, d) / d for d in dof])
    ax.fill_between(t, low, high, color=style.MUTED, alpha=0.25, lw=0)  # type: ignore[attr-defined]
