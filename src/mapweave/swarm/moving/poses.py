"""The least-squares problem of driving robots: a pose a knot, two odometry scales a robot; its factors.

There is a knot for every stamp that a robot has a part in.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import se2
from ...core.bearings import BearingTable
from ...core.records import Odometry
from ...core.se2 import wrap_angle
from ...solve import Cauchy, Factor, Problem, Solution, SolveConfig, Term, minimise, wrapping
from .. import bearing as model
from .result import SCALE_V, TRACK_MERGE, TrackConfig

SIDE_SLIP = 0.3  # sideways slip, of the slip along


def velocity_factor(columns: Int[np.ndarray, "s c"], dt: Float[np.ndarray, " s"], q: float) -> Factor:
    """Motion at nearly constant velocity over `dt` [s].

    columns: p, v of a knot, then p, v of the next; q: white-noise acceleration density [m^2/s^3].
    """
    s, d = len(dt), columns.shape[1] // 4
    eye = np.eye(d)
    J = np.zeros((s, 2 * d, 4 * d))
    J[:, :d, :d], J[:, d:, d : 2 * d] = -eye, -eye
    J[:, :d, 2 * d : 3 * d], J[:, d:, 3 * d :] = eye, eye
    J[:, :d, d : 2 * d] = -dt[:, None, None] * eye
    W2 = np.linalg.cholesky(np.linalg.inv(velocity_noise(dt, q))).swapaxes(1, 2)
    W = np.einsum("sij,kl->sikjl", W2, eye).reshape(s, 2 * d, 2 * d)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray((J @ x[columns][..., None])[..., 0])

    return Factor(columns, residual, lambda _x: J, 2 * d, sqrt_info=W, name="velocity")


def velocity_noise(dt: Float[np.ndarray, " s"], q: float) -> Float[np.ndarray, "s 2 2"]:
    """Covariance of position and velocity on one axis after `dt` of white acceleration noise."""
    return np.asarray(
        q * np.stack([np.stack([dt**3 / 3, dt**2 / 2], -1), np.stack([dt**2 / 2, dt], -1)], -2),
    )


def odometry_factor(
    columns: Int[np.ndarray, "s 8"],
    delta: Float[np.ndarray, "s 3"],
    slope: Float[np.ndarray, "s 3 2"],
    sigma: Float[np.ndarray, "s 3"],
) -> Factor:
    """The next pose lies `delta` (in the frame of the one before) away, for the scales found of v and w.

    columns: pose, next pose, then the robot's scale errors of v and w; slope: how delta changes with them.
    """

    def residual(x: np.ndarray) -> np.ndarray:
        a, b, c = x[columns[:, :3]], x[columns[:, 3:6]], x[columns[:, 6:]]
        cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, 0], (b - a)[:, 1]
        step = np.column_stack([cos * dx + sin * dy, -sin * dx + cos * dy, b[:, 2] - a[:, 2]])
        r = step - delta - (slope @ c[..., None])[..., 0]
        r[:, 2] = wrap_angle(r[:, 2])
        return np.asarray(r)

    def jacobian(x: np.ndarray) -> np.ndarray:
        A, B = se2.between_jacobians(x[columns[:, :3]], x[columns[:, 3:6]])
        return np.concatenate([A, B, -slope], axis=2)

    return Factor(columns, residual, jacobian, 3, sqrt_info=1.0 / sigma, name="odometry")


def sighting_factor(
    columns: Int[np.ndarray, "m c"],
    direction: Float[np.ndarray, "m d"],
    sigma: Float[np.ndarray, " m"],
    kernel: float = 0.0,
) -> Factor:
    """Sightings between knots, by the bearing models of a swarm that stands still.

    columns: position of the observer, then of the target, then, where there is no common axis, the observer's heading.
    """
    d = direction.shape[1]
    robust = Cauchy(kernel) if kernel else None
    p, q = columns[:, :d], columns[:, d : 2 * d]
    W = (1.0 / sigma)[:, None]
    if d == 3:

        def residual3(x: np.ndarray) -> np.ndarray:
            return model.sphere_residual(direction, x[p], x[q])

        def jacobian3(x: np.ndarray) -> np.ndarray:
            H = model.sphere_jacobian(x[p], x[q])
            return np.concatenate([H, -H], axis=2)

        return Factor(columns, residual3, jacobian3, 2, sqrt_info=W, kernel=robust, name="sighting")
    z = np.arctan2(direction[:, 1], direction[:, 0])
    turned = columns.shape[1] == 5

    def residual(x: np.ndarray) -> np.ndarray:
        seen = z + x[columns[:, 4]] if turned else z
        return model.angle_residual(np.asarray(seen), x[p], x[q])[:, None]

    def jacobian(x: np.ndarray) -> np.ndarray:
        H = model.angle_jacobian(x[p], x[q])
        parts = [H, -H, np.ones((len(z), 1))] if turned else [H, -H]
        return np.concatenate(parts, axis=1)[:, None, :]

    return Factor(columns, residual, jacobian, 1, sqrt_info=W, kernel=robust, name="sighting")


def ray_factor(
    columns: Int[np.ndarray, "m c"], direction: Float[np.ndarray, "m d"], sigma: Float[np.ndarray, " m"]
) -> Factor:
    """How far the target lies off the ray [m] over `sigma` [m]: linear in the positions, so it needs no guess."""
    m, d = direction.shape
    if d == 2:
        B = np.stack([-direction[:, 1], direction[:, 0]], axis=1)[:, None, :]
    else:
        B = model.tangent_basis(direction).swapaxes(1, 2)
    J = np.concatenate([-B, B], axis=2)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray((J @ x[columns][..., None])[..., 0])

    W = np.broadcast_to((1.0 / sigma)[:, None], (m, d - 1))
    return Factor(columns, residual, lambda _x: J, d - 1, sqrt_info=np.ascontiguousarray(W), name="ray")


def prior_factor(columns: Int[np.ndarray, "m c"], mean: Float[np.ndarray, "m c"], sigma: float) -> Factor:
    """Each of the entries `columns` of x is `mean`, give or take `sigma`."""
    m, c = columns.shape
    J = np.broadcast_to(np.eye(c), (m, c, c))
    W = np.full((1, c), 1.0 / sigma)
    return Factor(columns, lambda x: np.asarray(x[columns] - mean), lambda _x: J, c, sqrt_info=W, name="prior")


STEP = 1e-4  # by which the scales of v and w are varied


@dataclass(frozen=True, slots=True)
class OdometrySteps:
    """Between k + 1 instants. pose: (k + 1, 3) in the robot's own odometry frame; delta: (k, 3) in the frame of the
    pose before; slope: (k, 3, 2) of delta by relative errors of v and w; sigma: (k, 3) [m, m, rad].
    """

    pose: Float[np.ndarray, "K 3"]
    delta: Float[np.ndarray, "k 3"]
    slope: Float[np.ndarray, "k 3 2"]
    sigma: Float[np.ndarray, "k 3"]


def odometry_steps(rows: Odometry | None, t: Float[np.ndarray, " K"], cfg: TrackConfig) -> OdometrySteps:
    """The motion between the instants `t` (ascending); a robot without odometry stands still."""
    if rows is None:
        k = len(t) - 1
        return OdometrySteps(np.zeros((k + 1, 3)), np.zeros((k, 3)), np.zeros((k, 3, 2)), np.full((k, 3), 1e-6))
    pose = _integrate(rows, t, 1.0, 1.0)
    delta = _steps(pose)
    by_v = (_steps(_integrate(rows, t, 1.0 + STEP, 1.0)) - delta) / STEP
    by_w = (_steps(_integrate(rows, t, 1.0, 1.0 + STEP)) - delta) / STEP
    return OdometrySteps(pose, delta, np.stack([by_v, by_w], axis=-1), _noise(rows, t, cfg))


def _pieces(rows: Odometry, t: Float[np.ndarray, " K"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants at which the velocity may change or a pose is asked for, and v, w of each piece between them."""
    at = np.unique(np.concatenate([rows.t, t]))
    at = at[(at >= t[0]) & (at <= t[-1])]
    row = np.searchsorted(rows.t, at[:-1], side="right") - 1
    begun = row >= 0
    row = np.maximum(row, 0)
    return at, np.where(begun, rows.v[row], 0.0), np.where(begun, rows.w[row], 0.0)


