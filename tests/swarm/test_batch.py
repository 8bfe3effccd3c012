"""The batch estimator reaches the bound, and says what cannot be told."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork, Distance
from mapweave.swarm.result import SwarmStatus

from .swarms import score, simulated


@pytest.mark.parametrize("dim", [2, 3])
def test_robots_among_corner_anchors_are_located_to_the_bound(dim):
    net, truth = simulated(1, robots=216, dim=dim, sigma=1.0)
    estimate = locate(net)
    rmse, bound, nees = score(estimate, truth)
    assert estimate.status is SwarmStatus.CONVERGED
    assert estimate.reliable
    assert estimate.iterations <= 10
    assert estimate.localisable.all()
    assert estimate.null_space == 0
    assert 0.75 < rmse / bound < 1.3
    assert 0.8 < nees < 1.2
    assert estimate.chi2 / estimate.dof == pytest.approx(1.0, abs=0.15)


def test_joint_covariance_agrees_with_the_blocks_and_anchors_have_none():
    net, _ = simulated(2, robots=64, sigma=1.0)
    estimate = locate(net)
    joint = estimate.joint(np.arange(64))
    blocks = np.stack([joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(64)])
    np.testing.assert_allclose(blocks, estimate.cov, atol=1e-12)
    assert not estimate.cov[estimate.anchor].any()
    assert np.linalg.eigvalsh(joint).min() > -1e-12


@pytest.mark.parametrize("sigma", [0.0, 0.3])
def test_a_known_distance_is_as_sure_as_it_says_and_an_exact_one_ten_thousand_times_as_any_sighting(sigma):
    places = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, -10.0]])
    who, whom = np.array([0, 2]), np.array([1, 1])
    net = BearingNetwork(
        ("a", "b", "c"), 2, who, whom, np.array([0.0, np.pi / 2]), np.array([0.05, 0.01]),
        {0: places[0], 2: places[2]}, (Distance(0, 1, 4.0, sigma),),
    )  # fmt: skip
    estimate = locate(net)
    np.testing.assert_allclose(estimate.position, places, atol=1e-6)
    along = (sigma or 4.0 * 1e-4 * 0.01) ** -2.0 + (10.0 * 0.01) ** -2.0
    np.testing.assert_allclose(estimate.cov[1], np.diag([1.0 / along, (4.0 * 0.05) ** 2]), rtol=1e-4, atol=1e-13)


def test_no_sightings_is_an_error():
    none = np.zeros(0, dtype=int)
    with pytest.raises(DataError, match="no sightings"):
        locate(BearingNetwork(("a",), 2, none, none, np.zeros(0), np.zeros(0)))
