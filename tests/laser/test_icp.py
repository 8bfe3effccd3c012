"""Intensity-ICP: nearest points, the pose they ask for, and the whole match."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.kernels.laser.icp import nearest, sort_into_cells
from mapweave.laser.icp import IcpConfig, match

pytestmark = pytest.mark.kernel


@pytest.mark.eq("Hara07:1")
def test_the_point_found_on_the_grid_is_the_one_of_least_distance_brightness_included():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2, 2, (60, 2)), rng.uniform(0, 1, 60)])
    cell = 0.15
    ordered, starts, corner, cols = sort_into_cells(points, cell)
    for guess in (-1, 5):
        for z in np.column_stack([rng.uniform(-2.2, 2.2, (40, 2)), rng.uniform(0, 1, 40)]):
            D = ((ordered - z) ** 2 * [1, 1, 0.5]).sum(axis=1)
            k, d = nearest(ordered, starts, corner, cols, cell, tuple(z), 0.5, 0.4**2, guess)
            if D.min() <= 0.4**2:
                assert k == D.argmin()
                assert abs(d - D.min()) < 1e-12
            else:
                assert k == -1


def newton_pose(m, z, start, iterations=50):
    """The pose of least mean |m - T z|^2 by Newton's method, as the paper finds it; equals `se2.align(z, m)`.

    Full Hessian, its theta term kept positive so that the step descends from anywhere.
    """
    x = np.array(start, float)
    n = len(z)
    for _ in range(iterations):
        R = se2.rotation(float(x[2]))
        turned = z @ R.T
        e = turned + x[:2] - m
        dz = np.column_stack([-turned[:, 1], turned[:, 0]])  # d(R z)/dtheta
        g = np.array([e[:, 0].mean(), e[:, 1].mean(), (e * dz).sum() / n])
        H = np.eye(3)
        H[:2, 2] = H[2, :2] = dz.mean(axis=0)
        curvature = ((dz * dz).sum() - (e * turned).sum()) / n
        least = float(H[:2, 2] @ H[:2, 2])
        H[2, 2] = curvature if curvature > least + 1e-9 else (dz * dz).sum() / n + 1e-9
        step = np.linalg.solve(H, g)
        x -= step
        if np.abs(step).max() < 1e-13:
            break
    x[2] = se2.wrap_angle(x[2])
    return x


@pytest.mark.eq("Hara07:2")
def test_newtons_method_ends_where_the_closed_form_stands():
    rng = np.random.default_rng(1)
    for _ in range(10):
        z = rng.normal(0, 2, (30, 2))
        T = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
        m = se2.act(T, z) + rng.normal(0, 0.05, (30, 2))
        closed = se2.align(z, m)
        newton = newton_pose(m, z, np.zeros(3))
        d = newton - closed
        d[2] = se2.wrap_angle(d[2])
        assert np.abs(d).max() < 1e-6


def room(rng, n=90):
    """Points on the walls of a room of 5 x 4 m, with brightness."""
    s = np.sort(rng.uniform(0, 18, n))
    x = np.where(s < 5, s, np.where(s < 9, 5, np.where(s < 14, 14 - s, 0))) - 2.2
    y = np.where(s < 5, 0, np.where(s < 9, s - 5, np.where(s < 14, 4, 18 - s))) - 1.7
    return np.column_stack([x, y, np.floor(s / 0.7) % 2])


@pytest.mark.eq("Hara07:3")
def test_a_scan_moved_away_is_moved_back():
    rng = np.random.default_rng(2)
    reference = room(rng)
    T = np.array([0.12, -0.08, 0.05])
    scan = np.column_stack([se2.act(se2.inverse(T), reference[:, :2]), reference[:, 2]])
    found = match(reference, scan, np.zeros(3), IcpConfig())
    assert found.status == "converged"
    assert np.abs(se2.between(T, found.pose)).max() < 1e-6
    assert found.rms < 1e-6
    assert found.pairs == len(scan)


def test_along_a_bare_wall_only_brightness_tells_where_the_scan_belongs():
    x = np.arange(0, 6, 0.05)
    reference = np.column_stack([x, np.zeros_like(x), np.floor(x / 0.3) % 2])
    seen = reference[30:90]
    start = np.array([0.22, 0.0, 0.0])
    with_light = match(reference, seen, start, IcpConfig())
    without = match(reference * [1, 1, 0], seen * [1, 1, 0], start, IcpConfig())
    assert abs(with_light.pose[0]) < 0.06
    assert without.pose[0] > 0.15


def test_too_few_pairs_is_a_failure_that_says_so_and_moves_nothing():
    far = match(np.zeros((30, 3)) + 50, room(np.random.default_rng(3)), np.array([0.1, 0.2, 0.3]), IcpConfig())
    assert far.status == "failed"
    assert far.pairs == 0
    assert np.allclose(far.pose, [0.1, 0.2, 0.3])
    assert match(np.zeros((0, 3)), np.zeros((4, 3)), np.zeros(3), IcpConfig()).status == "failed"


def test_the_distance_left_is_the_root_mean_square_over_the_pairs_and_unpaired_points_have_none():
    rng = np.random.default_rng(4)
    reference = room(rng)
    T = np.array([0.05, 0.03, -0.02])
    scan = np.column_stack([se2.act(se2.inverse(T), reference[:, :2]) + rng.normal(0, 0.01, (90, 2)), reference[:, 2]])
    scan[::9, :2] += 20.0
    found = match(reference, scan, np.zeros(3), IcpConfig())
    paired = np.arange(90) % 9 > 0
    d = np.hypot(*(se2.act(found.pose, scan[paired, :2])[:, None] - reference[:, :2]).T).min(axis=0)
    assert found.pairs == paired.sum()
    assert found.rms == pytest.approx(np.sqrt(np.mean(d**2)), rel=0.2)
    assert 0.005 < found.rms < 0.03


def test_a_match_does_not_end_before_the_gate_is_at_its_least():
    """Two pairs beyond the least gate pull against each other: the match stands still and they must still go."""
    reference = room(np.random.default_rng(5))
    apart = np.array([[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0]])
    scan = np.concatenate([reference, apart])
    wide = np.concatenate([reference, apart * [1.02, 1, 1]])  # 0.2 m off: twice the least gate
    found = match(wide, scan, np.zeros(3), IcpConfig())
    assert np.abs(found.pose).max() < 1e-9
    assert found.pairs == len(reference)
    assert found.rms < 1e-9


def test_a_point_far_off_the_grid_finds_what_lies_within_its_limit():
    row = np.column_stack([np.linspace(0, 2, 30), np.full(30, 5.0), np.zeros(30)])
    column = np.ascontiguousarray(row[:, [1, 0, 2]])
    for points in (row, column):
        ordered, starts, corner, cols = sort_into_cells(points, 0.15)
        for away in ([0.0, -0.9], [0.0, 0.9], [-0.9, 0.0], [0.9, 0.0]):
            z = np.array([*(points[7, :2] + away), 0.0])
            D = ((ordered - z) ** 2).sum(axis=1)
            k, d = nearest(ordered, starts, corner, cols, 0.15, tuple(z), 1.0, 4.0, -1)
            assert d == pytest.approx(D.min())
            assert D[k] == pytest.approx(D.min())
