"""A robot without wheels has a pose only where sightings fix one."""

import numpy as np
import pytest

from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.fixed_stretches import fixed_stretches
from mapweave.team.relative_frame import PlacingConfig
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
    window = PlacingConfig().fixed_window
    assert kept.t[-1] == pytest.approx(20.0 + window, abs=0.5)
    assert kept.cov.shape == (len(kept.t), 3, 3)
    assert team.left_out == {"robot3": ()}
    (sentence,) = told
    assert sentence.startswith(f"robot 3: {len(T) - len(kept.t)} of {len(T)} poses are left out")


def test_a_distance_fixes_it_too():
    team, told = cut(*world({"robot1": (0, 60), "robot2": (0, 20)}, ranged=("robot1",)))
    assert len(team.tracks["robot3"].t) == len(T)
    assert told == ()


def test_where_sightings_contradict_its_way_it_is_left_out_of_the_map():
    team, told = cut(*world({"robot1": (0, 60), "robot2": (0, 60)}, off=4.0))
    assert team.robots == ("robot1", "robot2")
    assert set(team.tracks) == {"robot1", "robot2"}
    assert told == ("robot 3: too few sightings fix where it was: it is left out",)
