"""Submaps and their hand-over: Jacobians, equality with one central filter, what a fusion may and may not touch."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion import handover
from mapweave.fusion.handover import FLOOR, MapAndSubmap, PairingConfig, _Merging, hand_over, merge_duplicates
from mapweave.kernels.landmarks import submap as kernels
from mapweave.landmarks.landmark_map import GlobalMap, Submap, known_starts
from mapweave.landmarks.submap_slam import (
    Observations,
    SubmapConfig,
    empty,
    in_view,
    move,
    predict,
    predicted_observation,
    update,
)

from ..differences import jacobian


def random_psd(rng, n, scale=0.1):
    A = rng.normal(size=(n, n)) * scale
    return A @ A.T + 1e-4 * np.eye(n)


@pytest.mark.eq("Yuan09:3", "Yuan09:5")
def test_motion_and_sighting_jacobians_agree_with_central_differences():
    rng = np.random.default_rng(0)
    for _ in range(20):
        pose, control = rng.uniform(-3, 3, 3), rng.uniform(-2, 2, 2)
        points = rng.uniform(-10, 10, (3, 2))
        assert np.abs(carried(pose, control) - jacobian(lambda x: move(x, control, 0.5), pose)).max() < 1e-6
        for p in points:
            H = np.empty((2, 5))
            kernels.sight_jacobian(pose, p, H)
            both = jacobian(lambda x: predicted_observation(x[:3], x[None, 3:]), np.concatenate([pose, p]))
            assert np.abs(H - both).max() < 1e-6


def carried(pose, control):
    """The derivative the covariance is carried on with: what becomes of an identity beside the pose's block."""
    P = np.zeros((6, 6))
    P[:3, 3:] = P[3:, :3] = np.eye(3)
    return kernels.predicted(pose, P, *control, 0.5, np.zeros((3, 3)))[1][:3, 3:]


def test_the_bearing_has_the_sign_of_the_side_the_landmark_is_on():
    z = predicted_observation(np.zeros(3), np.array([[5.0, 1.0], [-5.0, 1.0]]))
    assert z[0, 1] > 0
    assert z[1, 1] > np.pi / 2


def test_the_hand_over_residual_has_the_jacobian_of_its_differences():
    rng = np.random.default_rng(1)
    G = GlobalMap(
        ("robot1", "robot2"), rng.uniform(-3, 3, (2, 3)), ("a", "b"), rng.normal(size=(2, 2)), random_psd(rng, 10)
    )
    L = Submap("robot2", rng.normal(size=3), ("p", "q"), rng.normal(size=(2, 2)), random_psd(rng, 7), "local_2")
    pairs = [(0, 1), (1, 0)]
    _, H, used = MapAndSubmap(G, L).residuals(pairs)

    def residual(x):
        Y = MapAndSubmap(G, L)
        Y.x[:] = x
        return Y.residuals(pairs)[0]

    dense = jacobian(residual, MapAndSubmap(G, L).x)
    assert np.allclose(H, dense[:, used], atol=1e-6)
    assert not np.delete(dense, used, axis=1).any()


@pytest.mark.eq("Yuan09:6", "Yuan09:7", "Yuan09:8", "Yuan09:9", "Yuan09:10", "Yuan09:11")
def test_a_submap_step_equals_a_dense_textbook_ekf():
    rng = np.random.default_rng(2)
    cfg = SubmapConfig(association="known")
    m = Submap(
        "r", np.array([0.2, 0.1, 0.3]), ("0", "1"), np.array([[4.0, 1.0], [3.0, -2.0]]), random_psd(rng, 7, 0.05), "l"
    )
    u = np.array([1.5, 0.4])
    p = predict(m, u, cfg)
    F = np.eye(7)
    F[:3, :3] = jacobian(lambda x: move(x, u, cfg.period), m.pose)
    P = F @ m.cov @ F.T
    P[:3, :3] += cfg.Q
    assert np.allclose(p.cov, P, atol=1e-10)
    z = predicted_observation(p.pose, p.mean) + 0.01
    done, _ = update(p, Observations(z, ("0", "1")), cfg)
    x = np.concatenate([p.pose, p.mean.ravel()])
    H = jacobian(lambda x: predicted_observation(x[:3], x[3:].reshape(2, 2)).ravel(), x)
    R = np.kron(np.eye(2), cfg.R)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    x = np.concatenate([p.pose, p.mean.ravel()]) + K @ (z - predicted_observation(p.pose, p.mean)).ravel()
    assert np.allclose(np.concatenate([done.pose, done.mean.ravel()]), x, atol=1e-6)
    assert np.allclose(done.cov, P - K @ H @ P, atol=1e-7)


