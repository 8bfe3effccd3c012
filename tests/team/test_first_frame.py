"""The frame of a map is the first pose of its lowest-numbered robot."""

import numpy as np

from mapweave.api.map_mixed import _finished
from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.clocks import RobotClock
from mapweave.team.known import PlacePriors
from mapweave.team.mixed import MixedMap
from mapweave.team.relative_frame import Layout
from mapweave.team.smooth import Smoothed
from mapweave.team.team_map import TeamMap, in_first_frame


def team(first):
    t = np.array([0.0, 1.0])
    cov = np.tile(np.diag([1.0, 4.0, 0.1]), (2, 1, 1))
    tracks = {
        "robot10": Track(t, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])),
        "robot2": Track(t, np.array([first, [4.0, 5.0, 1.0]]), cov),
    }
    landmarks = LandmarkMap(("7", "8"), np.array([[2.0, 1.0], [0.0, 3.0]]), np.diag([1.0, 4.0, 1.0, 9.0]))
    return TeamMap(("robot10", "robot2", "robot1"), landmarks, tracks)


def test_everything_is_seen_from_the_first_pose_of_the_lowest_numbered_robot_that_has_one():
    first = np.array([2.0, 1.0, np.pi / 2])
    before, after = team(first), in_first_frame(team(first))
    np.testing.assert_allclose(after.tracks["robot2"].pose[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(after.landmarks.mean, [[0.0, 0.0], [2.0, 2.0]], atol=1e-12)
    np.testing.assert_allclose(after.landmarks.cov, np.diag([4.0, 1.0, 9.0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(after.tracks["robot2"].cov[0], np.diag([4.0, 1.0, 0.1]), atol=1e-12)
    for name, track in before.tracks.items():
        np.testing.assert_allclose(se2.compose(first, after.tracks[name].pose), track.pose, atol=1e-12)


def test_a_map_that_is_in_its_frame_stays_the_same_object():
    there = team(np.zeros(3))
    assert in_first_frame(there) is there
    empty = TeamMap((), there.landmarks)
    assert in_first_frame(empty) is empty


def test_a_mixed_team_is_written_so_too_but_where_its_places_are_known():
    first = np.array([2.0, 1.0, np.pi / 2])
    smoothed = Smoothed(team(first), {}, {}, {}, 4, 1, "converged", {})
    made = MixedMap((smoothed,), Layout((), (), ()), (), {"robot10": RobotClock(3.0, 0.1)})
    stamps = {"robot10": np.array([3.5])}
    nowhere = PlacePriors.of({}, {}, {}, ())
    done = _finished(made, stamps, nowhere).components[0].map
    np.testing.assert_allclose(done.tracks["robot2"].pose[0], 0.0, atol=1e-12)
    np.testing.assert_array_equal(done.tracks["robot10"].t, [0.0, 0.5, 1.0])
    known = PlacePriors.of({}, {}, {"7": (0.0, 0.0, None)}, ())
    np.testing.assert_array_equal(_finished(made, stamps, known).components[0].map.tracks["robot2"].pose[0], first)
