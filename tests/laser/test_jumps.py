"""A scene that changes at once while the wheels stand is told; one that changes because the robot drives on is not."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.records import Scan
from mapweave.laser.laser_map import ScanRecords
from mapweave.laser.log_warnings import jumps


def drive(share, way=0.1, turn=0.0, beams=100):
    n = len(share)
    numbers = np.zeros(n)
    records = ScanRecords(
        10.0 + np.arange(n),
        ("",) * n,
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.full(n, beams),
        np.round(beams * np.array(share)).astype(int),
        ("matched",) * n,
        numbers,
        numbers.astype(bool),
    )
    poses = np.column_stack([way * np.arange(n), numbers, turn * np.arange(n)])
    ranges, hit = np.ones(beams), np.ones(beams, bool)
    return records, [Scan(ranges, hit, None, -1.0, 0.02, 30.0, odometry=pose) for pose in poses]


def test_a_scene_that_changes_at_once_is_told_with_when_and_by_how_much():
    (told,) = jumps(*drive([1.0, 0.9, 0.95, 0.2, 0.8, 0.9, 0.1]), "1")
    assert (told.code, told.robot, told.span) == ("scene-jump", "1", (13.0, 13.0))
    assert told.value == {"now": 20.0, "before": 95.0, "way": pytest.approx(0.1), "times": 2}


@pytest.mark.parametrize(
    "quiet",
    [
        drive([1.0, 0.9, 0.7, 0.45, 0.3, 0.6]),  # new walls come into view
        drive([1.0, 0.9, 0.95, 0.3, 0.8], way=0.6),
        drive([1.0, 0.9, 0.95, 0.3, 0.8], turn=1.5),
        drive([1.0, 0.1, 0.9, 0.9]),  # there is no map before the first scan
        drive([1.0, 0.9, 0.95, 0.1, 0.8], beams=20),
    ],
)
def test_scenes_that_change_as_robots_drive_are_not_told(quiet):
    assert jumps(*quiet, "1") == ()


def test_without_odometry_nothing_is_told():
    records, scans = drive([1.0, 0.9, 0.95, 0.1, 0.8])
    assert jumps(records, [Scan(s.ranges, s.hit, None, -1.0, 0.02, 30.0) for s in scans], "1") == ()


def test_a_second_scanner_that_sees_walls_the_first_has_not_seen_is_no_jump():
    records, scans = drive([1.0, 0.1, 0.95, 0.15, 0.9, 0.2, 0.95, 0.3], way=0.02)
    behind = np.array([-0.3, 0.0, np.pi])
    both = [replace(scan, T_robot_sensor=behind) if k % 2 else scan for k, scan in enumerate(scans)]
    assert jumps(records, both, "1") == ()
    assert jumps(records, scans, "1") != ()


def test_a_drive_with_another_scanner_joined_to_a_log_is_a_jump():
    records, scans = drive([1.0] * 60 + [0.2] + [0.9] * 10)
    other = [
        replace(scan, T_robot_sensor=np.array([0.4, 0.0, 0.0])) if k >= 60 else scan for k, scan in enumerate(scans)
    ]
    (told,) = jumps(records, other, "1")
    assert (told.span, told.value["now"], told.value["times"]) == ((70.0, 70.0), 20.0, 1)
