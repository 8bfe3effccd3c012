"""Robots at nearly constant velocity: all sightings of all times at once, and those up to each instant."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core.bearings import BearingTable
from ...core.errors import DataError
from ...core.gaussian import joseph, solve_psd, symmetrise
from ...core.records import frozen
from ...solve import Problem, Solution, SolveConfig, minimise
from .. import bearing as model
from .factors import prior_factor, ray_factor, sighting_factor, velocity_factor, velocity_noise
from .poses import Timeline, timeline
from .result import (
    FIRST_INSTANTS,
    TRACK_MERGE,
    TRACK_RELINEARISE,
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
        for name in ("x", "P"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


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
