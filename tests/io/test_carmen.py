"""CARMEN logs: what is read, and what is said when a row is wrong."""

import gzip

import numpy as np
import pytest

from mapweave.core.errors import DataError, ReaderError
from mapweave.core.records import OdometryPoses, Scan
from mapweave.io.laser_logs import is_laser_log, read_laser


def flaser(t, ranges, pose=(0.0, 0.0, 0.0), laser=None, host="gfs", word="FLASER"):
    laser = pose if laser is None else laser
    numbers = " ".join(map(str, (*ranges, *laser, *pose)))
    return f"{word} {len(ranges)} {numbers} {t} {host} {t - 1}"


def odom(t, x, y=0.0, theta=0.0):
    return f"ODOM {x} {y} {theta} 0 0 0 {t} odom {t}"


def robotlaser(t, ranges, remissions, far=50.0):
    return (
        f"ROBOTLASER1 0 -1.0 2.0 0.5 {far} 0.1 1 {len(ranges)} {' '.join(map(str, ranges))} {len(remissions)} "
        f"{' '.join(map(str, remissions))} 1.2 0 0 1 0 0 0 0 0 0 0 {t} robot {t}"
    )


def written(tmp_path, *lines, end="\n"):
    path = tmp_path / "some.log"
    path.write_text("\n".join(lines) + end)
    return path


WALL = [2.0, 2.1, 2.2, 2.1]


def test_a_scan_knows_its_beams_its_host_its_odometry_and_where_the_sensor_stands(tmp_path):
    log = read_laser(
        written(
            tmp_path, "# a comment", flaser(5.0, WALL, (1, 2, 0.5), (1 + np.cos(0.5) * 0.3, 2 + np.sin(0.5) * 0.3, 0.5))
        )
    )
    scan = log.scans[0]
    assert scan.host == "gfs"
    assert np.allclose(scan.odometry, [1, 2, 0.5])
    assert np.allclose(scan.T_robot_sensor, [0.3, 0, 0])
    assert np.allclose(np.degrees(scan.angles()), [-90, -45, 0, 45])
    assert scan.intensities is None
    assert log.odometry_from == "poses"


def test_what_gmapping_writes_of_a_log_is_read_and_its_odometry_is_that_of_the_readings(tmp_path):
    rows = ["PARAM particles 2", "ODOM 0 0 0 1.0", "ODO_UPDATE 2 0 0 0 0 0 0 0 0"]
    rows += [f"LASER_READING 4 2 2.1 2.2 2.1 {0.1 * k} 0 {0.01 * k} {1 + k}" for k in range(3)]
    log = read_laser(written(tmp_path, *rows, "SM_UPDATE 2 0 0 0 0 0 0 0 0", "NEFF 2", end=""))
    assert log.scan_t.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(np.stack([scan.odometry for scan in log.scans])[:, 0], [0.0, 0.1, 0.2])
    assert np.allclose(np.degrees(log.scans[0].angles()), [-90, -45, 0, 45])
    assert {kept.topic: kept.messages for kept in log.unused} == {
        "PARAM": 1,
        "ODOM": 1,
        "ODO_UPDATE": 1,
        "SM_UPDATE": 1,
        "NEFF": 1,
    }
    with pytest.raises(ReaderError, match="LASER_READING says 5 ranges, found 4"):
        read_laser(written(tmp_path, *rows, rows[-1].replace("READING 4", "READING 5"), rows[-1]))


def test_odometry_comes_before_the_scan_of_its_stamp_and_a_repeated_stamp_keeps_its_last_row(tmp_path):
    log = read_laser(written(tmp_path, odom(1, 0.0), odom(2, 0.5), odom(2, 0.7), flaser(2, WALL), odom(3, 1.0)))
    events = list(log.events())
    assert [type(e.record) for e in events] == [OdometryPoses, Scan, OdometryPoses]
    assert np.allclose(events[0].record.pose[:, 0], [0.0, 0.7])
    assert log.dropped == {"odometry row whose stamp comes again": 1}
    assert np.allclose(log.stamps(), [1, 2, 3])


def test_remissions_are_intensities_and_the_announced_beams_are_used(tmp_path):
    log = read_laser(written(tmp_path, robotlaser(1, [2, 3, 60, 4], [10, 20, 30, 40])))
    scan = log.scans[0]
    assert scan.hit.tolist() == [True, True, False, True]
    assert scan.intensities.tolist() == [10, 20, 0, 40]
    assert (scan.angle_min, scan.angle_increment) == (-1.0, 0.5)
    assert np.allclose(scan.T_robot_sensor, [0.2, 0, 0])


def test_the_rear_laser_is_a_sensor_of_its_own_and_no_double(tmp_path):
    rear = flaser(1, WALL, laser=(-0.2, 0, np.pi), word="RLASER")
    log = read_laser(written(tmp_path, flaser(1, WALL), rear))
    assert len(log.scans) == 2
    assert np.allclose(log.scans[1].T_robot_sensor, [-0.2, 0, np.pi], atol=1e-6)


