"""The information of a scan match is over the robot's own axes, however the robot stands in the map."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.scan_matching import FrontEnd, FrontEndConfig

SD = np.array([0.1, 0.1, 0.1])


def corridor_scan(y, heading):
    """What a scanner sees `y` off the middle of an endless corridor 2 m wide, turned by `heading` from its axis."""
    angle = np.linspace(-2.0, 2.0, 161)
    across = np.sin(angle + heading)
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (np.sign(across) - y) / across
    return Scan(np.where(r < 8.0, r, 30.0), r < 8.0, None, -2.0, float(angle[1] - angle[0]), 30.0)


def matched(frame):
    """Information of a match of a scan turned by 0.3 to the corridor, all in a map turned by `frame`."""
    front = FrontEnd(FrontEndConfig())
    where = np.array([0.31, -0.12, frame])
    for x in (-1.0, -0.5, 0.0, 0.5, 1.0):
        pose = se2.compose(where, np.array([x, 0.0, 0.0]))
        front.insert(beams(corridor_scan(0.0, 0.0), "none", None, BeamConfig()), pose)
    b = beams(corridor_scan(0.05, 0.3), "none", None, BeamConfig())
    pose = se2.compose(where, np.array([0.0, 0.05, 0.3]))
    match = front.match(b, pose, SD)
    assert np.abs(se2.between(pose, match.pose)).max() < 0.03
    return match.information, front.information(b, match.pose)


def direction(H):
    """The direction in the robot frame [rad] that the least is known of."""
    _, vectors = np.linalg.eigh(H[:2, :2] - H[:2, 2:] @ H[2:, :2] / H[2, 2])
    return np.arctan2(vectors[1, 0], vectors[0, 0]) % np.pi


@pytest.mark.parametrize("frame", [0.0, 0.9, np.pi / 2, -2.2])
def test_the_least_is_known_along_the_corridor_as_the_robot_sees_it(frame):
    for H in matched(frame):
        assert np.allclose(H, H.T)
        assert direction(H) == pytest.approx(np.pi - 0.3, abs=0.05)
        along = np.array([np.cos(0.3), -np.sin(0.3)])
        across = np.array([np.sin(0.3), np.cos(0.3)])
        assert across @ H[:2, :2] @ across > 8 * along @ H[:2, :2] @ along


def test_turning_the_map_by_a_right_angle_changes_nothing_that_the_robot_knows():
    for straight, turned in zip(matched(0.0), matched(np.pi / 2), strict=True):
        np.testing.assert_allclose(turned, straight, atol=0.15 * np.abs(straight).max())
