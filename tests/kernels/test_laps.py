"""What laps are judged by: the drive, the ground seen, the information gathered, against dense textbook forms."""

import numpy as np
import pytest

from mapweave.core.records import frozen
from mapweave.exploration.landmarks import coverage
from mapweave.exploration.landmarks.config import ExploreConfig
from mapweave.exploration.landmarks.objective import steer
from mapweave.exploration.landmarks.team import Team
from mapweave.kernels.exploration.objective import (
    LandmarkSensor,
    LapRules,
    add_landmark_information,
    drive_laps,
    landmark_errors,
    lap_sightings,
    mark_half_disc,
    odometry_information,
    seen_shares,
)
from mapweave.kernels.landmarks.submap import sight_jacobian
from mapweave.kernels.walls.segments import Raster, Sector
from mapweave.landmarks.submap_slam import SubmapConfig, move
from mapweave.sim.landmarks import Field

LOWER, UPPER = np.array([-20.0, -15.0]), np.array([20.0, 15.0])
STARTS = np.array([[-3.0, 0.0, np.pi], [3.0, 1.0, 0.0]])
WAYS = np.array([[[-12.0, 8.0], [-14.0, -12.0], [0.0, -9.0]], [[15.0, 4.0], [10.0, 13.0], [0.0, 0.0]]])
COUNTS = np.array([3, 2])


def drive(steps, ways=WAYS, counts=COUNTS):
    cfg = ExploreConfig()
    return drive_laps(ways, counts, STARTS, LapRules(cfg.controls, cfg.submap.period, LOWER, UPPER, 3.0, 3.0), steps)


@pytest.mark.kernel
def test_planned_laps_are_driven_as_the_robots_steer():
    cfg = ExploreConfig()
    track = drive(30)
    view = Team(Field(LOWER, UPPER, np.zeros((1, 2)), STARTS), cfg, coverage.choose, np.random.default_rng(0)).belief()
    for j in range(2):
        pose, lap = STARTS[j], list(WAYS[j, : COUNTS[j]])
        for t in range(1, 31):
            while lap and np.hypot(*(lap[0] - pose[:2])) < 3.0:
                lap.pop(0)
            if lap:
                pose = move(pose, steer(view, pose, lap[0], cfg), cfg.submap.period)
            assert np.allclose(track[j, t, :2], pose[:2])
            assert np.allclose(np.exp(1j * track[j, t, 2]), np.exp(1j * pose[2]))


@pytest.mark.kernel
def test_robots_stand_still_when_their_places_are_passed_and_nothing_seen_is_forgotten():
    track = drive(150)
    assert np.array_equal(track[0, -1], track[0, -2])
    share = seen_shares(track, np.zeros((30, 40), dtype=bool), Sector(6.0, np.pi / 2), Raster(frozen(LOWER), 1.0))
    first = np.zeros((30, 40), dtype=bool)
    for pose in STARTS:
        mark_half_disc(first, pose, Sector(6.0, np.pi / 2), Raster(frozen(LOWER), 1.0))
    assert share[0] == first.mean()
    assert np.all(np.diff(share) >= 0)
    assert share[-1] > 2 * share[0]


@pytest.mark.kernel
def test_odometrys_information_is_the_inverse_of_the_covariance_that_adds_up_on_the_way():
    cfg = SubmapConfig()
    track = drive(12)
    S = odometry_information(track, 4, cfg.Q)
    P = np.linalg.inv(S)
    for j in range(2):
        want = np.zeros((3, 3))
        for t in range(12):
            d = track[j, t + 1] - track[j, t]
            F = np.array([[1.0, 0.0, -d[1]], [0.0, 1.0, d[0]], [0.0, 0.0, 1.0]])
            want = F @ want @ F.T + cfg.Q
        b = 3 * (3 * j + 2)
        assert np.allclose(P[b : b + 3, b : b + 3], want)