def test_a_row_with_fewer_ranges_than_it_says_is_named_by_file_and_line(tmp_path):
    short = flaser(2, WALL).replace("FLASER 4", "FLASER 5")
    with pytest.raises(ReaderError, match=r"some\.log:2: FLASER says 5 ranges, found 4"):
        read_laser(written(tmp_path, flaser(1, WALL), short, flaser(3, WALL)))


def test_a_word_where_a_number_belongs_is_named(tmp_path):
    with pytest.raises(ReaderError, match=r"some\.log:2: expected a number, found 'x7'"):
        read_laser(written(tmp_path, flaser(1, WALL), odom(1, "x7"), odom(2, 0)))


def test_a_last_line_cut_short_is_dropped_and_counted(tmp_path):
    log = read_laser(written(tmp_path, flaser(1, WALL), flaser(2, WALL)[:-30], end=""))
    assert len(log.scans) == 1
    assert log.dropped == {"last line cut short": 1}


def test_a_gzip_file_cut_short_gives_what_was_readable_and_says_so(tmp_path):
    rng = np.random.default_rng(0)
    lines = [flaser(t, rng.uniform(1, 5, 180).round(2)) for t in range(50)]
    packed = gzip.compress("\n".join(lines).encode() + b"\n")
    path = tmp_path / "cut.clf.gz"
    path.write_bytes(packed[: len(packed) // 2])
    log = read_laser(path)
    assert 15 < len(log.scans) < 35
    assert any("gzip stream ends too soon" in w for w in log.warnings)


def test_scans_out_of_order_are_sorted_and_doubled_ones_dropped(tmp_path):
    log = read_laser(written(tmp_path, flaser(3, WALL), flaser(1, WALL), flaser(2, WALL), flaser(2, WALL)))
    assert log.scan_t.tolist() == [1, 2, 3]
    assert log.dropped["scan doubled"] == 1
    assert any("step back in time 1 times; sorted" in w for w in log.warnings)


def test_a_scan_without_any_return_stays_and_is_told(tmp_path):
    log = read_laser(written(tmp_path, flaser(1, WALL), flaser(2, [81.83] * 4)))
    assert len(log.scans) == 2
    assert not log.scans[1].hit.any()
    assert any("1 of 2 scans have no return at all" in w for w in log.warnings)


def test_nan_infinite_zero_and_negative_ranges_are_no_returns_and_stay_finite_numbers(tmp_path):
    log = read_laser(written(tmp_path, flaser(1, ["nan", "inf", 0.0, -1.0, 2.0, 2.0])))
    assert log.scans[0].hit.tolist() == [False] * 4 + [True] * 2
    assert np.isfinite(log.scans[0].ranges).all()
    assert any("1 ranges are not a number" in w for w in log.warnings)


def test_a_changing_beam_count_is_told_and_every_scan_keeps_its_own(tmp_path):
    log = read_laser(written(tmp_path, flaser(1, WALL), flaser(2, WALL), flaser(3, [*WALL, 2.0])))
    assert [len(s.ranges) for s in log.scans] == [4, 4, 5]
    assert any("beam count changes: 4 beams in 2 scans, 5 beams in 1 scans" in w for w in log.warnings)


@pytest.mark.parametrize("value", [0, 47])
def test_intensities_that_are_all_equal_are_left_out_and_told(tmp_path, value):
    log = read_laser(written(tmp_path, *(robotlaser(t, WALL, [value] * 4) for t in range(3))))
    assert not log.has_intensity
    assert any(f"all intensities are {value}" in w for w in log.warnings)


def test_one_scan_among_many_without_intensities_is_dropped_not_all_intensities(tmp_path):
    rows = [robotlaser(t, WALL, [1, 2, 3, 4]) for t in range(30)]
    log = read_laser(written(tmp_path, *rows, robotlaser(30, WALL, [])))
    assert log.has_intensity
    assert log.dropped == {"scan without intensities": 1}


def test_a_laser_pose_that_wanders_against_the_robot_is_not_taken_for_the_sensor_place(tmp_path):
    rows = [flaser(t, WALL, (t, 0, 0), (t + 0.3 * t, 0, 0)) for t in range(20)]
    log = read_laser(written(tmp_path, *rows))
    assert np.allclose(log.scans[5].T_robot_sensor, 0)
    assert any("moves against the robot pose" in w for w in log.warnings)


def test_a_sensor_pose_given_by_hand_replaces_the_log_one(tmp_path):
    from mapweave.io.laser_logs import LaserSource

    log = read_laser(written(tmp_path, flaser(1, WALL)), "1", LaserSource(sensor_pose=(0.1, 0.2, 0.3)))
    assert np.allclose(log.scans[0].T_robot_sensor, [0.1, 0.2, 0.3])


def test_a_log_without_scans_and_a_file_that_is_no_log_are_told(tmp_path):
    with pytest.raises(DataError, match="no laser scan"):
        read_laser(written(tmp_path, odom(1, 0)))
    other = tmp_path / "notes.txt"
    other.write_text("hello\nworld\n")
    assert not is_laser_log(other)
    with pytest.raises(ReaderError, match="expected a log of a known format, found text that begins 'hello' / 'world'"):
        read_laser(other)
    with pytest.raises(ReaderError, match="no such file"):
        read_laser(tmp_path / "absent.log")


def test_rows_of_other_kinds_ahead_of_the_first_scan_may_be_as_many_as_they_like(tmp_path):
    header = ["## made by", *(f"PARAM name_{k} {k} 1 host 1" for k in range(500)), "SYNC begin", "NEFF 30"]
    log = read_laser(written(tmp_path, *header, flaser(5.0, WALL), "NEFF 20"))
    assert len(log.scans) == 1
    assert {u.type: u.messages for u in log.unused} == {"PARAM": 500, "SYNC": 1, "NEFF": 2}


@pytest.mark.data
def test_a_log_behind_a_long_header_is_read_whole(data):
    log = read_laser(data / "carmen" / "freiburg-campus-corrected.log.gz")
    assert len(log.scans) == 2008
    assert {len(scan.ranges) for scan in log.scans} == {360}
    assert {u.type: u.messages for u in log.unused} == {"PARAM": 245, "NEFF": 2008}


def room(turn, n=181):
    """Ranges from the middle of an oblong room with one wall nearer, the robot turned by `turn`."""
    a = turn + np.linspace(-np.pi / 2, np.pi / 2, n)
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(a) > 0, 4.0, 2.0) / np.abs(np.cos(a))
        y = np.where(np.sin(a) > 0, 1.5, 3.0) / np.abs(np.sin(a))
    return np.minimum(x, y).round(3)


@pytest.mark.parametrize("sign", [1, -1])
def test_beams_that_turn_against_the_odometry_are_suspected_to_be_mirrored(tmp_path, sign):
    rows = [flaser(k, room(0.2 * k)[::sign], (0, 0, 0.2 * k)) for k in range(60)]
    told = [w for w in read_laser(written(tmp_path, *rows)).warnings if "wrong sign" in w]
    assert len(told) == (0 if sign == 1 else 1)


@pytest.mark.data
def test_the_intel_log_is_read_whole(data):
    log = read_laser(data / "carmen" / "intel.clf.gz")
    assert len(log.scans) == 5004
    assert len(log.odometry.t) == 8494 - 1097
    assert log.dropped == {"odometry row whose stamp comes again": 1097}
    assert log.warnings == ()
    hosts = [scan.host for scan in log.scans]
    assert [hosts.count(h) for h in ("flirt", "gfs", "mrpt")] == [2470, 462, 2072]
    assert np.allclose(log.scans[0].T_robot_sensor, 0)
    assert max(s.ranges[s.hit].max() for s in log.scans) < 81


@pytest.mark.data
def test_the_stampless_log_and_the_wheel_tick_log_are_read_whole(data):
    loop = read_laser(data / "carmen" / "loop5.log.gz")
    assert (len(loop.scans), len(loop.scans[0].ranges)) == (551, 181)
    assert any("no stamps" in w for w in loop.warnings)
    assert np.allclose(loop.scans[0].T_robot_sensor, [0.4, 0, 0])
    assert 0.9 < np.mean([s.hit.mean() for s in loop.scans]) < 0.96
    urg = read_laser(data / "urg04lx" / "exp1.dat.gz")
    assert (len(urg.scans), len(urg.scans[0].ranges)) == (756, 682)
    assert urg.odometry_from == "ticks"
    assert not any("wrong sign" in w for w in (*urg.warnings, *loop.warnings))
    assert np.allclose(np.degrees(urg.scans[0].angles()[[0, -1]]), [-120, 120])


def test_wheel_ticks_turn_left_when_the_right_wheel_goes_further():
    from mapweave.io.wheel_ticks import HALF_AXLE, RADIUS, TICKS_A_TURN, dead_reckoning

    poses = dead_reckoning(np.array([[0.0, 0.0], [100.0, 100.0], [50.0, 150.0]]))
    ahead = 100 / TICKS_A_TURN * 2 * np.pi * RADIUS
    assert np.allclose(poses[1], [ahead, 0, 0])
    assert np.allclose(poses[2], [ahead, 0, ahead / (2 * HALF_AXLE)])


def test_a_row_of_wheel_ticks_with_another_number_of_tokens_is_named(tmp_path):
    row = " ".join(["1000", "0", "5", "6", *["0"] * 20, *["1500"] * 120, "0"])
    path = tmp_path / "ticks.dat"
    path.write_text(f"{row}\n{row} 7\n{row}\n")
    with pytest.raises(ReaderError, match=r"ticks\.dat:2: expected 145 tokens, found 146"):
        read_laser(path)


def test_the_stampless_log_names_a_row_of_the_wrong_length(tmp_path):
    path = tmp_path / "loop.log"
    path.write_text("Odometry 0 0 0\nLaser 4 1 1 1\nOdometry 0 0 0\n")
    with pytest.raises(ReaderError, match=r"loop\.log:2: Laser says 4 ranges, found 3"):
        read_laser(path)
