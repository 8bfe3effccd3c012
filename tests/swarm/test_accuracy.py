"""A thousand and ten thousand robots: at the bound, with an honest covariance, in a few steps."""

import numpy as np
import pytest

from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate

from .swarms import simulated

DRAWS = 6
BOUND_ONLY = SwarmConfig(max_iterations=0)


def scored(draws, **scene):
    """RMSE over the bound at the truth, NEES per degree of freedom, most iterations, and failures over `draws`."""
    error = bound = nees = dof = 0.0
    iterations, failed = [], 0
    for seed in range(draws):
        net, truth = simulated(seed, **scene)
        estimate = locate(net)
        free = estimate.localisable & ~estimate.anchor
        error += np.square(estimate.position - truth)[free].sum(axis=1).mean()
        bound += np.trace(locate(net, BOUND_ONLY, initial=truth).cov[free], axis1=1, axis2=2).mean()
        value, count = estimate.nees(truth)
        nees, dof = nees + value, dof + count
        iterations.append(estimate.iterations)
        failed += estimate.status != "converged" or not estimate.reliable
    return np.sqrt(error / bound), nees / dof, max(iterations), failed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dim", "sigma", "layout"),
    [(2, 0.5, "grid"), (2, 2.0, "grid"), (2, 5.0, "grid"), (3, 0.5, "grid"), (3, 5.0, "grid"), (3, 2.0, "random")],
)
def test_a_thousand_robots_among_corner_anchors_stand_at_the_bound(dim, sigma, layout):
    ratio, nees, iterations, failed = scored(DRAWS, robots=1000, dim=dim, sigma=sigma, layout=layout)
    assert ratio <= 1.10
    assert 0.97 <= nees <= 1.03
    assert iterations <= 10
    assert failed == 0


@pytest.mark.slow
@pytest.mark.parametrize(("dim", "draws"), [(2, 6), (3, 3)])
def test_with_four_in_ten_sightings_lost_those_still_localisable_stand_at_the_bound(dim, draws):
    ratio, nees, _, failed = scored(draws, robots=1000, dim=dim, sigma=0.5, missing=0.4)
    assert ratio <= 1.10
    assert 0.95 <= nees <= 1.05
    assert failed == 0


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_ten_thousand_robots_are_located_with_an_honest_covariance(dim):
    net, truth = simulated(1, robots=10_000, dim=dim, sigma=0.5)
    estimate = locate(net)
    value, dof = estimate.nees(truth)
    free = ~estimate.anchor
    rmse = np.sqrt(np.square(estimate.position - truth)[free].sum(axis=1).mean())
    assert 0.95 <= value / dof <= 1.05
    assert rmse < 1.2 * np.sqrt(np.trace(estimate.cov[free], axis1=1, axis2=2).mean())
    assert estimate.localisable.all()


def test_two_neighbours_as_anchors_are_called_weak_and_corners_are_not():
    far, _ = simulated(1, robots=400, sigma=0.5)
    near, truth = simulated(1, robots=400, sigma=0.5, anchors=(0, 1))
    weak = locate(near)
    assert not locate(far).weak_anchors
    assert weak.weak_anchors
    assert weak.mode_share > 0.9
    assert any("weak anchors" in w for w in weak.warnings)
    value, dof = weak.nees(truth)
    assert value / dof == pytest.approx(1.0, abs=0.15)
