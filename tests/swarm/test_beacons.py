"""Robots that see known beacons, and nobody who sees them."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.swarm.locate import locate
from mapweave.swarm.network import network

BEACONS = {"b1": (0.0, 0.0), "b2": (6.0, 0.0), "b3": (6.0, 6.0), "b4": (0.0, 6.0)}


def seen(beacons, seed):
    rng = np.random.default_rng(seed)
    places, headings = rng.uniform(0.5, 5.5, (5, 2)), rng.uniform(-np.pi, np.pi, 5)
    rows = [(f"p{k}", b) for k in range(5) for b in beacons]
    d = np.array([np.subtract(BEACONS[b], places[int(p[1:])]) for p, b in rows])
    bearing = np.arctan2(d[:, 1], d[:, 0]) - np.repeat(headings, len(beacons)) + 0.002 * rng.normal(size=len(rows))
    known = {b: BEACONS[b] for b in beacons}
    return network(2, [p for p, _ in rows], [b for _, b in rows], bearing, 0.002, known, axis=False), places, headings


@pytest.mark.parametrize("seed", range(5))
def test_three_beacons_or_more_give_place_and_heading_without_a_guess(seed):
    net, places, headings = seen(list(BEACONS), seed)
    found = locate(net)
    mine = [found.ids.index(f"p{k}") for k in range(5)]
    assert found.reliable
    assert np.abs(found.position[mine] - places).max() < 0.1
    assert np.abs(np.angle(np.exp(1j * (found.heading[mine] - headings)))).max() < 0.02


def test_two_beacons_are_too_few_to_start_from():
    net, _, _ = seen(["b1", "b2"], 0)
    with pytest.raises(DataError, match="none sees three anchors"):
        locate(net)
