"""The steps around the team's problem: its size, wider kernels, fewer poses, and what is told of a map that stays."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.solve import Cauchy
from mapweave.team import problem
from mapweave.team import smooth as smoothing
from mapweave.team.config import SmoothingConfig
from mapweave.team.covariance import _with_size
from mapweave.team.known import PlacePriors
from mapweave.team.problem import WIDER, most_poses, team_problem, with_fewer_poses
from mapweave.team.robot_part import PARAMETERS, count_instants
from mapweave.team.smooth import RANGE_BESIDE_LASER, _beside_laser, _enlarged, smooth
from mapweave.team.team_map import TeamMap

from .test_team_algebra import FIELDS, logs_and_map

CFG = SmoothingConfig()


def spread(points):
    return np.sqrt(np.square(points - points.mean(axis=0)).sum())


@pytest.fixture(scope="module")
def made():
    return logs_and_map()


def test_where_size_is_unknown_everything_has_the_covariance_of_scaling_about_the_middle(made):
    logs, landmarks, tracks = made
    blind = [replace(log, odometry=None) for log in logs]
    team = team_problem(blind, landmarks, tracks, {}, {}, CFG)
    assert team.size_is_held
    assert not team_problem(logs, landmarks, tracks, {}, {}, CFG).size_is_held
    x, rng = team.problem.x0, np.random.default_rng(1)
    A = rng.normal(size=(10, 10))
    before, own = 1e-3 * A @ A.T, 1e-4 * np.eye(10)
    poses = [np.tile(1e-4 * np.eye(3), (len(part.instants.t), 1, 1)) for part in team.parts]
    found, moved = _with_size(team, x, before, own, poses)
    points = x[team.landmark_columns].reshape(-1, 2)
    middle, h = points.mean(axis=0), 1e-6
    grown = ((1 + h) * (points - middle) + middle - points).ravel() / h
    tells = grown / (grown @ grown)  # by least squares, how much larger a map is
    variance = tells @ before @ tells
    np.testing.assert_allclose(found - own, variance * np.outer(grown, grown), rtol=1e-6, atol=1e-12)
    for part, P, Q in zip(team.parts, poses, moved, strict=True):
        at = x[part.start : part.start + 3 * len(P)].reshape(-1, 3)
        for k in (0, 5, len(P) - 1):
            J = np.append(at[k, :2] - middle, 0.0)
            np.testing.assert_allclose(Q[k] - P[k], variance * np.outer(J, J), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("own_frame", [False, True])
def test_places_known_beforehand_are_the_frame_in_place_of_the_first_pose_unless_told_in_it(made, own_frame):
    logs, landmarks, tracks = made
    first = tracks["robot2"].pose[0]
    known = PlacePriors({"robot2": (first, 0.1)}, {"b": (landmarks.mean[1] + [0.3, 0.0], 0.2)}, own_frame=own_frame)
    team = team_problem(logs, landmarks, tracks, {}, {}, CFG, known=known)
    held = np.setdiff1d(np.arange(len(team.problem.x0)), team.problem.free)
    assert held.tolist() == ([0, 1, 2] if own_frame else [])
    places = {term.name: (term, origin) for term, origin in zip(team.problem.terms, team.origins, strict=True)}
    assert len(team.origins) == len(team.problem.terms)
    start, surveyed = places["start"], places["surveyed"]
    assert start[1] is None
    assert surveyed[1] is None
    x = team.problem.x0
    assert start[0].squares(x)[0] == pytest.approx(0.0, abs=1e-12)
    assert surveyed[0].squares(x)[0] == pytest.approx(1.5**2)
    assert team.used["landmark"] == sum(len(log.sightings) for log in logs)


def test_softened_kernels_are_so_many_times_as_wide_and_nothing_else_changes(made):
    logs, landmarks, tracks = made
    team = team_problem(logs, landmarks, tracks, {}, {}, CFG)
    soft = team.softened(3.0)
    x = team.problem.x0
    wide = 0
    for a, b in zip(team.factors, soft.factors, strict=True):
        assert a.name == b.name
        np.testing.assert_array_equal(a.squares(x), b.squares(x))
        if isinstance(a.kernel, Cauchy):
            assert b.kernel.k == 3.0 * a.kernel.k
            wide += 1
        else:
            assert b.kernel is a.kernel
    assert wide >= 2


def test_steps_are_made_longer_until_poses_are_few_enough_and_no_longer(made):
    (one, two), _, _ = made

    def poses(cfg, logs=(one, two)):
        return sum(count_instants(log, np.zeros(0), cfg) for log in logs)

    assert with_fewer_poses((one, two), CFG, ()) is CFG
    for most in (25, 14, 8):
        cfg = with_fewer_poses((one, two), replace(CFG, most_poses=most), ())
        assert poses(cfg) <= most
        one_less = cfg.shortest_step / WIDER
        longest = max(CFG.longest_step, 2.0 * one_less)
        assert poses(replace(cfg, shortest_step=one_less, longest_step=longest)) > most
        times = np.log(cfg.shortest_step / CFG.shortest_step) / np.log(WIDER)
        assert times == pytest.approx(round(times))
        assert cfg.longest_step >= max(CFG.longest_step, cfg.shortest_step)
    alone = with_fewer_poses((one, two), replace(CFG, most_poses=10), {"robot2"})  # scans tell where robot2's stand
    assert poses(alone, (one,)) <= 10 < poses(alone)


def test_of_a_crowd_that_sees_itself_fewer_poses_are_estimated_by_the_square_of_its_size(made, monkeypatch):
    logs = made[0]
    cfg = replace(CFG, most_poses=40)
    assert most_poses(logs, cfg) == 40
    fewer = with_fewer_poses(logs, replace(CFG, most_poses=10), ()).shortest_step
    monkeypatch.setattr(problem, "CROWD", 1)
    assert most_poses(logs, cfg) == 10
    assert most_poses(logs, replace(cfg, robot_sightings=False)) == 40
    assert with_fewer_poses(logs, cfg, ()).shortest_step == fewer


def test_every_step_of_the_solver_is_told(made):
    logs, landmarks, tracks = made
    steps = []
    done = smooth(TeamMap(tuple(tracks), landmarks, tracks), logs, {}, CFG, on_step=lambda: steps.append(1))
    assert len(steps) == done.iterations > 1


def test_an_enlarged_team_has_all_lengths_multiplied_and_every_angle_as_it_was(made):
    _, landmarks, tracks = made
    cov = np.diag([0.04, 0.09, 0.01]) + 0.002
    tracks = {robot: replace(t, cov=np.tile(cov, (len(t.t), 1, 1))) for robot, t in tracks.items()}
    by = 1.3
    larger = _enlarged(TeamMap(tuple(tracks), landmarks, tracks), by)
    L = np.diag([by, by, 1.0])
    np.testing.assert_allclose(larger.landmarks.mean, by * landmarks.mean)
    np.testing.assert_allclose(larger.landmarks.cov, by**2 * landmarks.cov)
    for robot, t in tracks.items():
        np.testing.assert_allclose(larger.tracks[robot].pose, t.pose @ L)
        np.testing.assert_allclose(larger.tracks[robot].cov, L @ cov @ L * np.ones((len(t.t), 1, 1)))


def test_a_team_of_cameras_alone_is_as_large_as_ranges_that_fall_short_say(monkeypatch):
    logs, landmarks, tracks = logs_and_map(noise=0.2)
    blind = [replace(log, odometry=None) for log in logs]
    team = TeamMap(("robot1", "robot2"), landmarks, tracks)
    monkeypatch.setattr(smoothing, "BARE_RANGE_SCALE", 0.8)
    made = smooth(team, blind, {}, CFG)
    assert not made.refused
    assert spread(made.map.landmarks.mean) == pytest.approx(spread(landmarks.mean) / 0.8, rel=1e-3)
    assert made.prior["range_scale"][0] == 0.8
    assert {name for known in made.calibration.values() for name in known} == set(PARAMETERS) - {
        "speed_scale",
        "turn_scale",
        "lag",
    }
    wheels = smooth(team, logs, {}, CFG)
    assert spread(wheels.map.landmarks.mean) == pytest.approx(spread(landmarks.mean), rel=0.05)
    assert wheels.poses == sum(count_instants(log, np.zeros(0), CFG) for log in logs)
    assert set(wheels.calibration["robot1"]) == set(PARAMETERS)


def test_a_map_that_cannot_be_smoothed_stays_and_says_why(made):
    logs, landmarks, tracks = made
    team = TeamMap(("robot1", "robot2"), landmarks, tracks)
    empty = [
        replace(log, sightings=replace(log.sightings, **{f: getattr(log.sightings, f)[:0] for f in FIELDS}))
        for log in logs
    ]
    elsewhere = LandmarkMap(tuple("vwxyz"), landmarks.mean, landmarks.cov)
    for asked, given, why, warned in (
        (team, empty, "nobody saw anything", False),
        (replace(team, landmarks=elsewhere), logs, "nobody saw a landmark of the map or another robot", False),
    ):
        kept = smooth(asked, given, {}, CFG)
        assert kept.refused == why
        assert kept.map is asked
        assert bool(kept.findings) == warned
        assert not kept.iterations


def test_beside_a_laser_ranges_are_believed_so_many_times_less():
    by = RANGE_BESIDE_LASER
    wide = _beside_laser(CFG.camera)
    assert wide.range_floor == by * CFG.camera.range_floor
    assert wide.range_share == by * CFG.camera.range_share
    assert replace(wide, range_floor=CFG.camera.range_floor, range_share=CFG.camera.range_share) == CFG.camera
