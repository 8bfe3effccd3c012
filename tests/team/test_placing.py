"""Loose robots placed by what they and others saw of each other."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.landmark_log import NOTHING_SEEN, LandmarkLog, SightingTable
from mapweave.core.records import Track
from mapweave.team.config import SmoothingConfig
from mapweave.team.relative_frame import Body, PlacingConfig, lay_out

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
