"""Bearings: the Jacobians equal finite differences, and a residual turns the shorter way."""

import numpy as np
import pytest

from mapweave.swarm import bearing

RNG = np.random.default_rng(5)
STEP = 1e-6


@pytest.mark.eq("Hamatani:2", "Hamatani:4")
def test_a_planar_residual_keeps_the_sign_of_the_ray_and_turns_the_shorter_way():
    origin = np.zeros((2, 2))
    there = np.array([[-1.0, -1.0], [-1.0, -1e-9]])
    np.testing.assert_allclose(bearing.angle(origin, there), [-0.75 * np.pi, -np.pi])
    z = np.array([0.75 * np.pi, np.pi - 0.01])
    np.testing.assert_allclose(bearing.angle_residual(z, origin, there), [-0.5 * np.pi, -0.01], atol=1e-8)


def test_planar_jacobian_equals_the_finite_difference():
    p, q = RNG.normal(size=(2, 40, 2)) * 5
    J = bearing.angle_jacobian(p, q)
    for k in range(2):
        shift = np.eye(2)[k] * STEP
        by_target = -bearing.angle_residual(bearing.angle(p, q), p, q + shift) / STEP
        by_observer = -bearing.angle_residual(bearing.angle(p, q), p + shift, q) / STEP
        np.testing.assert_allclose(J[:, k], by_target, atol=1e-4)
        np.testing.assert_allclose(-J[:, k], by_observer, atol=1e-4)


def test_spatial_jacobian_equals_the_finite_difference_at_the_prediction():
    p, q = RNG.normal(size=(2, 60, 3)) * 5
    J = bearing.sphere_jacobian(p, q)
    u, _ = bearing.predict(p, q)
    for k in range(3):
        moved, _ = bearing.predict(p, q + np.eye(3)[k] * STEP)
        turned = np.einsum("mkc,mk->mc", bearing.tangent_basis(u), bearing.log_map(u, moved)) / STEP
        np.testing.assert_allclose(J[:, :, k], turned, atol=1e-4)


def test_the_gradient_of_the_squared_spatial_residual_is_exact_also_far_from_the_sighting():
    p, q = RNG.normal(size=(2, 60, 3)) * 5
    b, _ = bearing.predict(RNG.normal(size=(60, 3)), RNG.normal(size=(60, 3)))
    square = lambda x: np.square(bearing.sphere_residual(b, p, x)).sum(axis=1)
    gradient = -2 * np.einsum("mck,mc->mk", bearing.sphere_jacobian(p, q), bearing.sphere_residual(b, p, q))
    for k in range(3):
        shift = np.eye(3)[k] * STEP
        np.testing.assert_allclose(gradient[:, k], (square(q + shift) - square(q - shift)) / (2 * STEP), atol=1e-4)


def exp_map(u, e):
    """The unit vector reached from `u` by turning along `e` [rad], coordinates in `tangent_basis(u)`."""
    t = np.einsum("mkc,mc->mk", bearing.tangent_basis(u), e)
    theta = np.linalg.norm(t, axis=1)
    return np.cos(theta)[:, None] * u + np.sinc(theta / np.pi)[:, None] * t


def test_log_and_exp_on_the_sphere_undo_each_other_at_the_poles_too():
    u = np.vstack([RNG.normal(size=(50, 3)), np.eye(3), -np.eye(3)])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    e = RNG.normal(size=(len(u), 2))
    e *= (RNG.uniform(0, 3.1, len(u)) / np.linalg.norm(e, axis=1))[:, None]
    B = bearing.tangent_basis(u)
    np.testing.assert_allclose(np.einsum("mki,mkj->mij", B, B), np.broadcast_to(np.eye(2), (len(u), 2, 2)), atol=1e-12)
    np.testing.assert_allclose(np.einsum("mki,mk->mi", B, u), 0, atol=1e-12)
    back = np.einsum("mkc,mk->mc", B, bearing.log_map(u, exp_map(u, e)))
    np.testing.assert_allclose(back, e, atol=1e-9)


def test_the_opposite_direction_is_half_a_turn_away_never_zero():
    u = np.vstack([np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(np.linalg.norm(bearing.log_map(u, -u), axis=1), np.pi)
    flat = np.array([[1.0, 0.0], [0.0, -1.0]])
    np.testing.assert_allclose(np.linalg.norm(bearing.log_map(flat, -flat), axis=1), np.pi)


def test_planar_log_map_is_the_wrapped_angle():
    p, q = RNG.normal(size=(2, 40, 2))
    z = RNG.uniform(-np.pi, np.pi, 40)
    u, _ = bearing.predict(p, q)
    e = bearing.log_map(u, np.stack([np.cos(z), np.sin(z)], axis=1))
    normal = np.stack([-u[:, 1], u[:, 0]], axis=1)
    np.testing.assert_allclose(np.einsum("mk,mk->m", normal, e), bearing.angle_residual(z, p, q), atol=1e-12)
