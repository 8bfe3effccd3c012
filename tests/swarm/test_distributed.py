"""Robots that talk only to those they see agree on what the batch estimator finds."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.core.se2 import wrap_angle
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.distributed import links_of
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork
from mapweave.swarm.result import SwarmStatus

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
    assert talked.status is SwarmStatus.CONVERGED
    assert talked.reliable


@pytest.mark.parametrize(
    "scene", [{}, {"missing": 0.2, "sigma": 2.0}, {"anchors": (0, 24)}], ids=["eight", "lost", "two known"]
)
def test_robots_without_a_common_axis_agree_on_one_and_reach_the_answer_of_the_centre(scene):
    net, _ = simulated(1, robots=25, axis=False, **scene)
    centre, talked = locate(net), locate(net, TALKING)
    free = centre.localisable & ~centre.anchor
    spread = np.sqrt(np.trace(centre.cov[free], axis1=1, axis2=2))
    apart = np.linalg.norm(talked.position - centre.position, axis=1)[free]
    assert (apart / spread).max() < AGREEMENT
    assert np.abs(wrap_angle(talked.heading - centre.heading)).max() < 1e-4
    np.testing.assert_allclose(talked.heading_var, centre.heading_var, rtol=1e-3)
    assert talked.status is SwarmStatus.CONVERGED
    assert talked.reliable
    np.testing.assert_array_equal(talked.outlier, centre.outlier)


def test_robots_that_only_see_and_are_seen_by_some_take_their_heading_from_where_they_are():
    net, _ = simulated(2, robots=25, axis=False, visibility="mutual")
    lonely = 12  # sees all its neighbours, and none of them sees it but two
    seen_by = np.flatnonzero(net.target == lonely)
    kept = np.setdiff1d(np.arange(len(net.observer)), seen_by[2:])
    answered = np.isin(net.target, net.observer[seen_by[:2]]) & (net.observer == lonely)
    heard = net.select(np.setdiff1d(kept, np.flatnonzero(answered)))
    centre, talked = locate(heard), locate(heard, TALKING)
    assert not talked.outlier.any()
    assert abs(wrap_angle(talked.heading[lonely] - centre.heading[lonely])) < 1e-4


def test_where_nobody_is_seen_back_those_who_see_three_anchors_begin():
    net, truth = simulated(3, robots=16, axis=False, visibility="directed", anchors=range(0, 16, 2))
    back = set(zip(net.target.tolist(), net.observer.tolist(), strict=True))
    once = [(i < j) or (i, j) not in back for i, j in zip(net.observer.tolist(), net.target.tolist(), strict=True)]
    single = net.select(np.array(once))
    centre, talked = locate(single), locate(single, TALKING)
    assert centre.localisable.sum() > 10
    np.testing.assert_array_equal(talked.localisable, centre.localisable)
    np.testing.assert_allclose(talked.position, centre.position, atol=1e-3)
    assert np.abs(talked.position - truth)[talked.localisable].max() < 1.0


def test_first_places_give_first_headings_without_a_word():
    net, truth = simulated(4, robots=25, axis=False, visibility="single")
    centre, talked = locate(net, SwarmConfig(), truth + 0.3), locate(net, TALKING, truth + 0.3)
    assert centre.localisable.all()
    assert centre.reliable
    np.testing.assert_allclose(talked.position, centre.position, atol=1e-3)


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
    both = BearingNetwork(
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
    alone, _ = simulated(1, robots=36, axis=False, visibility="single")
    with pytest.raises(DataError, match="no heading can be started"):
        locate(alone, TALKING)