def _integrate(rows: Odometry, t: Float[np.ndarray, " K"], scale_v: float, scale_w: float) -> Float[np.ndarray, "K 3"]:
    """Poses at `t`, the first at the origin, along arcs."""
    at, v, w = _pieces(rows, t)
    dt = np.diff(at)
    turn = scale_w * w * dt
    theta = np.concatenate([[0.0], np.cumsum(turn)])
    chord = scale_v * v * dt * np.sinc(turn / (2.0 * np.pi))
    middle = theta[:-1] + 0.5 * turn
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    k = np.searchsorted(at, t)
    return np.column_stack([x[k], y[k], theta[k]])


def _steps(pose: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "k 3"]:
    out = se2.compose(se2.inverse(pose[:-1]), pose[1:])
    out[:, 2] = pose[1:, 2] - pose[:-1, 2]
    return np.asarray(out)


def _noise(rows: Odometry, t: Float[np.ndarray, " K"], cfg: TrackConfig) -> Float[np.ndarray, "k 3"]:
    at, v, w = _pieces(rows, t)
    dt = np.diff(at)
    along = np.concatenate([[0.0], np.cumsum((cfg.slip_floor + cfg.slip * np.abs(v)) ** 2 * dt)])
    turn = np.concatenate([[0.0], np.cumsum((cfg.turn_floor + cfg.turn * np.abs(w)) ** 2 * dt)])
    k = np.searchsorted(at, t)
    a, b = np.sqrt(np.diff(along[k])), np.sqrt(np.diff(turn[k]))
    return np.asarray(np.maximum(np.column_stack([a, SIDE_SLIP * a, b]), 1e-6))


