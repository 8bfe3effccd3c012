"""Which robots a ROS graph holds, and what their messages make: mounts, odometry, and what is refused and counted."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.io.fixes import NAVSAT
from mapweave.io.inertial import IMU
from mapweave.laser.laser_map import GridMap
from mapweave.live.door import decode
from mapweave.live.fix_stream import UNTOLD
from mapweave.live.laser_feed import ToldUntil
from mapweave.live.laser_stream import LaserRecord, beams_of, messages_of_laser, scan_of, whole_log
from mapweave.live.messages import RefusedError, Scans, encode
from mapweave.live.ros2 import assembly, wire
from mapweave.live.ros2.assembly import GAP, LEAP, PATIENCE, Assembly, Gyroscope
from mapweave.live.ros2.feed import Graph, chosen, chosen_fixes
from mapweave.live.ros2.shown import grid_of, pose_of
from mapweave.live.ros2.wire import NO_HASH, Entity, Topic
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

from ..io.made_spins import scans_of, truth_of
from . import ros_peer


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    """Our clock: ten seconds later whenever it is read."""
    monkeypatch.setattr(assembly, "monotonic", itertools.count(0.0, 10.0).__next__)


RANGES = [1.0, 2.0, math.inf, math.nan, 0.01, 3.0]


def graph(*published, type_hash=None):
    made = Graph()
    for k, (name, kind) in enumerate(published):
        topic = Topic(name, kind, type_hash or wire.type_hash(kind))
        made.put(Entity(0, "ab", 0, k, "MP", "/", "n", topic).token())
    return made


def test_topics_of_one_namespace_are_one_robot():
    robots = graph(
        ("/tb1/scan", wire.SCAN),
        ("/tb1/odom", wire.ODOMETRY),
        ("/tb2/lidar/scan", wire.SCAN),
        ("/tb2/odometry/filtered", wire.ODOMETRY),
        ("/tb2/odom", wire.ODOMETRY),
        ("/tb2/tf", wire.TF),
        ("/tf", wire.TF),
        ("/tf_static", wire.TF),
    ).robots()
    assert [(r.name, r.scan.name, r.odometry.name) for r in robots] == [
        ("tb1", "/tb1/scan", "/tb1/odom"),
        ("tb2", "/tb2/lidar/scan", "/tb2/odom"),
    ]
    assert [t.name for t in robots[1].tf] == ["/tb2/tf", "/tf", "/tf_static"]
    assert robots[1].beside == ("/tb2/odometry/filtered",)
    (robot,) = graph(("/tb1/rear/scan", wire.SCAN), ("/tb1/scan", wire.SCAN), ("/tb1/odom", wire.ODOMETRY)).robots()
    assert robot.scan.name == "/tb1/scan"
    assert [t.name for t in robot.scanners] == ["/tb1/rear/scan"]
    assert robot.beside == ()


def test_a_robot_without_a_namespace_does_not_take_the_odometry_of_another():
    one, two = graph(("/scan", wire.SCAN), ("/tb1/scan", wire.SCAN), ("/tb1/odom", wire.ODOMETRY)).robots()
    assert (one.name, one.odometry) == ("", None)
    assert two.odometry.name == "/tb1/odom"


def test_the_only_robot_takes_the_only_odometry_wherever_it_is():
    (robot,) = graph(("/front/scan", wire.SCAN), ("/odom", wire.ODOMETRY)).robots()
    assert robot.odometry.name == "/odom"


def test_another_type_hash_is_refused_and_told():
    made = graph(("/scan", wire.SCAN), type_hash="RIHS01_" + 64 * "0")
    assert made.robots() == []
    assert "/scan is sensor_msgs/msg/LaserScan of another definition" in next(iter(made.refused.values()))


def test_a_graph_without_hashes_is_read():
    (robot,) = graph(("/scan", wire.SCAN), type_hash=NO_HASH).robots()
    assert robot.scan.key(0).endswith("LaserScan_/TypeHashNotSupported")


def test_what_comes_by_rmw_zenoh_too_is_not_heard_through_the_bridge():
    kind = wire.type_hash(wire.SCAN)
    both = [
        Topic(name, wire.SCAN, kind, bridged=bridged) for name in ("/a/scan", "/b/scan") for bridged in (True, False)
    ]
    made = Graph()
    for k, topic in enumerate(both[:3]):
        made.put(Entity(0, "ab", 0, k, "MP", "/", "n", topic).token())
    assert [(r.name, r.scan.bridged) for r in made.robots()] == [("a", False), ("b", True)]


def test_tokens_that_go_take_their_robot_with_them():
    made = graph(("/scan", wire.SCAN))
    made.drop(next(iter(made.entities)))
    made.put("@ros2_lv/nonsense")
    assert made.robots() == []
    assert list(made.refused) == ["@ros2_lv/nonsense"]


def test_a_pattern_a_name_or_being_alone_says_which_robot():
    robots = graph(("/tb1/scan", wire.SCAN), ("/tb2/scan", wire.SCAN)).robots()
    assert chosen(robots, "r1", "tb2").name == "tb2"
    assert chosen(robots, "r1", "*1").name == "tb1"
    assert chosen(robots, "tb2", None).name == "tb2"
    assert chosen(robots[:1], "r1", None).name == "tb1"
    assert chosen(robots, "r1", "x*") is None
    for pattern in (None, "tb?"):
        with pytest.raises(RefusedError, match="--pattern: which robot is r1\\? There are tb1, tb2"):
            chosen(robots, "r1", pattern)


def fed(made, *messages):
    for kind, payload in messages:
        message = wire.decode(payload, kind)
        takes = {wire.SCAN: made.scan, wire.ODOMETRY: made.odometry, wire.TF: made.transforms, NAVSAT: made.fix}
        takes[kind](message)
    return made


def fix(t, place=(35.7, 139.75, 40.0), sd=1.0, status=0):
    return NAVSAT, ros_peer.fix(t, "gps", place, sd, status)


def scan(t, frame="laser", ranges=RANGES, angle_min=-0.5, step=0.2, range_max=10.0, light=()):
    return wire.SCAN, ros_peer.scan(t, frame, ranges, angle_min, step, range_max, light)


def odometry(t, pose=(0.0, 0.0, 0.0)):
    return wire.ODOMETRY, ros_peer.odometry(t, "odom", "base", pose)


def mounted(pose=(0.2, 0.0, 0.3)):
    return wire.TF, ros_peer.transforms((1.0, "base", "laser", pose))


def test_a_scan_gets_the_odometry_of_its_own_stamp_and_its_place_on_the_robot():
    upper = wire.TF, ros_peer.transforms((1.0, "base", "tower", (0.1, 0.0, math.pi / 2)))
    lower = wire.TF, ros_peer.transforms((1.0, "tower", "laser", (0.3, 0.0, 0.1)))
    made = fed(Assembly(), odometry(10.0), scan(10.25), upper, odometry(10.5, (1.0, 0.0, 0.2)))
    assert made.ready()[0] == []
    ((t, placed),), rows = fed(made, lower).ready()
    assert t == 10.25
    np.testing.assert_allclose(placed.odometry, [0.5, 0.0, 0.1], atol=1e-9)
    np.testing.assert_allclose(placed.T_robot_sensor, [0.1, 0.3, math.pi / 2 + 0.1], atol=1e-9)
    assert placed.hit.tolist() == [True, True, False, False, False, True]
    assert placed.ranges.tolist() == [1.0, 2.0, 10.0, 10.0, 10.0, 3.0]
    assert rows == []  # those of the message before
    assert not made.refused


def test_a_revolution_that_a_driver_sends_twice_is_told_once_it_is_its_habit():
    rng = np.random.default_rng(0)
    made, told = fed(Assembly(), mounted()), []
    for k in range(60):
        seen = np.linspace(1.0, 3.0, 20) + (0.1 * rng.random(20) if k % 2 == 0 else 0.0)
        ranges = seen if k % 2 == 0 else ranges
        t = 10.0 + 0.1 * k
        fed(made, odometry(t, (0.02 * k, 0.0, 0.0)), scan(t, ranges=ranges.astype(np.float32).tolist()))
        told += [round((stamp - 10.0) / 0.1) for stamp, _ in made.ready()[0]]
    assert told[-15:] == list(range(30, 60, 2))
    assert set(made.refused) == {"repeated"}
    assert made.refused["repeated"] >= 15


def test_a_scanner_that_hangs_while_the_robot_drives_on_is_believed_no_longer():
    rng = np.random.default_rng(0)
    made, told = fed(Assembly(), mounted()), []
    for k in range(80):
        if not 40 <= k < 60:
            ranges = np.linspace(1.0, 3.0, 20) + 0.1 * rng.random(20)
        t = 10.0 + 0.1 * k
        fed(made, odometry(t, (0.1 * k, 0.0, 0.0)), scan(t, ranges=ranges.astype(np.float32).tolist()))
        told += [round((stamp - 10.0) / 0.1) for stamp, _ in made.ready()[0]]
    assert not set(range(43, 60)) & set(told)
    assert set(range(60, 79)) <= set(told)


def test_the_time_that_a_scan_takes_reaches_the_log():
    message = wire.decode(ros_peer.scan(10.0, "laser", RANGES, -0.5, 0.2, 10.0, (), 0.01), wire.SCAN)
    made = Assembly()
    made.scan(message)
    assert made.sweep == pytest.approx(0.01 * (len(RANGES) - 1))
    log = replace(simulate_office(OfficeConfig(rooms=2, visited=1), 0).log, sweep=0.2)
    header, *rest = (message for _, message in messages_of_laser(log, "robot1", "run", 1.0))
    record = LaserRecord(header)
    assert whole_log(header, [part for one in rest if (part := record.add(one)) is not None]).sweep == 0.2


def heard(made, stated, begin=10.0, scanner=""):
    """How many of as many scans are taken, of which each is said to take so long [s]."""
    before = sum(made.refused.values())
    for k, sweep in enumerate(stated):
        every = sweep / (len(RANGES) - 1)
        message = ros_peer.scan(begin + k, "laser", RANGES, -0.5, 0.2, 10.0, (), every)
        made.scan(wire.decode(message, wire.SCAN), scanner)
    return len(stated) - (sum(made.refused.values()) - before)


def test_scans_of_another_scanner_are_refused_and_told_and_not_read_with_the_time_of_the_first():
    made = Assembly()
    assert heard(made, [0.1, 0.11, 0.09]) == 3
    assert heard(made, [0.2, 0.0, 0.1], begin=20.0) == 1
    assert made.refused == {"scanner": 2}
    assert made.first_refusals["scanner"].startswith("scanner: a scan of 0.2 s after such of 0.1 s: another scanner")
    assert heard(made, [0.2, 0.2], begin=30.0, scanner="rear") == 2  # which is a scanner of its own


@pytest.mark.parametrize("told", [0.1, 0.0])
def test_a_robot_begun_again_with_another_scanner_does_not_go_on_with_its_history(told):
    made, same = Assembly(), Assembly()
    for one in made, same:
        one.resume(ToldUntil(10.0, 10.0, light=False), sweep=told)
    assert heard(made, [0.2, 0.2], begin=11.0) == 0
    assert heard(same, [told, told], begin=11.0) == 2


def test_scans_of_two_scanners_come_in_the_order_of_their_stamps():
    made = fed(Assembly(), mounted(), (wire.TF, ros_peer.transforms((1.0, "base", "back", (-0.2, 0.0, math.pi)))))
    for t in (9.0, 10.0, 11.0, 12.0):
        fed(made, odometry(t))

    def hears(t, scanner):
        made.scan(wire.decode(scan(t, scanner)[1], wire.SCAN), scanner)

    def told():
        return [(t, round(float(s.T_robot_sensor[0]), 3)) for t, s in made.ready()[0]]

    hears(9.1, "laser")
    hears(9.3, "laser")
    hears(9.2, "back")
    assert told() == [(9.1, 0.2), (9.2, -0.2)]  # before 9.3 the other may have told of 9.25
    hears(9.4, "back")
    hears(9.5, "back")
    assert told() == [(9.3, 0.2)]
    hears(9.45, "laser")
    hears(9.45 + PATIENCE + 0.1, "back")  # what is silent for so long is not waited for
    assert told() == [(9.4, -0.2), (9.45, 0.2), (9.5, -0.2)]
    hears(9.48, "laser")
    assert made.refused == {"late": 1}


def test_a_scanner_upside_down_sees_its_beams_the_other_way():
    hung = ros_peer.Writer().put("I", 1).head(1.0, "base").text("laser").put("d", 0, 0, 0, 1.0, 0.0, 0.0, 0.0)
    ((_, placed),), _ = fed(Assembly(), (wire.TF, hung.bytes()), odometry(9.0), odometry(10.0), scan(10.0)).ready()
    assert (placed.angle_min, placed.angle_increment) == (0.5, pytest.approx(-0.2))


def test_odometry_that_comes_as_a_transform_counts_from_its_first_row():
    made = fed(Assembly(), mounted())
    for t, x in ((5.0, 0.0), (5.5, 1.0)):
        fed(made, (wire.TF, ros_peer.transforms((t, "odom", "base", (x, 0.0, 0.0)))))
    fed(made, scan(5.25))
    assert made.odometry_edge == ("odom", "base")
    made.take_tf()
    ((_, placed),), rows = made.ready()
    assert placed.odometry.tolist() == [0.5, 0.0, 0.0]
    assert [row[:2] for row in rows] == [(5.0, 0.0), (5.5, 1.0)]


def test_without_odometry_the_root_of_the_scanners_frames_is_the_robot():
    ((_, placed),), _ = fed(Assembly("none"), mounted((0.2, 0.1, 0.0)), scan(5.0)).ready()
    assert placed.odometry is None
    assert placed.T_robot_sensor.tolist() == [0.2, 0.1, 0.0]


def test_a_scan_in_an_unknown_frame_is_refused_after_a_while():
    made = fed(Assembly(), mounted(), odometry(10.0), odometry(10.5), scan(10.5, "camera"))
    assert made.ready()[0] == []
    assert not made.refused
    fed(made, odometry(11.0 + PATIENCE), scan(11.0 + PATIENCE))
    assert [t for t, _ in made.ready()[0]] == [11.0 + PATIENCE]
    assert made.refused == {"frame": 1}
    assert made.first_refusals["frame"] == "frame: a scan in 'camera', which no transform places on 'base'"


def test_a_place_given_by_hand_serves_where_no_transform_tells_it():
    made = fed(Assembly(sensor_pose=(0.1, 0.0, 0.0)), odometry(10.0), scan(10.0))
    ((_, placed),), _ = made.ready()
    assert placed.T_robot_sensor.tolist() == [0.1, 0.0, 0.0]


def test_scans_while_odometry_is_away_are_refused_and_the_drive_goes_on_after():
    made = fed(Assembly(), mounted(), odometry(10.0), scan(10.0), scan(10.4), scan(11.0))
    assert [t for t, _ in made.ready()[0]] == [10.0]
    fed(made, odometry(10.2 + GAP, (1.0, 0.0, 0.0)), scan(10.2 + GAP), odometry(10.5 + GAP), scan(10.5 + GAP))
    assert [t for t, _ in made.ready()[0]] == [10.2 + GAP, 10.5 + GAP]
    assert made.refused == {"odometry": 2}


def test_scans_for_which_no_odometry_comes_at_all_do_not_wait_for_ever():
    made = fed(Assembly(), mounted(), odometry(10.0), scan(10.1), scan(11.0), scan(12.5))
    assert made.ready()[0] == []
    assert made.refused == {"odometry": 1}
    made.ready(all_of_them=True)
    assert made.refused == {"odometry": 3}


def test_a_drive_that_is_played_fast_waits_for_its_odometry_by_our_clock_too(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(assembly, "monotonic", lambda: now[0])
    made = fed(Assembly(), mounted(), odometry(10.0), scan(10.1), scan(12.5))
    now[0] = PATIENCE
    assert made.ready()[0] == []
    assert not made.refused
    fed(made, odometry(10.5, (1.0, 0.0, 0.0)))
    ((t, placed),), _ = made.ready()
    assert t == 10.1
    assert placed.odometry.tolist() == pytest.approx([0.2, 0.0, 0.0])
    made.ready()
    fed(made, scan(15.0))
    now[0] = 2 * PATIENCE + 0.1
    assert made.ready()[0] == []
    assert made.refused == {"odometry": 1}


def test_a_clock_that_is_set_back_is_refused_until_it_has_passed():
    made = fed(Assembly(), mounted(), odometry(10.0), scan(10.0), scan(7.0), odometry(7.0), scan(10.0))
    assert made.refused == {"clock": 3}
    assert made.first_refusals["clock"] == "clock: a scan 3 s before the last one: refused until past it"
    fed(made, odometry(10.1), scan(10.1))
    assert [t for t, _ in made.ready()[0]] == [10.0, 10.1]


def test_one_stamp_far_ahead_is_refused_and_three_in_a_row_are_believed():
    far = 20.0 + LEAP
    made = fed(Assembly("none"), mounted(), scan(10.0), scan(far), scan(10.1))
    assert [t for t, _ in made.ready()[0]] == [10.0, 10.1]
    fed(made, scan(far), scan(far + 0.1), scan(far + 0.2))
    assert [t for t, _ in made.ready()[0]] == [far + 0.2]
    assert made.refused == {"clock": 3}


def test_light_is_kept_when_the_first_scan_has_some_and_all_have_it():
    light = [5.0, 6.0, 0.0, 0.0, 0.0, 7.0]
    made = fed(Assembly("none"), mounted(), scan(1.0, light=light), scan(1.1), scan(1.2, light=light))
    placed, _ = made.ready()
    assert [s.intensities.tolist() for _, s in placed] == [light, light]
    assert made.refused == {"light": 1}
    made = fed(Assembly("none"), mounted(), scan(1.0), scan(1.1, light=light))
    assert [s.intensities for _, s in made.ready()[0]] == [None, None]


@pytest.mark.parametrize(
    "message",
    [
        scan(5.0, ranges=[1.0]),
        scan(5.0, angle_min=math.nan),
        scan(5.0, step=math.inf),
        scan(5.0, step=3.0),
        scan(0.0),
        odometry(5.0, (math.nan, 0.0, 0.0)),
        odometry(5.0, (1e300, 0.0, 0.0)),
        (wire.TF, ros_peer.transforms((1.0, "base", "", (0.0, 0.0, 0.0)))),
        (wire.TF, ros_peer.transforms((1.0, "base", "laser", (math.inf, 0.0, 0.0)))),
    ],
)
def test_what_no_sensor_says_is_refused_and_changes_nothing(message):
    made = fed(Assembly(), message)
    assert sum(made.refused.values()) == 1
    assert made.ready(all_of_them=True) == ([], [])


def test_messages_with_any_byte_changed_are_used_or_refused_and_nothing_else():
    rng = np.random.default_rng(5)
    made = Assembly(sensor_pose=(0.0, 0.0, 0.0))
    refused = 0
    for k in range(3000):
        t = 10.0 + 0.1 * k
        kind, payload = (scan(t), odometry(t), mounted())[k % 3]
        changed = bytearray(payload[: rng.integers(1, len(payload) + 1)] if rng.random() < 0.2 else payload)
        for at in rng.integers(0, len(changed), rng.integers(1, 4)):
            changed[at] = rng.integers(256)
        try:
            fed(made, (kind, bytes(changed)))
        except RefusedError:
            refused += 1
        for when, placed in made.ready()[0]:
            assert np.isfinite(placed.ranges).all()
            assert np.isfinite([when, *placed.odometry, *placed.T_robot_sensor, placed.angle_min]).all()
            (beams,) = decode(encode(Scans(robot="r1", run="a", seq=1, scans=[beams_of(when, placed)]))).scans
            assert np.array_equal(scan_of(beams).ranges, placed.ranges)
    assert refused > 100
    assert sum(made.refused.values()) > 100


def test_rows_that_no_scan_waits_for_are_let_go():
    made = fed(Assembly(), mounted())
    for k in range(500):
        fed(made, odometry(10.0 + 0.02 * k), *([scan(10.0 + 0.02 * k)] if k % 10 == 0 else []))
        made.ready()
    assert len(made._rows) <= 3


def test_a_resumed_drive_uses_only_what_is_later():
    made = Assembly()
    made.resume(ToldUntil(10.0, 10.0, 10.0, light=False))
    fed(
        made,
        fix(9.9),
        fix(10.1),
        mounted(),
        odometry(9.9),
        scan(9.9),
        odometry(10.1),
        odometry(10.3, (0.2, 0.0, 0.0)),
        scan(10.2),
    )
    ((t, placed),), _ = made.ready()
    assert t == 10.2
    np.testing.assert_allclose(placed.odometry, [0.1, 0.0, 0.0], atol=1e-9)
    assert [row[0] for row in made.fixes()] == [10.1]
    assert made.refused == {"clock": 3}


def test_fixes_are_told_as_the_reader_of_recordings_has_them_and_those_that_tell_nothing_are_counted():
    made = Assembly()
    fed(
        made,
        fix(10.0, sd=1.5),
        fix(10.5, status=-1),
        fix(11.0, (math.nan, 139.75, 40.0)),
        fix(11.5, (0.0, 0.0, 40.0)),
        fix(12.0, (35.7, 139.75, math.nan), sd=None),
        fix(12.0),
        fix(9.0),  # steps back
        fix(500.0),  # leaps ahead
        fix(13.0, (36.0, 139.75, 40.0)),  # tens of kilometres off: told, as `map` reads it, and left out of the map
        (wire.TF, ros_peer.transforms((1.0, "base", "gps", (-0.3, 0.1, 0.0)))),
    )
    assert made.fixes() == [
        (10.0, 35.7, 139.75, 40.0, 2.25, 0.0, 2.25),
        (12.0, 35.7, 139.75, 0.0, UNTOLD, UNTOLD, UNTOLD),
        (13.0, 36.0, 139.75, 40.0, 1.0, 0.0, 1.0),
    ]
    assert made.fixes() == []
    assert made.fixes_left == {
        "fix without satellites": 1,
        "fix that is no number": 1,
        "fix at latitude 0, longitude 0": 1,
        "fix whose stamp comes again": 1,
    }
    assert made.refused == {"clock": 2}
    assert made.antenna == (0.0, 0.0)
    fed(made, odometry(10.0))
    assert made.antenna == pytest.approx((-0.3, 0.1))


def test_poses_by_others_are_fixes_with_their_covariance():
    made = Assembly()
    told = ros_peer.pose_told(10.0, "mocap", (5.0, 2.0, 0.5), (0.04, 0.01, 0.09))
    made.fix(wire.decode(told, wire.POSE))
    assert made.fixes() == [(10.0, 5.0, 2.0, 0.5, 0.04, 0.01, 0.09)]
    assert made.fix_frame == "mocap"


def test_a_receiver_is_its_robots_and_poses_by_others_are_heard_where_they_are_named():
    made = graph(
        *((f"/tb{k}/{name}", kind) for k in (1, 2) for name, kind in (("scan", wire.SCAN), ("odom", wire.ODOMETRY))),
        ("/tb1/gps/fix", NAVSAT),
        ("/tb1/fix", NAVSAT),
        ("/tb1/mocap", wire.POSE),
        ("/vrpn/tb2", wire.GOAL),
    )
    one, two = made.robots()
    assert [t.name for t in one.fixes] == ["/tb1/fix", "/tb1/gps/fix", "/tb1/mocap"]
    assert two.fixes == ()
    assert chosen_fixes(made, one, None).name == "/tb1/fix"
    assert chosen_fixes(made, one, "none") is None
    assert chosen_fixes(made, one, "tb1/mocap").name == "/tb1/mocap"
    assert chosen_fixes(made, two, None) is chosen_fixes(made, two, "/vrpn/tb2") is None
    with pytest.raises(RefusedError, match="--fixes: no topic 'tb1/scan' that tells positions; there are /tb1/fix "):
        chosen_fixes(made, one, "/tb1/scan")
    (only,) = graph(("/scan", wire.SCAN), ("/vrpn/me/pose", wire.GOAL)).robots()
    assert [t.name for t in only.fixes] == ["/vrpn/me/pose"]


def headings(scale=1.0, bias=0.0, seconds=40.0, gap=(0.0, 0.0)):
    """What a gyroscope tells of a robot that spins, stamps and headings; and how it truly turns from scan to scan."""
    truth, rate = truth_of(seconds, 1.0)
    rate = np.where(truth.t < truth.t[0] + 3.0, 0.0, rate)  # it stands first
    stands = (truth.t < truth.t[0] + 3.0)[:, None]
    truth = replace(truth, pose=np.where(stands, truth.pose[300], truth.pose))
    t, scans = scans_of(truth)
    made, out, told = Gyroscope("/imu"), [], iter(zip(truth.t.tolist(), rate.tolist(), strict=True))
    row = next(told)
    for at, scan in zip(t.tolist(), scans, strict=True):
        while row is not None and row[0] <= at + 0.05:
            if not gap[0] < row[0] - truth.t[0] < gap[1]:
                made.add(wire.decode(ros_peer.imu(row[0], "imu", (0.0, 0.0, scale * (row[1] + bias))), IMU))
            row = next(told, None)
        out += made.turned([(at, scan)], np.array([0.0, 0.0, 1.0]), all_of_them=False)
    out += made.turned([], np.array([0.0, 0.0, 1.0]), all_of_them=True)
    assert [at for at, _ in out] == t.tolist()
    true = np.diff(np.unwrap(se2.interpolate(t, truth.t, truth.pose)[:, 2]))
    return made, np.array([np.nan if s.heading is None else s.heading for _, s in out]), true


@pytest.mark.parametrize(("scale", "bias"), [(1.0, 0.0), (1.0, 0.05), (-1.0, 0.0), (180.0 / math.pi, 0.02)])
def test_a_robot_without_wheels_is_told_its_turns_once_scans_have_shown_what_they_are_counted_in(scale, bias):
    made, heading, true = headings(scale, bias)
    known = np.isfinite(heading)
    assert not known[:20].any()  # it stands: nothing shows the unit
    assert known[150:].all()
    off = (np.diff(heading) - true)[known[1:] & known[:-1]]
    assert np.abs(off).max() < 0.02
    assert "imu-turns" in {found.code for found in made.findings}
    assert len(made._rows) < 6000


def test_a_turn_whose_stamp_cannot_be_is_refused():
    made = Gyroscope("/imu")
    turn = lambda t: made.add(wire.decode(ros_peer.imu(t, "imu", (0.0, 0.0, 0.1)), IMU))
    turn(10.0)
    for wrong in (0.0, 9.0, 500.0):
        with pytest.raises(RefusedError, match="a turn"):
            turn(wrong)
    turn(10.01)


def test_turns_that_scans_do_not_show_are_not_told_and_none_is_told_over_a_gap():
    assert np.isnan(headings(scale=0.0, bias=0.4)[1]).all()
    _, heading, true = headings(gap=(25.0, 28.0))
    known = np.isfinite(heading)
    assert np.abs((np.diff(heading) - true)[known[1:] & known[:-1]]).max() < 0.02
    assert 20 < (~known[200:]).sum() < 60


def test_mounts_compose_as_poses_do():
    made = fed(Assembly("none"), mounted((0.2, 0.1, 0.4)))
    fed(made, (wire.TF, ros_peer.transforms((1.0, "root", "base", (1.0, 2.0, -0.7)))), scan(3.0))
    ((_, placed),), _ = made.ready()
    np.testing.assert_allclose(
        placed.T_robot_sensor, se2.compose(np.array([1.0, 2.0, -0.7]), np.array([0.2, 0.1, 0.4])), atol=1e-9
    )


def test_a_grid_is_told_from_its_lowest_row_up_and_a_covariance_at_x_y_and_the_turn():
    hits = np.array([[5, 0, 0], [0, 5, 0]])
    passes = np.array([[0, 9, 0], [9, 0, 1]])
    nothing = np.zeros((2, 3))
    grid = GridMap(0.05, np.array([-1.0, 2.0]), hits, passes, np.zeros((2, 3, 2)), nothing, nothing)
    told = ros_peer.read_grid(wire.encode(grid_of(5_000_000_007, "map", grid), wire.GRID))
    assert told[0] == "map"
    assert told[1] == pytest.approx(0.05)
    assert told[2:] == ((3, 2), (-1.0, 2.0), (100, 0, -1, 0, 100, -1))
    pose = pose_of(5_000_000_007, "map", np.array([1.0, 2.0, 0.5]), np.arange(1.0, 7.0))
    t, frame, told, cov = ros_peer.read_pose(wire.encode(pose, wire.POSE))
    assert (t, frame) == (pytest.approx(5.000000007), "map")
    np.testing.assert_allclose(told, [1.0, 2.0, 0.5], atol=1e-12)
    whole = np.array(cov).reshape(6, 6)
    np.testing.assert_array_equal(whole[np.ix_([0, 1, 5], [0, 1, 5])], [[1, 2, 3], [2, 4, 5], [3, 5, 6]])
    assert np.count_nonzero(whole) == 9
