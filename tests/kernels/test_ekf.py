"""The EKF's kernels equal dense textbook algebra, and their derivatives finite differences."""

import numpy as np
import pytest

from mapweave.core.gaussian import joseph
from mapweave.core.se2 import wrap_angle
from mapweave.kernels.landmarks import ekf

from ..differences import jacobian
from . import robot_models as models

pytestmark = pytest.mark.kernel

PLAIN = ekf.Noise(
    along=0.05, across=0.02, drift=0.05, turn=0.04, rest_xy=0.0, rest_theta=0.0, lost_xy=0.06, lost_theta=0.3,
    hold=2.0, speed=0.0, speed_time=1.0, spin=0.0, spin_time=1.0, range_floor=0.05, range_share=0.045, bearing=0.014,
    range_inflation=1.0, bearing_inflation=1.0, gate=1e9, far=1e9, agree=1,
)  # fmt: skip
SILENT = PLAIN._replace(along=0.0, across=0.0, drift=0.0, turn=0.0)


def random_state(seed, landmarks=3):
    rng = np.random.default_rng(seed)
    size = ekf.HEAD + 2 * landmarks
    x = np.concatenate([rng.uniform(-1, 1, 3), [1.02, 0.93, 0.13, 0.01, 0.98], rng.uniform(2, 5, 2 * landmarks)])
    A = rng.normal(size=(size, size))
    return x, 1e-3 * (A @ A.T + np.eye(size))


def cleared():
    Phi, Q = np.zeros((3, 8)), np.zeros((3, 3))
    ekf.clear(Phi, Q)
    return Phi, Q


def driven(head, until, commands, noise=SILENT, start=10.0):
    x = head.copy()
    Phi, Q = cleared()
    ekf.drive(x, Phi, Q, start, until, ekf.Commands(*commands), -1, noise)
    return x, Phi, Q


def some_commands(n=20):
    rng = np.random.default_rng(5)
    return 10.0 + 0.05 * np.arange(n), rng.uniform(0.0, 0.2, n), rng.uniform(-0.6, 0.6, n)


def test_driving_is_the_unicycle_with_each_command_delayed_by_the_lag():
    x, _ = random_state(1)
    t, v, w = some_commands()
    got, _, _ = driven(x, 10.8, (t, v, w))
    pose, now = x[:3].copy(), 10.0 + x[ekf.LAG]
    for k in range(len(t)):
        end = min(10.8, (t[k + 1] if k + 1 < len(t) else np.inf) + x[ekf.LAG])
        if end > now:
            pose = models.unicycle(pose, x[ekf.V_SCALE] * v[k], x[ekf.TURN_SCALE] * w[k], end - now)
            now = end
    assert np.allclose(got[:2], pose[:2], atol=1e-12)
    assert abs(wrap_angle(got[2] - pose[2])) < 1e-12
    assert np.array_equal(got[3:], x[3:])


def test_the_derivative_of_driving_agrees_with_central_differences():
    x, _ = random_state(2)
    commands = some_commands()
    _, Phi, _ = driven(x, 10.81, commands)
    for k in range(ekf.HEAD):
        d = np.zeros(len(x))
        d[k] = 1e-6
        difference = (driven(x + d, 10.81, commands)[0] - driven(x - d, 10.81, commands)[0])[:3] / 2e-6
        assert np.allclose(Phi[:, k], difference, atol=1e-6), k


def test_driving_in_many_calls_is_driving_in_one():
    x, _ = random_state(3)
    t, v, w = some_commands()
    a, Phi_a, Q_a = driven(x, 10.8, (t, v, w), PLAIN)
    b = x.copy()
    Phi, Q = cleared()
    now, at = 10.0, -1
    for until in np.linspace(10.01, 10.8, 60):
        now, at = ekf.drive(b, Phi, Q, now, until, ekf.Commands(t, v, w), at, PLAIN)
    assert np.allclose(a, b, atol=1e-12)
    assert np.allclose(Phi_a, Phi, atol=1e-10)
    assert np.allclose(Q_a, Q, atol=2e-6)  # noise enters at the end of each step


