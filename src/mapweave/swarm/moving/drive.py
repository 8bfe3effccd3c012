"""Robots that drive with odometry while they sight each other, with or without common axes."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.bearings import BearingTable
from ...core.errors import DataError
from ...core.records import Odometry
from ...core.workers import Progress, no_progress
from ..headings import relative_odometry_frame
from .poses import PoseProblem
from .result import (
    GROW_KERNEL,
    MEETING_FLOOR,
    MEETING_OUTLIER,
    TRACK_ENOUGH,
    TRACK_MEETING,
    TRACK_WINDOW,
    RobotTrajectory,
    SwarmTrack,
    TrackConfig,
    without_outliers,
)
from .smooth import solve_velocity


def grow(problem: PoseProblem, cfg: TrackConfig, on_progress: Progress = no_progress) -> tuple[np.ndarray, set[int]]:
    """A start for all poses, and the robots that could be placed in the one frame.

    Begins in the window of time in which most robots are tied best, then goes forward and backward window by window;
    a robot joins when its sightings with those already placed fix it.
    """
    stamps = problem.table.t
    assert stamps is not None  # noqa: S101
    edges = np.arange(stamps.min(), stamps.max() + TRACK_WINDOW, TRACK_WINDOW)
    count = len(edges) - 1
    window = np.clip(np.searchsorted(edges, stamps, side="right") - 1, 0, count - 1)
    begin = max(range(count), key=lambda w: _tied(problem, window == w, TRACK_ENOUGH))
    x = problem.x0
    x[problem.index] = problem.own
    root = _busiest(problem, window == begin)
    placed = {root}
    robust = replace(cfg, kernel=cfg.kernel or GROW_KERNEL)
    sigma = float(np.median(problem.table.sigma))
    # The rms bearing error under which a meeting is believed: noise, and what the odometry turns astray meanwhile.
    good = float(np.sqrt((TRACK_MEETING * sigma) ** 2 + cfg.turn_floor**2 * TRACK_WINDOW)) + MEETING_FLOOR
    windows = [*range(begin, count), *range(begin - 1, -1, -1), *range(begin, count)]
    for done, w in enumerate(windows):
        on_progress("growing tracks", done, len(windows))
        low, high = edges[w], edges[w + 1]
        _join(problem, x, placed, window == w, good)
        still = ~np.isin(problem.line.robot, list(problem.odometry))
        inside = (problem.line.t >= low - TRACK_WINDOW) & (problem.line.t <= high + TRACK_WINDOW * (w < begin))
        reached = _reached(problem, w, begin, edges)
        x = problem.solve(x, placed, robust, hold_anchors=False, active=(inside & reached) | still).x
        _carry(problem, x, placed, w, begin, edges)
    on_progress("growing tracks", len(windows), len(windows))
    if len(placed) < 2:
        raise DataError("no two robots sight each other enough to tell how they stand to each other")
    return x, placed


def _tied(problem: PoseProblem, rows: np.ndarray, enough: int) -> tuple[int, float]:
    """The size of the largest group of robots that sightings `rows` connect, and the sightings of its weakest link."""
    counts: dict[tuple[int, int], int] = {}
    for a, b in zip(problem.table.observer[rows].tolist(), problem.table.target[rows].tolist(), strict=True):
        counts[min(a, b), max(a, b)] = counts.get((min(a, b), max(a, b)), 0) + 1
    group: dict[int, set[int]] = {}
    size, weakest = 0, 0.0
    for (a, b), c in sorted(counts.items(), key=lambda item: -item[1]):
        if c < enough or b in group.get(a, {a}):
            continue
        joined = group.get(a, {a}) | group.get(b, {b})
        for k in joined:
            group[k] = joined
        if len(joined) > size:
            size, weakest = len(joined), float(c)
    return size, weakest


def _busiest(problem: PoseProblem, rows: np.ndarray) -> int:
    both = np.concatenate([problem.table.observer[rows], problem.table.target[rows]])
    return int(np.bincount(both).argmax())


def _join(problem: PoseProblem, x: np.ndarray, placed: set[int], rows: np.ndarray, good: float) -> None:
    """Robots that the sightings `rows` tie to those placed are placed too, the best tied first; x is changed."""
    refused: set[int] = set()
    while True:
        a, b = problem.table.observer, problem.table.target
        inside = np.isin(a, list(placed)), np.isin(b, list(placed))
        tie = rows & (inside[0] != inside[1])
        other = np.where(inside[0], b, a)
        counts = np.bincount(other[tie], minlength=len(problem.table.ids))
        counts[list(refused)] = 0
        new = int(counts.argmax())
        if counts[new] < TRACK_ENOUGH:
            return
        use = np.flatnonzero(tie & (other == new))
        by_placed = inside[0][use]
        here = np.where(by_placed, problem.line.observer[use], problem.line.target[use])
        there = np.where(by_placed, problem.line.target[use], problem.line.observer[use])
        T, error = relative_odometry_frame(
            x[problem.index[here]],
            problem.own[there],
            problem.table.bearing()[use],
            by_placed,
            MEETING_OUTLIER * good,
        )
        if np.sqrt(error) > good:
            refused.add(new)
            continue
        knots = problem.index[problem.line.of(new)]
        x[knots] = se2.compose(T, problem.own[problem.line.of(new)])
        placed.add(new)


def _reached(problem: PoseProblem, w: int, begin: int, edges: np.ndarray) -> np.ndarray:
    """Which knots lie in the span of time grown so far."""
    low, high = edges[min(w, begin)], edges[w + 1] if w >= begin else np.inf
    return np.asarray((problem.line.t >= low) & (problem.line.t <= high))


def _carry(problem: PoseProblem, x: np.ndarray, placed: set[int], w: int, begin: int, edges: np.ndarray) -> None:
    """Knots not reached yet follow from the nearest one that is, by odometry; x is changed."""
    for robot in placed & set(problem.odometry):
        rows = problem.line.of(robot)
        t, own = problem.line.t[rows], problem.own[rows]
        here = np.flatnonzero((t >= edges[min(w, begin)]) & (t <= edges[w + 1]))
        if not len(here):
            continue
        pose = x[problem.index[rows]]
        if w >= begin and here[-1] + 1 < len(t):
            T = se2.compose(pose[here[-1]], se2.inverse(own[here[-1]]))
            x[problem.index[rows][here[-1] + 1 :]] = se2.compose(T, own[here[-1] + 1 :])
        if w <= begin and here[0] > 0:
            T = se2.compose(pose[here[0]], se2.inverse(own[here[0]]))
            x[problem.index[rows][: here[0]]] = se2.compose(T, own[: here[0]])


Anchors = Mapping[int, Float[np.ndarray, "2"]]


def smooth_driving(
    table: BearingTable,
    odometry: Mapping[int, Odometry],
    anchors: Anchors,
    cfg: TrackConfig | None = None,
    *,
    covariance: bool = True,
    on_progress: Progress = no_progress,
) -> SwarmTrack:
    """The most probable motion of robots in the plane given sightings and odometry, found without a guess.

    A robot without odometry stands still, anchors too. In common axes two anchors are needed for the start; without
    them none: the frame is then the first pose of the robot named in `gauge`. Raises DataError otherwise.
    """
    cfg = cfg or TrackConfig()
    if table.dim != 2:
        raise DataError("odometry moves robots in the plane; the sightings are of three dimensions")
    problem = PoseProblem.of(table, odometry, anchors, cfg)
    warnings: list[str] = []
    if table.axis:
        x = _from_velocity(problem, table, anchors, cfg)
        placed = set(np.unique(problem.line.robot).tolist())
    else:
        x, placed = grow(problem, cfg, on_progress)
        x = _onto_anchors(problem, x, anchors, placed)
    on_progress("smoothing", 0, 2)
    solution = problem.solve(x, placed, cfg, hold_anchors=len(set(anchors) & placed) >= 2, iterations=100)
    on_progress("smoothing", 1, 2)
    lost = sorted(set(np.unique(problem.line.robot).tolist()) - placed)
    if lost:
        names = ", ".join(table.ids[k] for k in lost[:10])
        warnings.append(f"{len(lost)} robots are never tied to the others: {names}")
    warnings += [
        f"robot {table.ids[k]} has no odometry: taken to stand still"
        for k in sorted(placed - set(odometry) - set(anchors))
    ]
    cov = None
    if covariance and solution.information is not None:
        cov = solution.dissected(*problem.places_in_time()).blocks(problem.index[:, :2])
    on_progress("smoothing", 2, 2)
    out, chi2, dof = without_outliers(problem.sighted(placed).squares(solution.x), 1, solution, cfg)
    tracks = {}
    for robot in sorted(placed):
        rows = problem.line.of(robot)
        pose = solution.x[problem.index[rows]]
        own = None if cov is None else cov[rows]
        tracks[robot] = RobotTrajectory(problem.line.t[rows], pose[:, :2], own, pose[:, 2])
    scale = {k: (1.0 + solution.x[c], 1.0 + solution.x[d]) for k, (c, d) in problem.scales.items() if k in placed}
    gauge = (
        ""
        if len(set(anchors) & placed) >= 2
        else f"place and turn free (the frame is the first pose of robot {table.ids[problem.root(placed)]})"
    )
    return SwarmTrack(
        tracks,
        "smoothed with odometry",
        solution.converged,
        solution.iterations,
        chi2,
        dof,
        out,
        gauge,
        tuple(warnings),
        {k: (float(a), float(b)) for k, (a, b) in scale.items()},
    )


def _from_velocity(problem: PoseProblem, table: BearingTable, anchors: Anchors, cfg: TrackConfig) -> np.ndarray:
    """Positions as of robots without odometry; each robot's heading then turns its odometry upon them."""
    line, solution, index = solve_velocity(table, anchors, replace(cfg, acceleration=max(cfg.acceleration, 0.1)))
    x = problem.x0.copy()
    x[problem.index[:, 2]] = problem.own[:, 2]
    for robot in np.unique(problem.line.robot).tolist():
        rows, there = problem.line.of(robot), line.of(robot)
        t = problem.line.t[rows]
        place = np.column_stack([np.interp(t, line.t[there], solution.x[index[there, c]]) for c in range(2)])
        x[problem.index[rows, :2]] = place
        own = problem.own[rows]
        step, said = np.diff(place, axis=0), np.diff(own[:, :2], axis=0)
        turn = np.angle(np.sum((step[:, 0] + 1j * step[:, 1]) * np.conj(said[:, 0] + 1j * said[:, 1])))
        x[problem.index[rows, 2]] = se2.wrap_angle(own[:, 2] + turn)
    return x


def _onto_anchors(problem: PoseProblem, x: np.ndarray, anchors: Anchors, placed: set[int]) -> np.ndarray:
    """The whole motion moved rigidly so that anchors lie best upon their places; as it is with fewer than two."""
    seen = sorted(set(anchors) & placed)
    if len(seen) < 2:
        return x
    at = np.array([x[problem.index[problem.line.of(k)][0, :2]] for k in seen])
    moved = x.copy()
    T = se2.align(at, np.stack([anchors[k] for k in seen]))
    moved[problem.index] = se2.compose(T, x[problem.index])
    for k in seen:
        moved[problem.index[problem.line.of(k)][0, :2]] = anchors[k]
    return moved
