"""A team of ranging radios that drives: at the end the map of its recording, on the way where ranges place it."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mapweave
from mapweave.api.live import _final
from mapweave.api.map_options import MapOptions
from mapweave.core import se2
from mapweave.core.errors import ReaderError, UsageError
from mapweave.io.range_bags import read_range_bag
from mapweave.live.door import decode
from mapweave.live.messages import Closed, Header, Radios, RefusedError, encode, pack
from mapweave.live.range_stream import (
    RangeRecord,
    RangeRobot,
    messages_of_ranges,
    of_robot,
    of_team,
    ranged,
    ranged_again,
    ranges_told,
)
from mapweave.live.shared_map import SharedMap
from mapweave.live.sources import messages, open_source
from mapweave.live.store import Store
from mapweave.ranges.network import network_of

from .processes import Fleet, same_result
from .teams import heard, heard_late_and_twice, payloads
from .teams import team as landmark_team

NAMES = ("r1", "r2", "r3")
DATA = Path(os.environ.get("MAPWEAVE_DATA", "/nowhere"), "uwb")


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A simulated recording, and where its robots truly drove."""
    home = tmp_path_factory.mktemp("radios")
    made = mapweave.simulate_team(home / "log", ranges=True, lasers=3, cameras=0, bearings=0, beacons=2, minutes=0.6)
    return home, {robot.name: robot.truth for robot in made.robots}


@pytest.fixture(scope="module")
def direct(drive):
    """What `map` makes of the recording."""
    mapweave.map(drive[0] / "log", drive[0] / "direct")
    return drive[0] / "direct"


@pytest.fixture(scope="module")
def told(drive):
    """What each robot tells, message by message."""
    source = str(drive[0] / "log")
    return {name: [encode(m) for _, m in messages(open_source(source, name, None), name, "a", 1.0)] for name in NAMES}


@pytest.mark.parametrize("period", [0.3, 1.0, 1e6])
def test_what_robots_tell_is_the_log_they_are_of_whatever_was_wrong_with_it(drive, period):
    log = read_range_bag(drive[0] / "log")
    z = log.z.copy()
    z[:7], z[7:9] = np.inf, -1.0
    a = np.where(np.arange(len(z)) % 5 == 0, log.b, log.a)  # some were measured by the other end
    b = np.where(np.arange(len(z)) % 5 == 0, log.a, log.b)
    b[21:24] = a[21:24]
    beacons = [log.names.index(name) for name in ("beacon1", "beacon2")]
    a[30:60], b[30:60] = beacons  # beacons that measure each other
    a[40:50], b[40:50] = beacons[::-1]
    log = replace(log, a=a, b=b, z=z, antennas={"robot2": np.array([0.1, -0.2])}, dropped={"unreadable": 3})
    again = []
    for name in log.odometry:
        told = [decode(encode(m)) for _, m in messages_of_ranges(of_robot(log, name), "r1", "a", period)]
        assert isinstance(told[0], Header)
        assert isinstance(told[-1], Closed)
        assert [m.seq for m in told] == list(range(len(told)))
        again.append(ranges_told(told))
    whole = of_team(again[::-1])
    one, other = network_of(log), network_of(whole)
    assert (one.robots, one.beacons, one.dropped) == (other.robots, other.beacons, other.dropped)
    assert one.dropped["range that is no positive number"] == 9
    for column in ("a", "b", "t", "z", "lever_a", "lever_b", "rate_a", "rate_b"):
        np.testing.assert_array_equal(getattr(one.ranges, column), getattr(other.ranges, column))
    apart = one.is_beacon[one.ranges.a] & one.is_beacon[one.ranges.b]
    assert apart.sum() == 30
    np.testing.assert_array_equal(one.motions.z, other.motions.z)
    assert (whole.source, whole.log_hash, whole.findings, whole.unused) == (
        log.source,
        log.log_hash,
        log.findings,
        log.unused,
    )


@pytest.mark.drawn
def test_messages_late_and_doubled_give_the_map_of_the_recording(direct, told, tmp_path):
    rng = np.random.default_rng(1)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard_late_and_twice(store, told, rng)
        assert all(ledger.complete for ledger in inbox.ledgers.values())
        _final(inbox, MapOptions(), print).write(tmp_path / "out")
    same_result(direct, tmp_path / "out")


