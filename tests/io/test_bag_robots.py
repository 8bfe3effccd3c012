"""Several robots in one recording: whose scans go with whose odometry, and which scanners are one robot's."""

import numpy as np
import pytest

import mapweave
from mapweave.core.errors import ReaderError
from mapweave.io.bag import Bag, open_bag
from mapweave.io.bag_robots import ODOMETRY, SCAN, bag_robots
from mapweave.io.laser_logs import LaserSource, read_laser, recordings_in, robots_of

from .ros_logs import N, Recording, driving, wall

SPEED = {"robot1": 1.0, "robot2": -2.0, "robot10": 3.0}
EVERY = LaserSource()


def speed(log):
    return float((log.scans[-2].odometry[0] - log.scans[0].odometry[0]) / (log.scan_t[-2] - log.scan_t[0]))


def read(path, name, **given):
    return read_laser(path, "1", LaserSource(name=name, **given))


@pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])
@pytest.mark.parametrize("tf", ["shared", "of each", "none"])
def test_scans_go_with_the_odometry_of_their_namespace_though_all_frames_are_called_alike(tmp_path, name, tf):
    out = Recording(tmp_path / name)
    if tf == "shared":
        out.tf(9.9, "base_link", "laser", x=0.2, topic="/tf_static")
    for robot, v in SPEED.items():
        if tf == "of each":
            out.tf(9.9, "base_link", "laser", x=0.1 * abs(v), topic=f"/{robot}/tf_static")
        for k in range(20 if robot == "robot1" else 30):  # the fullest scans are not of the fullest odometry
            driving(out, robot, k, speed=v)
    out.rows.sort(key=lambda row: row[0])
    path = out.write()
    assert robots_of(path, EVERY) == ("robot1", "robot2", "robot10")
    hashes = set()
    for robot, v in SPEED.items():
        log = read(path, robot)
        assert speed(log) == pytest.approx(v)
        assert len(log.scans) == (20 if robot == "robot1" else 30)
        if tf != "none":
            assert log.warnings == ()
            assert np.allclose(log.scans[0].T_robot_sensor, [0.2 if tf == "shared" else 0.1 * abs(v), 0, 0])
        hashes.add(log.log_hash)
    assert len(hashes) == 3


