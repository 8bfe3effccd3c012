"""Poses and what is known between them, as a least-squares problem, and what its solution knows of two poses together.

Edges are a vectorised `Factor`, and for graphs of thousands of poses a term in compiled loops, `PoseEdges`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.records import freeze, frozen
from ..core.se2 import wrap_angle
from ..kernels.laser.pose_edges import edge_normal, edge_squares
from ..solve import Factor, Huber, Information, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from ..solve.problem import Kernel

SOLVE = SolveConfig(max_iterations=12, step_tolerance=1e-6, cost_tolerance=1e-7)


@dataclass(frozen=True, slots=True)
class PoseGraph:
    """n poses and m edges.

    pose: (n, 3) in `map`; first, second: (m,), indices into `pose`; measured: (m, 3), pose of `second` in `first`;
    information: (m, 3, 3) in second's frame over x, y, theta [1/m^2, 1/rad^2], symmetric.
    """

    pose: Float[np.ndarray, "n 3"]
    first: Int[np.ndarray, " m"]
    second: Int[np.ndarray, " m"]
    measured: Float[np.ndarray, "m 3"]
    information: Float[np.ndarray, "m 3 3"]

    def __post_init__(self) -> None:
        freeze(self, "pose", "measured", "information")
        freeze(self, "first", "second", dtype=np.int64)

    @classmethod
    def of(
        cls,
        pose: Float[np.ndarray, "n 3"],
        pairs: Sequence[tuple[int, int]],
        measured: Sequence[np.ndarray],
        information: Sequence[np.ndarray],
    ) -> "PoseGraph":
        """The graph of an edge for each of `pairs`, there may be none."""
        ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        relative = np.array(measured, dtype=float).reshape(-1, 3)
        return cls(pose, ends[:, 0], ends[:, 1], relative, np.array(information, dtype=float).reshape(-1, 3, 3))

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def edges(self) -> int:
        """How many edges there are."""
        return len(self.first)

    def joined(self, other: "PoseGraph") -> "PoseGraph":
        """These poses with these edges and then those of `other`, which is over the same poses."""
        names = ("first", "second", "measured", "information")
        return PoseGraph(self.pose, *(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))

    def among(self, keep: Int[np.ndarray, " k"]) -> "PoseGraph":
        """These poses alone, ascending, numbered anew, and the edges between them."""
        number = np.full(len(self), -1)
        number[keep] = np.arange(len(keep))
        first, second = number[self.first], number[self.second]
        own = (first >= 0) & (second >= 0)
        return PoseGraph(self.pose[keep], first[own], second[own], self.measured[own], self.information[own])


def edge_factor(graph: PoseGraph, name: str, kernel: Kernel | None = None) -> Factor:
    """The edges of `graph` as one factor over x = [x0 y0 theta0 x1 ...]; its poses are not read."""
    i, k, z = graph.first, graph.second, graph.measured
    W = np.linalg.cholesky(graph.information).swapaxes(1, 2)
    columns = np.concatenate([3 * i[:, None] + np.arange(3), 3 * k[:, None] + np.arange(3)], axis=1)

    def residual(x: np.ndarray) -> np.ndarray:
        X = x.reshape(-1, 3)
        return np.asarray(se2.between(z, se2.between(X[i], X[k])))

    def jacobian(x: np.ndarray) -> np.ndarray:
        X = x.reshape(-1, 3)
        A, B = se2.between_jacobians(X[i], X[k])
        R = se2.turn(-z[:, 2])
        return np.concatenate([R @ A, R @ B], axis=2)

    return Factor(columns, residual, jacobian, 3, W, kernel, name)


def problem(
    steps: PoseGraph,
    closures: PoseGraph,
    starts: tuple[Int[np.ndarray, " s"], Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]],
    kernel: float,
) -> Problem:
    """Least squares over the poses of `steps`, which `closures` shares.

    starts: pose numbers, where they are known to be, and with what sd; kernel: width [sd] of the closures' one.
    """
    at, known, sd = starts
    columns = 3 * at[:, None] + np.arange(3)

    def residual(v: np.ndarray) -> np.ndarray:
        r = np.asarray(v[columns] - known)
        r[:, 2] = wrap_angle(r[:, 2])
        return r

    unit = np.broadcast_to(np.eye(3), (len(at), 3, 3))
    terms = [Factor(columns, residual, lambda _: unit, 3, 1.0 / sd, None, "starts")]
    if steps.edges:
        terms.append(edge_factor(steps, "steps"))
    if closures.edges:
        terms.append(edge_factor(closures, "closures", Huber(kernel)))
    x = steps.pose.ravel()
    return Problem(x, terms, None, wrapping(np.arange(2, x.size, 3)))


@dataclass(slots=True)
class Solved:
    """A solution of the first n poses; columns of its covariance are worked out once each, when asked for."""

    pose: Float[np.ndarray, "n 3"]
    solution: Solution
    problem: Problem
    _columns: dict[int, np.ndarray] = field(default_factory=dict)

    @classmethod
    def of(cls, asked: Problem) -> "Solved":
        solution = minimise(asked, SOLVE)
        return cls(solution.x.reshape(-1, 3), solution, asked)

    def __len__(self) -> int:
        return len(self.pose)

    def prepare(self, anchors: list[int]) -> None:
        """The columns of these poses, all in one go."""
        missing = [a for a in anchors if a not in self._columns]
        if missing and self.solution.information is not None:
            C = self.solution.information.columns((3 * np.array(missing)[:, None] + np.arange(3)).ravel())
            self._columns |= {a: C[:, 3 * k : 3 * k + 3] for k, a in enumerate(missing)}

    def copy(self) -> "Solved":
        """The same solution; columns worked out for the copy are not this one's."""
        return Solved(self.pose, self.solution, self.problem, dict(self._columns))

    def marginal(self, a: int) -> Float[np.ndarray, "3 3"]:
        """Covariance of pose `a` over x, y, theta in `map`; infinite where the problem could not be solved."""
        self.prepare([a])
        if a not in self._columns:
            return np.full((3, 3), np.inf)
        C = self._columns[a][3 * a : 3 * a + 3]
        return np.asarray(0.5 * (C + C.T))

    def relative(self, k: int, a: int) -> Float[np.ndarray, "3 3"]:
        """Covariance of `between(pose k, pose a)`."""
        self.prepare([k, a])
        P, Q = self._columns[k], self._columns[a]
        rows = np.concatenate([3 * k + np.arange(3), 3 * a + np.arange(3)])
        joint = np.concatenate([P[rows], Q[rows]], axis=1)
        J = np.concatenate(se2.between_jacobians(self.pose[k], self.pose[a]), axis=1)
        return np.asarray(J @ (0.5 * (joint + joint.T)) @ J.T)

    def covariances(self) -> Float[np.ndarray, "n 3 3"]:
        """The covariance of every pose, over x, y, theta in `map`."""
        solution = self.solution
        if solution.information is None:
            return np.full((len(self), 3, 3), np.inf)
        pattern = Pattern.of(self.problem)
        group = np.arange(3 * len(self)) // 3
        H, _ = pattern.assemble(*zip(*[term.normal(solution.x) for term in self.problem.terms], strict=True))
        pattern = pattern.dissected(group)
        return Information.of(H, pattern.elimination).blocks(np.arange(3 * len(self)).reshape(-1, 3))


