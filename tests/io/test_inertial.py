"""What an IMU tells: turns in every mounting and unit, a bias, a robot that is tipped, and what is not believed."""

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.io.laser_logs import LaserSource, read_laser

from .made_spins import error_of, spin_bag, truth_of
from .ros_logs import Recording, driving, wall

DOWN = np.diag([1.0, -1.0, -1.0])
ASIDE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def codes(findings):
    return {f.code: f.value for f in findings if f.code.startswith(("imu", "robot-tipped"))}


def turned(log):
    """(told, true) turns from scan to scan of a log without wheels."""
    return np.diff([scan.heading for scan in log.scans])


@pytest.mark.parametrize(
    ("unit", "found"),
    [
        ({}, {}),
        ({"bias": 0.05}, {}),
        ({"mounted": DOWN}, {"imu-mounted": 180.0}),
        ({"mounted": ASIDE}, {"imu-mounted": 90.0}),
        ({"scale": 180 / np.pi}, {"imu-unit": "in degrees"}),
        ({"scale": -1.0}, {"imu-unit": "the other way round"}),
        ({"mounted": DOWN, "felt": False}, {"imu-unit": "the other way round"}),
    ],
)
def test_turns_are_read_however_the_unit_is_mounted_and_whatever_it_counts_in(tmp_path, unit, found):
    truth, rate = truth_of(20.0, 1.0)
    log = read_laser(spin_bag(tmp_path / "a.mcap", truth, rate, **unit))
    true = np.diff(np.unwrap(se2.interpolate(log.scan_t, truth.t, truth.pose)[:, 2]))
    assert np.abs(turned(log) - true - 0.1 * unit.get("bias", 0.0)).max() < 0.01
    told = codes(log.findings)
    assert told.pop("imu-turns").startswith("/imu: ")
    assert {k: v if isinstance(v, str) else pytest.approx(v, abs=2) for k, v in told.items()} == found
    assert log.unused == ()


@pytest.mark.slow
def test_beside_a_scanner_alone_it_maps_turns_that_matching_alone_loses(tmp_path):
    truth, rate = truth_of(40.0, 2.0)
    alone = mapweave.map(spin_bag(tmp_path / "a.mcap", truth, rate, imu=False, every=40)).maps[0].track
    told = mapweave.map(spin_bag(tmp_path / "b.mcap", truth, rate, bias=0.02, every=40)).maps[0].track
    assert error_of(told, truth)[0] < 0.05
    assert error_of(told, truth)[0] < 0.2 * error_of(alone, truth)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "turns"), [(60.0, 2.0), (40.0, 1.0), (40.0, 3.0)])
def test_matching_alone_asks_for_no_turn_that_no_robot_makes_between_two_scans(tmp_path, seconds, turns):
    """From two places the room looks alike: turned far enough, scans of either fit the other."""
    truth, rate = truth_of(seconds, turns)
    alone = mapweave.map(spin_bag(tmp_path / "a.mcap", truth, rate, imu=False)).maps[0].track
    assert error_of(alone, truth)[1] < 0.1


def test_a_bias_is_found_where_the_robot_stands(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(600):
        out.imu(10 + 0.01 * k, 0.08)
    for k in range(60):
        out.scan(10 + 0.1 * k, wall(0))
    log = read_laser(out.write())
    assert np.abs(turned(log)).max() < 1e-3


def test_headings_of_wheels_are_replaced_where_scans_agree_more_with_the_imu_and_the_way_is_kept(tmp_path):
    truth, rate = truth_of(20.0, 1.0)
    log = read_laser(spin_bag(tmp_path / "a.mcap", truth, rate, wheels=1.6))
    assert "wheels'" in codes(log.findings)["imu-turns"]
    assert error_of(log.odometry, truth)[1] < 0.15
    good = read_laser(spin_bag(tmp_path / "b.mcap", truth, rate, wheels=1.0))
    assert codes(good.findings) == {}
    assert [(u.topic, u.reason) for u in good.unused] == [("/imu", "wheels tell turns as well")]


def test_an_imu_whose_turns_no_scan_shows_is_not_believed(tmp_path):
    truth, _ = truth_of(20.0, 0.3)
    other = np.sin(1.7 * truth.t)
    log = read_laser(spin_bag(tmp_path / "a.mcap", truth, other))
    assert codes(log.findings) == {"imu-unlike": "/imu"}
    assert log.scans[5].heading is None
    assert [u.topic for u in log.unused] == ["/imu"]


def test_a_robot_that_is_tipped_is_told_with_the_time(tmp_path):
    out = Recording(tmp_path / "a.bag")
    for k in range(1000):
        lean = 0.9 if 400 <= k < 700 else 0.0
        out.imu(10 + 0.01 * k, 0.0, (9.81 * np.sin(lean), 0.0, 9.81 * np.cos(lean)))
    for k in range(100):
        out.scan(10 + 0.1 * k, wall(0))
    (found,) = [f for f in read_laser(out.write()).findings if f.code == "robot-tipped"]
    assert found.span == pytest.approx((14.0, 17.0), abs=0.2)
    assert found.value == pytest.approx(np.rad2deg(0.9), abs=2)


def test_over_a_gap_and_with_numbers_that_are_none_no_turn_is_known(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(300):
        if not 100 <= k < 150:
            out.imu(10 + 0.01 * k, np.nan if k % 7 == 0 else 0.5)
    for k in range(30):
        out.scan(10.005 + 0.1 * k, wall(3 * k))
    known = [scan.heading is not None for scan in read_laser(out.write()).scans]
    assert known == [not 10 <= k <= 15 for k in range(30)]


def test_each_robot_of_a_recording_has_its_own(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for name in ("r1", "r2"):
        for k in range(30):
            driving(out, name, k, base=f"{name}/base", laser=f"{name}/laser")
            out.imu(10 + 0.1 * k, 0.0, topic=f"/{name}/imu")
    path = out.write()
    for name, other in (("r1", "r2"), ("r2", "r1")):
        unused = {u.topic: u.reason for u in read_laser(path, "1", LaserSource(name=name)).unused}
        assert unused[f"/{name}/imu"] == "wheels tell turns as well"
        assert "another robot" in unused[f"/{other}/imu"]
