"""Headings of robots without a common axis, against the truth and by trying everything."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.swarm.network import BearingNetwork
from mapweave.swarm.start import (
    anchored_turn,
    beacon_headings,
    headings_at,
    mutual_headings,
    relative_odometry_frame,
    resected_headings,
    world_directions,
)


def swarm(seed, n=7, noise=0.0, pairs=None, anchors=()):
    """Robots that see those of `pairs` (all when None) in their own axes; their places and headings."""
    rng = np.random.default_rng(seed)
    places, headings = rng.uniform(-4, 4, (n, 2)), rng.uniform(-np.pi, np.pi, n)
    i, j = np.nonzero(~np.eye(n, dtype=bool)) if pairs is None else np.array(pairs).T
    d = places[j] - places[i]
    z = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - headings[i] + noise * rng.normal(size=len(i)))
    known = {k: places[k] for k in anchors}
    net = BearingNetwork(tuple(map(str, range(n))), 2, i, j, z, np.full(len(i), 0.01), known, axis=False)
    return net, places, headings


def apart(a, b):
    return np.abs(se2.wrap_angle(np.asarray(a) - np.asarray(b))).max()


@pytest.mark.parametrize("seed", range(3))
def test_how_two_odometry_frames_lie_follows_from_sightings_by_either_robot(seed):
    rng = np.random.default_rng(seed)
    T = se2.pose(*rng.uniform(-3, 3, 2), rng.uniform(-3, 3))
    one, two = (np.column_stack([rng.uniform(-4, 4, (30, 2)), rng.uniform(-3, 3, 30)]) for _ in range(2))
    by_one = rng.random(30) < 0.5
    there = se2.compose(T, two)
    here = np.where(by_one[:, None], one, there)
    seen = np.where(by_one[:, None], there, one)
    d = seen[:, :2] - here[:, :2]
    bearing = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - here[:, 2])
    found, left = relative_odometry_frame(one, two, bearing, by_one)
    assert np.abs(se2.between(T, found)).max() < 0.02
    assert left < 1e-5
    bearing[:6] += 1.0  # a fifth is false
    (x, y, turn), left = relative_odometry_frame(one, two, bearing, by_one, 0.2)
    there = se2.compose(np.array([x, y, turn]), two)
    d = np.where(by_one[:, None], there - one, one - there)
    heading = np.where(by_one, one[:, 2], there[:, 2])
    off = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - heading - bearing)
    assert left == pytest.approx(np.minimum(off**2, 0.2**2).mean())
    assert left <= 0.2**2


def test_robots_that_see_each_other_all_know_their_headings_up_to_one_turn():
    pairs = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2), (4, 5), (5, 4), (6, 0), (3, 0), (0, 3)]
    for noise, near in ((0.0, 1e-6), (0.02, 0.1)):
        net, _, headings = swarm(1, noise=noise, pairs=pairs)
        found, known = mutual_headings(net)
        assert known.tolist() == [True] * 4 + [False] * 3
        off = se2.wrap_angle(found - headings)[known]
        assert apart(off, off[0]) < near
    nobody, known = mutual_headings(swarm(2, pairs=[(0, 1), (1, 2)])[0])
    assert not known.any()
    assert not nobody.any()


def test_many_mutual_sightings_average_their_noise_out():
    net, _, headings = swarm(3, n=20, noise=0.1)
    found, known = mutual_headings(net)
    assert known.all()
    off = se2.wrap_angle(found - headings)
    off = se2.wrap_angle(off - np.angle(np.exp(1j * off).mean()))
    assert np.sqrt(np.square(off).mean()) < 1.5 * 0.1 * np.sqrt(2 / 19)


def test_who_sees_three_anchors_knows_its_heading_alone_and_nobody_else():
    pairs = [(3, 0), (3, 1), (3, 2), (4, 0), (4, 1), (4, 1), (5, 0), (5, 1), (5, 2), (0, 1), (5, 4)]
    net, _, headings = swarm(4, pairs=pairs, anchors=(0, 1, 2))
    found, known = beacon_headings(net)
    assert np.flatnonzero(known).tolist() == [3, 5]
    assert apart(found[known], headings[known]) < 0.02
    assert not found[~known].any()


def test_placed_robots_turn_as_what_they_see_says_and_known_headings_stay():
    net, places, headings = swarm(5, noise=0.05)
    assert apart(headings_at(net, places), headings) < 0.15
    placed, known = np.array([True] * 5 + [False] * 2), np.array([True] + [False] * 6)
    before = np.full(7, 0.7)
    found, now = resected_headings(net, places, placed, before, known)
    assert now.tolist() == [True] * 5 + [False] * 2
    assert found[0] == 0.7
    assert (found[5:] == 0.7).all()
    for k in range(1, 5):
        rows = (net.observer == k) & (net.target < 5)
        d = places[net.target[rows]] - places[k]
        turns = np.exp(1j * (np.arctan2(d[:, 1], d[:, 0]) - net.bearing[rows]))
        assert apart(found[k], np.angle(turns.sum())) < 1e-12
    blind = swarm(6, pairs=[(0, 1), (1, 0)])
    assert not headings_at(blind[0], blind[1])[2:].any()


def test_a_shape_is_turned_onto_its_anchors_whatever_its_place_and_size():
    net, places, headings = swarm(7, anchors=(1, 3, 4))
    for turn in (-2.5, 0.4, 3.0):
        shape = 2.5 * (places @ se2.rotation(-turn).T) + np.array([3.0, -8.0])
        everybody = np.ones(7, dtype=bool)
        np.testing.assert_allclose(anchored_turn(net, shape, everybody), se2.rotation(turn), atol=1e-9)
        moved = shape.copy()
        moved[3] += 5.0  # who is not chosen has no say
        np.testing.assert_allclose(anchored_turn(net, moved, np.arange(7) != 3), se2.rotation(turn), atol=1e-9)
    seen = world_directions(net, headings)
    d = places[net.target] - places[net.observer]
    np.testing.assert_allclose(seen, d / np.linalg.norm(d, axis=1, keepdims=True), atol=1e-9)
    np.testing.assert_array_equal(world_directions(net, None), net.direction)