def test_while_they_drive_robots_and_beacons_stand_where_ranges_place_them(drive, told, tmp_path):
    half = {name: each[:25] for name, each in told.items()}
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, half)
        logs = [inbox.log(name) for name in NAMES]
    found = ranged(logs)
    assert [b.id for b in found.beacons] == ["beacon1", "beacon2"]
    shared = SharedMap()
    assert shared.take_ranged(found) == []
    assert {name: placed.component for name, placed in shared.placed.items()} == dict.fromkeys(drive[1], 1)
    assert [b.component for b in shared.landmarks] == [1, 1]
    assert shared.fused == 1
    last = np.array([min(log.odometry[name].t[-1] for log in logs for name in log.odometry)])
    at, true = [], []
    for log in logs:
        ((name, track),) = log.odometry.items()
        pose, cov = shared.placed[name].carry(se2.interpolate(last, track.t, track.pose)[0], np.zeros((3, 3)))
        at.append(pose[:2])
        true.append(se2.interpolate(last, drive[1][name].t, drive[1][name].pose)[0, :2])
        assert 0.0 < cov[0, 0] + cov[1, 1] < 0.25
    # few seconds of nearly straight ways fit their mirror image as well, which is told
    apart, truly = (np.hypot(*(np.array(p)[:, None] - np.array(p)).T) for p in (at, true))
    np.testing.assert_allclose(apart, truly, atol=0.3)
    assert shared.decisions == found.decisions


def test_a_robot_that_is_not_heard_is_no_beacon(told, tmp_path):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        result = _final(heard(store, {name: told[name] for name in ("r1", "r2")}), MapOptions(), print)
    assert result.network.robots == ("robot1", "robot2")
    assert result.network.beacons == ("beacon1", "beacon2")
    assert result.network.dropped["range to a robot that told no odometry"] > 100


def test_a_team_is_placed_from_the_store_by_its_own_names_without_who_told_no_odometry(told, tmp_path):
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, {**{name: told[name][:25] for name in ("r1", "r2")}, "r3": told["r3"][:1]})
        found = ranged_again(store, {name: ledger.sure for name, ledger in inbox.ledgers.items()})
        apart = ranged([inbox.log(name) for name in ("r1", "r2")])
    assert set(found.placed) == {"r1", "r2"}
    np.testing.assert_array_equal(found.placed["r2"].frame, apart.placed["robot2"].frame)
    assert [b.id for b in found.beacons] == ["beacon1", "beacon2"]
    assert list(found.decisions) == list(apart.decisions)


def test_a_robot_knows_its_odometry_and_how_it_may_err(told):
    first, *rest = map(decode, told["r2"])
    robot = RangeRobot(first)
    for message in [first, *rest]:
        robot.add(message)
    pose, cov, others = robot.status()
    log = ranges_told([first, *rest])
    np.testing.assert_array_equal(pose, log.odometry["robot2"].pose[-1])
    assert others == 4
    assert 0.0 < cov[0] < 1.0
    assert robot.snapshot() is None
    assert robot.t == log.odometry["robot2"].t[-1]


def header(**other):
    words = {"sensor": "ranges", "log_robot": "a1", "source": "", "odometry": True, "names": ["a1", "b"]}
    return Header(robot="r1", run="a", **(words | other))


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ({"track": pack([2.0, 1.0], [0, 0], [0, 0], [0, 0])}, "odometry that steps back"),
        ({"track": pack([1.0, 2.0], [0, 5e5], [0, 0], [0, 0])}, "odometry that steps 5e\\+05 m"),
        ({"told": pack([2.0, 1.0], [1, 1]), "whom": [1, 1]}, "ranges that step back"),
        ({"told": pack([1.0], [1]), "whom": [3]}, "an index of 3"),
        ({"told": pack([1.0], [1]), "whom": [1], "by": [3]}, "an index of 3"),
        ({"told": pack([1.0], [1]), "whom": [0], "by": [2]}, "ranges that other robots tell"),
        ({"told": pack([1.0], [1]), "whom": [2], "by": [1]}, "ranges that other robots tell"),
    ],
)
def test_rows_that_cannot_be_a_ranging_robots_are_refused(rows, reason):
    record = RangeRecord(header(names=["a1", "b", "a2"], others=["a2"]))
    record.add(Radios(robot="r1", run="a", seq=1, track=pack([0.5], [0], [0], [0])))
    with pytest.raises(RefusedError, match=reason):
        record.add(Radios(robot="r1", run="a", seq=2, **rows))


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ({"told": pack([1.0], [np.inf]), "whom": [1]}, "not finite"),
        ({"told": pack([1.0], [1e39]), "whom": [1]}, "a range of"),
        ({"told": pack([1.0], [1.0]), "whom": [1, 0]}, "an index a range"),
        ({"told": pack([1.0], [1.0]), "whom": [-1]}, "an index from 0"),
        ({"told": pack([1.0], [1.0]), "whom": [1], "by": [1, 0]}, "who measured each range"),
        ({"told": pack([1.0], [1.0]), "whom": [1], "by": [-1]}, "an index from 0"),
        ({"track": pack([1.0], [1e10], [0], [0])}, "odometry of"),
    ],
)
def test_rows_that_no_radio_tells_do_not_come_in(rows, reason):
    with pytest.raises(RefusedError, match=reason):
        decode(encode(Radios(robot="r1", run="a", seq=1, **rows)))