def test_one_topic_given_by_hand_brings_the_other_of_its_robot(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for robot, v in SPEED.items():
        for k in range(10):
            driving(out, robot, k, speed=v)
    path = out.write()
    assert speed(read_laser(path, "1", LaserSource(scan_topic="/robot2/scan"))) == pytest.approx(-2)
    assert speed(read_laser(path, "1", LaserSource(odom_topic="/robot10/odom"))) == pytest.approx(3)
    both = LaserSource(scan_topic="/robot2/scan", odom_topic="/robot1/odom")
    assert speed(read_laser(path, "1", both)) == pytest.approx(1)
    assert robots_of(path, both) == (None,)


def test_asked_for_one_robot_a_recording_of_several_says_which_there_are(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for robot in ("robot1", "robot2"):
        driving(out, robot, 0)
    with pytest.raises(
        ReaderError, match=r"expected one robot, found robot1 \(/robot1/scan\), robot2 \(/robot2/scan\)"
    ):
        read_laser(out.write())


def test_frames_tell_robots_apart_where_topics_share_a_namespace(tmp_path):
    out = Recording(tmp_path / "a.db3")
    for j, v in ((1, 1.0), (2, -2.0)):
        for k in range(10):
            driving(out, "", k, speed=v, base=f"r{j}/base", laser=f"r{j}/laser", odom=f"wheels{3 - j}", scan=f"scan{j}")
    path = out.write()
    assert robots_of(path, EVERY) == ("r1", "r2")
    assert [speed(read(path, name)) for name in ("r1", "r2")] == pytest.approx([1, -2])


def test_tf_alone_tells_robots_apart_and_gives_each_its_odometry(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for j, v in ((1, 1.0), (2, -2.0)):
        for k in range(10):
            t = 10 + 0.1 * k
            out.tf(t, "map", f"tb{j}/odom")
            out.tf(t, f"tb{j}/odom", f"tb{j}/base", x=v * 0.1 * k)
            out.tf(t, f"tb{j}/base", f"tb{j}/laser", x=0.1 * j)
            out.scan(t, wall(k), topic=f"/tb{j}/scan", frame=f"tb{j}/laser")
    path = out.write()
    assert robots_of(path, EVERY) == ("tb1", "tb2")
    for j, v in ((1, 1.0), (2, -2.0)):
        log = read(path, f"tb{j}")
        assert log.odometry_from == "tf"
        assert speed(log) == pytest.approx(v)
        assert np.allclose(log.scans[0].T_robot_sensor, [0.1 * j, 0, 0])


def test_a_robot_without_odometry_never_borrows_that_of_another(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(10):
        driving(out, "robot1", k)
        out.scan(10.05 + 0.1 * k, wall(k), topic="/robot2/scan", frame="laser")
    path = out.write()
    assert robots_of(path, EVERY) == ("robot1", "robot2")
    assert read(path, "robot2").odometry is None
    assert speed(read(path, "robot1")) == pytest.approx(1)


def test_scanners_of_one_robot_are_used_together_where_tf_places_them(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    out.tf(9.9, "base_link", "front_laser", x=0.3, topic="/tf_static")
    out.tf(9.9, "base_link", "rear_laser", x=-0.3, yaw=np.pi, topic="/tf_static")
    for k in range(10):
        driving(out, "", k, laser="front_laser", scan="front/scan")
        out.scan(10.05 + 0.1 * k, wall(k), topic="/rear/scan", frame="rear_laser")
        out.scan(10.07 + 0.1 * k, np.full(N, 7.0), topic="/attic/scan", frame="attic_laser")
    path = out.write()
    assert robots_of(path, EVERY) == (None,)
    log = read_laser(path)
    assert len(log.scans) == 20
    assert {tuple(np.round(scan.T_robot_sensor, 3)) for scan in log.scans} == {(0.3, 0, 0), (-0.3, 0, 3.142)}
    assert any("scan is read from /front/scan and /rear/scan; there is also /attic/scan" in w for w in log.warnings)
    one = read_laser(path, "1", LaserSource(scan_topic="/rear/scan"))
    assert len(one.scans) == 10
    by_hand = read_laser(path, "1", LaserSource(sensor_pose=(0.1, 0, 0)))
    assert len(by_hand.scans) == 10


def test_scanners_that_tf_does_not_place_are_not_mixed(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(10):
        driving(out, "", k, laser="front_laser", scan="front/scan")
        out.scan(10.05 + 0.1 * k, wall(k), topic="/rear/scan", frame="rear_laser")
    log = read_laser(out.write())
    assert len(log.scans) == 10
    assert any("scan is read from /front/scan; there is also /rear/scan" in w for w in log.warnings)
    assert any("no transform from base_link to front_laser" in w for w in log.warnings)


def test_a_second_scanner_in_a_namespace_of_its_own_stays_with_the_robot_that_carries_it(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    out.tf(9.9, "base_link", "laser", x=0.3, topic="/tf_static")
    out.tf(9.9, "base_link", "camera", x=0.1, topic="/tf_static")
    for k in range(10):
        driving(out, "", k)
        driving(out, "camera", k, laser="camera", base="camera")
    log = read_laser(out.write())
    assert len(log.scans) == 20
    assert np.allclose(log.scans[-1].odometry[0], 0.95, atol=0.06)


def test_odometry_that_may_be_of_either_robot_is_refused_with_the_way_out(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(10):
        for j in (1, 2):
            out.scan(10 + 0.1 * k, wall(k), topic=f"/robot{j}/scan", frame="laser")
        out.odom(10 + 0.1 * k, 0.1 * k, topic="/wheels")
        out.odom(10 + 0.1 * k, 0.2 * k, topic="/fused")
    path = out.write()
    assert robots_of(path, EVERY) == ("robot1", "robot2")
    with pytest.raises(ReaderError, match="may be the odometry of /robot1/scan or of /robot2/scan; choose with --scan"):
        read(path, "robot1")
    both = LaserSource(scan_topic="/robot2/scan", odom_topic="/fused")
    assert speed(read_laser(path, "1", both)) == pytest.approx(2)


def test_messages_that_a_damaged_index_gives_unasked_are_not_taken_for_odometry(tmp_path, monkeypatch):
    out = Recording(tmp_path / "a.bag")
    for k in range(3):
        for name in ("", "/robot2"):
            out.scan(10 + k, wall(k), topic=f"{name}/scan")
            out.odom(10 + k, float(k), topic=f"{name}/odom")
    bag = open_bag(out.write(), (SCAN, ODOMETRY))
    bag.counts["/robot2/scan"] = 0  # as the index says, whose chunk holds them all the same
    whole = Bag._raw
    monkeypatch.setattr(Bag, "_raw", lambda self, _: whole(self, set(self.kinds)))
    (robot,) = bag_robots(bag)
    assert robot.scans == ("/scan",)
    assert {topic for topic, _, _ in bag.messages({"/scan"})} == {"/scan"}


def test_a_folder_of_recordings_is_a_robot_each_unless_they_are_parts_of_one(tmp_path):
    def folder(name, *files):
        path = tmp_path / name
        path.mkdir()
        for file in files:
            (path / file).write_bytes(b"")
        return path

    team = folder("team", "robot10.mcap", "robot2.mcap", "robot2.truth.tum", "notes.txt")
    assert recordings_in(team) == [team / "robot2.mcap", team / "robot10.mcap"]
    numbered = folder("numbered", "robot_1.mcap", "robot_2.mcap")
    assert recordings_in(numbered) == [numbered / "robot_1.mcap", numbered / "robot_2.mcap"]
    for whole in (
        folder("one", "robot1.mcap"),
        folder("split", "run_0.db3", "run_1.db3"),
        folder("bag", "run_3.db3", "other.db3", "metadata.yaml"),
        folder("none", "notes.txt"),
        tmp_path / "one" / "robot1.mcap",
        tmp_path / "nowhere",
    ):
        assert recordings_in(whole) == [whole]


def test_a_log_of_another_kind_beside_recordings_is_told_not_left_out_in_silence(tmp_path):
    for name in ("robot1.mcap", "robot2.mcap", "notes.txt"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "robot3.clf").write_text("FLASER 3 1.0 1.1 1.2 0 0 0 0 0 0 0.1 host 0.1\n" * 3)
    with pytest.raises(ReaderError, match=r"robot3\.clf; name each"):
        recordings_in(tmp_path)


def test_a_folder_of_recordings_is_read_as_it_is_mapped(tmp_path):
    for robot, v in SPEED.items():
        out = Recording(tmp_path / f"{robot}.mcap")
        for k in range(20):
            driving(out, "", k, speed=v)
        out.write()
    assert mapweave.read(tmp_path).robots == ("1", "2", "3")


@pytest.mark.parametrize("first", [np.nan, np.inf, -1.0, 1e9, 0.0])
def test_the_time_of_a_scan_is_what_most_of_its_messages_state(tmp_path, first):
    out = Recording(tmp_path / "log.mcap")
    for k in range(10):
        out.scan(10.0 + 0.1 * k, wall(k), dt=1e-3 if k > 3 else first)
    assert read_laser(out.write()).sweep == pytest.approx(1e-3 * (N - 1), rel=1e-6)


def test_the_time_of_a_scan_that_few_messages_state_is_none(tmp_path):
    out = Recording(tmp_path / "log.mcap")
    for k in range(10):
        out.scan(10.0 + 0.1 * k, wall(k), dt=1e-3 if k < 3 else 1e9)
    assert read_laser(out.write()).sweep == 0.0
