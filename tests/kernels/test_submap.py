"""The submap filter's kernels against dense linear algebra; covariances symmetric to the bit."""

import numpy as np
import pytest

from mapweave.core.records import frozen
from mapweave.core.se2 import wrap_angle
from mapweave.kernels import dense
from mapweave.kernels.landmarks import submap

pytestmark = pytest.mark.kernel


def random_state(rng, n):
    A = 0.1 * rng.normal(size=(3 + 2 * n, 3 + 2 * n))
    return tuple(map(frozen, (rng.normal(size=3), rng.uniform(2, 9, (n, 2)), A @ A.T + 1e-4 * np.eye(len(A)))))


def noise(rng, n):
    A = 0.1 * rng.normal(size=(n, n))
    return frozen(A @ A.T + 1e-4 * np.eye(n))


def test_a_drive_carries_the_covariance_as_the_dense_product_does():
    rng = np.random.default_rng(0)
    pose, _, P = random_state(rng, 3)
    Q, v, w, T = noise(rng, 3), 1.5, 0.7, 0.5
    after, out = submap.predicted(pose, P, v, w, T, Q)
    F = np.eye(9)
    F[:2, 2] = v * T * np.array([-np.sin(pose[2]), np.cos(pose[2])])
    expected = F @ P @ F.T
    expected[:3, :3] += Q
    assert np.allclose(out, expected, atol=1e-14)
    assert np.array_equal(out, out.T)
    assert np.allclose(after, pose + np.array([v * T * np.cos(pose[2]), v * T * np.sin(pose[2]), w * T]), atol=1e-14)


def test_a_correction_is_the_textbook_update_of_all_sightings_together():
    rng = np.random.default_rng(1)
    pose, mean, P = random_state(rng, 4)
    R, index = noise(rng, 2), np.array([2, 0, 3])
    H, zhat = np.zeros((6, 11)), np.zeros((3, 2))
    for k, j in enumerate(index):
        one = np.empty((2, 5))
        submap.sight_jacobian(pose, mean[j], one)
        H[2 * k : 2 * k + 2, :3], H[2 * k : 2 * k + 2, 3 + 2 * j : 5 + 2 * j] = one[:, :3], one[:, 3:]
        d = mean[j] - pose[:2]
        zhat[k] = np.hypot(*d), np.arctan2(d[1], d[0]) - pose[2]
    error = 0.05 * rng.normal(size=(3, 2))
    z = zhat + error
    z[:, 1] = wrap_angle(z[:, 1])
    S = H @ P @ H.T + np.kron(np.eye(3), R)
    K = P @ H.T @ np.linalg.inv(S)
    x = np.concatenate([pose, mean.ravel()]) + K @ error.ravel()
    after, marks, out = submap.corrected(pose, mean, P, index, z, R)
    assert np.allclose(np.concatenate([after, marks.ravel()]), x, atol=1e-12)
    assert np.allclose(out, P - K @ S @ K.T, atol=1e-13)
    assert np.array_equal(out, out.T)
    HP, HPH = submap.innovation(pose, mean, P, index)
    assert np.allclose(HP, H @ P, atol=1e-14)
    assert np.allclose(HPH, H @ P @ H.T, atol=1e-14)


def test_new_landmarks_come_with_all_their_covariances():
    rng = np.random.default_rng(2)
    pose, mean, P = random_state(rng, 2)
    R, z = noise(rng, 2), np.array([[4.0, 0.5], [7.0, -0.9]])
    J, N = np.zeros((11, 7)), np.zeros((11, 11))
    J[:7] = np.eye(7)
    for k, (r, b) in enumerate(z):
        c, s = np.cos(pose[2] + b), np.sin(pose[2] + b)
        row = slice(7 + 2 * k, 9 + 2 * k)
        J[row, :3] = [[1, 0, -r * s], [0, 1, r * c]]
        G = np.array([[c, -r * s], [s, r * c]])
        N[row, row] = G @ R @ G.T
        expected = pose[:2] + r * np.array([c, s])
        assert np.allclose(submap.grown(pose, mean, P, z, R)[0][2 + k], expected, atol=1e-14)
    marks, out = submap.grown(pose, mean, P, z, R)
    assert np.array_equal(marks[:2], mean)
    assert np.allclose(out, J @ P @ J.T + N, atol=1e-14)
    assert np.array_equal(out, out.T)


@pytest.mark.parametrize("angle", [0.0, 3.0, np.pi, -np.pi, 3.5, -9.7])
def test_angles_wrap_as_everywhere_else(angle):
    assert submap.wrapped(angle) == pytest.approx(wrap_angle(angle), abs=1e-14)


@pytest.mark.parametrize("n", [1, 31, 32, 77])
def test_a_mirrored_matrix_has_its_lower_triangle_twice(n):
    P = np.random.default_rng(n).normal(size=(n, n))
    lower = np.tril(P)
    dense.mirror(P)
    assert np.array_equal(P, lower + np.tril(lower, -1).T)


def test_a_landmark_close_by_is_corrected_as_a_place_by_the_textbook_update():
    rng = np.random.default_rng(3)
    pose, mean, P = random_state(rng, 3)
    mean = frozen([mean[0], (pose[0] + 0.5, pose[1] + 0.3), mean[2]])
    R, z = frozen(np.diag([0.04, 0.0016])), np.array([0.9, 0.4])

    def place(x):
        d, c, s = x[5:7] - x[:2], np.cos(x[2]), np.sin(x[2])
        return np.array([c * d[0] + s * d[1], c * d[1] - s * d[0]])

    x = np.concatenate([pose, mean.ravel()])
    H = np.stack([(place(x + h) - place(x - h)) / 2e-6 for h in 1e-6 * np.eye(9)], axis=1)
    c, s = np.cos(z[1]), np.sin(z[1])
    G = np.array([[c, -z[0] * s], [s, z[0] * c]])
    S = H @ P @ H.T + G @ R @ G.T
    K = P @ H.T @ np.linalg.inv(S)
    after, marks, out = submap.placed(pose, mean, P, 1, z, R)
    expected = x + K @ (z[0] * np.array([c, s]) - place(x))
    assert np.allclose(np.concatenate([after, marks.ravel()]), expected, atol=1e-8)
    assert np.allclose(out, P - K @ S @ K.T, atol=1e-8)
    assert np.array_equal(out, out.T)


def test_only_landmarks_within_their_spread_are_too_near():
    P, R = frozen(np.diag([0.0, 0.0, 0.0, 0.02, 0.02, 0.02, 0.02, 0.5, 0.5])), frozen(np.diag([0.04, 0.0016]))
    mean = frozen([[0.9, 0.0], [1.1, 0.0], [0.5, 0.0]])  # five deviations are 1 m; the last is known too badly
    near = submap.too_near(frozen(np.zeros(3)), mean, P, np.arange(3), 5.0, R)
    assert near.tolist() == [True, False, False]


def test_a_first_reading_of_no_range_does_not_make_a_landmark_certain():
    nothing = map(frozen, (np.zeros(3), np.zeros((0, 2)), np.zeros((3, 3))))
    marks, out = submap.grown(*nothing, np.array([[-0.01, 0.0]]), frozen(np.diag([0.04, 0.0016])))
    assert np.allclose(marks, [[-0.01, 0.0]])
    assert np.sqrt(out[4, 4]) == pytest.approx(0.04 * 0.6)