class Central:
    """One Kalman filter over both robots' positions and all landmarks; headings known, sightings as displacements."""

    def __init__(self, starts):
        self.x, self.P, self.where = np.concatenate(starts), np.zeros((4, 4)), {}

    def drive(self, j, step, Q):
        self.x[2 * j : 2 * j + 2] += step
        self.P[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] += Q

    def see(self, j, name, d, R):
        if name not in self.where:
            self.where[name] = len(self.x)
            n = len(self.x)
            A = np.zeros((n + 2, n))
            A[:n, :n] = np.eye(n)
            A[n:, 2 * j : 2 * j + 2] = np.eye(2)
            self.x = np.concatenate([self.x, self.x[2 * j : 2 * j + 2] + d])
            self.P = A @ self.P @ A.T
            self.P[n:, n:] += R
            return
        k = self.where[name]
        H = np.zeros((2, len(self.x)))
        H[:, k : k + 2], H[:, 2 * j : 2 * j + 2] = np.eye(2), -np.eye(2)
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.x = self.x + K @ (d - H @ self.x)
        self.P = self.P - K @ H @ self.P


class Local(Central):
    """The same filter for one robot's submap, from its own origin."""

    def __init__(self, robot):
        super().__init__([np.zeros(2)])
        self.P, self.robot = np.zeros((2, 2)), robot

    def submap(self):
        n = len(self.x)
        keep = np.r_[0, 1, 3 : n + 1]
        P = np.zeros((n + 1, n + 1))
        P[np.ix_(keep, keep)] = self.P
        pose = np.array([self.x[0], self.x[1], 0.0])
        return Submap(self.robot, pose, tuple(self.where), self.x[2:].reshape(-1, 2), P, "local")


def test_submaps_handed_over_equal_one_central_kalman_filter():
    """[Yuan09] corrected fusion: linear world, two robots, three hand-overs each, mean and covariance below 1e-9."""
    rng = np.random.default_rng(3)
    starts = [np.array([-1.0, 0.0]), np.array([1.0, 0.5])]
    marks = {str(k): p for k, p in enumerate(rng.uniform(-4, 4, (6, 2)))}
    Q, R = 0.01 * np.array([[2.0, 0.3], [0.3, 1.0]]), 0.04 * np.array([[1.0, -0.2], [-0.2, 1.5]])
    G = known_starts(("robot1", "robot2"), np.array([[*starts[0], 0.0], [*starts[1], 0.0]]))
    central, local = Central(starts), [Local("robot1"), Local("robot2")]
    true = [s.copy() for s in starts]
    for step in range(1, 25):
        for j in (0, 1):
            u = rng.normal(size=2) * 0.5
            true[j] = true[j] + u + rng.multivariate_normal(np.zeros(2), Q)
            central.drive(j, u, Q)
            local[j].drive(0, u, Q)
            for name in rng.choice(list(marks), 2, replace=False):
                d = marks[name] - true[j] + rng.multivariate_normal(np.zeros(2), R)
                central.see(j, str(name), d, R)
                local[j].see(0, str(name), d, R)
            if step % 8 == (0 if j == 0 else 4) or step == 24:
                G = hand_over(G, local[j].submap(), known=True).map
                local[j] = Local(G.robots[j])
    order = [central.where[name] for name in G.ids]
    rows = np.concatenate([[0, 1, 2, 3], *[[k, k + 1] for k in order]]).astype(int)
    ours = np.concatenate([[0, 1, 3, 4], np.arange(6, len(G.cov))]).astype(int)
    assert np.abs(np.concatenate([G.frames[:, :2].ravel(), G.mean.ravel()]) - central.x[rows]).max() < 1e-9
    assert np.abs(G.cov[np.ix_(ours, ours)] - central.P[np.ix_(rows, rows)]).max() < 1e-9


