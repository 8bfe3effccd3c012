"""Loose robots placed by what they and others saw of each other."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from mapweave.core.records import Track
from mapweave.team.config import PlacingConfig, SmoothingConfig
from mapweave.team.relative_frame import Body, agreeing_sightings, lay_out

SPEED = 0.12  # [m/s] of the robot without wheels


@pytest.mark.parametrize("every", [0.25, 1.3])
def test_a_robot_without_wheels_is_placed_however_rarely_it_is_sighted(every):
    """Three robots stand about; one of them sights it with its range, it sights all of them by bearing alone."""
    others = {"robot1": [0.0, 0.0, 0.3], "robot2": [5.0, 0.0, 2.0], "robot3": [2.0, 4.0, -1.0]}
    t = np.arange(0.0, 30.0, every)
    way = Track(t, np.column_stack([1.0 + SPEED * t, 1.0 + 0 * t, 0.4 + 0 * t]))
    span = np.array([-1.0, 31.0])
    body = Body({name: Track(span, np.array([pose, pose])) for name, pose in others.items()}, {})
    where = np.array(list(others.values()))[:, :2]
    turn = np.arange(len(t)) % 3
    seen = where[turn] - way.pose[:, :2]
    bearing = se2.wrap_angle(np.arctan2(seen[:, 1], seen[:, 0]) - way.pose[:, 2])
    own = SightingTable(t, turn, np.full(len(t), np.nan), bearing, tuple(others))
    loose = LandmarkLog("robot4", None, NOTHING_SEEN, bearings=own)
    ahead = way.pose[:, :2] - where[0]
    table = SightingTable(
        t, np.zeros(len(t), np.int64), np.hypot(*ahead.T), np.arctan2(ahead[:, 1], ahead[:, 0]) - 0.3, ("robot4",)
    )
    logs = {"robot1": LandmarkLog("robot1", None, table), "robot4": loose}
    layout = lay_out([body], [loose], logs, {}, PlacingConfig(), SmoothingConfig())
    assert layout.lost == ()
    track = layout.bodies[0].tracks["robot4"]
    off = track.pose - se2.interpolate(track.t, way.t, way.pose)
    assert np.hypot(*off[:, :2].T).max() < 0.4


@pytest.mark.parametrize("shared", [1, 3])
def test_robots_are_not_tied_by_one_landmark_however_often_it_was_seen(shared):
    """Of what the second robot sighted `shared` landmarks are the first's; a tenth of the names is of others."""
    rng = np.random.default_rng(4)
    names = tuple(f"L{k}" for k in range(8))
    at = rng.uniform(-5, 5, (8, 2))
    T = np.array([3.0, 1.0, 0.7])
    t = np.arange(0.0, 60.0, 0.5)
    way = np.column_stack([3 * np.cos(0.1 * t), 3 * np.sin(0.1 * t), 0.1 * t + np.pi / 2])
    what = rng.integers(0, shared, len(t))
    seen = se2.act(se2.inverse(T), at)[what]
    wrong = rng.random(len(t)) < 0.1
    what = np.where(wrong, rng.integers(shared, 8, len(t)), what)
    ahead = seen - way[:, :2]
    bearing = se2.wrap_angle(np.arctan2(ahead[:, 1], ahead[:, 0]) - way[:, 2])
    log = LandmarkLog("robot2", None, SightingTable(t, what, np.hypot(*ahead.T), bearing, names))
    ends = np.array([t[0], t[-1]])
    bodies = [
        Body({"robot1": Track(ends, np.zeros((2, 3)))}, dict(zip(names, at, strict=True))),
        Body({"robot2": Track(t, way)}, {}),
    ]
    layout = lay_out(bodies, [], {"robot2": log}, {}, PlacingConfig(), SmoothingConfig())
    if shared == 1:
        assert layout.ties == ()
        return
    (tie,) = layout.ties
    off = layout.bodies[0].tracks["robot2"].pose - se2.compose(T, way)
    assert tie.agree >= 100
    assert np.abs(off[:, :2]).max() < 0.2


def test_poses_are_asked_for_sightings_of_the_other_body_alone(monkeypatch):
    robots, each = 8, 10
    names = tuple(f"robot{k}" for k in range(robots))
    span = np.array([0.0, 100.0])
    body = Body({name: Track(span, np.tile([float(k), 0.0, 0.0], (2, 1))) for k, name in enumerate(names)}, {})
    what = np.repeat(np.arange(robots), each)
    t = np.arange(len(what), dtype=float)
    logs = {
        name: LandmarkLog(name, None, SightingTable(t, what, np.ones(len(t)), np.zeros(len(t)), names))
        for name in names
    }
    asked, pose = [], Body.pose

    def counted(self, robot, t):
        asked.append(len(t))
        return pose(self, robot, t)

    monkeypatch.setattr(Body, "pose", counted)
    _, of = agreeing_sightings("robot3", body, logs, {}, PlacingConfig())
    assert of == 2 * (robots - 1) * each
    assert sum(asked) == 2 * of
