"""ROS 1 and ROS 2 recordings: what is found in them, and what is said when something is not."""

import gzip

import numpy as np
import pytest

from mapweave.core.errors import DataError, ReaderError
from mapweave.io.laser_logs import LaserSource, is_laser_log, read_laser, robots_of

from .ros_logs import N, Recording, usual, wall

FORMATS = ("a.bag", "a.db3", "a.mcap")


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_gives_scans_with_intensities_odometry_and_the_sensor_pose_from_tf(tmp_path, name):
    path = usual(tmp_path / name).write()
    assert is_laser_log(path)
    log = read_laser(path)
    assert len(log.scans) == 30
    assert len(log.odometry.t) == 30
    assert (log.odometry_from, log.warnings, log.dropped) == ("poses", (), {})
    scan = log.scans[7]
    assert np.allclose(scan.ranges, wall(7), atol=1e-6)
    assert np.allclose(scan.intensities, np.arange(N) + 7)
    assert np.allclose(scan.angles()[[0, -1]], [-1.5, 1.5], atol=1e-6)
    assert np.allclose(scan.T_robot_sensor, [0.2, 0, 0])
    assert np.allclose(scan.odometry, [0.75, 0, 0])


@pytest.mark.parametrize("broken", [np.nan, np.inf, 1e200])
def test_a_transform_whose_numbers_are_none_is_left_out_and_counted(tmp_path, broken):
    out = Recording(tmp_path / "a.db3")
    for k in range(5):
        out.tf(5 + 0.1 * k, "odom", "base_link", x=0.2 * k)
        out.tf(5 + 0.1 * k, "base_link", "laser", x=broken if k == 2 else 0.1)
        out.scan(5 + 0.1 * k, wall(k))
    log = read_laser(out.write())
    assert log.dropped["transform that is not finite"] == 1
    assert np.allclose(log.scans[4].T_robot_sensor, [0.1, 0, 0])


@pytest.mark.parametrize("name", FORMATS)
def test_without_odometry_messages_the_odometry_comes_from_tf(tmp_path, name):
    out = Recording(tmp_path / name)
    for k in range(20):
        out.tf(5 + 0.1 * k, "map", "odom", x=0.001 * k)
        out.tf(5 + 0.1 * k, "odom", "base_footprint", x=0.2 * k, yaw=0.01 * k)
        out.tf(5 + 0.1 * k, "base_footprint", "base_link")
        out.tf(5 + 0.1 * k, "base_link", "laser", x=0.1, y=-0.05, yaw=0.5)
        out.scan(5 + 0.1 * k, wall(k), frame="/laser")
    log = read_laser(out.write())
    assert log.odometry_from == "tf"
    assert np.allclose(log.scans[4].odometry, [0.8, 0, 0.04])
    assert np.allclose(log.scans[4].T_robot_sensor, [0.1, -0.05, 0.5])
    assert not log.has_intensity


def test_the_odometry_of_tf_is_read_though_no_transform_places_the_scanner(tmp_path):
    out = Recording(tmp_path / "a.bag")
    for k in range(20):
        out.tf(5 + 0.1 * k, "odom", "base_link", x=0.2 * k)
        out.tf(5 + 0.1 * k, "base_link", "wheel", y=0.2, yaw=0.1 * k)
        out.scan(5 + 0.1 * k, wall(k))
    log = read_laser(out.write())
    assert log.odometry_from == "tf"
    assert np.allclose(log.scans[4].odometry, [0.8, 0, 0])
    assert any("no transform from base_link to laser" in w for w in log.warnings)


def test_of_two_odometries_of_tf_none_is_that_of_a_scanner_no_transform_places(tmp_path):
    out = Recording(tmp_path / "a.bag")
    for k in range(20):
        out.tf(5 + 0.1 * k, "r1/odom", "r1/base", x=0.2 * k)
        out.tf(5 + 0.1 * k, "r2/odom", "r2/base", x=0.1 * k)
        out.scan(5 + 0.1 * k, wall(k))
    assert read_laser(out.write()).odometry is None


