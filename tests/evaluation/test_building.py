"""What robots can reach and see of a building, and how a map of it is scored."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.core.walls import Walls
from mapweave.evaluation.building import known_at, share_free, survey_building, wall_scores

# A room of 6 x 4 m, a closed cell of 1 x 1 m in it, and a niche of 2 x 4 m behind a gap of 0.3 m.
ROOM = [(0, 0, 8, 0), (8, 0, 8, 4), (8, 4, 0, 4), (0, 4, 0, 0), (6, 0, 6, 1.8), (6, 2.1, 6, 4)]
CELL = [(1, 1, 2, 1), (2, 1, 2, 2), (2, 2, 1, 2), (1, 2, 1, 1)]
WALLS = Walls.of(np.array([*ROOM, *CELL], dtype=float))
START = np.array([[4.0, 2.0, 0.0]])


def building(radius=0.2):
    return survey_building(WALLS, np.zeros(2), np.array([8.0, 4.0]), START, radius, 12.0)


def test_a_disc_reaches_the_room_but_neither_the_closed_cell_nor_what_lies_behind_a_gap():
    made = building()
    places = made.places()
    assert places[:, 0].max() < 5.9
    inside = ((places > 1) & (places < 2)).all(axis=1)
    assert not inside.any()
    expected = 5.6 * 3.6 - 1.4 * 1.4 + (4 - np.pi) * 0.04  # the corners round the cell are round
    assert made.area == pytest.approx(expected, rel=0.02)
    ((x, y, area),) = made.shut  # the cell is as small as furniture
    assert (x, y, area) == pytest.approx((7.0, 2.0, 1.6 * 3.6), abs=0.15)


def test_a_smaller_disc_goes_through_the_gap():
    assert len(building(0.1).shut) == 0
    assert building(0.1).places()[:, 0].max() > 7.5


def test_a_world_with_a_way_out_is_refused():
    open_ = Walls.of(np.delete(WALLS.segments, 3, axis=0))
    with pytest.raises(DataError, match="the walls do not close round the robots"):
        survey_building(open_, np.zeros(2), np.array([8.0, 4.0]), START, 0.2, 12.0)


def test_only_walls_that_can_be_seen_are_asked_of_a_map():
    seen = building().seen
    x, y = seen.T
    assert (np.isclose(x, 0) & (y > 0.5) & (y < 3.5)).sum() == 30
    assert not ((x > 1.01) & (x < 1.99) & (y > 1.01) & (y < 1.99)).any()
    behind = (x > 6.01) & (np.isclose(y, 0) | np.isclose(y, 4))
    assert 0 < behind.sum() < 30  # of 40, through the gap


def test_a_map_of_the_very_walls_is_perfect_and_a_shifted_one_errs_by_the_shift():
    made = building()
    error, precision, recall = wall_scores(made.seen, WALLS, made, 0.1)
    assert error == pytest.approx(0.0, abs=1e-9)
    assert precision == recall == 1.0
    left = made.seen[np.isclose(made.seen[:, 0], 0.0)]
    error, precision, recall = wall_scores(left - (0.25, 0.0), WALLS, made, 0.1)
    assert error == pytest.approx(0.25, abs=0.01)
    assert precision == recall == 0.0
    assert wall_scores(left, WALLS, made, 0.1)[2] < 0.2
    assert wall_scores(np.zeros((0, 2)), WALLS, made, 0.1) == (None, None, None)


def test_the_share_mapped_counts_reached_ground_alone():
    made = building()
    free = np.zeros((40, 40), dtype=bool)  # the left half of the world, 4 x 4 m
    free[:] = True
    half = share_free(made, free, np.zeros(2), 0.1)
    assert half == pytest.approx((made.places()[:, 0] < 4).mean())
    assert share_free(made, ~free, np.zeros(2), 0.1) == 0.0
    assert known_at(np.array([[-0.01, 0.0], [3.99, 3.99], [4.01, 0.0]]), free, np.zeros(2), 0.1).tolist() == [
        False,
        True,
        False,
    ]