def driven_submap(rng, robot, marks, steps=12):
    cfg = SubmapConfig(association="known")
    m, pose = empty(robot, "local"), np.zeros(3)
    for _ in range(steps):
        u = np.array([1.0, rng.uniform(-0.3, 0.3)])
        pose = move(pose, u, cfg.period) + rng.normal(size=3) * cfg.motion_sd
        z = predicted_observation(pose, marks) + rng.normal(size=(len(marks), 2)) * (cfg.range_sd, cfg.bearing_sd)
        m, _ = update(predict(m, u, cfg), Observations(z, tuple(str(k) for k in range(len(marks)))), cfg)
    return m


def test_a_fusion_keeps_the_covariance_symmetric_and_touches_no_other_submap():
    rng = np.random.default_rng(4)
    marks = rng.uniform(2, 8, (4, 2))
    a, b = driven_submap(rng, "robot1", marks), driven_submap(rng, "robot2", marks)
    before = b.cov.tobytes() + b.mean.tobytes() + b.pose.tobytes()
    G = hand_over(known_starts(("robot1", "robot2"), np.zeros((2, 3))), a, known=True).map
    assert b.cov.tobytes() + b.mean.tobytes() + b.pose.tobytes() == before
    G = hand_over(G, b, known=True).map
    assert np.array_equal(G.cov, G.cov.T)
    assert np.linalg.eigvalsh(G.cov).min() > -1e-9


def test_a_hand_over_equals_conditioning_and_mapping_the_whole_map_and_submap():
    """Dense: every product over all of Y, relinearised to the end; two of the submap's four landmarks are known."""
    rng = np.random.default_rng(11)
    marks = rng.uniform(2, 8, (6, 2))
    G = GlobalMap(
        ("robot1", "robot2"),
        np.array([[0.0, 0.0, 0.1], [0.3, -0.2, 0.05]]),
        ("0", "1", "2"),
        marks[:3] + 0.05 * rng.normal(size=(3, 2)),
        random_psd(rng, 12),
    )
    L = driven_submap(rng, "robot2", marks[1:5])
    L = Submap(L.robot, L.pose, ("1", "2", "new", "newer"), L.mean, L.cov, L.frame)

    def residual(x):  # l_i - T^-1(XL_2, m_g) of the two pairs
        return (x[15:19].reshape(2, 2) - se2.act(se2.inverse(x[3:6]), x[8:12].reshape(2, 2))).ravel()

    def forward(x):
        new = [se2.compose(x[3:6], x[12:15]), x[6:12], se2.act(x[3:6], x[19:23].reshape(2, 2)).ravel()]
        return np.concatenate([x[:3], *new])

    x0 = np.concatenate([G.frames.ravel(), G.mean.ravel(), L.pose, L.mean.ravel()])
    P = np.zeros((23, 23))
    P[:12, :12], P[12:, 12:] = G.cov, L.cov
    x = x0
    for _ in range(20):
        H = jacobian(residual, x)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T)
        x = x0 - K @ (residual(x) - H @ (x - x0))
    J = jacobian(forward, x)
    done = hand_over(G, L, known=True)
    assert done.matched == (True, True, False, False)
    assert done.map.ids == ("0", "1", "2", "new", "newer")
    ours = np.concatenate([done.map.frames.ravel(), done.map.mean.ravel()])
    assert np.abs(ours - forward(x)).max() < 1e-7
    assert np.abs(done.map.cov - J @ (P - K @ H @ P) @ J.T).max() < 1e-7