@pytest.mark.kernel
@pytest.mark.parametrize(("known_until", "margin", "look"), [(24, 0.0, 4), (9, 1.0, 4), (24, 0.0, 1), (0, 0.7, 2)])
def test_landmark_errors_are_those_of_the_dense_information_matrix(known_until, margin, look):
    cfg = SubmapConfig()
    track, every = drive(24), 4
    marks = np.array([[-8.0, 5.0], [7.0, 5.0], [0.0, -6.0], [-200.0, 0.0]])
    poses = [(j, i) for j in range(2) for i in range(1, 7)]
    S = odometry_information(track, every, cfg.Q)
    n = len(S)
    dense = np.zeros((n + 6, n + 6))
    dense[:n, :n] = S
    W = np.linalg.inv(cfg.R) * look
    for k in range(3):
        for j in range(2):
            looks = range(0 if look == 4 else -2, 4 if look == 4 else 2, look)
            for i, t in [(node, 4 * node + k) for node in range(7) for k in looks if 0 <= 4 * node + k <= 24]:
                pose = track[j, t]
                d = marks[k] - pose[:2]
                reach = cfg.reach - (margin if t > known_until else 0.0)
                if np.hypot(*d) > reach or d @ [np.cos(pose[2]), np.sin(pose[2])] < 0:
                    continue
                near = np.zeros((2, 5))
                sight_jacobian(pose, marks[k], near)
                lever = pose[:2] - track[j, i * every, :2]
                near[:, 2] += near[:, :2] @ [-lever[1], lever[0]]  # turning the pose turns the way on from it
                H = np.zeros((2, n + 6))
                if i:
                    b = 3 * poses.index((j, i))
                    H[:, b : b + 3] = near[:, :3]
                H[:, n + 2 * k : n + 2 * k + 2] = near[:, 3:]
                dense += H.T @ W @ H
    P = np.linalg.inv(dense)
    sensor = LandmarkSensor(Sector(cfg.reach, cfg.half_angle), cfg.R, 0.01, known_until, margin, look)
    sighted = lap_sightings(track, every, marks, sensor)
    add_landmark_information(S, sighted)
    assert np.allclose(np.linalg.inv(S), P[:n, :n])
    errors = landmark_errors(np.linalg.inv(S), sighted)
    each = [P[b : b + 2, b : b + 2] for b in range(n, n + 6, 2)]
    assert np.allclose(errors[:3], [np.sqrt(np.trace(p)) for p in each])
    assert np.isnan(errors[3])


@pytest.mark.kernel
def test_a_landmark_that_a_robot_drives_over_is_known_from_elsewhere():
    cfg = SubmapConfig()
    track, every = drive(24), 4
    under = track[0, 8, :2].copy()
    S = odometry_information(track, every, cfg.Q)
    sensor = LandmarkSensor(Sector(cfg.reach, cfg.half_angle), cfg.R, 2.0, 24, 0.0, 2)
    add_landmark_information(S, lap_sightings(track, every, under[None], sensor))
    both = lap_sightings(track, every, np.array([under, under + 1e-9]), sensor)
    errors = landmark_errors(np.linalg.inv(S), both)
    assert np.isfinite(S).all()
    assert np.isfinite(errors).all()
    assert errors[1] == pytest.approx(errors[0], rel=1e-6)


@pytest.mark.kernel
@pytest.mark.parametrize(("moved", "counts"), [((0, 0, 0), 0), ((0.01, 0, 0), 8), ((0, 0.01, 0), 8), ((0, 0, 0.01), 8)])
def test_looks_of_a_robot_that_stands_still_count_once_and_any_motion_counts_anew(moved, counts):
    track = (np.array([1.0, -2.0, 0.3]) + np.arange(9)[:, None] * np.array(moved, float))[None]
    point = np.array([[4.0, -1.0]])
    sensor = LandmarkSensor(Sector(6.0, np.pi / 2), np.diag([0.04, 0.01]), 0.01, 8, 0.0, 1)
    own = lap_sightings(track, 4, point, sensor).own[0]
    want = np.zeros((2, 2))
    for pose in track[0, : 1 + counts]:
        d = point[0] - pose[:2]
        r = np.hypot(*d)
        J = np.array([d / r, [-d[1] / r**2, d[0] / r**2]])
        want += J.T @ np.diag([1 / 0.04, 1 / 0.01]) @ J
    np.testing.assert_allclose(own, [want[0, 0], want[0, 1], want[1, 1]])
