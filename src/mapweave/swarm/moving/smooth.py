"""Robots that move: all sightings of all times at once, and those up to each instant; with odometry or without."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...core import se2
from ...core.bearings import BearingTable
from ...core.errors import DataError
from ...core.gaussian import joseph, solve_psd, symmetrise
from ...core.records import Odometry, freeze
from ...core.workers import Progress, no_progress
from ...solve import Problem, Solution, SolveConfig, minimise
from .. import bearing as model
from ..start import relative_odometry_frame
from .poses import (
    PoseProblem,
    Timeline,
    prior_factor,
    ray_factor,
    sighting_factor,
    timeline,
    velocity_factor,
    velocity_noise,
)
from .result import (
    FIRST_INSTANTS,
    GROW_KERNEL,
    MEETING_FLOOR,
    MEETING_OUTLIER,
    TRACK_ENOUGH,
    TRACK_MEETING,
    TRACK_MERGE,
    TRACK_RELINEARISE,
    TRACK_WINDOW,
    RobotTrajectory,
    SwarmTrack,
    TrackConfig,
    without_outliers,
)

Anchors = Mapping[int, Float[np.ndarray, " d"]]


def smooth(
    table: BearingTable, anchors: Anchors, cfg: TrackConfig | None = None, *, covariance: bool = True
) -> SwarmTrack:
    """The most probable motion of all robots given a stamped `table` in common axes; no guess is needed.

    Anchors stand still. Raises DataError when fewer than two are given: without odometry nothing else holds the scale.
    """
    cfg = cfg or TrackConfig()
    line, solution, index = solve_velocity(table, anchors, cfg)
    d = table.dim
    cov = None
    if covariance and solution.information is not None:
        cov = solution.dissected(np.repeat(np.arange(len(line)), 2 * d)).blocks(index[:, :d])
    tracks = {}
    for robot in np.unique(line.robot).tolist():
        rows = line.of(robot)
        tracks[robot] = RobotTrajectory(line.t[rows], solution.x[index[rows, :d]], None if cov is None else cov[rows])
    seen = sighting_factor(_pair(line, index, d), table.direction, table.sigma)
    out, chi2, dof = without_outliers(seen.squares(solution.x), d - 1, solution, cfg)
    return SwarmTrack(tracks, "smoothed", solution.converged, solution.iterations, chi2, dof, out)


def solve_velocity(
    table: BearingTable, anchors: Anchors, cfg: TrackConfig
) -> tuple[Timeline, Solution, Int[np.ndarray, "K c"]]:
    """Timeline, solution and where each knot's position and velocity stand in it."""
    present = set(table.observer.tolist()) | set(table.target.tolist())
    if len(set(anchors) & present) < 2:
        raise DataError(
            "robots that move, with bearings in common axes, need two anchors that are seen, found "
            f"{len(set(anchors) & present)}"
        )
    d = table.dim
    line = timeline(table, set(anchors), TRACK_MERGE)
    index = np.arange(2 * d * len(line)).reshape(len(line), 2 * d)
    known = np.isin(line.robot, list(anchors))
    fixed = np.repeat(known, 2 * d)
    x0 = np.zeros(index.size)
    for robot, place in anchors.items():
        rows = line.of(robot)
        x0[index[rows, :d]] = place
    places = np.stack(list(anchors.values()))
    centre, extent = places.mean(axis=0), float(np.linalg.norm(np.ptp(places, axis=0)))
    if extent <= 0.0:
        raise DataError("the anchors stand at one point: the scale is not held")

    moves = line.moves
    start = line.first & ~known
    motion = velocity_factor(
        np.column_stack([index[moves[:, 0]], index[moves[:, 1]]]),
        line.t[moves[:, 1]] - line.t[moves[:, 0]],
        cfg.acceleration,
    )
    speed = prior_factor(index[start, d:], np.zeros((int(start.sum()), d)), cfg.speed)
    # So weak that it says nothing; it keeps the problem regular where a robot is not tied to the others.
    somewhere = prior_factor(index[start, :d], np.tile(centre, (int(start.sum()), 1)), 1e3 * extent)
    pair = _pair(line, index, d)
    rays = ray_factor(pair, table.direction, table.sigma * 0.25 * extent)
    once = SolveConfig(max_iterations=1, damping=0.0)
    x1 = minimise(Problem(x0, (motion, speed, somewhere, rays), fixed), once).x
    seen = sighting_factor(pair, table.direction, table.sigma, cfg.kernel)
    return line, minimise(Problem(x1, (motion, speed, somewhere, seen), fixed)), index


