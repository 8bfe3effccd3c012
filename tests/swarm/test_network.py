"""A network is whole when it exists: every mistake is named when it is made."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.swarm.network import BearingNetwork, Distance, components, network

from .swarms import complete


def test_ids_stand_in_natural_order_and_sightings_by_index():
    net = network(2, ["10", "2"], ["2", "b"], np.array([0.1, 0.2]), 0.01, {"b": [0.0, 0.0]})
    assert net.ids == ("2", "10", "b")
    assert net.observer.tolist() == [1, 0]
    assert net.target.tolist() == [0, 2]
    assert net.is_anchor.tolist() == [False, False, True]
    np.testing.assert_allclose(net.direction[0], [np.cos(0.1), np.sin(0.1)])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"bearing": np.array([np.nan, 0.0])}, "finite"),
        ({"observer": np.array([1, 1])}, "sights itself"),
        ({"target": np.array([1, 7])}, "not in the network"),
        ({"anchors": {0: np.zeros(3)}}, "expected 2 finite coordinates"),
        ({"sigma": np.array([0.0, 0.1])}, "zero for some"),
        ({"distances": (Distance(0, 1, -1.0),)}, "positive"),
        ({"dim": 4}, "expected 2 or 3"),
        ({"ids": ("a", "a")}, "distinct"),
    ],
)
def test_what_does_not_belong_together_is_refused(change, told):
    good = {
        "ids": ("a", "b"),
        "dim": 2,
        "observer": np.array([0, 1]),
        "target": np.array([1, 0]),
        "bearing": np.array([0.0, 3.1]),
        "sigma": np.array([0.1, 0.1]),
    }
    with pytest.raises(DataError, match=told):
        BearingNetwork(**(good | change))


def test_an_anchor_nobody_sighted_is_refused():
    with pytest.raises(DataError, match="'z'"):
        network(2, ["a"], ["b"], np.array([0.1]), 0.01, {"z": [0.0, 0.0]})


@pytest.mark.parametrize(
    ("anchors", "measured", "held"), [(0, True, False), (1, False, False), (1, True, True), (2, False, True)]
)
def test_a_piece_is_held_by_two_anchors_or_by_one_and_a_distance(anchors, measured, held):
    places = np.array([[0.0, 0.0], [4.0, 1.0], [1.0, 3.0], [5.0, 5.0]])
    net = complete(places, 0.5, np.random.default_rng(1), range(anchors))
    net = replace(net, distances=(Distance(2, 3, 4.5),) if measured else ())
    parts = components(net)
    assert parts.label.max() == 0
    assert parts.fixed(0) is held
    assert parts.anchored is held
