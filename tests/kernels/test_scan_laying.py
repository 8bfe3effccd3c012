"""Scans laid into a grid in whole numbers."""

import numpy as np
import pytest

from mapweave.kernels.laser.scan_laying import UNIT, WEIGHT, CellCounts, lay_scan

pytestmark = pytest.mark.kernel


def blank(rows=30, cols=40):
    return *(np.zeros((rows, cols), np.int32) for _ in range(3)), np.zeros((rows, cols, 4), np.int64)


def test_a_scan_taken_out_leaves_no_trace_and_the_corner_does_not_matter():
    rng = np.random.default_rng(0)
    eye, points, ends = rng.uniform(-1, 1, 2), rng.uniform(-1.9, 1.9, (50, 2)), rng.uniform(-1.9, 1.9, (9, 2))
    light = rng.uniform(0, 1, (50, 2))
    one, two = blank(60, 60), blank(80, 90)
    lay_scan(CellCounts(*one, np.array([-30, -30]), 0.07), eye, points, light, ends, 1.2, 1)
    lay_scan(CellCounts(*two, np.array([-41, -37]), 0.07), eye, points, light, ends, 1.2, 1)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a, b[7:67, 11:71])
    lay_scan(CellCounts(*one, np.array([-30, -30]), 0.07), eye, points, light, ends, 1.2, -1)
    assert not any(a.any() for a in one)


def test_a_return_is_a_hit_and_a_beam_that_came_to_nothing_passes_its_last_cell_too():
    hits, far, passes, sums = blank()
    counts = CellCounts(hits, far, passes, sums, np.zeros(2, np.int64), 0.1)
    lay_scan(counts, np.array([0.05, 0.05]), np.array([[0.525, 0.05]]),
              np.array([[0.7, 0.5]]), np.array([[0.05, 0.35]]), 0.6, 1)  # fmt: skip
    assert hits.sum() == 1
    assert far.sum() == 0
    assert hits[0, 5] == 1
    assert passes[0, 1:5].tolist() == [1] * 4
    assert passes[0, 5] == 0
    assert passes[1:5, 0].tolist() == [1, 1, 1, 0]
    assert np.allclose(sums[0, 5] / WEIGHT, [0.125 * UNIT, 0.25 * UNIT, 0.35 * UNIT, 0.5], rtol=1e-4)
