"""Correcting past poses equals dense least squares over all of them, and their covariance holds the map's."""

import numpy as np
import pytest
from scipy.linalg import eigh

from mapweave.core.se2 import wrap_angle
from mapweave.kernels.landmarks import ekf, ekf_smooth
from mapweave.kernels.landmarks.ekf import Commands, PoseRows, SightingRows
from mapweave.kernels.landmarks.ekf_smooth import smooth

from . import robot_models as models
from .test_ekf import PLAIN, cleared

pytestmark = pytest.mark.kernel

NOISE = PLAIN._replace(
    along=0.01, across=0.005, drift=0.01, turn=0.01, range_floor=0.002, range_share=0.0, bearing=0.001
)


def problem():
    """A drive of nine frames among three landmarks: final state, commands, sightings and the track's stamps."""
    rng = np.random.default_rng(0)
    x = np.concatenate([np.zeros(3), [1.0, 0.95, 0.02, 0.01, 0.99], [1.5, 1.0, 2.0, -1.0, 0.5, -1.5]])
    t = 0.05 * np.arange(40)
    commands = Commands(t, np.full(40, 0.3), rng.uniform(-0.5, 0.5, 40))
    stamps = np.repeat(0.21 * np.arange(1, 10), 2)
    slots = np.array([0, 1, 1, 2, 2, 0] * 3, dtype=np.int64)
    truth = x.copy()
    Phi, Q = cleared()
    now, at, z = 0.0, -1, np.zeros((18, 2))
    for k in range(18):
        now, at = ekf.drive(truth, Phi, Q, now, stamps[k], commands, at, NOISE)
        z[k] = models.observe(truth[:3], truth[8 + 2 * slots[k] : 10 + 2 * slots[k]])
        z[k] = x[7] * z[k, 0] + 0.002 * rng.normal(), z[k, 1] + x[6] + 0.001 * rng.normal()
    return x, commands, stamps, slots, z, np.unique(np.concatenate([t, stamps]))


def smoothed(x, P_final):
    _, commands, stamps, slots, z, track_t = problem()
    pose, cov = np.zeros((len(track_t), 3)), np.zeros((len(track_t), 3, 3))
    seen = SightingRows(stamps, slots, z[:, 0].copy(), z[:, 1].copy())
    smooth(x, P_final, 0.0, commands, seen, np.unique(stamps), NOISE, PoseRows(track_t, pose, cov))
    return pose, cov


def dense():
    """Gauss-Newton over all frames' poses, map and calibration fixed; poses and their joint covariance."""
    x, commands, stamps, slots, z, _ = problem()
    nodes = np.unique(stamps)
    n = len(nodes)
    poses = np.zeros((n, 3))
    for _ in range(12):
        A, b = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
        now, at, before = 0.0, -1, np.zeros(3)
        for k in range(n):
            moved = x.copy()
            moved[:3] = before
            Phi, Q = cleared()
            now, at = ekf.drive(moved, Phi, Q, now, nodes[k], commands, at, NOISE)
            J = np.zeros((3, 3 * n))
            J[:, 3 * k : 3 * k + 3] = np.eye(3)
            if k:
                J[:, 3 * k - 3 : 3 * k] = -Phi[:, :3]
            e = moved[:3] - poses[k]
            W = np.linalg.inv(Q)
            A += J.T @ W @ J
            b += J.T @ W @ np.array([*e[:2], wrap_angle(e[2])])
            for i in np.flatnonzero(stamps == nodes[k]):
                point = x[8 + 2 * slots[i] : 10 + 2 * slots[i]]
                r, angle = models.observe(poses[k], point)
                by_pose = models.observe_by_pose(poses[k], point)
                H = np.zeros((2, 3 * n))
                H[:, 3 * k : 3 * k + 3] = np.diag([x[7], 1.0]) @ by_pose
                W = np.diag([1 / 0.002**2, 1 / 0.001**2])
                A += H.T @ W @ H
                b += H.T @ W @ np.array([z[i, 0] - x[7] * r, wrap_angle(z[i, 1] - angle - x[6])])
            before = poses[k]
        poses = poses + np.linalg.solve(A, b).reshape(n, 3)
    return nodes, poses, np.linalg.inv(A)


def test_smoothed_poses_and_covariances_equal_dense_least_squares():
    x, *_, track_t = problem()
    pose, cov = smoothed(x, np.zeros((14, 14)))
    nodes, wanted, joint = dense()
    at = np.searchsorted(track_t, nodes)
    assert np.abs(pose[at] - wanted).max() < 2e-5
    for k, row in enumerate(at):
        assert np.allclose(cov[row], joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], rtol=0.03, atol=1e-9)


def test_poses_between_frames_lie_between_their_covariances_and_start_at_the_frame():
    x, *_, track_t = problem()
    pose, cov = smoothed(x, np.zeros((14, 14)))
    assert np.array_equal(pose[0], np.zeros(3))
    assert np.abs(np.diff(pose[:, :2], axis=0)).max() < 0.03
    assert np.linalg.eigvalsh(cov[1:]).min() > -1e-12
    assert len(track_t) == len(pose)


def test_the_maps_own_covariance_moves_poses_as_shifting_a_landmark_does():
    x, *_ = problem()
    for k in (6, 7, 8, 11):
        P = np.zeros((14, 14))
        P[k, k] = 0.01**2
        d = np.zeros(14)
        d[k] = 1e-5
        by = (smoothed(x + d, np.zeros((14, 14)))[0] - smoothed(x - d, np.zeros((14, 14)))[0]) / 2e-5
        own, with_map = smoothed(x, np.zeros((14, 14)))[1], smoothed(x, P)[1]
        frames = np.isin(problem()[-1], np.unique(problem()[2]))
        wanted = 0.01**2 * by[frames, :, None] * by[frames, None, :]
        assert np.allclose((with_map - own)[frames], wanted, rtol=0.05, atol=2e-7)


