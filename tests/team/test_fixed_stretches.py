"""A robot without wheels has a pose only where sightings fix one."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.config import PlacingConfig
from mapweave.team.mixed import fixed_stretches
from mapweave.team.relative_frame import FIXED_WINDOW
from mapweave.team.team_map import TeamMap

T = np.arange(0.0, 60.0, 0.5)
WAY = np.column_stack([2.0 + 0.05 * T, np.full(len(T), 3.0), np.zeros(len(T))])
POSTS = {"robot1": (0.0, 0.0), "robot2": (6.0, 0.0)}


def world(seen_by, off=0.0, ranged=()):
    """Robots 1 and 2 stand still and tell bearings to robot 3 in `seen_by[robot]` = (from, to) [s]."""
    tracks = {name: Track(T, np.column_stack([np.tile(p, (len(T), 1)), np.zeros(len(T))])) for name, p in POSTS.items()}
    tracks["robot3"] = Track(T, WAY + np.array([0.0, off, 0.0]), np.tile(0.01 * np.eye(3), (len(T), 1, 1)))
    logs = {"robot3": LandmarkLog("robot3", None, NOTHING_SEEN)}
    for name, (x, y) in POSTS.items():
        rows = np.flatnonzero((seen_by[name][0] <= T) & (seen_by[name][1] >= T))
        d = WAY[rows, :2] - (x, y)
        far = np.hypot(*d.T) if name in ranged else np.full(len(rows), np.nan)
        table = SightingTable(T[rows], np.zeros(len(rows), int), far, np.arctan2(d[:, 1], d[:, 0]), ("robot3",))
        logs[name] = LandmarkLog(name, None, NOTHING_SEEN, bearings=table)
    return TeamMap(("robot1", "robot2", "robot3"), LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0))), tracks), logs


def cut(team, logs):
    return fixed_stretches(team, ["robot3"], logs, {}, PlacingConfig())


def test_where_two_saw_it_its_poses_stay():
    team, told = cut(*world({"robot1": (0, 60), "robot2": (0, 60)}))
    assert team.tracks["robot3"].t.tolist() == T.tolist()
    assert told == ()


def test_where_one_saw_it_by_bearing_its_poses_are_left_out_and_said():
    team, told = cut(*world({"robot1": (0, 60), "robot2": (0, 20)}))
    kept = team.tracks["robot3"]
    window = FIXED_WINDOW
    assert kept.t[-1] == pytest.approx(20.0 + window, abs=0.5)
    assert kept.cov.shape == (len(kept.t), 3, 3)
    assert team.left_out == {"robot3": ()}
    (sentence,) = told
    lost = f"at {len(T) - len(kept.t)} of {len(T)} poses; they are left out"
    assert sentence.told == f"robot 3: too few sightings fix where it was {lost}"


def test_a_distance_fixes_it_too():
    team, told = cut(*world({"robot1": (0, 60), "robot2": (0, 20)}, ranged=("robot1",)))
    assert len(team.tracks["robot3"].t) == len(T)
    assert told == ()


def test_where_sightings_contradict_its_way_it_is_left_out_of_the_map():
    team, told = cut(*world({"robot1": (0, 60), "robot2": (0, 60)}, off=4.0))
    assert team.robots == ("robot1", "robot2")
    assert set(team.tracks) == {"robot1", "robot2"}
    assert [f.told for f in told] == ["robot 3: too few sightings fix where it was; it is left out"]


@pytest.mark.parametrize("leap", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.8)])
def test_poses_beside_a_leap_that_no_robot_makes_are_left_out(leap):
    """A way that bearings allow may still be of another place than the robot's, if it takes a leap to get there."""
    team, logs = world({"robot1": (0, 60), "robot2": (0, 60)})
    track = team.tracks["robot3"]
    pose = track.pose + np.where(np.abs(T - 30.0) < 0.3, 1.0, 0.0)[:, None] * np.array(leap)
    made, told = cut(replace(team, tracks={**team.tracks, "robot3": Track(T, pose, track.cov)}), logs)
    kept, window = made.tracks["robot3"].t, FIXED_WINDOW
    assert set(kept) == set(T[np.abs(T - 30.0) > window + 0.5 + 1e-9])
    assert len(told) == 1
    slow = track.pose + np.where(np.abs(T - 30.0) < 0.3, 0.3, 0.0)[:, None] * np.array(leap)
    made, told = cut(replace(team, tracks={**team.tracks, "robot3": Track(T, slow, track.cov)}), logs)
    assert len(made.tracks["robot3"].t) == len(T)
    assert told == ()
