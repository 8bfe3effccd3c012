"""What wheels are worth is learned from steps where walls hold every direction, and from no others."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.keyframes import KeyframeConfig, KeyframeOdometry, StepNoise
from mapweave.laser.scan_matching import FrontEndConfig
from mapweave.laser.wheel_worth import LEAST

from .test_scan_matching import box_scan

STEP = 0.05  # [m] driven from scan to scan
NOISE = StepNoise(wheels_xy=0.1, wheels_turn_per_m=0.03, wheels_turn=0.1)


def driven(wheels_sd, scans=300, half=(3.0, 2.0), *, turn_sd=0.0, learn=True, seed=0):
    """Keyframes of a robot that drives to and fro in a room, its wheels' steps wrong by these [m] and [rad]."""
    rng = np.random.default_rng(seed)
    odometry = KeyframeOdometry(0, KeyframeConfig(noise=NOISE), FrontEndConfig(), learn=learn)
    x, wheels = -0.8, np.zeros(3)
    for k in range(scans):
        scan = box_scan(np.array([x, 0.0, 0.0]), n=181, half=half)
        odometry.advance(replace(scan, odometry=np.array(wheels)), beams(scan, "none", None, BeamConfig()))
        forth = STEP if (k // 30) % 2 == 0 else -STEP
        x += forth
        wheels = wheels + np.array([forth, 0.0, 0.0]) + rng.standard_normal(3) * [wheels_sd, wheels_sd, turn_sd]
    return odometry


def test_good_wheels_may_err_by_less_and_bad_ones_by_as_much_as_any():
    good, fair, bad = (driven(sd).worth.step[0] for sd in (0.002, 0.015, 0.1))
    assert LEAST <= good < 0.5 * bad
    assert good < fair < bad
    assert bad == 1.0


def test_ways_of_good_wheels_are_believed_and_those_of_bad_ones_are_as_of_any():
    cov = np.diag([0.01, 0.01, 0.001])
    good, bad = driven(0.002).worth.scaled(cov), driven(0.1, turn_sd=0.05).worth.scaled(cov)
    assert np.sqrt(good[0, 0] / cov[0, 0]) == pytest.approx(0.5, abs=0.3)
    assert np.sqrt(good[2, 2] / cov[2, 2]) < 0.8
    np.testing.assert_allclose(np.diag(bad), np.diag(cov))


def test_wheels_that_slipped_once_in_a_turn_may_slip_again():
    odometry = driven(0.002)
    before = odometry.worth.step[2]
    odometry.worth.see(np.array([STEP, 0, 0]), np.array([0, 0, 0.9]), np.full(3, 1.0), 1e5 * np.eye(3), 1e5)
    assert before < 0.5
    assert odometry.worth.step[2] == pytest.approx(0.9)


@pytest.mark.parametrize("how", [{"half": (300.0, 2.0)}, {"scans": 2}], ids=["a corridor", "one step"])
def test_nothing_is_learned_of_a_way_where_walls_leave_a_direction_open(how):
    worth = driven(0.002, **how).worth
    assert worth.step[0] == 1.0
    np.testing.assert_array_equal(worth.scaled(np.eye(3)), np.eye(3))


def test_explorers_believe_what_they_are_told_of_their_wheels():
    assert driven(0.002, scans=3, learn=False).worth is None
