"""Grid maps: what a cell says."""

import numpy as np

from mapweave.laser.laser_map import GridMap, IntensityCalibration


def small_grid():
    hits = np.zeros((2, 3), int)
    passes = np.zeros((2, 3), int)
    hits[1, 2], passes[0, 1] = 9, 9
    weight = (hits > 0).astype(float)
    mean = np.zeros((2, 3, 2))
    mean[1, 2] = 0.25, 0.15
    return GridMap(0.1, np.array([0.0, 0.0]), hits, passes, mean, 0.7 * weight, weight)


def test_a_cell_no_beam_reached_is_half_occupied_and_beams_move_it_towards_what_they_say():
    p = small_grid().occupancy()
    assert p[0, 0] == 0.5
    assert p[1, 2] > 0.9
    assert p[0, 1] < 0.1


def test_cells_with_returns_are_listed_with_their_mean_point_feature_and_weight():
    assert np.allclose(small_grid().cells(), [[0.25, 0.15, 0.7, 1.0]])


def test_free_cells_are_those_beams_went_through():
    assert np.allclose(small_grid().free_cells(2), [[0.15, 0.05]])


def test_the_gain_is_linear_in_logarithm_between_knots_and_held_outside():
    c = IntensityCalibration(np.array([1.0, 2.0]), np.array([0.0, -1.0]), 1.0, 1.0, 0.1, 10)
    assert np.allclose(np.log(c.gain(np.array([0.5, 1.5, 9.0]))), [0.0, -0.5, -1.0])