def test_without_a_new_command_the_robot_stops_and_may_go_anywhere():
    x, _ = random_state(4)
    t, v, w = np.array([10.0]), np.array([0.2]), np.array([0.0])
    held, _, Q_held = driven(x, 10.0 + x[ekf.LAG] + 2.0, (t, v, w), PLAIN)
    later, _, Q_later = driven(x, 20.0 + x[ekf.LAG] + 2.0, (t, v, w), PLAIN)
    assert np.allclose(np.hypot(*(held - x)[:2]), 0.4 * x[ekf.V_SCALE])
    assert np.allclose(held[:3], later[:3])
    assert np.isclose(Q_later[2, 2] - Q_held[2, 2], 0.3**2 * 10.0)


def test_settling_equals_the_dense_prediction():
    x, P = random_state(6)
    _, Phi, Q = driven(x, 10.7, some_commands(), PLAIN)
    F = np.eye(len(x))
    F[:3, :8] = Phi
    wanted = F @ P @ F.T
    wanted[:3, :3] += Q
    packed = np.empty(6)
    ekf.pose_covariance(P, Phi, Q, packed)
    ekf.apply_drive(P, len(x), Phi, Q)
    assert np.allclose(P, wanted, atol=1e-14)
    assert np.allclose(packed, wanted[np.triu_indices(3)], atol=1e-14)
    assert np.array_equal(Phi, cleared()[0])
    assert not Q.any()


def predicted(x, slot):
    r, b = models.observe(x[:3], x[8 + 2 * slot : 10 + 2 * slot])
    return np.array([x[ekf.RANGE_SCALE] * r, b + x[ekf.BEARING_BIAS]])


@pytest.mark.parametrize("gate", [1e9, 0.01])
def test_one_sighting_equals_the_dense_update(gate):
    x, P = random_state(7)
    noise = PLAIN._replace(gate=gate, range_inflation=20.0, bearing_inflation=5.0)
    z = predicted(x, 1) + np.array([0.1, -0.02])
    H = jacobian(lambda y: predicted(y, 1), x)
    r = np.hypot(*(x[10:12] - x[:2]))
    R = models.noise(r, 0.05, 0.045, 0.014)
    e = z - predicted(x, 1)
    d2 = e @ np.linalg.solve(H @ P @ H.T + R, e)
    weight = min(1.0, gate / np.sqrt(d2))
    R = R @ np.diag([20.0, 5.0]) / weight
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    wanted, wanted_P = x + K @ e, joseph(P, K, H, R)
    U = np.empty((2, len(x)))
    nis, got_weight = ekf.sight(x, P, U, 0, 1, z[0], z[1], noise, np.zeros(1, np.int64))
    ekf.release(P, U, 2)
    assert np.isclose(nis, d2)
    assert np.isclose(got_weight, weight)
    assert (weight < 1.0) == (gate < 1.0)
    assert np.allclose(x, wanted, atol=1e-8)
    assert np.allclose(P, wanted_P, atol=1e-9)
    assert np.array_equal(P, P.T)


def test_a_frame_worked_in_at_once_is_its_sightings_one_by_one():
    x, P = random_state(11)
    y, R = x.copy(), P.copy()
    noise = PLAIN._replace(range_inflation=20.0, gate=2.0)
    slots, started = np.array([2, -1, 0, 1]), np.ones(3, bool)
    z = np.array([[3.0, 0.5], [1.0, 0.0], [4.0, 0.9], [2.5, 0.7]])
    astray = np.zeros(1, np.int64)
    places = ekf.LandmarkTable(started, np.zeros((3, ekf.CANDIDATES, 2)), np.zeros(3, np.int64), astray)
    nis, weight = np.zeros(4), np.zeros(4)
    seen = ekf.CameraFrame(slots, z[:, 0].copy(), z[:, 1].copy())
    ekf.frame(x, P, seen, noise, places, ekf.UpdateOutcomes(nis, weight))
    U, alone = np.empty((2, len(y))), np.zeros(1, np.int64)
    for slot, (r, b) in zip(slots, z, strict=True):
        if slot >= 0:
            ekf.sight(y, R, U, 0, slot, r, b, noise, alone)
            ekf.release(R, U, 2)
    assert np.allclose(x, y, atol=1e-12)
    assert np.allclose(P, R, atol=1e-12)
    assert np.array_equal(P, P.T)
    assert np.array_equal(np.isnan(nis), slots < 0)


