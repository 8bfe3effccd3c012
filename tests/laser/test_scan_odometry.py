"""What wheels are worth is learned from steps where walls hold every direction, and from no others."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.scan_matching import FrontEndConfig
from mapweave.laser.scan_odometry import LEARNED, LEAST_WIDE, ScanOdometry

from .test_scan_matching import box_scan

STEP = 0.05  # [m] driven from scan to scan
CFG = FrontEndConfig()


def driven(wheels_sd, scans=3 * LEARNED, half=(3.0, 2.0), *, lines=True, gate=None, seed=0):
    """Scan odometry of a robot that drives along a room, its wheels' steps wrong by `wheels_sd` [m]."""
    rng = np.random.default_rng(seed)
    odometry = ScanOdometry(CFG, gate=gate, tell_lines=lines)
    way = np.array([-0.8, 0.0, 0.0])
    wheels = np.zeros(3)
    for k in range(scans):
        scan = box_scan(way, n=181, half=half)
        odometry.advance(replace(scan, odometry=np.array(wheels)), beams(scan, "none", None, BeamConfig()))
        forth = 1.0 if (k // 30) % 2 == 0 else -1.0
        way = way + np.array([forth * STEP, 0.0, 0.0])
        wheels = wheels + np.array([forth * STEP, 0.0, 0.0]) + wheels_sd * np.array([*rng.standard_normal(2), 0.0])
    return odometry


def allowed(odometry):
    """What a step of the robot may err by in x [m]."""
    return odometry.increment(odometry.odometry + np.array([STEP, 0.0, 0.0])).sd


def test_good_wheels_may_err_by_less_and_bad_ones_by_as_much_as_any():
    anybody = allowed(driven(0.0, scans=2))
    good, bad = allowed(driven(0.002)), allowed(driven(0.1))
    assert good[:2] == pytest.approx(LEAST_WIDE * anybody[:2])
    assert bad[:2] == pytest.approx(anybody[:2])
    assert good[2] == bad[2] == anybody[2]
    assert LEAST_WIDE * anybody[0] < allowed(driven(0.006))[0] < anybody[0]


@pytest.mark.parametrize(
    "how",
    [{"half": (300.0, 2.0)}, {"gate": lambda sd: 9.0 * sd}, {"lines": False}, {"scans": LEARNED}],
    ids=["a corridor", "a gate", "no lines", "few steps"],
)
def test_nothing_is_learned_where_walls_leave_a_direction_open_or_nobody_asks(how):
    assert allowed(driven(0.002, **how)) == pytest.approx(allowed(driven(0.0, scans=2)))


def test_a_robot_whose_wheels_stand_learns_nothing_from_them():
    odometry = ScanOdometry(CFG, tell_lines=True)
    for _ in range(3 * LEARNED):
        scan = box_scan(np.zeros(3), n=181)
        odometry.advance(replace(scan, odometry=np.zeros(3)), beams(scan, "none", None, BeamConfig()))
    assert allowed(odometry) == pytest.approx(allowed(driven(0.0, scans=2)))
