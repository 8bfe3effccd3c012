"""A trajectory whose covariances say that it may be off by more than a map is good for is told."""

import numpy as np
import pytest

import mapweave
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.mapping.segments import LOOSE_ALL
from mapweave.team.team_map import TeamMap, way_loose

NOTHING = LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))


def loose_from_30_to_50(sd: float) -> TeamMap:
    """100 s at even stamps, then a silence that ends at 200 s."""
    t = np.append(np.arange(101.0), 200.0)
    cov = np.tile(1e-4 * np.eye(3), (len(t), 1, 1))
    cov[30:51, :2, :2] = 0.5 * sd**2 * np.eye(2)
    return TeamMap(("1",), NOTHING, {"1": Track(t, np.zeros((len(t), 3)), cov)})


def test_a_trajectory_is_loose_by_its_covariances_over_time_wherever_its_poses_stand():
    share = 21.0 / 200.0  # of the time, whatever of the poses
    (told,) = way_loose(loose_from_30_to_50(1.05 * LOOSE_ALL / np.sqrt(share)))
    assert (told.code, told.severity, told.robot, told.span) == ("way-loose", "doubtful", "1", (30.0, 50.0))
    assert told.value == pytest.approx(1.05 * LOOSE_ALL, rel=0.01)
    assert way_loose(loose_from_30_to_50(0.95 * LOOSE_ALL / np.sqrt(share))) == ()


@pytest.mark.slow
def test_a_robot_without_wheels_that_saw_nothing_for_long_makes_no_good_map(tmp_path):
    log = tmp_path / "log"
    mapweave.simulate_landmarks(log, robots=1, landmarks=30, minutes=6.0, seed=6)
    next(log.glob("*Odometry.dat")).unlink()
    result = mapweave.map(log)
    assert result.verdict == "doubtful"
    assert "way-loose" in {found.code for found in result.findings}
