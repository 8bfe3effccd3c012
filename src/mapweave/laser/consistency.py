"""Which closures between two maps can be true together: pairwise consistency and the largest consistent set.

[Mangelson18]: two closures and the trajectories between them in both maps make a cycle; its error must be within what
the covariances allow. The largest set in which all pairs do is a maximum clique, found exactly.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2

MOST_NODES = 300_000  # of the clique search, some seconds


class Clique(NamedTuple):
    """members: ascending; exact: whether no larger set exists for sure (else the search was cut short)."""

    members: tuple[int, ...]
    exact: bool


def adjoint(pose: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """How a small motion [x, y, theta] of a frame that stands at `pose` looks in the frame the pose is given in."""
    out = np.zeros((*pose.shape, 3))
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    out[..., 0, 2], out[..., 1, 2], out[..., 2, 2] = pose[..., 1], -pose[..., 0], 1.0
    return out


def cycle_squares(
    first: Float[np.ndarray, "n 3"],
    second: Float[np.ndarray, "n 3"],
    measured: Float[np.ndarray, "n 3"],
    covariance: Float[np.ndarray, "n 3 3"],
    way_first: Float[np.ndarray, "n n 3 3"] | None = None,
    way_second: Float[np.ndarray, "n n 3 3"] | None = None,
) -> Float[np.ndarray, "n n"]:
    """Squared error [sd^2] of the cycle through closures k and l, symmetric; zero on the diagonal.

    first, second: where closure k ends in the one map and in the other; measured: pose of the second end seen from the
    first, covariance: of an error in the second end's frame. way_first [l, k]: covariance of the pose of first k seen
    from first l, in k's frame; way_second [k, l]: of second l seen from second k, in l's frame; None: exact.
    """
    n = len(first)
    z = measured
    u = se2.between(first[None, :], first[:, None])  # [k, l]: k seen from l
    v = se2.between(second[:, None], second[None, :])  # [k, l]: l seen from k
    zv = se2.compose(z[:, None], v)
    e = se2.compose(se2.inverse(z)[None, :], se2.compose(u, zv))
    back, far = adjoint(se2.inverse(v)), adjoint(se2.inverse(zv))
    P = back @ covariance[:, None] @ back.swapaxes(-1, -2)
    turned = adjoint(se2.inverse(e))
    P = P + turned @ covariance[None, :] @ turned.swapaxes(-1, -2)
    if way_first is not None:
        P = P + far @ way_first.swapaxes(0, 1) @ far.swapaxes(-1, -2)
    if way_second is not None:
        P = P + way_second
    squares = np.einsum("kli,kli->kl", e, np.linalg.solve(P, e[..., None])[..., 0])
    squares = np.where(np.tri(n, k=-1, dtype=bool).T, squares, 0.0)
    return np.asarray(squares + squares.T)


def largest_clique(adjacent: Bool[np.ndarray, "n n"], most_nodes: int = MOST_NODES) -> Clique:
    """The largest set of nodes all tied to each other, by branch and bound with greedy colouring as the bound.

    adjacent: symmetric, diagonal False. Exact unless more than `most_nodes` branches were needed.
    """
    n = len(adjacent)
    if not n:
        return Clique((), exact=True)
    order = _by_degeneracy(adjacent)
    tied = [0] * n  # over places in `order`, one bit a node
    ranked = adjacent[np.ix_(order, order)]
    for i in range(n):
        tied[i] = sum(1 << int(j) for j in np.flatnonzero(ranked[i]))
    best: list[int] = []
    nodes = 0
    stack: list[tuple[list[int], int]] = [([], (1 << n) - 1)]  # chosen so far, candidates that may still join
    while stack and nodes < most_nodes:
        chosen, left = stack.pop()
        nodes += 1
        if len(chosen) > len(best):
            best = chosen
        if len(chosen) + left.bit_count() <= len(best):
            continue
        branches = []
        for node, colours in _coloured(left, tied):
            if len(chosen) + colours > len(best):
                branches.append((node, left))
                left &= ~(1 << node)
        stack += [([*chosen, node], rest & tied[node]) for node, rest in reversed(branches)]
    members = tuple(sorted(int(order[i]) for i in best))
    return Clique(members, exact=not stack)


def _coloured(left: int, tied: list[int]) -> list[tuple[int, int]]:
    """The nodes of `left` and, of each, the colours needed up to it; most colours first: what to branch on first."""
    out: list[tuple[int, int]] = []
    colour = 0
    while left:
        colour += 1
        free = left
        while free:
            node = (free & -free).bit_length() - 1
            left &= ~(1 << node)
            free &= ~(1 << node) & ~tied[node]
            out.append((node, colour))
    return out[::-1]


def _by_degeneracy(adjacent: np.ndarray) -> Int[np.ndarray, " n"]:
    """Nodes ordered so that those with the most ties among the rest come first; the lower number first of equals."""
    n = len(adjacent)
    degree, left, out = adjacent.sum(axis=1).astype(np.int64), np.ones(n, dtype=bool), np.empty(n, dtype=np.int64)
    for place in range(n - 1, -1, -1):
        candidates = np.flatnonzero(left)
        node = int(candidates[::-1][np.argmin(degree[candidates][::-1])])
        out[place], left[node] = node, False
        degree -= adjacent[node]
    return out