def test_a_submap_without_common_landmarks_leaves_the_old_ones_unchanged():
    rng = np.random.default_rng(5)
    a, b = (
        driven_submap(rng, "robot1", rng.uniform(2, 8, (3, 2))),
        driven_submap(rng, "robot2", rng.uniform(2, 8, (3, 2))),
    )
    b = Submap(b.robot, b.pose, ("x", "y", "z"), b.mean, b.cov, b.frame)
    G1 = hand_over(known_starts(("robot1", "robot2"), np.zeros((2, 3))), a, known=True).map
    G2 = hand_over(G1, b, known=True).map
    old = G1.landmarks
    again = G2.landmarks.select(old.ids)
    assert np.array_equal(again.mean, old.mean)
    assert np.array_equal(again.cov, old.cov)


def test_unknown_landmarks_are_recognised_and_duplicates_merged():
    rng = np.random.default_rng(6)
    marks = np.array([[4.0, 2.0], [6.0, -3.0], [9.0, 4.0]])
    a, b = driven_submap(rng, "robot1", marks), driven_submap(rng, "robot2", marks)
    G = hand_over(known_starts(("robot1", "robot2"), np.zeros((2, 3))), a, known=False, prefix="m").map
    done = hand_over(G, b, known=False, prefix="m")
    assert all(done.matched)
    assert done.names == ("m0", "m1", "m2")
    n = len(done.map.cov)
    J = np.vstack([np.eye(n), np.eye(n)[-2:]])
    jitter = np.zeros((n + 2, n + 2))
    jitter[-2:, -2:] = 1e-3 * np.eye(2)
    twice = GlobalMap(
        done.map.robots,
        done.map.frames,
        (*done.map.ids, "m9"),
        np.vstack([done.map.mean, done.map.mean[-1] + 0.01]),
        J @ done.map.cov @ J.T + jitter,
    )
    merged, pairs = merge_duplicates(twice)
    assert pairs == (("m2", "m9"),)
    assert merged.ids == done.map.ids


def test_merging_two_pairs_of_duplicates_is_conditioning_on_both_at_once():
    rng = np.random.default_rng(12)
    mean = np.array([[0.0, 0.0], [20.0, 0.0], [0.1, 0.0], [40.0, 5.0], [20.0, 0.1]])
    G = GlobalMap(("robot1",), np.zeros((1, 3)), ("a", "b", "c", "d", "e"), mean, random_psd(rng, 13))
    merged, pairs = merge_duplicates(G)
    assert set(pairs) == {("a", "c"), ("b", "e")}
    assert merged.ids == ("a", "b", "d")
    H = np.zeros((4, 13))
    H[:2, 3:5], H[:2, 7:9], H[2:, 5:7], H[2:, 11:] = np.eye(2), -np.eye(2), np.eye(2), -np.eye(2)
    K = G.cov @ H.T @ np.linalg.inv(H @ G.cov @ H.T)
    x0 = np.concatenate([np.zeros(3), mean.ravel()])
    x, rows = x0 - K @ (H @ x0), np.r_[:7, 9:11]
    assert np.allclose(np.concatenate([merged.frames.ravel(), merged.mean.ravel()]), x[rows], atol=1e-8)
    assert np.allclose(merged.cov, (G.cov - K @ H @ G.cov)[np.ix_(rows, rows)], atol=1e-9)


def one_submap(robot, points, sd, pose_sd=0.0):
    """A submap with these landmarks, each known to `sd` [m], whose robot has not moved."""
    P = np.diag([pose_sd**2] * 3 + [sd**2] * (2 * len(points)))
    return Submap(robot, np.zeros(3), tuple(f"l{k}" for k in range(len(points))), np.array(points, float), P, "local")


def test_landmarks_that_one_submap_holds_apart_are_never_merged():
    close = [[5.0, 0.0], [5.3, 0.0], [9.0, 2.0]]
    G = hand_over(known_starts(("robot1",), np.zeros((1, 3))), one_submap("robot1", close, 0.2), known=False).map
    assert len(G.ids) == 3
    assert merge_duplicates(G) == (G, ())
    told = GlobalMap(G.robots, G.frames, G.ids, G.mean, G.cov)
    assert merge_duplicates(told)[1] == ((G.ids[0], G.ids[1]),)


