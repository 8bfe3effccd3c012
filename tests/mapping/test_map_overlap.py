"""What one robot's views say of another's walls."""

import numpy as np

from mapweave.core import se2
from mapweave.mapping.map_overlap import KeyframeMap, seen_alike, wall_overlap
from mapweave.mapping.merge import merge_maps

from ..laser.test_merge import office_pair


def test_only_points_amid_free_floor_speak_against_clear_sight():
    """A map moved by half a metre contradicts itself close to its walls; moved by a room it does so amid the floor."""
    made = office_pair(7, 0.9)
    near = seen_alike(made.a, made.b, se2.compose(np.array([0.45, 0.0, 0.0]), made.transform))
    far = seen_alike(made.a, made.b, se2.compose(np.array([1.7, 1.1, 0.4]), made.transform))
    true = seen_alike(made.a, made.b, made.transform)
    assert true.clear > 0.98
    assert near.clear > near.share
    assert far.clear < 0.95


def test_a_map_without_walls_is_refused_from_either_side():
    made = office_pair(7, 0.5)
    empty = KeyframeMap("empty", np.zeros((2, 3)), [np.zeros((0, 2))] * 2)
    assert not merge_maps(made.b, empty).merged
    assert not merge_maps(empty, made.b).merged


def test_of_a_wall_and_half_of_it_all_of_the_half_overlaps_whichever_map_holds_it():
    wall = np.column_stack([np.arange(0.0, 8.0, 0.2), np.full(40, 2.0)])
    for held, other in ((wall, wall[:20]), (wall[:20], wall)):
        assert wall_overlap(other, KeyframeMap("one", np.zeros((1, 3)), [held]), np.zeros(3)) == 1.0
