"""Whole maps laid on each other: the true place scores most, wherever it is, and others stay apart from it."""

import numpy as np

from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.laser.map_correlation import CorrelationConfig, map_places
from mapweave.laser.map_overlap import KeyframeMap, seen_alike
from mapweave.sim.laser_pairs import PairConfig, drive_pair
from mapweave.sim.office_floor import office_floor

CFG = CorrelationConfig(turn=np.radians(4.0))


def office_pair(seed, share):
    floor = office_floor(500.0, seed)
    walls, rng = Walls.of(floor.world.segments), np.random.default_rng([seed, 5])
    return drive_pair(walls, floor.lower + 4.0, floor.upper - 4.0, share, rng, PairConfig(keyframes=120, beams=90))


def test_the_true_place_is_the_best_and_the_others_are_elsewhere():
    made = office_pair(4, 0.4)
    turn = se2.compose(np.array([3.0, -2.0, 2.2]), np.zeros(3))
    a = KeyframeMap("a", se2.compose(turn, made.a.pose), made.a.points)
    places = map_places(a, made.b, CFG)
    e = se2.between(se2.compose(turn, made.transform), places[0].transform)
    assert np.hypot(*e[:2]) < 1.0
    assert abs(e[2]) < 0.1
    assert 1 < len(places) <= CFG.places
    scores = [p.score for p in places]
    assert scores == sorted(scores, reverse=True)
    assert scores[-1] > CFG.least * scores[0]
    middle = made.b.walls.mean(axis=0)
    at = [np.array([*se2.act(p.transform, middle[None])[0], p.transform[2]]) for p in places]
    for i, one in enumerate(at):
        for other in at[:i]:
            apart = np.hypot(*(one - other)[:2]) > 0.8 * CFG.apart
            assert apart or abs(se2.wrap_angle(one[2] - other[2])) > CFG.apart_turn


def test_walls_amid_what_the_other_saw_as_free_speak_against_a_place():
    made = office_pair(7, 0.5)
    strict = map_places(made.a, made.b, CFG)[0].score
    blind = map_places(made.a, made.b, CorrelationConfig(turn=CFG.turn, through=0.0))[0].score
    assert 0.0 < strict < blind


def test_a_map_without_walls_has_no_place():
    made = office_pair(7, 0.5)
    empty = KeyframeMap("empty", np.zeros((2, 3)), [np.zeros((0, 2))] * 2)
    assert map_places(made.a, empty, CFG) == []
    assert map_places(empty, made.b, CFG) == []


def test_only_points_amid_free_floor_speak_against_clear_sight():
    """A map moved by half a metre contradicts itself close to its walls; moved by a room it does so amid the floor."""
    made = office_pair(7, 0.9)
    near = seen_alike(made.a, made.b, se2.compose(np.array([0.45, 0.0, 0.0]), made.transform))
    far = seen_alike(made.a, made.b, se2.compose(np.array([1.7, 1.1, 0.4]), made.transform))
    true = seen_alike(made.a, made.b, made.transform)
    assert true.clear > 0.98
    assert near.clear > near.share
    assert far.clear < 0.95