def coasting_state():
    rng = np.random.default_rng(3)
    x = np.concatenate([[0.3, -0.4, 0.8, 0.25, 0.6, 0.0, 0.01, 1.0], rng.uniform(-2, 2, 6)])
    A = rng.normal(size=(14, 14))
    return x, 1e-3 * A @ A.T


def test_coasting_the_chain_is_coasting_the_whole_state_and_its_derivative():
    noise = NOISE._replace(speed=0.2, speed_time=1.5, spin=0.7, spin_time=0.8)
    x, P = coasting_state()
    y, F, Q = x.copy(), np.zeros((5, 5)), np.zeros((5, 5))
    ekf_smooth.coasted(y, 0.73, noise, F, Q)
    wanted, R = x.copy(), P.copy()
    ekf.coast(wanted, R, len(x), 0.73, noise)
    np.testing.assert_allclose(y, wanted, atol=1e-14)
    np.testing.assert_allclose(F @ P[:5, :5] @ F.T + Q, R[:5, :5], atol=1e-12)
    for k in range(5):
        ends = []
        for step in (1e-6, -1e-6):
            moved = x.copy()
            moved[k] += step
            ekf_smooth.coasted(moved, 0.73, noise, np.zeros((5, 5)), np.zeros((5, 5)))
            ends.append(moved[:5])
        np.testing.assert_allclose(F[:, k], (ends[0] - ends[1]) / 2e-6, atol=1e-6)


def test_speed_and_turn_rate_gather_what_they_forget_and_never_more_than_their_spread():
    noise = NOISE._replace(speed=0.2, speed_time=1.5, spin=0.7, spin_time=0.8)
    for dt in (0.02, 0.5, 30.0):
        x, F, Q = coasting_state()[0], np.zeros((5, 5)), np.zeros((5, 5))
        ekf_smooth.coasted(x, dt, noise, F, Q)
        assert F[3, 3] == pytest.approx(np.exp(-dt / 1.5))
        assert F[4, 4] == pytest.approx(np.exp(-dt / 0.8))
        assert Q[3, 3] == pytest.approx(0.2**2 * (1 - np.exp(-2 * dt / 1.5)))
        assert Q[4, 4] == pytest.approx(0.7**2 * (1 - np.exp(-2 * dt / 0.8)))


def test_a_way_between_frames_is_nearly_what_frames_without_sightings_there_would_give():
    x, commands, stamps, slots, z, track_t = problem()
    rough, spread = smoothed(x, np.zeros((14, 14)))
    more = np.setdiff1d(track_t, stamps)
    order = np.argsort(np.concatenate([stamps, more]), kind="stable")
    every = np.concatenate([stamps, more])[order]
    which = np.concatenate([slots, np.full(len(more), -1)])[order]
    r, b = (np.concatenate([z[:, c], np.zeros(len(more))])[order] for c in (0, 1))
    pose, cov = np.zeros_like(rough), np.zeros_like(spread)
    seen, track = SightingRows(every, which, r, b), PoseRows(track_t, pose, cov)
    smooth(x, np.zeros((14, 14)), 0.0, commands, seen, np.unique(every), NOISE, track)
    np.testing.assert_allclose(rough, pose, atol=2e-4)
    for k in range(1, len(track_t)):
        ratio = eigh(spread[k] + 1e-10 * np.eye(3), cov[k] + 1e-10 * np.eye(3), eigvals_only=True)
        assert ratio.min() > 0.3
        assert ratio.max() < 3.0


@pytest.mark.parametrize("gate", [1e9, 0.5])
def test_a_sighting_moves_the_chain_as_it_moves_the_filter_whose_map_is_known(gate):
    rng = np.random.default_rng(6)
    x, _ = coasting_state()
    x[6:8] = 0.03, 1.04
    noise = NOISE._replace(range_share=0.05, range_inflation=7.0, bearing_inflation=3.0, gate=gate)
    root = rng.normal(size=(3, 3))
    P = 1e-3 * root @ root.T
    whole = np.zeros((14, 14))
    whole[:3, :3] = P
    r, b = models.observe(x[:3], x[10:12])
    z = 1.04 * r + 0.02, b + 0.03 - 0.01
    y, U = x.copy(), np.zeros((2, 14))
    ekf.sight(y, whole, U, 0, 1, *z, noise, np.zeros(1, np.int64))
    ekf.release(whole, U, 2)
    B = np.zeros((3, 11))
    ekf_smooth.fix(x, P, B, 1, *z, noise, np.zeros(1, np.int64))
    np.testing.assert_allclose(x, y, atol=1e-12)
    np.testing.assert_allclose(P, whole[:3, :3], atol=1e-12)


def test_what_a_sighting_makes_the_chain_owe_to_the_map_is_its_derivative():
    x, _ = coasting_state()
    x[6:8] = 0.03, 1.04
    r, b = models.observe(x[:3], x[10:12])
    z = 1.04 * r, b + 0.03  # as predicted: the gain's own change takes no part

    def fixed(parameters):
        y = x.copy()
        y[3:] = parameters
        P, B = np.diag([0.02, 0.03, 0.01]), np.zeros((3, 11))
        ekf_smooth.fix(y, P, B, 1, *z, NOISE._replace(range_share=0.05), np.zeros(1, np.int64))
        return y[:3], B

    _, B = fixed(x[3:])
    for k in range(11):
        d = np.zeros(11)
        d[k] = 1e-6
        np.testing.assert_allclose(B[:, k], (fixed(x[3:] + d)[0] - fixed(x[3:] - d)[0]) / 2e-6, atol=1e-5)
