"""Covariances in a gauge that is named, whichever entries held it while solving."""

import numpy as np

from mapweave.solve import Factor, Problem, minimise
from mapweave.swarm.posterior import robot_blocks


def test_covariances_in_the_gauge_of_least_trace_are_those_of_the_pseudo_inverse():
    rng = np.random.default_rng(4)
    i, j = np.triu_indices(9, 1)
    keep = rng.random(len(i)) < 0.5
    i, j = np.append(i[keep], np.arange(8)), np.append(j[keep], np.arange(1, 9))
    differences = Factor(
        columns=np.stack([i, j], axis=1),
        residual=lambda x: (x[j] - x[i])[:, None],
        jacobian=lambda _: np.tile([[[-1.0, 1.0]]], (len(i), 1, 1)),
        rows=1,
    )
    solution = minimise(Problem(x0=np.zeros(9), terms=[differences], fixed=np.arange(9) == 4))
    L = np.zeros((9, 9))
    for a, b in zip(i, j, strict=True):
        L[np.ix_([a, b], [a, b])] += [[1, -1], [-1, 1]]
    G = np.ones((9, 1))  # all may move together, and the conditions leave out just that motion
    blocks = robot_blocks(solution.information, solution.free, 3, 3, G, G)
    pinv = np.linalg.pinv(L)
    for k in range(3):
        np.testing.assert_allclose(blocks[k], pinv[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], atol=1e-12)