def _pair(line: Timeline, index: Int[np.ndarray, "K c"], d: int) -> Int[np.ndarray, "m p"]:
    """Where the positions of observer and target of each sighting stand in the solution."""
    return np.column_stack([index[line.observer, :d], index[line.target, :d]])


@dataclass(frozen=True, slots=True)
class MotionState:
    """All robots at time `t` [s]. x: (n 2d,) position and velocity of each robot that moves; P: their covariance."""

    t: float
    x: Float[np.ndarray, " s"]
    P: Float[np.ndarray, "s s"]

    def __post_init__(self) -> None:
        freeze(self, "x", "P")


def filtered(
    table: BearingTable, anchors: Mapping[int, Float[np.ndarray, " d"]], cfg: TrackConfig | None = None
) -> SwarmTrack:
    """What was known at each instant from the sightings until then; the first instants are smoothed together.

    Robots at nearly constant velocity in common axes; anchors stand still. Raises DataError when fewer than two are
    seen, when there are no later instants, or a robot is not seen in the first ones.
    """
    cfg = cfg or TrackConfig()
    assert table.t is not None  # noqa: S101  (callers hand in stamped tables)
    stamps = np.unique(table.t)
    if len(stamps) <= FIRST_INSTANTS:
        raise DataError(f"a filter needs more than {FIRST_INSTANTS} instants, found {len(stamps)}")
    moving = np.setdiff1d(np.unique(np.concatenate([table.observer, table.target])), list(anchors))
    begin = _begin(table.rows(table.t <= stamps[FIRST_INSTANTS - 1]), moving, anchors, cfg)
    out: list[MotionState] = []
    chi2, rows = 0.0, 0
    for state, value, count in _run(table, stamps[FIRST_INSTANTS:], begin, moving, anchors, cfg):
        out.append(state)
        chi2, rows = chi2 + value, rows + count
    d = table.dim
    t = np.array([s.t for s in out])
    tracks = {int(k): RobotTrajectory(t[:1], np.asarray(p)[None]) for k, p in anchors.items()}
    for i, k in enumerate(moving.tolist()):
        at = 2 * d * i + np.arange(d)
        tracks[k] = RobotTrajectory(t, np.stack([s.x[at] for s in out]), np.stack([s.P[np.ix_(at, at)] for s in out]))
    none = np.zeros(len(table.observer), dtype=bool)
    return SwarmTrack(tracks, "filtered", converged=True, iterations=len(out), chi2=chi2, dof=rows, outlier=none)


def predict(state: MotionState, t: float, d: int, q: float) -> MotionState:
    """The state at `t`: positions go on at their velocities, which wander."""
    dt, robots = t - state.t, len(state.x) // (2 * d)
    eye = np.eye(d)
    F1 = np.kron(np.array([[1.0, dt], [0.0, 1.0]]), eye)
    Q1 = np.kron(velocity_noise(np.array([dt]), q)[0], eye)
    F, Q = np.kron(np.eye(robots), F1), np.kron(np.eye(robots), Q1)
    return MotionState(t, F @ state.x, symmetrise(F @ state.P @ F.T + Q))


def update(
    state: MotionState,
    table: BearingTable,
    moving: Int[np.ndarray, " n"],
    anchors: Mapping[int, Float[np.ndarray, " d"]],
    rounds: int = 3,
) -> tuple[MotionState, float, int]:
    """The state given one instant's sightings, linearised anew `rounds` times; also NIS and its dof."""
    d = table.dim
    place = np.full(len(table.ids), -1)
    place[moving] = np.arange(len(moving))
    known = np.zeros((len(table.ids), d))
    for k, p in anchors.items():
        known[k] = p
    R = np.repeat(table.sigma**2, d - 1)
    x, nis = state.x, 0.0
    K = H = np.zeros((0, 0))
    for step in range(rounds):
        p = known.copy()
        p[moving] = x.reshape(len(moving), 2 * d)[:, :d]
        e, H = _linear(table, p, place, len(state.x))
        innovation = e - H @ (state.x - x)
        S = H @ state.P @ H.T + np.diag(R)
        K = solve_psd(S, H @ state.P).T
        if step == 0:
            nis = float(e @ solve_psd(S, e))
        x = state.x + K @ innovation
    return MotionState(state.t, x, joseph(state.P, K, H, np.diag(R))), nis, len(R)


