"""Where a trajectory is not one piece."""

import numpy as np
import pytest

from mapweave.laser.scan_odometry import ScanInfo
from mapweave.mapping.segments import GAP, JUMP, LEARNED, REFUSED, SLIP, Borders, SegmentConfig

STEP = np.array([0.3, 0.0, 0.1])


def info(innovation=(0.0, 0.0, 0.0), share=0.9, decision="matched"):
    return ScanInfo(np.array(innovation), 100, int(100 * share), decision)


def after(told, step=STEP, apart=0.2, *, wheels=True):
    """What is said of a scan that comes after many that were sure."""
    borders = Borders(SegmentConfig())
    for k in range(LEARNED + 5):
        assert borders.seen(0.2 * k, info(decision="first" if k == 0 else "matched"), STEP, wheels=wheels) == ""
    return borders.seen(0.2 * (LEARNED + 4) + apart, told, step, wheels=wheels)


@pytest.mark.parametrize(
    ("told", "why"),
    [
        (info(), ""),
        (info((0.9, 0.0, 0.0)), ""),  # most returns match: wheels slipped
        (info((0.3, 0.0, 0.0), share=0.4), SLIP),
        (info((0.0, 0.0, -0.3), share=0.4), SLIP),
        (info((0.1, 0.0, 0.1), share=0.4), ""),  # few match, but where wheels put them
        (info((0.0, 1.2, 0.0)), JUMP),
        (info((0.0, 0.0, 1.2)), JUMP),
        (info(decision="odometry"), REFUSED),
        (info(decision="empty"), ""),
    ],
)
def test_a_step_is_sure_unless_matches_and_wheels_leave_it_open(told, why):
    assert after(told) == why


def test_without_wheels_no_match_contradicts_them():
    assert after(info((2.0, 0.0, 0.0), share=0.4), wheels=False) == ""
    assert after(info(decision="odometry"), wheels=False) == REFUSED


def test_after_a_pause_a_robot_that_moved_may_be_anywhere():
    assert after(info(), apart=60.0) == GAP
    assert after(info(), np.array([0.05, 0.0, 0.01]), apart=60.0) == ""
    assert after(info(), apart=4.0) == ""


def test_over_a_border_a_long_step_may_err_by_more():
    cfg = SegmentConfig()
    assert np.allclose(np.sqrt(np.diag(cfg.covariance(np.zeros(3)))), [1.0, 1.0, 0.5])
    assert np.allclose(np.sqrt(np.diag(cfg.covariance(np.array([6.0, 0.0, 2.0])))), [3.0, 3.0, 1.0])