@dataclass(frozen=True, slots=True)
class PoseEdges:
    """The edges of `graph`, whose poses are not read, over x = [x0 y0 theta0 x1 ...]; each `weight` (m,) times.

    kernel: applied to each edge's squared whitened norm.
    """

    graph: PoseGraph
    weight: Float[np.ndarray, " m"]
    kernel: Kernel | None = None

    @property
    def columns(self) -> Int[np.ndarray, "m 6"]:
        """Which entries of x each edge touches."""
        i, j = 3 * self.graph.first[:, None], 3 * self.graph.second[:, None]
        return np.concatenate([i + np.arange(3), j + np.arange(3)], axis=1)

    @property
    def size(self) -> int:
        """Rows of residual in all."""
        return 3 * self.graph.edges

    def squares(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Squared whitened residual of each edge."""
        g = self.graph
        return np.asarray(
            self.weight * edge_squares(frozen(x).reshape(-1, 3), g.first, g.second, g.measured, g.information)
        )

    def costs(self, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Robust cost of each edge."""
        s = self.squares(x)
        return s if self.kernel is None else np.asarray(self.kernel.cost(s))

    def normal(self, x: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "m 6 6"], Float[np.ndarray, "m 6"]]:
        """Information and gradient of each edge, robust weights in them."""
        g = self.graph
        weight = self.weight if self.kernel is None else self.weight * self.kernel.weight(self.squares(x))
        H, b = edge_normal(frozen(x).reshape(-1, 3), g.first, g.second, g.measured, g.information, weight)
        return H, b