@dataclass(frozen=True, slots=True)
class Timeline:
    """K knots, those of one robot together and ascending in time.

    robot: (K,) index; t: (K,) [s]; observer, target: (m,) the knots that each sighting ties.
    """

    robot: Int[np.ndarray, " K"]
    t: Float[np.ndarray, " K"]
    observer: Int[np.ndarray, " m"]
    target: Int[np.ndarray, " m"]

    def __len__(self) -> int:
        return len(self.robot)

    @property
    def moves(self) -> Int[np.ndarray, "s 2"]:
        """Consecutive knots of one robot."""
        k = np.flatnonzero(self.robot[1:] == self.robot[:-1])
        return np.column_stack([k, k + 1])

    @property
    def first(self) -> Bool[np.ndarray, " K"]:
        """Whether a knot is its robot's first."""
        out = np.ones(len(self), dtype=bool)
        out[1:] = self.robot[1:] != self.robot[:-1]
        return out

    def of(self, robot: int) -> slice:
        low, high = np.searchsorted(self.robot, [robot, robot + 1])
        return slice(int(low), int(high))


def timeline(table: BearingTable, still: AbstractSet[int], merge: float) -> Timeline:
    """The knots of a stamped `table`; robots that stand `still` have one, stamps closer than `merge` [s] are one."""
    assert table.t is not None  # noqa: S101  (callers hand in stamped tables)
    robot = np.concatenate([table.observer, table.target])
    t = np.concatenate([table.t, table.t])
    if still:
        t = np.where(np.isin(robot, list(still)), t.min(), t)
    order = np.lexsort((t, robot))
    r, s = robot[order], t[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (r[1:] != r[:-1]) | (s[1:] - s[:-1] > merge)
    knot = np.empty(len(order), dtype=np.int64)
    knot[order] = np.cumsum(new) - 1
    m = len(table.observer)
    return Timeline(r[new], s[new], knot[:m], knot[m:])


FAR = 1e4  # [m], [rad]: a prior this wide says nothing


@dataclass(frozen=True, slots=True)
class PoseProblem:
    """Everything of the problem that does not change while it is solved.

    index: (K, 3) where each knot's pose stands in x; scales: by robot, where its two scale errors stand; own: (K, 3)
    poses in each robot's own odometry frame; delta, slope, sigma: of each of `line.moves`.
    """

    table: BearingTable
    line: Timeline
    index: Int[np.ndarray, "K 3"]
    scales: Mapping[int, tuple[int, int]]
    own: Float[np.ndarray, "K 3"]
    delta: Float[np.ndarray, "s 3"]
    slope: Float[np.ndarray, "s 3 2"]
    sigma: Float[np.ndarray, "s 3"]
    anchors: Mapping[int, Float[np.ndarray, "2"]]
    odometry: AbstractSet[int]

    @classmethod
    def of(
        cls,
        table: BearingTable,
        odometry: Mapping[int, Odometry],
        anchors: Mapping[int, Float[np.ndarray, "2"]],
        cfg: TrackConfig,
    ) -> "PoseProblem":
        present = set(table.observer.tolist()) | set(table.target.tolist())
        still = (present - set(odometry)) | set(anchors)
        line = timeline(table, still, TRACK_MERGE)
        robots = np.unique(line.robot).tolist()
        parts = [odometry_steps(None if k in still else odometry[k], line.t[line.of(k)], cfg) for k in robots]
        K = len(line)
        scales = {k: (3 * K + 2 * i, 3 * K + 2 * i + 1) for i, k in enumerate(robots)}
        return cls(
            table,
            line,
            np.arange(3 * K).reshape(K, 3),
            scales,
            np.concatenate([p.pose for p in parts]),
            np.concatenate([p.delta for p in parts]),
            np.concatenate([p.slope for p in parts]),
            np.concatenate([p.sigma for p in parts]),
            anchors,
            present - still,
        )

    @property
    def x0(self) -> Float[np.ndarray, " n"]:
        """Every robot at the origin of its own odometry frame; anchors at their places."""
        x = np.zeros(self.index.size + 2 * len(self.scales))
        x[self.index] = self.own
        for robot, place in self.anchors.items():
            rows = self.line.of(robot)
            x[self.index[rows, :2]] = place
        return x

    def places_in_time(self) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 1"]]:
        """Of every entry of x the group it belongs to (a knot, or itself) and where in time that lies [s].

        Cut along time, the problem falls apart into pieces that share one knot a robot and the odometry scales.
        """
        K, n = len(self.line), self.index.size + 2 * len(self.scales)
        group, t = np.arange(n) + K, np.full((n, 1), float(np.median(self.line.t)))
        group[self.index] = np.arange(K)[:, None]
        t[self.index, 0] = self.line.t[:, None]
        return group, t

    def root(self, placed: AbstractSet[int]) -> int:
        """The robot whose first pose is the frame: the first with odometry."""
        return min(set(placed) & set(self.odometry) or set(placed))

    def solve(
        self,
        x: np.ndarray,
        placed: AbstractSet[int],
        cfg: TrackConfig,
        *,
        hold_anchors: bool,
        active: np.ndarray | None = None,
        iterations: int = 15,
    ) -> Solution:
        """The minimum from `x` over the knots `active` (all when None) of robots `placed`; other knots stay."""
        here = np.isin(self.line.robot, list(placed))
        moving = here if active is None else here & active
        fixed = np.ones(len(x), dtype=bool)
        fixed[self.index[moving]] = False
        for robot, at in self.scales.items():
            driven = robot in placed and robot in self.odometry
            fixed[list(at)] = not (SCALE_V > 0.0 and driven), not (cfg.scale_w > 0.0 and driven)
        if hold_anchors:
            for robot in self.anchors:
                fixed[self.index[self.line.of(robot), :2]] = True
        elif active is None or not (here & ~active).any():
            fixed[self.index[self.line.of(self.root(placed))][0]] = True
        if self.table.axis:
            idle = [k for k in placed if k not in self.odometry]
            for robot in idle:  # a robot that stands still in common axes has no heading to find
                fixed[self.index[self.line.of(robot), 2]] = True
        problem = Problem(x, self._terms(moving, here, placed, cfg), fixed, wrapping(self.index[:, 2]))
        return minimise(problem, SolveConfig(max_iterations=iterations, cost_tolerance=1e-6))

    def _terms(self, moving: np.ndarray, here: np.ndarray, placed: AbstractSet[int], cfg: TrackConfig) -> list[Term]:
        line = self.line
        seen = here[line.observer] & here[line.target] & (moving[line.observer] | moving[line.target])
        moves = line.moves
        driven = here[moves[:, 0]] & (moving[moves[:, 0]] | moving[moves[:, 1]])
        moves = moves[driven]
        scale = np.array([self.scales[k] for k in line.robot[moves[:, 0]].tolist()], dtype=np.int64).reshape(-1, 2)
        steps = np.column_stack([self.index[moves[:, 0]], self.index[moves[:, 1]], scale])
        terms: list[Term] = [
            self._sighting(seen, cfg.kernel),
            odometry_factor(steps, self.delta[driven], self.slope[driven], self.sigma[driven]),
            prior_factor(self.index[moving], np.zeros((int(moving.sum()), 3)), FAR),
        ]
        for which, sigma in enumerate((SCALE_V, cfg.scale_w)):
            if sigma > 0.0:
                at = np.array([[self.scales[k][which]] for k in sorted(placed & self.odometry)], dtype=np.int64)
                terms.append(prior_factor(at, np.zeros(at.shape), sigma))
        return terms

    def sighted(self, placed: AbstractSet[int]) -> Factor:
        """All sightings, without a kernel; those of robots not placed count nothing."""
        here = np.isin(self.line.robot, list(placed))
        return self._sighting(None, 0.0, here[self.line.observer] & here[self.line.target])

    def _sighting(self, rows: np.ndarray | None, kernel: float, counted: np.ndarray | None = None) -> Factor:
        rows = np.ones(len(self.table.observer), dtype=bool) if rows is None else rows
        a, b = self.line.observer[rows], self.line.target[rows]
        columns = [self.index[a, :2], self.index[b, :2]]
        if not self.table.axis:
            columns.append(self.index[a, 2:])
        sigma = self.table.sigma[rows] if counted is None else np.where(counted, self.table.sigma[rows], np.inf)
        return sighting_factor(np.column_stack(columns), self.table.direction[rows], sigma, kernel)
