"""The team's pose graph as a least-squares problem, and what its solution knows of two poses together."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.se2 import wrap_angle
from ..solve import Factor, Huber, Information, Pattern, Problem, Solution, SolveConfig, minimise, wrapping
from ..solve.problem import Kernel
from .pose_graph import PoseGraph

SOLVE = SolveConfig(max_iterations=12, step_tolerance=1e-6, cost_tolerance=1e-7)


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