def test_a_landmark_starts_where_it_was_seen_with_its_cross_covariances():
    x, P = random_state(8)
    P[-2:, :] = P[:, -2:] = 0.0
    z = np.array([2.5, 0.7])

    def place(y):
        return models.locate(y[:3], np.array([y[8] / y[ekf.RANGE_SCALE], y[9] - y[ekf.BEARING_BIAS]]))

    G = jacobian(place, np.concatenate([x[:8], z]))
    R = models.noise(2.5 / x[ekf.RANGE_SCALE], 0.05, 0.045, 0.014)
    old = P[:-2, :-2].copy()
    cross = np.zeros((2, len(old)))
    cross[:, :] = G[:, :8] @ old[:8]
    ekf.begin(x, P, len(x), 2, z[0], z[1], PLAIN)
    assert np.allclose(x[-2:], place(np.concatenate([x[:8], z])))
    assert np.allclose(P[-2:, :-2], cross, atol=1e-9)
    assert np.allclose(P[-2:, -2:], G[:, :8] @ old[:8, :8] @ G[:, :8].T + G[:, 8:] @ R @ G[:, 8:].T, atol=1e-9)
    assert np.allclose(P, P.T)


def test_a_landmark_waits_until_enough_sightings_agree():
    x, _ = random_state(9)
    noise = PLAIN._replace(agree=3)
    waiting, count = np.zeros((1, ekf.CANDIDATES, 2)), np.zeros(1, np.int64)
    said = [ekf.consider(x, 0, r, 0.1, noise, waiting, count) for r in (2.0, 6.0, 2.05, 4.0, 1.95)]
    assert said == [False, False, False, False, True]


def test_coasting_forgets_speed_and_turn_rate_and_keeps_their_spread():
    x, P = random_state(10, landmarks=1)
    x[3:5] = 0.1, 0.4
    P[:, 3:5] = P[3:5, :] = 0.0
    P[3, 3], P[4, 4] = 0.1**2, 0.5**2
    noise = PLAIN._replace(speed=0.1, speed_time=2.0, spin=0.5, spin_time=1.0)
    ekf.coast(x, P, len(x), 3.0, noise)
    assert np.allclose(x[3:5], [0.1 * np.exp(-1.5), 0.4 * np.exp(-3.0)])
    assert np.allclose([P[3, 3], P[4, 4]], [0.1**2, 0.5**2])
    assert np.linalg.eigvalsh(P)[0] > -1e-12


def test_a_far_sighting_hardly_counts_unless_far_ones_keep_coming():
    noise, astray = PLAIN._replace(gate=2.0, far=10.0), np.zeros(1, np.int64)
    assert ekf.trust(1.9, noise, astray) == 1.0
    assert np.isclose(ekf.trust(4.0, noise, astray), 0.5)
    first = [ekf.trust(40.0, noise, astray) for _ in range(4)]
    assert np.allclose(first, [0.05 / 16, 0.05 / 16, 0.05 / 16, 0.05])
    assert ekf.trust(1.0, noise, astray) == 1.0
    assert ekf.trust(40.0, noise, astray) < 0.01


def test_wrap_brings_angles_into_half_open_turn():
    for angle in (-7.0, -np.pi, 0.0, 3.0, np.pi, 9.5):
        assert -np.pi <= ekf.wrap(angle) < np.pi
        assert abs(wrap_angle(ekf.wrap(angle) - angle)) < 1e-12


