"""When a place found in a map is believed: nothing else fits, walls are not seen through, light agrees."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.laser import localise_trust
from mapweave.laser.beam import Beams
from mapweave.laser.laser_map import GridMap
from mapweave.laser.localise_trust import LEAST_OCCUPANCY, LocalisedScan, TrustConfig, evidence, nearest_field

CELL = 0.1
RNG = np.random.default_rng(5)
LIGHT = RNG.uniform(0.1, 1.0, 20)  # of every metre of wall, by its number


def outline(*corners):
    """Points every 5 cm along a closed line, and the light they send back."""
    points = []
    for a, b in zip(corners, (*corners[1:], corners[0]), strict=True):
        n = int(np.hypot(*np.subtract(b, a)) / 0.05)
        points += [np.add(a, np.subtract(b, a) * k / n) for k in range(n)]
    points = np.array(points)
    return points, LIGHT[np.floor(points.sum(axis=1)).astype(int) % 20]


def room(x=0.0, alcove=True):
    back = [(2.5, 4), (2.5, 4.6), (1, 4.6), (1, 4)] if alcove else []
    points, q = outline((0, 0), (6, 0), (6, 4), *back, (0, 4))
    return points + np.array([x, 0.0]), q


def grid(*parts):
    """Walls as a map whose lower corner is (-2, -2) [m]."""
    points, q = (np.concatenate(part) for part in zip(*parts, strict=True))
    shape = (100, 300)
    hits, feature, mean = np.zeros(shape, int), np.zeros(shape), np.zeros((*shape, 2))
    col, row = np.floor((points + 2.0) / CELL).astype(int).T
    hits[row, col] = 5
    feature[row, col], mean[row, col] = q, points
    return GridMap(CELL, np.array([-2.0, -2.0]), hits, np.zeros(shape, int), mean, feature, hits.astype(float))


def scan(part, pose):
    """All of the part's walls, seen from `pose` without noise."""
    points, q = part
    s = se2.act(se2.inverse(pose), points)
    n = len(s)
    r = np.hypot(*s.T)
    return Beams(s, q, np.ones(n), np.zeros((n, 2)), r, np.ones(n), q, np.full(n, 5), np.arange(n))


def asked(made, part, believed, light=True, searched=True, **cfg):
    """The evidence for a robot that drives a metre from (2, 1.5) in the part, believed to be moved by `believed`."""
    seen = []
    for x in np.arange(2.0, 3.0, 0.3):
        pose = np.array([x, 1.5, 0.2])
        seen.append(LocalisedScan(se2.compose(np.array(believed), pose), scan(part, pose), np.zeros(2)))
    return evidence(
        seen,
        made,
        nearest_field(made, LEAST_OCCUPANCY),
        light=light,
        searched=searched,
        cfg=replace(TrustConfig(), **cfg),
    )


def test_the_only_place_that_fits_is_believed():
    for light in (True, False):
        found = asked(grid(room()), room(), (0.0, 0.0, 0.0), light)
        assert not found.doubt
        assert found.explained > 0.95
        assert found.through < 0.05
        assert found.ratio < 0.9
    assert found.light is None


def test_a_room_that_stands_twice_is_doubted_and_the_other_place_named_unless_light_tells_them_apart():
    room_points, q = room(10.0)
    painted = grid(room(), (room_points, RNG.permutation(q)))
    alone = asked(painted, room(), (0.0, 0.0, 0.0), light=False)
    assert "fit also where the last pose is (12.9 m, 1.5 m, " in alone.doubt
    assert alone.ratio == pytest.approx(1.0, abs=0.05)
    assert not asked(painted, room(), (0.0, 0.0, 0.0)).doubt
    assert not asked(painted, room(), (0.0, 0.0, 0.0), light=False, searched=False).doubt
    twice = asked(grid(room(), room(10.0)), room(), (0.0, 0.0, 0.0))
    assert "fit also where" in twice.doubt


def test_the_wrong_one_of_two_rooms_alike_is_given_away_by_its_light():
    points, q = room(10.0)
    painted = grid(room(), (points, RNG.permutation(q)))
    wrong = asked(painted, room(), (10.0, 0.0, 0.0))
    assert wrong.light < 0.5
    assert "light" in wrong.doubt


def test_light_without_contrast_neither_speaks_for_a_place_nor_against_it():
    points, q = room()
    grey = (points, np.full(len(q), 0.5))
    found = asked(grid(grey), grey, (0.0, 0.0, 0.0))
    assert (found.light, found.doubt) == (None, "")


def test_a_place_that_the_map_does_not_explain_is_not_believed():
    found = asked(grid(room()), room(alcove=False), (0.5, 0.7, 0.3), light=False)
    assert "the map explains" in found.doubt


def test_beams_through_walls_of_the_map_are_a_doubt():
    wall = outline((1.5, 0.5), (1.5, 2.9), (1.52, 2.9), (1.52, 0.5))
    found = asked(grid(room(), wall), room(), (0.0, 0.0, 0.0), light=False)
    assert found.explained > 0.9
    assert found.through > 0.1
    assert "through walls" in found.doubt


def test_a_place_that_is_not_among_the_two_best_is_doubted(monkeypatch):
    monkeypatch.setattr(localise_trust, "MOST_THROUGH", 1.0)
    found = asked(grid(room(), room(10.0)), room(), (0.0, 1.0, 0.0), light=False, least_explained=0.0)
    assert "fit also where" in found.doubt
    assert found.ratio == 1.0