def test_a_frame_that_travels_under_that_of_the_odometry_is_where_the_robot_is(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(20):
        out.tf(5 + 0.1 * k, "odom", "base_footprint", x=1.0, yaw=np.pi / 2)
        out.tf(5 + 0.1 * k, "base_footprint", "base_link", x=0.2 * k)
        out.tf(5 + 0.1 * k, "base_link", "laser", x=0.1, yaw=0.02 * k)
        out.scan(5 + 0.1 * k, wall(k))
    log = read_laser(out.write())
    assert np.allclose(log.scans[4].odometry, [1.0, 0.8, np.pi / 2])
    assert np.allclose(log.scans[4].T_robot_sensor, [0.1, 0, 0])


def test_a_recording_without_odometry_is_read_and_says_so(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(5):
        out.scan(1 + k, wall(k))
    log = read_laser(out.write())
    assert log.odometry is None
    assert log.scans[0].odometry is None
    assert log.odometry_from == "none"
    assert any("no odometry: poses come from scan matching alone" in w for w in log.warnings)
    assert any("no transform from" in w for w in log.warnings)
    assert [type(e.record).__name__ for e in log.events()] == ["Scan"] * 5


def test_a_topic_that_is_not_there_is_told_with_those_that_are(tmp_path):
    path = usual(tmp_path / "a.bag").write()
    with pytest.raises(ReaderError, match=r"no scan topic '/front'; there are /odom \(nav_msgs/msg/Odometry, 30 mess"):
        read_laser(path, "1", LaserSource(scan_topic="/front"))
    with pytest.raises(
        ReaderError, match=r"no odometry topic '/wheels'; there are .*/scan \(sensor_msgs/msg/LaserScan"
    ):
        read_laser(path, "1", LaserSource(odom_topic="/wheels"))
    out = Recording(tmp_path / "b.db3")
    out.text(1.0)
    with pytest.raises(ReaderError, match=r"no message of LaserScan or PointCloud2; there are /chatter"):
        read_laser(out.write())


def test_topics_are_chosen_by_name_and_else_the_fullest_is_taken_and_told(tmp_path):
    out = usual(tmp_path / "a.mcap")
    for k in range(4):
        out.scan(10 + k, np.full(N, 7.0), topic="/rear", frame="laser")
        out.odom(10 + k, 100.0 + k, topic="/fused")
        out.tf(10 + k, "odom", "base_link", x=50.0 + k)
    path = out.write()
    log = read_laser(path)
    assert len(log.scans) == 30
    assert any("scan is read from /scan; there is also /rear" in w for w in log.warnings)
    assert any("odometry is read from /odom; there is also /fused" in w for w in log.warnings)
    assert [(u.topic, u.messages, u.source) for u in log.unused] == [("/fused", 4, str(path)), ("/rear", 4, str(path))]
    assert [u.type for u in log.unused] == ["nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"]
    named = read_laser(path, "1", LaserSource(scan_topic="rear", odom_topic="/fused"))
    assert len(named.scans) == 4
    assert np.allclose(named.scans[2].odometry, [102, 0, 0])
    by_tf = read_laser(path, "1", LaserSource(odom_topic="/tf"))
    assert by_tf.odometry_from == "tf"
    assert np.allclose(by_tf.odometry.pose[:, 0], [50, 51, 52, 53])


@pytest.mark.parametrize("n", [30, 60])
def test_scans_in_the_frame_that_others_hang_on_were_computed_of_them_and_are_left_out(tmp_path, n):
    out = usual(tmp_path / "a.mcap")
    for k in range(n):
        out.scan(10.05 + 0.05 * k, np.full(N, 7.0), topic="/scan_multi", frame="base_link")
    path = out.write()
    log = read_laser(path)
    assert len(log.scans) == 30
    assert any("scan is read from /scan; there is also /scan_multi" in w for w in log.warnings)
    assert len(read_laser(path, "1", LaserSource(scan_topic="/scan_multi")).scans) == n


def test_a_sensor_mounted_upside_down_turns_its_beams_round(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    out.tf(0.9, "base_link", "laser", x=0.3, yaw=0.2, roll=np.pi, topic="/tf_static")
    for k in range(3):
        out.odom(1 + k, 0.0)
        out.scan(1 + k, wall(k))
    scan = read_laser(out.write()).scans[0]
    assert scan.angle_min == pytest.approx(1.5)
    assert scan.angle_increment < 0
    assert np.allclose(scan.T_robot_sensor, [0.3, 0, 0.2])


def test_a_sensor_pose_given_by_hand_wins_and_no_transform_is_missed(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    out.odom(1.0, 0.0)
    out.scan(1.0, wall(0))
    log = read_laser(out.write(), "1", LaserSource(sensor_pose=(0.1, 0.0, 3.0)))
    assert np.allclose(log.scans[0].T_robot_sensor, [0.1, 0, 3.0])
    assert log.warnings == ()


def test_nan_infinite_and_zero_ranges_and_those_outside_the_limits_are_no_returns(tmp_path):
    out = Recording(tmp_path / "a.db3")
    out.odom(1.0, 0.0)
    out.scan(1.0, [np.nan, np.inf, 0.0, 0.05, 10.0, 11.0, 3.0, 4.0])
    scan = read_laser(out.write()).scans[0]
    assert scan.hit.tolist() == [False] * 6 + [True] * 2
    assert np.isfinite(scan.ranges).all()


def test_header_stamps_out_of_order_are_sorted_and_doubled_messages_dropped(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k, at in enumerate((1.0, 3.0, 2.0, 2.0)):
        out.odom(1.0 + k, 0.1 * k)
        out.scan(1.0 + k, wall(k), at=at)
    log = read_laser(out.write())
    assert log.scan_t.tolist() == [1.0, 2.0, 3.0]
    assert log.dropped == {"scan doubled": 1}
    assert any("scans step back in time 1 times" in w for w in log.warnings)


def test_scans_outside_the_time_of_the_odometry_are_told(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(4):
        out.odom(10.0 + k, 1.0 * k)
    out.scan(9.8, wall(0))
    out.scan(20.0, wall(1))
    out.rows.sort(key=lambda row: row[0])
    log = read_laser(out.write())
    assert any("1 of 2 scans are outside the time of the odometry" in w for w in log.warnings)
    assert np.allclose(log.scans[1].odometry, [3, 0, 0])


@pytest.mark.parametrize("name", FORMATS)
def test_a_recording_cut_short_gives_what_was_readable_and_reports_the_loss(tmp_path, name):
    path = usual(tmp_path / name, n=300).write()
    whole = read_laser(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    log = read_laser(path)
    assert 0.3 * 300 < len(log.scans) < 0.8 * 300
    assert any("cut short or damaged" in w and "could be read" in w for w in log.warnings)
    for a, b in zip(log.scans, whole.scans, strict=False):
        assert np.array_equal(a.ranges, b.ranges)
        assert np.array_equal(a.intensities, b.intensities)
    assert np.allclose(log.scans[3].T_robot_sensor, [0.2, 0, 0])


@pytest.mark.parametrize("kept", [1.0, 0.6])
def test_a_recording_older_than_the_name_of_todays_header_is_read(tmp_path, kept):
    path = usual(tmp_path / "a.bag", n=300).write()
    old = path.read_bytes().replace(b"MSG: std_msgs/Header", b"MSG: roslib/Header  ")  # as long: the index fits
    old = old.replace(b"std_msgs/Header", b"Header         ")
    path.write_bytes(old[: int(kept * len(old))])
    log = read_laser(path)
    assert 0.3 * 300 < len(log.scans) <= (300 if kept == 1.0 else 240)
    assert any("cut short" in w for w in log.warnings) == (kept < 1.0)
    assert np.allclose(log.scans[3].T_robot_sensor, [0.2, 0, 0])


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_that_is_no_recording_is_told_whatever_its_name_says(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"nothing like it" * 40)
    assert not is_laser_log(path)
    with pytest.raises(ReaderError, match="found text that begins 'nothing like it"):
        read_laser(path)
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(ReaderError, match=r"found binary data that begins 00 01 02 .*; a ROS recording begins with"):
        read_laser(path)


@pytest.mark.parametrize("head", [b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0"])
def test_what_begins_as_a_recording_and_is_none_is_told(tmp_path, head):
    path = tmp_path / "a.log"
    path.write_bytes(head + b"nothing like it" * 40)
    with pytest.raises(ReaderError, match=r"a\.log: not a readable ROS recording") as told:
        read_laser(path)
    assert "recording." not in str(told.value)


@pytest.mark.parametrize("given", FORMATS)
@pytest.mark.parametrize("name", ["a.log", "a", "b.bag", "b.mcap"])
def test_a_recording_opens_as_what_it_is_whatever_it_is_called(tmp_path, given, name):
    whole = usual(tmp_path / given).write()
    path = tmp_path / "other" / name
    path.parent.mkdir()
    path.write_bytes(whole.read_bytes())
    assert is_laser_log(path)
    assert robots_of(path, LaserSource()) == robots_of(whole, LaserSource())
    a, b = read_laser(path), read_laser(whole)
    assert len(a.scans) == 30
    assert a.scan_hash() == b.scan_hash()
    assert [p.name for p in path.parent.iterdir()] == [name]


@pytest.mark.parametrize("given", FORMATS)
def test_a_recording_cut_short_is_salvaged_whatever_it_is_called(tmp_path, given):
    whole = usual(tmp_path / given, 300).write().read_bytes()
    path = tmp_path / "cut.log"
    path.write_bytes(whole[: int(0.6 * len(whole))])
    log = read_laser(path)
    assert 0.3 * 300 < len(log.scans) < 0.8 * 300
    assert any("cut.log: cut short or damaged" in w for w in log.warnings)


def test_a_compressed_recording_is_told_to_be_unpacked(tmp_path):
    path = tmp_path / "a.db3.gz"
    path.write_bytes(gzip.compress(usual(tmp_path / "a.db3").write().read_bytes()))
    with pytest.raises(ReaderError, match="a ROS recording, compressed as a whole: unpack it first"):
        read_laser(path)


def test_a_recording_folder_is_read_like_its_file(tmp_path):
    out = usual(tmp_path / "a.mcap")
    path = out.write()
    (tmp_path / "a" / path.name).write_bytes(path.read_bytes())
    assert (tmp_path / "a" / "metadata.yaml").is_file()
    assert is_laser_log(tmp_path / "a")
    path.unlink()
    inside = tmp_path / "a" / "a.mcap"
    listed = (tmp_path / "a" / "metadata.yaml").read_text().split("relative_file_paths:")[1].split("\n")
    inside.rename(tmp_path / "a" / next(line for line in listed if ".mcap" in line).strip(" -"))
    assert len(read_laser(tmp_path / "a").scans) == 30


def test_a_recording_whose_only_scan_has_no_return_is_read_and_says_so(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    out.odom(1.0, 0.0)
    out.scan(1.0, np.zeros(5))
    log = read_laser(out.write())
    assert "scans-blind" in {f.code for f in log.findings}


@pytest.mark.parametrize(("beams", "told"), [(2, True), (9, True), (10, False)])
def test_scans_that_all_have_too_few_returns_to_be_matched_are_told(tmp_path, beams, told):
    out = Recording(tmp_path / "a.mcap")
    for k in range(20):
        out.scan(1.0 + k, np.full(beams, 2.0) if k else np.zeros(beams))
    found = {f.code: f.text for f in read_laser(out.write()).findings}
    assert ("scans-sparse" in found) == told
    assert found.get("scans-sparse", "no scan of 20 has 10 returns") == "no scan of 20 has 10 returns"


def test_where_no_scan_can_be_used_the_reason_is_told(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    out.scan(1.0, np.full(400, 2.0), angles=(-90.0, 90.0))  # degrees
    with pytest.raises(DataError, match="no laser scan in it can be used; left out, 1 times: scan with a stamp, pose"):
        read_laser(out.write())


def lit(tmp_path, light_of, scans=40):
    """A log whose scan k has the intensities that `light_of` gives for k."""
    out = Recording(tmp_path / "lit.bag")
    for k in range(scans):
        out.scan(10.0 + 0.1 * k, wall(k), light_of(k))
    return read_laser(out.write())


@pytest.mark.parametrize("length", [1, N - 1, N + 1, 2 * N])
def test_intensities_of_another_number_than_ranges_are_left_out_and_told(tmp_path, length):
    log = lit(tmp_path, lambda _: np.linspace(10.0, 900.0, length))
    assert not log.has_intensity
    assert len(log.scans) == 40
    told = [f.text for f in log.findings if f.code == "light-unused"]
    assert len(told) == 1
    assert "40 of 40 scans hold another number of them than of ranges" in told[0]


def test_a_scan_with_another_number_of_intensities_among_many_is_dropped(tmp_path):
    log = lit(tmp_path, lambda k: np.linspace(10.0, 900.0, N - (k == 7)))
    assert log.has_intensity
    assert log.dropped == {"scan without intensities": 1}
    assert all(len(scan.intensities) == len(scan.ranges) for scan in log.scans)


@pytest.mark.parametrize("without", [3, 20])
def test_a_log_whose_first_scans_have_no_intensity_is_read_whole_without_and_says_so(tmp_path, without):
    log = lit(tmp_path, lambda k: None if k < without else np.linspace(10.0, 900.0, N))
    assert not log.has_intensity
    assert len(log.scans) == 40
    assert any(f"{without} of 40 scans have none" in f.text for f in log.findings if f.code == "light-unused")
