"""Robots that stand close together: covariances that count what is not known of their distance, wrong sightings between
them found or doubted.
"""

import numpy as np
import pytest

from mapweave.core.gaussian import chi2_quantile
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.posterior import CLOSE

from .swarms import complete, simulated


def nees(estimate, truth):
    """NEES per degree of freedom, and twice its 99.9 % limit."""
    value, dof = estimate.nees(truth)
    return value / dof, 2 * chi2_quantile(0.999, float(dof)) / dof


@pytest.mark.parametrize(
    ("seed", "dim", "layout", "visibility"),
    [(5, 3, "clusters", "mutual"), (33, 3, "random", "single"), (1000, 2, "random", "directed")],
)
def test_robots_that_fall_onto_one_spot_do_not_make_the_covariance_claim_to_know_it(seed, dim, layout, visibility):
    net, truth = simulated(seed, robots=64, dim=dim, sigma=5.0, layout=layout, visibility=visibility)
    estimate = locate(net)
    found, most = nees(estimate, truth)
    assert found < most
    assert estimate.reliable
    assert any("so close that the distance is not known" in w for w in estimate.warnings)


def two_close(gap):
    """Eight robots in the plane that see each other, two of them `gap` [m] apart."""
    ring = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0], [10.0, 22.0], [11.0, -3.0]])
    truth = np.vstack([ring, [[10.0, 10.0], [10.0 + gap, 10.0]]])
    return complete(truth, 2.0, np.random.default_rng(1), anchors=(0, 1, 2, 3)), truth


def test_robots_further_apart_than_their_errors_are_counted_as_they_are():
    net, _ = two_close(4.0)
    estimate = locate(net)
    spread = np.sqrt(np.trace(estimate.cov[6:], axis1=1, axis2=2)).sum()
    assert CLOSE * spread < 4.0
    assert not any("so close" in w for w in estimate.warnings)


def test_across_a_distance_that_is_not_known_the_deviation_is_that_of_the_distance_times_the_angle():
    net, truth = two_close(0.05)
    estimate = locate(net, initial=truth)
    P = estimate.joint([6, 7])
    D = np.hstack([-np.eye(2), np.eye(2)])
    apart = estimate.position[7] - estimate.position[6]
    u = apart / np.linalg.norm(apart)
    relative = D @ P @ D.T
    along = u @ relative @ u
    across = np.array([-u[1], u[0]]) @ relative @ np.array([-u[1], u[0]])
    length = np.sqrt(apart @ apart + along)
    assert np.linalg.norm(apart) < np.sqrt(along)
    expected = length * np.radians(2.0) / np.sqrt(2.0)  # two sightings, one from either end
    assert np.sqrt(across) == pytest.approx(expected, rel=0.15)
    assert any("a pair of robots" in w for w in estimate.warnings)


@pytest.mark.parametrize(("seed", "sure"), [(1008, True), (1011, False)])
def test_a_wrong_sighting_that_two_robots_escape_by_falling_together_is_found(seed, sure):
    net, truth = simulated(seed, robots=64, sigma=5.0, visibility="single", outliers=0.05)
    estimate = locate(net, SwarmConfig(method="robust"))
    found, most = nees(estimate, truth)
    assert found < most
    assert estimate.reliable == sure
    assert any("may as well be wrong" in w for w in estimate.warnings) != sure


def test_where_right_and_wrong_explain_the_sightings_alike_the_answer_is_doubted_and_the_pair_named():
    net, _ = simulated(1009, robots=64, sigma=5.0, visibility="single", outliers=0.05)
    estimate = locate(net, SwarmConfig(method="robust"))
    assert not estimate.reliable
    assert any("may as well be wrong" in w and "56-47" in w for w in estimate.warnings)


def test_a_wrong_sighting_that_a_right_one_was_given_up_for_is_found_by_believing_that_one():
    """Seed 2008: a wrong sighting of a usual length fitted, and one that missed by 9 standard deviations was right."""
    net, truth = simulated(2008, robots=64, sigma=0.5, layout="random", visibility="single", outliers=0.05)
    estimate = locate(net, SwarmConfig(method="robust"))
    found, most = nees(estimate, truth)
    assert found < most
    assert estimate.outlier[283]
    assert not estimate.outlier[284]


def test_of_two_sightings_of_a_pair_that_contradict_the_one_called_wrong_is_tried_in_the_place_of_the_other():
    """Seed 1003: 11 sights 62 wrongly by 15 standard deviations and is believed, what 62 says of 11 is not."""
    net, truth = simulated(1003, robots=64, sigma=2.0, layout="clusters", visibility="directed", outliers=0.05)
    estimate = locate(net, SwarmConfig(method="robust"))
    found, most = nees(estimate, truth)
    assert found > most
    assert not estimate.reliable
    assert any("may as well be wrong" in w and "11-62" in w for w in estimate.warnings)


def test_without_wrong_sightings_nothing_is_doubted():
    doubted = 0
    for seed in range(8):
        net, _ = simulated(seed, robots=36, sigma=5.0, layout="random", visibility="single")
        doubted += not locate(net, SwarmConfig(method="robust")).reliable
    assert doubted <= 1


def test_two_sightings_of_a_pair_that_noise_sets_apart_are_no_contradiction():
    """One of the two misses by more than a sighting may, by chance; its place is no other if it is believed."""
    for seed in range(1000, 1006):
        net, _ = simulated(seed, robots=64, sigma=2.0, layout="random", visibility="mutual")
        assert locate(net, SwarmConfig(method="robust")).reliable
