"""Figures of a team's map: the whole, each robot's part, how sure it is, what robots found out of themselves.

All are drawn from a `TeamStory`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core import se2
from ..core.findings import Finding
from ..core.gaussian import ellipse
from ..core.names import in_order, robot_key
from ..core.records import Track
from ..core.truth import NO_SURVEY, Survey
from ..evaluation.consistency import shape_covariance
from ..evaluation.landmarks import GrowthPoint
from ..evaluation.team import RobotTruth, TeamScore
from ..fusion.result import Fusion
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from ..team.online import OnlineRun
from ..team.smooth import Smoothed
from ..team.team_map import TeamMap
from . import style


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
