"""The compiled edges are the same term as the ones in plain arrays."""

import numpy as np
import pytest

from mapweave.laser.pose_graph import PoseEdges, PoseGraph, edge_factor
from mapweave.solve import Cauchy


def some_graph(rng, n=30, m=80):
    A = rng.normal(size=(m, 3, 3))
    first = rng.integers(0, n, m)
    second = (first + rng.integers(1, n, m)) % n
    pose, z = rng.normal(scale=4.0, size=(n, 3)), rng.normal(scale=4.0, size=(m, 3))
    return PoseGraph(pose, first, second, z, A @ A.swapaxes(1, 2) + 0.1 * np.eye(3))


@pytest.mark.parametrize("kernel", [None, Cauchy(2.0)])
def test_costs_information_and_gradient_are_those_of_the_plain_factor(kernel):
    rng = np.random.default_rng(0)
    graph = some_graph(rng)
    weight = rng.uniform(0.1, 2.0, graph.edges)
    weighed = PoseGraph(
        graph.pose, graph.first, graph.second, graph.measured, graph.information * weight[:, None, None]
    )
    plain, fast = edge_factor(weighed, "edges", kernel), PoseEdges(graph, weight, kernel)
    x = graph.pose.ravel()
    np.testing.assert_array_equal(plain.columns, fast.columns)
    assert plain.size == fast.size
    np.testing.assert_allclose(fast.squares(x), plain.squares(x), rtol=1e-10)
    np.testing.assert_allclose(fast.costs(x), plain.costs(x), rtol=1e-10)
    for ours, theirs in zip(fast.normal(x), plain.normal(x), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
