"""Smoothing a whole team: derivatives, what it finds, how sure it says it is, and what it must not depend on."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.findings import verdict
from mapweave.core.landmark_log import NOTHING_SEEN
from mapweave.evaluation.team import score_team
from mapweave.solve import Factor
from mapweave.team import smooth as smoothing
from mapweave.team.config import CalibrationPrior, SmoothingConfig
from mapweave.team.problem import team_problem
from mapweave.team.robot_part import PARAMETERS
from mapweave.team.smooth import BARE_RANGE_SCALE, smooth

from .teams import world

CFG = SmoothingConfig()


def smoothed(w, cfg=CFG, logs=None, calibration=None):
    return smooth(w.map, w.logs if logs is None else logs, w.fusion.labels, cfg, calibration)


def errors(w, result):
    score = score_team([result.map], {}, w.truth.survey, w.truth.robots)
    return score.landmarks.rmse, float(np.mean([r.ate for r in score.robots.values()])), score


def test_all_derivatives_are_those_of_differences():
    w = world(4, minutes=1.0)
    assert len(w.map.robots) == 3
    logs = [w.logs[0], w.logs[1], replace(w.logs[2], odometry=None)]
    team = team_problem(logs, w.map.landmarks, w.map.tracks, {}, {}, CFG)
    x = team.problem.x0 + np.random.default_rng(0).normal(0, 0.02, len(team.problem.x0))
    kinds = set()
    for term in team.problem.terms:
        assert isinstance(term, Factor)
        kinds.add(term.name)
        J = term.jacobian(x)
        for row in range(0, len(term.columns), max(1, len(term.columns) // 5)):
            for c, column in enumerate(term.columns[row]):
                lag = term.name == "odometry" and c == J.shape[2] - 1
                h = 1e-4 if lag else 1e-6  # stamps of today tell apart a quarter of a microsecond
                d = np.zeros(len(x))
                d[column] = h
                change = term.residual(x + d)[row] - term.residual(x - d)[row]
                change = np.where(np.abs(change) > 1, se2.wrap_angle(change), change) / (2 * h)
                np.testing.assert_allclose(J[row, :, c], change, atol=5e-3 if lag else 2e-5, err_msg=term.name)
    assert kinds == {"odometry", "wandering", "landmark", "robot", "prior"}


def test_a_name_that_two_landmarks_bear_is_told_and_those_of_one_are_not():
    w = world(5)
    assert "landmark-torn" not in {f.code for f in smoothed(w).notes}
    log = w.logs[0]
    seen = log.sightings
    bears, other = (seen.ids.index(name) for name in ("8", "15"))
    rows = np.flatnonzero(seen.what == other)
    what = seen.what.copy()
    what[rows[: len(rows) // 2]] = bears
    told = smoothed(w, logs=[replace(log, sightings=replace(seen, what=what)), *w.logs[1:]]).findings
    assert [f.value["name"] for f in told if f.code == "landmark-torn"] == ["8"]
    assert verdict(told) == "doubtful"


@pytest.fixture(scope="module")
def long_runs():
    """Ten minutes of four robots, three times, smoothed."""
    return [(w, smoothed(w)) for w in (world(seed, robots=4, minutes=10.0) for seed in range(20, 23))]


@pytest.mark.slow
def test_smoothing_beats_the_fused_filters(long_runs):
    for w, result in long_runs:
        filters = score_team([w.map], {}, w.truth.survey, w.truth.robots)
        before = float(np.mean([r.ate for r in filters.robots.values()]))
        rmse, ate, _ = errors(w, result)
        assert ate < 0.8 * before
        assert rmse < filters.landmarks.rmse + 0.006


@pytest.mark.slow
def test_covariances_of_landmarks_and_poses_hold(long_runs):
    nees, poses = [], []
    for w, result in long_runs:
        _, _, score = errors(w, result)
        nees.append(score.landmarks.nees_per_dof)
        T = score.alignment
        for robot, track in result.map.tracks.items():
            true = w.truth.robots[robot].track
            inside = (track.t >= true.t[0]) & (track.t <= true.t[-1])
            e = (se2.compose(T, track.pose[inside]) - se2.interpolate(track.t[inside], true.t, true.pose))[:, :2]
            R = se2.rotation(float(T[2]))
            P = R @ track.cov[inside][:, :2, :2] @ R.T
            poses.append(float(np.einsum("ni,nij,nj->n", e, np.linalg.inv(P), e).mean() / 2))
    assert all(0.4 < n < 1.8 for n in nees)
    assert 0.6 < np.mean(nees) < 1.4
    assert 0.25 < np.mean(poses) < 1.6  # careful: real cameras err together for longer than simulated ones


@pytest.mark.parametrize(
    "team",
    [
        pytest.param({"robots": 1, "minutes": 4.0}, marks=pytest.mark.slow),
        {"robots": 2, "minutes": 2.0},
        pytest.param({"robots": 3, "minutes": 3.0, "noise": 3.0}, marks=pytest.mark.slow),
    ],
)
def test_covariances_of_few_sightings_and_of_noisy_sensors_hold(team):
    nees = []
    for seed in range(60, 65):
        w = world(seed, **team)
        nees.append(errors(w, smoothed(w))[2].landmarks.nees_per_dof)
    assert 0.5 < np.mean(nees) < 1.5
    assert np.max(nees) < 3.0


def test_the_calibration_found_agrees_with_one_that_is_given():
    w = world(3)
    found = smoothed(w).calibration
    for robot, known in found.items():
        assert set(known) == set(PARAMETERS)
        assert all(sd > 0 for _, sd in known.values()), robot
    held = {robot: {name: (value, 0.0) for name, (value, _) in known.items()} for robot, known in found.items()}
    again = smoothed(w, calibration=held)
    assert all(not known for known in again.calibration.values())
    np.testing.assert_allclose(again.map.landmarks.mean, smoothed(w).map.landmarks.mean, atol=0.005)


def test_a_wrong_calibration_that_is_held_makes_the_map_worse():
    w = world(3)
    wrong = {log.robot: {"range_scale": (1.1, 0.0)} for log in w.logs}
    assert errors(w, smoothed(w, calibration=wrong))[0] > 2 * errors(w, smoothed(w))[0]


@pytest.mark.slow
def test_the_order_of_the_logs_does_not_matter():
    w = world(4)
    a, b = smoothed(w), smoothed(w, logs=w.logs[::-1])
    np.testing.assert_allclose(a.map.landmarks.mean, b.map.landmarks.mean, atol=1e-9)
    np.testing.assert_allclose(a.map.landmarks.cov, b.map.landmarks.cov, atol=1e-9)


@pytest.mark.slow
def test_a_robot_without_odometry_is_carried_by_those_who_saw_it(long_runs):
    w, _ = long_runs[0]
    logs = [replace(log, odometry=None) if log.robot == "robot3" else log for log in w.logs]
    ate = errors(w, smoothed(w, logs=logs))[2].robots["robot3"].ate
    alone = errors(w, smoothed(w, replace(CFG, robot_sightings=False), logs=logs))[2].robots["robot3"].ate
    assert ate < 0.8 * alone


@pytest.mark.slow
def test_wrong_labels_hardly_matter():
    clean, wrong = world(4), world(4, misreads=0.1)
    assert errors(wrong, smoothed(wrong))[0] < 1.5 * errors(clean, smoothed(clean))[0] + 0.005


def test_poses_stand_at_every_stamp_with_covariances_that_can_be():
    w = world(3)
    for log in w.logs:
        track = smoothed(w).map.tracks[log.robot]
        np.testing.assert_array_equal(track.t, np.unique(np.concatenate([log.odometry.t, log.sightings.t])))
        assert np.isfinite(track.pose).all()
        assert np.linalg.eigvalsh(track.cov).min() > 0


def test_a_smaller_map_is_no_likelier_one():
    """With loose scales wheels and cameras keep the size of the map; nothing else may pull at it."""
    w = world(3)
    loose = replace(CFG, calibration=CalibrationPrior(speed_scale_sd=1.0, range_scale_sd=0.5))
    small = {log.robot: {"range_scale": (1.3, 0.002)} for log in w.logs}
    size = np.linalg.norm(w.map.landmarks.mean - w.map.landmarks.mean.mean(axis=0))
    shrunk = smoothed(w, loose, calibration=small).map.landmarks.mean
    assert np.linalg.norm(shrunk - shrunk.mean(axis=0)) / size == pytest.approx(1 / 1.3, abs=0.03)
    costs = [
        team_problem(w.logs, w.map.landmarks, w.map.tracks, {}, known, loose).solve().cost for known in ({}, small)
    ]
    assert costs[1] == pytest.approx(costs[0], rel=0.02)


def test_without_any_wheels_the_map_has_the_size_that_ranges_tell():
    w = world(3)
    blind = [replace(log, odometry=None) for log in w.logs]
    result = smoothed(w, logs=blind)
    bare = BARE_RANGE_SCALE
    before, after = (m.mean - m.mean.mean(axis=0) for m in (w.map.landmarks, result.map.landmarks))
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before) / bare, rel=1e-3)
    size = after.ravel() / np.linalg.norm(after)
    alone = (w.map.landmarks.mean - w.map.landmarks.mean.mean(axis=0)).ravel()
    alone /= np.linalg.norm(alone)
    assert size @ result.map.landmarks.cov @ size >= 0.9 * (alone @ w.map.landmarks.cov @ alone)
    held = [team_problem(logs, w.map.landmarks, w.map.tracks, {}, {}, CFG).size_is_held for logs in (blind, w.logs)]
    assert held == [True, False]


def test_nothing_seen_leaves_the_filters_map_and_says_so():
    w = world(3)
    blind = [replace(log, sightings=NOTHING_SEEN) for log in w.logs]
    result = smoothed(w, logs=blind)
    assert result.map is w.map
    assert result.refused


def test_a_team_whose_size_ranges_alone_tell_is_enlarged_by_what_they_fall_short(monkeypatch):
    w = world(4, minutes=1.0)
    logs = [replace(log, odometry=None) for log in w.logs]
    spread = []
    for bare in (1.0, 0.99):
        monkeypatch.setattr(smoothing, "BARE_RANGE_SCALE", bare)
        done = smoothed(w, logs=logs)
        assert not done.refused
        mean = done.map.landmarks.mean
        spread.append(float(np.sqrt(np.square(mean - mean.mean(axis=0)).sum())))
    assert spread[1] / spread[0] == pytest.approx(1 / 0.99, rel=1e-3)
    begun = w.map.landmarks.mean
    assert spread[0] == pytest.approx(np.sqrt(np.square(begun - begun.mean(axis=0)).sum()), rel=3e-3)


@pytest.mark.slow
def test_a_team_of_too_many_poses_is_smoothed_with_longer_steps_and_told():
    w = world(27, minutes=4.0)
    whole = smoothed(w)
    assert not whole.notes
    fewer = smoothed(w, replace(CFG, most_poses=whole.poses // 3))
    assert whole.poses / 6 < fewer.poses <= whole.poses // 3
    assert f"{whole.poses // 3:,} poses" in fewer.notes[0].text
    for own, track in fewer.map.tracks.items():
        np.testing.assert_array_equal(track.t, whole.map.tracks[own].t)
    (landmarks, ate, _), (landmarks_whole, ate_whole, _) = errors(w, fewer), errors(w, whole)
    assert landmarks < 1.2 * landmarks_whole + 0.002
    assert ate < 1.2 * ate_whole + 0.002
