"""Robots that talk only to those they see agree on what the batch estimator finds."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.distributed import links_of
from mapweave.swarm.locate import locate
from mapweave.swarm.network import Network
from mapweave.swarm.result import Status

from .swarms import simulated

TALKING = SwarmConfig(method="distributed")
AGREEMENT = 0.02  # standard deviations of a robot's position


@pytest.mark.parametrize(
    "scene",
    [{"robots": 64}, {"robots": 64, "sigma": 2.0, "missing": 0.2}, {"robots": 64, "dim": 3}],
    ids=["plane", "some sightings lost", "space"],
)
def test_neighbours_talking_reach_the_answer_of_the_centre(scene):
    net, _ = simulated(1, **scene)
    centre, talked = locate(net), locate(net, TALKING)
    free = centre.localisable & ~centre.anchor
    spread = np.sqrt(np.trace(centre.cov[free], axis1=1, axis2=2))
    apart = np.linalg.norm(talked.position - centre.position, axis=1)[free]
    assert (apart / spread).max() < AGREEMENT
    assert talked.status is Status.CONVERGED
    assert talked.reliable


def test_rounds_messages_and_bytes_are_counted():
    net, _ = simulated(2, robots=36)
    traffic = locate(net, TALKING).traffic
    links = len(links_of(net).a)
    assert 10 < traffic.rounds < 2000
    assert links < traffic.messages < traffic.rounds * links  # silence is not counted
    assert 2 * 8 * traffic.messages < traffic.bytes < 7 * 8 * traffic.messages


def test_each_link_joins_two_robots_of_which_one_sees_the_other():
    net, _ = simulated(3, robots=36)
    links = links_of(net)
    seen = set(zip(net.observer, net.target, strict=True))
    assert all((a, b) in seen or (b, a) in seen for a, b in zip(links.a, links.b, strict=True))
    np.testing.assert_array_equal(links.a[links.back], links.b)
    np.testing.assert_array_equal(links.a[links.of_sighting], net.observer)
    np.testing.assert_array_equal(links.b[links.of_sighting], net.target)


def test_running_out_of_rounds_is_said():
    net, _ = simulated(1, robots=36)
    estimate = locate(net, SwarmConfig(method="distributed", max_rounds=12))
    assert any("still talking" in w for w in estimate.warnings)
    assert not estimate.reliable


def test_a_piece_without_anchors_does_not_disturb_the_rest():
    a, truth = simulated(1, robots=36)
    b, _ = simulated(2, robots=16, anchors=())
    both = Network(
        tuple(map(str, range(52))),
        2,
        np.r_[a.observer, b.observer + 36],
        np.r_[a.target, b.target + 36],
        np.r_[a.bearing, b.bearing],
        np.r_[a.sigma, b.sigma],
        a.anchors,
    )
    estimate = locate(both, TALKING)
    assert estimate.localisable[:36].all()
    assert not estimate.localisable[36:].any()
    np.testing.assert_allclose(estimate.position[:36], locate(a).position, atol=1e-3)
    assert np.abs(estimate.position[:36] - truth).max() < 1.0


def test_what_neighbours_cannot_agree_on_is_refused():
    net, _ = simulated(1, robots=36, anchors=(0,))
    with pytest.raises(DataError, match="two anchors"):
        locate(net, TALKING)