def _linear(
    table: BearingTable, p: Float[np.ndarray, "n d"], place: Int[np.ndarray, " n"], size: int
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r s"]]:
    """Sighting less prediction, and how the prediction changes with the state."""
    d, m = table.dim, len(table.observer)
    a, b = p[table.observer], p[table.target]
    if d == 2:
        e = model.angle_residual(table.bearing(), a, b)
        G = model.angle_jacobian(a, b)[:, None, :]
    else:
        e = model.sphere_residual(table.direction, a, b).ravel()
        G = model.sphere_jacobian(a, b)
    H = np.zeros((m, d - 1, size))
    for sign, robots in ((-1.0, table.observer), (1.0, table.target)):
        rows = np.flatnonzero(place[robots] >= 0)
        for c in range(d):
            H[rows[:, None], np.arange(d - 1), (2 * d * place[robots[rows]] + c)[:, None]] += sign * G[rows, :, c]
    return e, H.reshape(m * (d - 1), size)


def _begin(
    table: BearingTable, moving: Int[np.ndarray, " n"], anchors: Mapping[int, Float[np.ndarray, " d"]], cfg: TrackConfig
) -> MotionState:
    """Everybody at the last instant of `table`, with their joint covariance."""
    line, solution, index = solve_velocity(table, anchors, cfg)
    last = []
    for k in moving.tolist():
        rows = line.of(k)
        if rows.start == rows.stop:
            raise DataError(
                f"robot {table.ids[k]} is not seen in the first {FIRST_INSTANTS} instants: the filter cannot begin"
            )
        last.append(rows.stop - 1)
    at = index[np.array(last)].ravel()
    assert table.t is not None  # noqa: S101
    now, d = float(table.t.max()), table.dim
    x, P = solution.x[at].copy(), solution.covariance(at).copy()
    for i, knot in enumerate(last):
        if line.t[knot] < now:  # seen last a little earlier: carried on alone
            mine = slice(2 * d * i, 2 * d * (i + 1))
            part = predict(MotionState(float(line.t[knot]), x[mine], P[mine, mine]), now, d, cfg.acceleration)
            F = np.kron(np.array([[1.0, now - line.t[knot]], [0.0, 1.0]]), np.eye(d))
            P[mine] = F @ P[mine]
            P[:, mine] = P[:, mine] @ F.T
            x[mine], P[mine, mine] = part.x, part.P
    return MotionState(now, x, symmetrise(P))


def _run(
    table: BearingTable,
    stamps: Float[np.ndarray, " k"],
    state: MotionState,
    moving: Int[np.ndarray, " n"],
    anchors: Mapping[int, Float[np.ndarray, " d"]],
    cfg: TrackConfig,
) -> Iterator[tuple[MotionState, float, int]]:
    assert table.t is not None  # noqa: S101
    order = np.argsort(table.t, kind="stable")
    edges = np.searchsorted(table.t[order], np.append(stamps, np.inf))
    for k, t in enumerate(stamps.tolist()):
        now = table.rows(order[edges[k] : edges[k + 1]])
        state, nis, rows = update(
            predict(state, t, table.dim, cfg.acceleration), now, moving, anchors, TRACK_RELINEARISE
        )
        yield state, nis, rows


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


PlaneAnchors = Mapping[int, Float[np.ndarray, "2"]]


def smooth_driving(
    table: BearingTable,
    odometry: Mapping[int, Odometry],
    anchors: PlaneAnchors,
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


def _from_velocity(problem: PoseProblem, table: BearingTable, anchors: PlaneAnchors, cfg: TrackConfig) -> np.ndarray:
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


def _onto_anchors(problem: PoseProblem, x: np.ndarray, anchors: PlaneAnchors, placed: set[int]) -> np.ndarray:
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
