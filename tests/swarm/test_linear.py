"""The linear start: what noise adds to its cost, and the scale of pieces that have none."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.swarm.network import Distance, components
from mapweave.swarm.start import bias, linear_pattern, linear_start

from .swarms import simulated


@pytest.mark.parametrize("dim", [2, 3])
def test_the_bias_is_the_share_of_a_squared_distance_that_noise_leaves_across_the_sighting(dim):
    net, _ = simulated(0, robots=9, dim=dim)
    rng = np.random.default_rng(4)
    across = 0.3 * rng.normal(size=(dim - 1, 200_000))
    # in space, noise in the plane across the sighting, brought back to length one
    left = np.sin(across[0]) ** 2 if dim == 2 else 1.0 - 1.0 / (1.0 + (across**2).sum(axis=0))
    noisy = replace(net, sigma=np.full(len(net.sigma), 0.3))
    np.testing.assert_allclose(bias(noisy), left.mean(), rtol=0.1)
    exact = replace(net, sigma=np.full(len(net.sigma), 1e-3))
    np.testing.assert_allclose(bias(exact), (dim - 1) * 1e-6, rtol=1e-4)


@pytest.mark.parametrize("metres", [None, 7.0])
def test_a_piece_of_free_scale_has_a_median_sighting_of_one_or_its_known_distance(metres):
    net, truth = simulated(1, robots=16, anchors=(3,))
    if metres is not None:
        net = replace(net, distances=(Distance(2, 9, metres, 0.1),))
    parts = components(net)
    direction = np.stack([np.cos(net.bearing), np.sin(net.bearing)], axis=1)
    x = linear_start(net, parts, direction, *linear_pattern(net, parts))
    span = np.linalg.norm(x[net.target] - x[net.observer], axis=1)
    held = np.median(span) if metres is None else np.linalg.norm(x[9] - x[2])
    assert held == pytest.approx(1.0 if metres is None else metres)
    np.testing.assert_allclose(x[3], truth[3])
