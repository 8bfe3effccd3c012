"""A camera whose clock is off that of the robot's wheels."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core.landmark_log import LandmarkLog
from mapweave.team.clocks import camera_ahead, on_camera_clock

from .teams import world


def seen_later(log: LandmarkLog, by: float) -> LandmarkLog:
    return replace(log, sightings=replace(log.sightings, t=log.sightings.t + by))


def test_clocks_that_agree_are_left_alone():
    for log in world(31, robots=4, minutes=3.0).logs:
        assert on_camera_clock(log) is log


@pytest.mark.parametrize("by", [2.0, -3.0, 4.5])
def test_a_camera_that_is_off_its_wheels_is_found_whichever_way(by):
    log = world(31, robots=4, minutes=3.0).logs[0]
    late = seen_later(log, by)
    assert camera_ahead(late) == pytest.approx(by, abs=0.3)
    made = on_camera_clock(late)
    assert made.odometry is not None
    assert late.odometry is not None
    np.testing.assert_allclose(made.odometry.t - late.odometry.t, by, atol=0.3)
    np.testing.assert_array_equal(made.sightings.t, late.sightings.t)
    assert ("ahead of" if by > 0 else "behind") in made.warnings[-1]
    assert not camera_ahead(made)


def test_nothing_is_told_of_a_robot_without_wheels_or_that_saw_little():
    log = seen_later(world(31, robots=4, minutes=3.0).logs[0], 2.0)
    assert camera_ahead(replace(log, odometry=None)) == 0.0
    few = replace(log, sightings=log.sightings.select(np.arange(len(log.sightings)) < 50))
    assert camera_ahead(few) == 0.0


def test_the_map_is_as_good_as_with_right_clocks_and_says_so(tmp_path):
    home = tmp_path / "team"
    mapweave.simulate_landmarks(home, robots=2, minutes=3.0, seed=7440)
    right = mapweave.map(home, truth=home).metrics["refined"]["ate"]
    path = home / "Robot2_Odometry.dat"
    rows = [r.split() for r in path.read_text().splitlines() if not r.startswith("#")]
    path.write_text("\n".join(" ".join([repr(float(t) - 2.0), *rest]) for t, *rest in rows) + "\n")
    made = mapweave.map(home, truth=home)
    assert any("robot 2: its camera's stamps are" in w and "ahead of its wheels" in w for w in made.metrics["warnings"])
    assert not any("elsewhere" in w for w in made.metrics["warnings"])
    assert made.metrics["refined"]["ate"] < 1.3 * right