def test_a_landmark_between_two_that_it_may_be_is_left_out():
    start = known_starts(("robot1", "robot2"), np.zeros((2, 3)))
    G = hand_over(start, one_submap("robot1", [[5.0, 0.0], [5.0, 0.4]], 0.1), known=False, prefix="m").map
    done = hand_over(G, one_submap("robot2", [[5.0, 0.2], [5.0, 8.0]], 0.1), known=False, prefix="m")
    assert done.names == (None, "m2")
    assert done.map.ids == ("m0", "m1", "m2")
    assert np.allclose(done.map.mean[:2], G.mean, atol=1e-9)


def test_a_landmark_that_may_be_new_stays_one_until_more_is_known():
    lost = GlobalMap(("robot1", "robot2"), np.zeros((2, 3)), (), np.zeros((0, 2)), np.diag([0, 0, 0, 4.0, 4.0, 1e-6]))
    G = hand_over(lost, one_submap("robot1", [[5.0, 0.0], [8.0, 3.0]], 0.1), known=False, prefix="m").map
    one = hand_over(G, one_submap("robot2", [[9.0, -3.5]], 0.1), known=False, prefix="m")
    assert one.matched == (False,)
    assert one.map.ids == ("m0", "m1", "m2")
    both = hand_over(G, one_submap("robot2", [[6.0, -1.0], [9.0, 2.0]], 0.1), known=False, prefix="m")
    assert both.names == ("m0", "m1")  # one shift explains the two


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_driving_close_past_a_landmark_leaves_an_honest_submap(speed):
    cfg, nees = SubmapConfig(association="known"), []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        marks = np.array([[rng.uniform(0.2, 1.5), rng.uniform(-1, 1)], [8.0, 5.0], [10.0, -4.0]])
        pose, m = np.zeros(3), empty("robot1", "local")
        for step in range(11):
            if step:
                u = np.array([speed, rng.choice([-0.4, 0.0, 0.4])])
                pose = move(pose, u, cfg.period) + rng.normal(size=3) * cfg.motion_sd
                m = predict(m, u, cfg)
            z = predicted_observation(pose, marks)
            rows = np.flatnonzero(in_view(z, cfg))
            seen = z[rows] + rng.normal(size=(len(rows), 2)) * (cfg.range_sd, cfg.bearing_sd)
            m, _ = update(m, Observations(seen, tuple(map(str, rows))), cfg)
        error = np.concatenate([m.pose - pose, (m.mean - marks[[int(name) for name in m.ids]]).ravel()])
        nees.append(error @ np.linalg.solve(m.cov, error) / len(error))
    assert 0.85 <= np.mean(nees) <= 1.15
    assert max(nees) < 6


def test_no_landmark_in_view_and_a_singular_pose_block_are_no_errors():
    cfg = SubmapConfig()
    m = empty("robot1", "local")
    same, info = update(m, Observations(np.zeros((0, 2)), None), cfg)
    assert same is m
    assert info.dropped == 0
    G = hand_over(known_starts(("robot1",), np.zeros((1, 3))), m, known=False).map
    assert np.array_equal(G.frames, np.zeros((1, 3)))
    seen, _ = update(m, Observations(np.array([[5.0, 0.1]]), None), cfg)
    assert len(seen.ids) == 1
    assert np.allclose(se2.act(m.pose, seen.mean), [[5 * np.cos(0.1), 5 * np.sin(0.1)]])


