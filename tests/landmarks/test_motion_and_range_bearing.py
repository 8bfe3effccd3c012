"""Models agree with finite differences, with each other and with what a textbook says."""

import numpy as np
import pytest

from mapweave.core.se2 import wrap_angle
from mapweave.landmarks import motion, range_bearing


def differences(f, x, angles=()):
    columns = []
    for k in range(len(x)):
        d = np.zeros(len(x))
        d[k] = 1e-6
        diff = f(x + d) - f(x - d)
        for a in angles:
            diff[a] = wrap_angle(diff[a])
        columns.append(diff / 2e-6)
    return np.array(columns).T


@pytest.mark.parametrize("w", [0.0, 1e-7, 1e-3, 0.5, -3.0])
def test_motion_jacobians_agree_with_central_differences(w):
    rng = np.random.default_rng(3)
    for _ in range(10):
        pose, v, dt = rng.uniform(-3, 3, 3), rng.uniform(-1, 1), rng.uniform(0.01, 0.5)
        F, G = motion.unicycle_jacobians(pose, v, w, dt)
        assert np.allclose(F, differences(lambda p: motion.unicycle(p, v, w, dt), pose, (2,)), atol=1e-8)
        by_u = differences(lambda u: motion.unicycle(pose, u[0], u[1], dt), np.array([v, w]), (2,))
        assert np.allclose(G, by_u, atol=1e-8)


def test_a_half_circle_ends_a_diameter_to_the_left_facing_back():
    end = motion.unicycle(np.zeros(3), np.pi, np.pi, 1.0)  # radius 1 m
    assert np.allclose(end[:2], [0.0, 2.0])
    assert np.isclose(end[2], np.pi)


def test_two_half_steps_are_one_step():
    once = motion.unicycle(np.array([1.0, 2.0, 0.3]), 0.2, -0.4, 1.0)
    half = motion.unicycle(np.array([1.0, 2.0, 0.3]), 0.2, -0.4, 0.5)
    assert np.allclose(motion.unicycle(half, 0.2, -0.4, 0.5), once)


def test_no_motion_changes_nothing():
    pose = np.array([1.0, 2.0, 0.3])
    assert np.allclose(motion.unicycle(pose, 0.0, 0.0, 1.0), pose)


def test_sighting_jacobians_agree_with_central_differences():
    rng = np.random.default_rng(4)
    for _ in range(20):
        pose, point = rng.uniform(-3, 3, 3), rng.uniform(4, 8, 2)
        A, B = range_bearing.observe_jacobians(pose, point)
        assert np.allclose(A, differences(lambda p: range_bearing.observe(p, point), pose, (1,)), atol=1e-8)
        assert np.allclose(B, differences(lambda q: range_bearing.observe(pose, q), point, (1,)), atol=1e-8)
        z = range_bearing.observe(pose, point)
        C, D = range_bearing.locate_jacobians(pose, z)
        assert np.allclose(C, differences(lambda p: range_bearing.locate(p, z), pose), atol=1e-8)
        assert np.allclose(D, differences(lambda y: range_bearing.locate(pose, y), z), atol=1e-8)


def test_locating_what_was_observed_gives_the_point_back():
    pose, point = np.array([1.0, -2.0, 3.0]), np.array([-4.0, 0.5])
    assert np.allclose(range_bearing.locate(pose, range_bearing.observe(pose, point)), point)


def test_noise_grows_with_the_distance():
    near, far = (range_bearing.noise(r, 0.05, 0.045, 0.014) for r in (1.0, 4.0))
    assert np.isclose(far[0, 0], 0.05**2 + 0.18**2)
    assert near[0, 0] < far[0, 0]
    assert near[1, 1] == far[1, 1] == 0.014**2
