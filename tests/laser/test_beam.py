"""Beams: what a return is, its line, its incidence, its feature."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.kernels.laser.beams import spacing
from mapweave.laser.beam import BeamConfig, IntensityCalibration, beams, insertion_weight

pytestmark = pytest.mark.kernel


def wall_scan(distance=2.0, n=81, light=1000.0):
    """A straight wall `distance` ahead, across the view."""
    angle = np.linspace(-1.0, 1.0, n)
    r = distance / np.cos(angle)
    return Scan(r, np.ones(n, bool), np.full(n, light), -1.0, float(angle[1] - angle[0]), 5.0, np.array([0.1, 0, 0]))


def test_the_cosine_of_incidence_on_a_straight_wall_is_that_of_the_beam():
    b = beams(wall_scan(), "none", None, BeamConfig())
    angle = np.linspace(-1.0, 1.0, 81)[b.beam]
    assert np.allclose(b.c, np.cos(angle), atol=1e-9)
    assert np.allclose(b.normal, [-1.0, 0.0], atol=1e-9)
    assert np.allclose(b.s[:, 0], 2.1)


def test_a_return_with_fewer_than_three_near_in_range_counts_as_met_head_on():
    scan = wall_scan()
    r = np.array(scan.ranges)
    r[40] = 0.7
    b = beams(Scan(r, scan.hit, None, -1.0, scan.angle_increment, 5.0), "none", None, BeamConfig())
    assert b.c[40] == 1.0
    assert b.support[40] == 1


def test_misses_and_ranges_outside_the_sensors_limits_are_no_returns():
    scan = wall_scan()
    r, hit = np.array(scan.ranges), np.array(scan.hit)
    r[[0, 1, 2, 3]] = np.nan, np.inf, 0.0, 6.0
    hit[4] = False
    b = beams(Scan(r, hit, None, -1.0, scan.angle_increment, 5.0), "none", None, BeamConfig())
    assert b.beam[0] == 5
    assert (b.q == 0).all()


def test_the_feature_takes_out_range_and_incidence_and_is_capped():
    calibration = IntensityCalibration(np.array([0.0, 10.0]), np.array([0.0, -1.0]), 2.0, 100.0, 0.1, 1000)
    scan = wall_scan()
    angle = np.linspace(-1.0, 1.0, 81)
    light = 0.5 * 100.0 * np.exp(-np.array(scan.ranges) / 10) * np.cos(angle) ** 2
    light[10] *= 10
    told = Scan(scan.ranges, scan.hit, light, -1.0, scan.angle_increment, 5.0)
    q = beams(told, "normalised", calibration, BeamConfig()).q
    assert np.allclose(np.delete(q, 10), 0.5)
    assert q[10] == 1.2
    raw = beams(told, "raw", calibration, BeamConfig()).q
    assert np.allclose(raw, np.minimum(1.2, light / 100))


def test_a_return_counts_fully_up_to_a_metre_and_then_falls_with_range_squared():
    assert np.allclose(insertion_weight(np.array([0.3, 1.0, 2.0, 10.0])), [1, 1, 0.25, 0.01])


def test_returns_are_where_the_sensor_is_mounted_and_keep_their_numbers():
    mount, angles = np.array([0.2, -0.1, 0.7]), np.linspace(-1.0, 1.0, 21)
    ranges = np.array([2.0, np.nan, 30.0, 0.01, *np.linspace(3.0, 4.0, 17)])
    hit = np.ones(21, bool)
    hit[7] = False
    scan = Scan(ranges, hit, None, -1.0, 0.1, 10.0, mount)
    b = beams(scan, "none", None, BeamConfig())
    kept = np.setdiff1d(np.arange(21), [1, 2, 3, 7])
    assert b.beam.tolist() == kept.tolist()
    at = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])[kept]
    np.testing.assert_allclose(b.s, se2.act(mount, at), atol=1e-12)
    np.testing.assert_allclose(b.r, ranges[kept])
    np.testing.assert_allclose(np.hypot(*b.normal.T), 1.0)
    towards = se2.act(mount, np.zeros(2)) - b.s
    np.testing.assert_allclose((b.normal * towards).sum(axis=1) / b.r, b.c, atol=1e-12)


def test_a_return_is_as_far_apart_as_the_nearer_of_those_beside_it():
    points = np.array([[0.0, 0.0], [0.3, 0.4], [0.3, 1.4], [3.3, 5.4]])
    np.testing.assert_allclose(spacing(points), [0.5, 0.5, 1.0, 5.0])
    assert spacing(points[:1]).tolist() == [0.0]
    assert spacing(points[:0]).tolist() == []
