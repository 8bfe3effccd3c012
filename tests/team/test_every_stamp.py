"""Poses at stamps whose rows no estimate was made from."""

import numpy as np

from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.team_map import TeamMap, at_every_stamp


def team(left_out=()):
    t = np.array([10.0, 11.0, 12.0, 20.0, 21.0])
    pose = np.column_stack([t - 10.0, np.zeros(5), np.array([3.0, -3.1, 0.0, 0.0, 0.4])])
    cov = np.eye(3) * np.array([1.0, 2.0, 3.0, 4.0, 5.0])[:, None, None]
    return TeamMap(
        ("robot1",),
        LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0))),
        {"robot1": Track(t, pose, cov)},
        left_out={"robot1": left_out},
    )


def test_a_pose_lies_between_its_neighbours_and_the_others_stay():
    before = team().tracks["robot1"]
    after = at_every_stamp(team(), {"robot1": np.array([10.0, 10.5, 20.25, 21.0])}, {}).tracks["robot1"]
    np.testing.assert_array_equal(after.t, [10.0, 10.5, 11.0, 12.0, 20.0, 20.25, 21.0])
    there = np.isin(after.t, before.t)
    np.testing.assert_array_equal(after.pose[there], before.pose)
    np.testing.assert_array_equal(after.cov[there], before.cov)
    np.testing.assert_allclose(after.pose[5], [10.25, 0.0, 0.1])
    np.testing.assert_allclose(after.cov[5], np.eye(3) * 4.25)
    assert abs(abs(after.pose[1, 2]) - (3.0 + 0.5 * (2 * np.pi - 6.1))) < 1e-12, "along the shorter arc"


def test_none_is_made_up_where_nothing_says_where_the_robot_was():
    after = at_every_stamp(team(((12.0, 20.0),)), {"robot1": np.array([9.0, 10.5, 15.0, 22.0])}, {}).tracks["robot1"]
    np.testing.assert_array_equal(after.t, [10.0, 10.5, 11.0, 12.0, 20.0, 21.0])


def test_stamps_of_a_clock_that_is_ahead_are_taken_to_the_track():
    after = at_every_stamp(team(), {"robot1": np.array([13.5])}, {"robot1": 3.0}).tracks["robot1"]
    np.testing.assert_array_equal(after.t, [10.0, 10.5, 11.0, 12.0, 20.0, 21.0])