def test_a_replay_stands_at_every_stamp_of_commands_and_sightings_until_both_have_ended():
    x, P = random_state(12)
    y, R = x.copy(), P.copy()
    t, v, w = some_commands()
    stamp = np.array([10.12, 10.12, 10.4, 10.99, 11.2])  # two after the last command
    slots, z = np.array([0, 2, 1, -1, 0]), np.array([[3.0, 0.4], [4.0, 0.9], [2.5, 0.7], [1.0, 0.0], [3.1, 0.5]])
    want_t = np.unique(np.concatenate([t, stamp]))

    def tables():
        waiting = np.zeros((3, ekf.CANDIDATES, 2))
        return ekf.LandmarkTable(np.ones(3, bool), waiting, np.zeros(3, np.int64), np.zeros(1, np.int64))

    Phi, Q = cleared()
    track_t = np.full(60, np.nan)
    pose, cov = np.zeros((60, 3)), np.zeros((60, 6))
    rows, at = ekf.replay(
        ekf.Belief(x, P, Phi, Q), 10.0, ekf.Commands(t, v, w), -1, 0,
        ekf.SightingRows(stamp, slots, *z.T.copy()), PLAIN, tables(),
        ekf.UpdateOutcomes(np.zeros(5), np.zeros(5)), ekf.PoseRows(track_t, pose, cov),
    )  # fmt: skip
    assert rows == len(want_t)
    np.testing.assert_array_equal(track_t[:rows], want_t)
    now, at_one, kept = 10.0, -1, tables()
    Phi, Q = cleared()
    for k, until in enumerate(want_t):
        given = ekf.Commands(t[: np.searchsorted(t, until, "right")], v, w)
        now, at_one = ekf.drive(y, Phi, Q, now, until, given, at_one, PLAIN)
        here = stamp == until
        if here.any():
            ekf.apply_drive(R, len(y), Phi, Q)
            seen = ekf.CameraFrame(slots[here], z[here, 0].copy(), z[here, 1].copy())
            ekf.frame(y, R, seen, PLAIN, kept, ekf.UpdateOutcomes(np.zeros(here.sum()), np.zeros(here.sum())))
        np.testing.assert_allclose(pose[k, :2], y[:2], atol=1e-9)
    assert at == at_one
    np.testing.assert_allclose(x, y, atol=1e-9)
    np.testing.assert_allclose(P, R, atol=1e-9)


def test_sightings_of_one_place_agree_from_wherever_and_whichever_way_the_robot_looks():
    noise = PLAIN._replace(agree=4)
    waiting, count = np.zeros((1, ekf.CANDIDATES, 2)), np.zeros(1, np.int64)
    place, said = np.array([2.0, -1.0]), []
    for pose in ([0.0, 0.0, 0.3], [1.0, 1.5, -2.0], [-1.0, 0.5, 2.9], [3.0, 0.0, 1.2]):
        x, _ = random_state(13)
        x[:3] = pose
        r, b = models.observe(x[:3], place)
        said.append(ekf.consider(x, 0, r * x[ekf.RANGE_SCALE], b + x[ekf.BEARING_BIAS], noise, waiting, count))
        np.testing.assert_allclose(waiting[0, len(said) - 1], place)
    assert said == [False, False, False, True]


@pytest.mark.parametrize("said", [{"range_floor": 0.3}, {"range_share": 0.07}, {"bearing": 0.05}, {"bearing": 0.2}])
@pytest.mark.parametrize("away", [0.99, 1.01])
def test_two_sightings_agree_within_three_deviations_of_their_distance(said, away):
    x, _ = random_state(9)
    noise = PLAIN._replace(**({"range_floor": 0.02, "range_share": 0.03, "bearing": 0.01, "agree": 2} | said))
    r, b = 4.0 / x[ekf.RANGE_SCALE], 0.4
    one = noise.range_floor**2 + (noise.range_share * r) ** 2 + (noise.bearing * r) ** 2
    place = models.locate(x[:3], np.array([r, b - x[ekf.BEARING_BIAS]]))
    for side in np.array([[1.0, 0.0], [0.0, -1.0], [-0.6, 0.8]]):
        waiting, count = np.zeros((1, ekf.CANDIDATES, 2)), np.ones(1, np.int64)
        waiting[0, 0] = place + away * 3.0 * np.sqrt(2.0 * one) * side
        assert ekf.consider(x, 0, 4.0, b, noise, waiting, count) == (away < 1.0)


def test_only_the_last_few_sightings_of_a_landmark_that_waits_are_remembered():
    x, _ = random_state(9)
    noise = PLAIN._replace(agree=2)
    for others in range(2 * ekf.CANDIDATES):
        waiting, count = np.zeros((1, ekf.CANDIDATES, 2)), np.zeros(1, np.int64)
        ranges = [4.0, *(10.0 * 2.0**k for k in range(others)), 4.0]
        said = [ekf.consider(x, 0, r, 0.4, noise, waiting, count) for r in ranges]
        assert said[:-1] == [False] * (others + 1)
        assert said[-1] == (others < ekf.CANDIDATES)
