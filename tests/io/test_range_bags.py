"""Recordings of ranges: who ranged to whom, which radio is on which robot, whose clock counts."""

import numpy as np
import pytest

from mapweave.core.errors import ReaderError, UsageError
from mapweave.core.fixes import Fixes
from mapweave.core.records import Track
from mapweave.io import mcap, range_bags
from mapweave.io.bag_robots import FIXES, TF
from mapweave.io.range_bags import is_range_bag, read_range_bag, write_range_bag

T = np.arange(0.0, 10.0, 0.5) + 1.7e9
WAY = Track(T, np.column_stack([T - T[0], 0 * T, 0 * T]))


def bag(tmp_path, robots, pairs):
    path = tmp_path / "ranges.mcap"
    write_range_bag(path, dict.fromkeys(robots, WAY), [(a, b, T, np.full(len(T), 2.5)) for a, b in pairs])
    return path


def test_a_recording_read_back_holds_its_odometry_pairs_and_ranges(tmp_path):
    path = bag(tmp_path, ["robot1", "robot2"], [("robot1", "robot2"), ("robot2", "beacon7")])
    assert is_range_bag(path)
    log = read_range_bag(path)
    assert log.names == ("robot1", "robot2", "beacon7")
    assert sorted(zip(log.a.tolist(), log.b.tolist(), strict=True)) == [(0, 1)] * len(T) + [(1, 2)] * len(T)
    assert log.odometry["robot2"].pose == pytest.approx(WAY.pose)
    assert not log.findings


@pytest.mark.parametrize(
    ("robots", "pairs", "on"),
    [
        (["turtle01", "turtle03"], [("n_1", "n_3"), ("n_1", "n_8")], {"n_1": "turtle01", "n_3": "turtle03"}),
        (["turtle01", "turtle03"], [("n_2", "n_5")], {"n_2": "turtle01", "n_5": "turtle03"}),
    ],
)
def test_radios_are_on_robots_of_their_number_or_on_either_of_two_and_that_is_told(tmp_path, robots, pairs, on):
    log = read_range_bag(bag(tmp_path, robots, pairs))
    assert set(log.names) == {*robots, *{radio for pair in pairs for radio in pair} - set(on)}
    told = [f.value for f in log.findings if f.code == "radios-assumed"]
    assert all(f"{radio} on {robot}" in told[0] for radio, robot in on.items())


def test_radios_that_nobody_can_tell_apart_are_refused_and_may_be_said(tmp_path):
    path = bag(tmp_path, ["alpha1", "beta2", "gamma3"], [("n_7", "n_8"), ("n_8", "n_9")])
    with pytest.raises(ReaderError, match="--radios"):
        read_range_bag(path)
    log = read_range_bag(path, {"n_7": "gamma3", "n_9": "alpha1"})
    assert set(log.names) == {"alpha1", "beta2", "gamma3", "n_8"}
    with pytest.raises(UsageError, match="knows no n_1"):
        read_range_bag(path, {"n_1": "gamma3"})


def test_the_antenna_of_a_radio_stands_where_transforms_say(tmp_path):
    kinds = {"/robot1/odom": range_bags.ODOMETRY, "/uwb/robot1/beacon7/range": range_bags.RANGE, "/tf_static": TF[0]}
    ns = [mcap.nanoseconds(t) for t in T]
    still = mcap.transform_message(ns[0], mcap.BASE, "robot1", np.array([0.3, -0.1, 1.0]))
    messages = [(ns[0], "/tf_static", mcap.message_type(TF[0])(transforms=[still]))]
    for t, pose in zip(ns, WAY.pose, strict=True):
        messages.append((t, "/robot1/odom", mcap.odometry_message(t, pose)))
        messages.append((t, "/uwb/robot1/beacon7/range", range_bags._range_message(t, "robot1", 2.5)))
    mcap.write_messages(tmp_path / "ranges.mcap", kinds, messages, {"/tf_static"})
    log = read_range_bag(tmp_path / "ranges.mcap")
    assert log.antennas["robot1"] == pytest.approx([0.3, -0.1])
    assert log.unused == ()
    assert not read_range_bag(bag(tmp_path, ["robot1"], [("robot1", "beacon7")])).antennas


def receiver(sd):
    place = np.column_stack([35.7 + 1e-6 * np.arange(len(T)), np.full(len(T), 139.7), np.full(len(T), 40.0)])
    return Fixes(T + 0.1, place, np.tile(sd**2 * np.eye(2), (len(T), 1, 1)))


def test_fixes_beside_ranges_are_their_robots_and_come_back_as_they_were_written(tmp_path):
    path = tmp_path / "ranges.mcap"
    told = {"robot2": receiver(1.5)}
    pairs = [("robot1", "robot2", T, np.full(len(T), 2.5))]
    write_range_bag(path, dict.fromkeys(["robot1", "robot2"], WAY), pairs, told)
    log = read_range_bag(path)
    assert list(log.fixes) == ["robot2"]
    again = log.fixes["robot2"]
    assert again.topic == "/robot2/fix"
    np.testing.assert_allclose(again.t, told["robot2"].t, atol=1e-9)
    np.testing.assert_array_equal(again.place, told["robot2"].place)
    np.testing.assert_array_equal(again.cov, told["robot2"].cov)
    assert log.unused == ()
    none = read_range_bag(path, fixes="none")
    assert none.fixes == {}
    assert "--fixes /robot2/fix" in none.unused[0].reason
    with pytest.raises(ReaderError, match="--fixes: no topic 'gps'"):
        read_range_bag(path, fixes="gps")


def test_poses_by_others_are_read_where_they_are_asked_for_of_the_robot_of_that_number(tmp_path):
    topic = "/capture/turtlebot3_cap/pose"
    kinds = {topic: FIXES[2], "/uwb/n_1/n_3/range": range_bags.RANGE}
    kinds |= {f"/{robot}/odom": range_bags.ODOMETRY for robot in ("turtle01", "turtle03")}
    messages = []
    for t, pose in zip(map(mcap.nanoseconds, T), WAY.pose, strict=True):
        messages += [(t, f"/{robot}/odom", mcap.odometry_message(t, pose)) for robot in ("turtle01", "turtle03")]
        messages.append((t, "/uwb/n_1/n_3/range", range_bags._range_message(t, "n_1", 2.5)))
        stamped = mcap.message_type("PoseStamped")(
            header=mcap.header_message(t, "room"), pose=mcap.pose_message(pose + 1.0)
        )
        messages.append((t, topic, stamped))
    path = tmp_path / "ranges.mcap"
    mcap.write_messages(path, kinds, messages, ())
    plain = read_range_bag(path)
    assert plain.fixes == {}
    assert [left.topic for left in plain.unused] == [topic]
    assert "--fixes" in plain.unused[0].reason
    log = read_range_bag(path, fixes=topic)
    assert list(log.fixes) == ["turtle03"]
    assert log.fixes["turtle03"].frame == "room"
    np.testing.assert_allclose(log.fixes["turtle03"].xy(None), WAY.pose[:, :2] + 1.0)
    assert [(f.code, f.robot) for f in log.findings if f.code == "topics-chosen"] == [("topics-chosen", "turtle03")]
