"""Rooms that no robot without wheels ties by itself, tied by robots that saw each other from one to the other."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.team import team_maps
from mapweave.core.records import Track
from mapweave.evaluation.landmarks import rmse_after_alignment
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.landmark_truth import read_survey
from mapweave.landmarks.mapping import local_map
from mapweave.team.config import PlacingConfig
from mapweave.team.team_map import with_further_rooms

from .teams import world


def joined(logs, placing=None):
    local = [local_map(log) for log in logs]
    team = team_maps(local, fuse(local))[0]
    return team, *with_further_rooms(team, local, logs, placing or PlacingConfig(), local_map, fuse, team_maps)


@pytest.mark.data
def test_both_halves_of_a_real_room_become_one_map_without_any_wheels(data):
    home = data / "mrclam" / "MRCLAM_Dataset6.zip"
    logs = [replace(log, odometry=None, log_hash="") for log in read_landmark_logs(home)]
    half, whole, told = joined(logs)
    assert len(half.landmarks) == 8
    assert len(whole.landmarks) == 15
    assert rmse_after_alignment(whole.landmarks, read_survey(home)) < 0.12
    assert len(told) == 1
    assert "7 landmarks that robots 1, 2, 3, 4, 5 mapped apart are tied by" in told[0].text
    assert np.linalg.eigvalsh(whole.landmarks.cov)[0] > -1e-12
    assert set(whole.members) == set(whole.sightings) == set(whole.landmarks.ids)
    for robot, track in whole.tracks.items():
        np.testing.assert_array_equal(track.t, half.tracks[robot].t)
        sure, before = (np.sqrt(t.cov[:, 2, 2]) < 0.8 for t in (track, half.tracks[robot]))
        assert sure.sum() > 1.5 * before.sum()


@pytest.mark.data
def test_a_room_that_no_sighting_ties_surely_stays_out(data):
    logs = [replace(log, odometry=None, log_hash="") for log in read_landmark_logs(data / "mrclam/MRCLAM_Dataset6.zip")]
    half, whole, told = joined(logs, PlacingConfig(sure_xy=1e-6))
    assert whole is half
    assert told == ()


def test_a_team_with_wheels_comes_back_as_it_is():
    team, same, told = joined(world(4, minutes=1.0).logs)
    assert same is team
    assert told == ()


@pytest.mark.data
def test_a_robot_put_down_elsewhere_may_know_more_of_its_way_than_its_map_tells(data):
    """Its map is of the longest stretch of its log, the team's track of all stretches that sightings place."""
    logs = read_landmark_logs(data / "mrclam" / "MRCLAM_Dataset6.zip", [1, 2])
    logs = [logs[0], replace(logs[1], odometry=None, log_hash="")]
    local = [local_map(log) for log in logs]
    team = team_maps(local, fuse(local))[0]
    main = team.tracks["robot1"]
    late = main.t[-1] + np.arange(1.0, 20.0)
    way = Track(
        np.append(main.t, late), np.append(main.pose, main.pose[:19], 0), np.append(main.cov, main.cov[:19], 0), "map"
    )
    team = replace(team, tracks={**team.tracks, "robot1": way})
    whole, _ = with_further_rooms(team, local, logs, PlacingConfig(), local_map, fuse, team_maps)
    np.testing.assert_array_equal(whole.tracks["robot1"].t, way.t)
