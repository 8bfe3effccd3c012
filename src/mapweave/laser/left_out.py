"""How far a measurement lies from the solution that it takes part in, had it been left out.

What bends the solution to itself has a small residual and may be false all the same: its residual is weighed with what
is left of its covariance when that of the prediction is taken off.
"""

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..solve import Solution
from ..solve.information import BlockCholesky
from .pose_graph import PoseGraph

HOLDS_ALONE = 1e-6  # share of an edge's covariance that is left over: less, and nothing else tells what it tells


def left_out_squares(graph: PoseGraph, solution: Solution, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """How far edges `rows`, which `solution` rests on, lie from the solution without each [squared sd].

    With residual r, covariance R and that of what is predicted J P J^T it is `r^T (R - J P J^T)^-1 r`; 0 in directions
    that no other edge tells.
    """
    i, j = graph.first[rows], graph.second[rows]
    block = np.full(len(graph), -1)
    block[solution.free[::3] // 3] = np.arange(len(solution.free) // 3)
    both = (block[i] >= 0) & (block[j] >= 0)
    diagonal, tied = _factor(solution).pairs(block[i][both], block[j][both])
    at_home = np.concatenate([diagonal, np.zeros((1, 3, 3))])  # a pose that is held: number -1
    P = np.zeros((len(rows), 6, 6))
    P[:, :3, :3], P[:, 3:, 3:] = at_home[block[i]], at_home[block[j]]
    P[both, :3, 3:], P[both, 3:, :3] = tied, tied.swapaxes(1, 2)
    A, B = se2.between_jacobians(graph.pose[i], graph.pose[j])
    J = se2.turn(-graph.measured[rows, 2]) @ np.concatenate([A, B], axis=2)
    r = se2.between(graph.measured[rows], se2.between(graph.pose[i], graph.pose[j]))
    return without_it(r, J, P, graph.information[rows])


def without_it(
    r: Float[np.ndarray, "k 3"],
    J: Float[np.ndarray, "k 3 d"],
    P: Float[np.ndarray, "k d d"],
    information: Float[np.ndarray, "k 3 3"],
) -> Float[np.ndarray, " k"]:
    """`r^T (R - J P J^T)^-1 r` [squared sd] with R the inverse of `information`; 0 in directions nothing else tells."""
    W = np.linalg.cholesky(information).swapaxes(1, 2)
    M = np.eye(3) - W @ (J @ P @ J.swapaxes(1, 2)) @ W.swapaxes(1, 2)
    values, vectors = np.linalg.eigh(0.5 * (M + M.swapaxes(1, 2)))
    along = (vectors.swapaxes(1, 2) @ (W @ r[..., None]))[..., 0]
    left = values > HOLDS_ALONE
    return np.asarray((np.square(along) * left / np.where(left, values, 1.0)).sum(axis=1))


def _factor(solution: Solution) -> BlockCholesky:
    assert solution.information is not None  # noqa: S101  (asked before)
    factor: BlockCholesky = solution.information.factor
    return factor
