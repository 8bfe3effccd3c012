"""Clearance along an arc."""

import numpy as np
import pytest

from mapweave.kernels.exploration.wavefront import arc_clearance, arc_points

pytestmark = pytest.mark.kernel


def test_an_arc_is_the_limit_of_many_small_moves():
    v, w, period, n = 0.6, -0.8, 0.5, 20000
    x = y = heading = 0.0
    for _ in range(n):
        x += v * period / n * np.cos(heading)
        y += v * period / n * np.sin(heading)
        heading += w * period / n
    assert arc_points(v, w, period, 7)[-1] == pytest.approx([x, y, heading], abs=1e-4)


def test_driving_straight_is_the_limit_of_ever_wider_arcs():
    assert arc_points(0.5, 0.0, 1.0, 4) == pytest.approx(arc_points(0.5, 1e-5, 1.0, 4), abs=1e-5)


def test_clearance_is_the_least_distance_of_the_way_to_any_point():
    points = np.array([[0.15, 0.3], [2.0, 0.0]])
    straight, still, turning = arc_clearance(np.array([[0.6, 0.0], [0.0, 0.0], [0.0, 1.0]]), 0.5, points, 0.01)
    assert straight == pytest.approx(0.3, abs=1e-3)
    assert still == pytest.approx(np.hypot(0.15, 0.3))
    assert turning == pytest.approx(still)


def test_without_points_every_arc_is_clear():
    assert np.isinf(arc_clearance(np.array([[0.6, 0.0]]), 0.5, np.zeros((0, 2)), 0.02)).all()