@pytest.mark.parametrize("other", [{"names": ["b"]}, {"odometry": False}])
def test_a_header_of_ranges_names_its_robot_and_has_odometry(other):
    with pytest.raises(RefusedError, match="without its own name or odometry"):
        RangeRecord(header(**other))
    with pytest.raises(RefusedError, match="two numbers of an antenna"):
        decode(encode(header(antenna=(1.0,))))


def test_where_others_see_those_that_range_are_left_out_and_it_is_told(told, tmp_path):
    said = []
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, {"r1": told["r1"], "k1": payloads(landmark_team()[1], "k1")})
        result = _final(inbox, MapOptions(), said.append)
    assert [line for line in said if "r1: left out of the map: it ranges" in line]
    assert result.maps[0].robots == (landmark_team()[1].robot,)


def test_which_robot_of_a_recording_it_is_is_told_by_name_or_number(drive, tmp_path):
    source = str(drive[0] / "log")
    assert list(open_source(source, "eve", "robot3").odometry) == ["robot3"]
    assert list(open_source(source, "eve2", None).odometry) == ["robot2"]
    with pytest.raises(UsageError, match="which robot is eve"):
        open_source(source, "eve", None)
    with pytest.raises(UsageError, match="which robot is eve9"):
        open_source(source, "eve9", None)


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs MAPWEAVE_DATA")
def test_a_real_team_whose_radios_are_told_by_hand_gives_the_map_of_its_recording(tmp_path):
    path, captured = DATA / "four-turtlebots.db3", "/vrpn_client_node/turtlebot3_cap/pose"
    radios = {"n_7": "turtle01", "n_3": "turtle03", "n_4": "turtle04", "n_5": "turtle05"}
    mapweave.map(path, tmp_path / "direct", radios=radios, laser=mapweave.LaserOptions(fixes=captured))
    of = {name: open_source(str(path), name, None, radios=radios, fixes=captured) for name in (*NAMES, "r4", "r5")}
    assert [name for name, log in of.items() if log.fixes] == ["r3"]
    beacons = {"n_1", "n_2", "n_6", "n_8"}
    apart = {
        name: sum({log.names[i], log.names[j]} <= beacons for i, j in zip(log.a, log.b, strict=True))
        for name, log in of.items()
    }
    assert apart == {"r1": 878} | dict.fromkeys(("r2", "r3", "r4", "r5"), 0)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, {name: [encode(m) for _, m in messages(log, name, "a", 1.0)] for name, log in of.items()})
        _final(inbox, MapOptions(), print).write(tmp_path / "out")
    same_result(tmp_path / "direct", tmp_path / "out")


def test_options_of_recordings_are_refused_where_there_is_none_and_names_where_there_are_others(drive, tmp_path):
    log = drive[0] / "log"
    network = mapweave.Network(listen=("tcp/127.0.0.1:0",))
    for source, options, error in (
        (log, {"radios": {"n_9": "robot1"}}, "--radios: .* knows no n_9, only beacon1, beacon2, robot1"),
        (log, {"radios": {"robot1": "turtle"}}, "--radios: .* knows no turtle, only robot1, robot2, robot3"),
        ("sim:office", {"radios": {"n_9": "robot1"}}, "--radios: only for recordings of ranges, found sim:office"),
        ("ros2", {"radios": {"n_9": "robot1"}}, "--radios: only for recordings of ranges"),
        ("sim:office", {"fixes": "/gps"}, "--fixes: only for recordings, found sim:office"),
    ):
        with pytest.raises(UsageError, match=error):
            mapweave.live_robot("r1", source, history=tmp_path / "r1.sqlite", network=network, **options)
    with pytest.raises(ReaderError, match="--fixes: no topic '/gps' that tells positions; there are none"):
        open_source(str(log), "r1", None, fixes="/gps")


@pytest.mark.drawn
@pytest.mark.slow
def test_processes_that_are_killed_meanwhile_make_the_map_of_the_recording(drive, direct, tmp_path):
    fleet = Fleet(tmp_path, drive[0] / "log")
    try:
        fleet.map(robots=",".join(NAMES))
        for name in NAMES:
            fleet.robot(name, rate="4")
        for name in NAMES:
            fleet.hears("map", f"{name}: joined")
        fleet.kill("r2")
        fleet.robot("r2", rate="4")
        fleet.kill("map")
        fleet.map(robots=",".join(NAMES))
        for name in ("map", *NAMES):
            assert fleet.wait(name) == 0, fleet.said(name)
    finally:
        fleet.end()
    same_result(direct, tmp_path / "out-map")
    assert json.loads((tmp_path / "out-map" / "metrics.json").read_text())["components"] == [["1", "2", "3"]]