def test_distances_of_pairs_after_a_constraint_are_those_of_the_constrained_covariance():
    rng = np.random.default_rng(13)
    marks = rng.uniform(2, 8, (6, 2))
    frames = np.array([[0.0, 0.0, 0.1], [0.3, -0.2, 0.05]])
    G = GlobalMap(
        ("robot1", "robot2"), frames, ("0", "1", "2"), marks[:3] + 0.05 * rng.normal(size=(3, 2)), random_psd(rng, 12)
    )
    L = driven_submap(rng, "robot2", marks[1:5])
    Y = MapAndSubmap(G, L)
    Y.constrain([(0, 1)])
    n = len(G.cov)
    P = np.zeros((n + len(L.cov), n + len(L.cov)))
    P[:n, :n], P[n:, n:] = G.cov, L.cov
    P -= Y.U.T @ Y.U
    i, m = np.array([1, 1, 2, 3]), np.array([2, 0, 0, 2])
    want = []
    for a, b in zip(i.tolist(), m.tolist(), strict=True):
        h, H, used = Y.residuals([(a, b)])
        want.append(h @ np.linalg.solve(H @ P[np.ix_(used, used)] @ H.T + FLOOR * np.eye(2), h))
    np.testing.assert_allclose(Y._distances(i, m), want, rtol=1e-6)


def test_which_duplicates_are_surest_depends_on_the_covariances_of_the_pairs_themselves():
    """Two pairs equally far apart: the one whose places are known less well may be one landmark, the other not."""
    mean = np.array([[0.0, 0.0], [0.5, 0.0], [20.0, 0.0], [20.5, 0.0], [40.0, 1.0]])
    for loose in (0, 2):
        sd = np.full(5, 0.05)
        sd[[loose, loose + 1]] = 0.5
        P = np.diag(np.concatenate([[1e-6] * 3, np.repeat(sd**2, 2)]))
        G = GlobalMap(("robot1",), np.zeros((1, 3)), ("a", "b", "c", "d", "e"), mean, P)
        merged, pairs = merge_duplicates(G)
        assert pairs == ((("a", "b"), ("c", "d"))[loose // 2],)
        assert len(merged.ids) == 4


@pytest.mark.parametrize("merged", [False, True])
def test_pairs_are_weighed_together_with_the_covariance_of_all_their_differences_after_what_was_merged(
    monkeypatch, merged
):
    rng = np.random.default_rng(21)
    mean = np.array([[0.0, 0.0], [0.2, 0.1], [9.0, 0.0], [9.1, 0.2], [0.1, -0.2], [20.0, 1.0], [9.2, 0.1]])
    G = GlobalMap(("one", "two"), np.zeros((2, 3)), tuple("abcdefg"), mean, random_psd(rng, 20))
    made, told = _Merging(G), []
    x, P = np.concatenate([np.zeros(6), mean.ravel()]), G.cov.copy()

    def difference(a, b):
        H = np.zeros((2, 20))
        H[:, 6 + 2 * a : 8 + 2 * a], H[:, 6 + 2 * b : 8 + 2 * b] = np.eye(2), -np.eye(2)
        return H

    if merged:
        made.merge(0, 4)
        H = difference(0, 4)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T)
        x, P = x - K @ (H @ x), P - K @ H @ P

    def weighed(pairs, e, S, density):
        told.append((pairs, e, S))
        return np.zeros(len(pairs))

    monkeypatch.setattr(handover, "pairing_probabilities", weighed)
    assert made.surest(PairingConfig(gate=1e9)) is None
    ((pairs, e, S),) = told
    near = {(0, 1), (2, 3), (2, 6), (3, 6)} | (set() if merged else {(0, 4), (1, 4)})
    assert {tuple(map(int, p)) for p in pairs} == near
    H = np.concatenate([difference(a, b) for a, b in pairs])
    np.testing.assert_allclose(e.ravel(), H @ x, atol=1e-7)
    np.testing.assert_allclose(S, H @ P @ H.T, atol=1e-7)


def test_of_two_that_a_landmark_may_be_the_one_known_well_is_merged_first():
    mean = np.array([[0.0, 0.0], [0.15, 0.0], [-0.15, 0.0]])
    P = np.diag(np.concatenate([[1e-6] * 3, np.repeat(np.array([0.05, 0.05, 2.0]) ** 2, 2)]))
    _, pairs = merge_duplicates(GlobalMap(("robot1",), np.zeros((1, 3)), ("a", "b", "c"), mean, P))
    assert pairs[0] == ("a", "b")
