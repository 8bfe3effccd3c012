"""Free, occupied and unknown cells."""

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.laser.occupancy_mapper import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Occupancy,
    OccupancyMapper,
    Returns,
    from_counts,
    without_gaps,
)


def test_a_cell_is_occupied_when_enough_of_its_beams_ended_there():
    hits = np.array([[0, 0, 1, 1, 5]])
    passes = np.array([[0, 3, 30, 3, 0]])
    state = from_counts(0.2, np.zeros(2), hits, passes, share=0.2).state
    assert state.tolist() == [[UNKNOWN, FREE, FREE, OCCUPIED, OCCUPIED]]


def test_the_middle_of_a_cell_lies_in_that_cell():
    grid = Occupancy(0.25, np.array([-1.0, 2.0]), np.zeros((6, 9), np.int8))
    cells = np.argwhere(grid.free)
    assert np.array_equal(grid.cells(grid.centres(cells)), cells)


def test_a_point_outside_comes_to_the_border():
    grid = Occupancy(0.5, np.zeros(2), np.zeros((4, 6), np.int8))
    assert grid.cells(np.array([[-3.0, 0.6], [99.0, 99.0]])).tolist() == [[1, 0], [3, 5]]


def test_gaps_between_beams_close_and_neither_walls_nor_what_lies_behind_them_become_free():
    state = np.zeros((9, 12), dtype=np.int8)
    state[:, 2:4] = UNKNOWN  # a gap of two cells
    state[4, 6] = UNKNOWN
    state[:, 8], state[:, 9:] = OCCUPIED, UNKNOWN  # a wall and what is behind it
    closed = without_gaps(Occupancy(0.05, np.zeros(2), state)).state
    assert (closed[:, :8] == FREE).all()
    assert (closed[:, 8] == OCCUPIED).all()
    assert (closed[:, 9:] == UNKNOWN).all()
    wide = state.copy()
    wide[:, 2:6] = UNKNOWN
    assert (without_gaps(Occupancy(0.05, np.zeros(2), wide)).state[:, 2:6] == UNKNOWN).all()


def test_a_map_of_more_cells_than_any_memory_holds_is_refused_with_its_size():
    scan = Returns(np.array([[5.0, 3.0], [-5.0, 2.0]]), np.zeros((0, 2)), np.zeros(2))
    with pytest.raises(DataError, match=r"a map of 1e\+10 x 3e\+09 cells of 1e-09 m"):
        OccupancyMapper(1e-9).update([scan], np.zeros((1, 3)))
