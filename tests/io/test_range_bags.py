"""Recordings of ranges: who ranged to whom, which radio is on which robot, whose clock counts."""

import numpy as np
import pytest

from mapweave.core.errors import ReaderError, UsageError
from mapweave.core.records import Track
from mapweave.io import mcap, range_bags
from mapweave.io.bag_robots import TF
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
