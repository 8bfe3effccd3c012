"""Laser robots: scans told and put together again to the bit, and real processes whose map is that of their logs."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from mapweave.api.map_laser import map_logs as map_lasers
from mapweave.api.map_options import MapOptions
from mapweave.api.simulate import simulate_laser
from mapweave.api.slam import LaserSlam
from mapweave.core.errors import UsageError
from mapweave.live.door import decode
from mapweave.live.driven import LaserRobot
from mapweave.live.laser_stream import LaserRecord, beams_of, messages_of_laser, scan_of, whole_log
from mapweave.live.messages import LARGEST, RefusedError, Rows, Scans, encode
from mapweave.live.sources import open_source
from mapweave.mapping.config import LaserConfig
from mapweave.sim.laser_worlds import CorridorConfig, OfficeConfig

from ..forked import Forked
from .processes import Fleet, same_result


@cache
def drive(robot="robot1", distance=4.0):
    return replace(simulate_laser(world=CorridorConfig(distance=distance), seed=1).log, robot=robot)


def told(log, period=1.0):
    return [m for _, m in messages_of_laser(log, "r1", "a", period)]


@pytest.mark.parametrize("period", [0.3, 2.0, 1e6])
def test_a_laser_log_is_the_same_to_the_bit_once_told(period):
    for log in (
        drive(),
        replace(drive(), odometry=None, scans=tuple(replace(s, odometry=None) for s in drive().scans)),
    ):
        first, *rest = [decode(encode(m)) for m in told(log, period)]
        assert max(len(encode(m)) for m in rest) < LARGEST
        record = LaserRecord(first)
        got = whole_log(first, [part for message in rest if (part := record.add(message)) is not None])
        assert record.closed
        assert (got.robot, got.source, got.log_hash, got.odometry_from) == (
            log.robot, log.source, log.log_hash, log.odometry_from,
        )  # fmt: skip
        assert (got.dropped, got.findings) == (log.dropped, log.findings)
        assert got.scan_t.tobytes() == log.scan_t.tobytes()
        for a, b in zip(got.scans, log.scans, strict=True):
            for name in ("ranges", "hit", "intensities", "T_robot_sensor", "odometry"):
                x, y = getattr(a, name), getattr(b, name)
                assert (x is None and y is None) or x.tobytes() == y.tobytes()
            assert (a.angle_min, a.angle_increment, a.range_max, a.host) == (
                b.angle_min, b.angle_increment, b.range_max, b.host,
            )  # fmt: skip
        if log.odometry is not None:
            assert got.odometry.pose.tobytes() == log.odometry.pose.tobytes()


def test_a_laser_robot_whose_scans_alone_tell_odometry_is_mapped():
    first, *rest = [
        msgspec.structs.replace(m, track=b"") if isinstance(m, Scans) else m for m in told(drive(distance=2.0))
    ]
    record = LaserRecord(first)
    log = whole_log(first, [part for message in rest if (part := record.add(message)) is not None])
    assert log.odometry is None
    (part,) = map_lasers([log], MapOptions()).maps
    assert part.track.t.tolist() == log.scan_t.tolist()


def test_scans_that_contradict_what_was_announced_are_refused():
    first, second, *_ = told(drive())
    scan = second.scans[0]

    def refused(words, *messages, header=first):
        record = LaserRecord(header)
        for message in messages[:-1]:
            record.add(message)
        with pytest.raises(RefusedError, match=words):
            record.add(messages[-1])

    again = Scans(robot="r1", run="a", seq=2, scans=second.scans[:1])
    refused("scans that step back", Scans(robot="r1", run="a", seq=1, scans=second.scans[:3]), again)
    refused("odometry that steps back", second, Scans(robot="r1", run="a", seq=2, track=second.track))
    dark = replace(scan_of(scan), intensities=None)
    refused("light in some", Scans(robot="r1", run="a", seq=1, scans=[scan, beams_of(scan.t + 1, dark)]))
    lost = replace(scan_of(scan), odometry=None)
    refused("not what was announced", Scans(robot="r1", run="a", seq=1, scans=[beams_of(scan.t, lost)]))
    refused("Rows from a robot that announced a laser", Rows(robot="r1", run="a", seq=1))


def begun_again_with_another_scanner():
    """The log of a robot whose scanner, from the middle of its drive on, has a third of the beams."""
    log = drive()
    half = len(log.scans) // 2
    coarse = [
        replace(
            scan,
            ranges=scan.ranges[::3].copy(),
            hit=scan.hit[::3].copy(),
            intensities=None if scan.intensities is None else scan.intensities[::3].copy(),
            angle_increment=3.0 * scan.angle_increment,
        )
        for scan in log.scans[half:]
    ]
    return replace(log, scans=(*log.scans[:half], *coarse))


@pytest.mark.parametrize("made", [drive, begun_again_with_another_scanner])
def test_a_laser_robot_told_message_by_message_stands_where_its_scans_one_by_one_put_it(made):
    log, cfg = made(), LaserConfig(method="graph")
    first, *rest = told(log)
    robot = LaserRobot(first, cfg)
    for message in [first, *rest]:
        robot.add(message)
    slam = LaserSlam(cfg)
    for t, scan in zip(log.scan_t, log.scans, strict=True):
        pose = slam.add_scan(
            t, scan.ranges, scan.angles(), odometry=scan.odometry, intensities=scan.intensities,
            range_max=scan.range_max, sensor_pose=scan.T_robot_sensor,
        ).pose  # fmt: skip
    np.testing.assert_allclose(robot.status()[0], pose, atol=1e-9)
    assert robot.t == log.stamps()[-1]
    record = LaserRecord(first)
    again = whole_log(first, [part for part in map(record.add, rest) if part is not None])
    assert [scan.ranges.tobytes() for scan in again.scans] == [scan.ranges.tobytes() for scan in log.scans]


@pytest.mark.slow
def test_simulated_sources_give_each_robot_its_own_way_and_all_the_same_walls():
    one, two = (open_source("sim:office", f"r{k}", None, 2) for k in (1, 2))
    assert (one.robot, two.robot) == ("robot1", "robot2")
    assert one.log_hash != two.log_hash or not np.array_equal(one.scans[5].ranges, two.scans[5].ranges)
    again = open_source("sim:office", "r1", None, 2)
    assert again.scans[7].ranges.tobytes() == one.scans[7].ranges.tobytes()
    assert open_source("sim:landmarks", "scout-3", None).robot == "robot3"
    with pytest.raises(UsageError, match="holds robots 1, 2, 3, 4, 5"):
        open_source("sim:landmarks", "r1", "9")
    with pytest.raises(UsageError, match="expected sim:landmarks or sim:office"):
        open_source("sim:moon", "r1", None)


@pytest.mark.slow
def test_laser_robots_that_drive_give_the_map_of_their_logs(tmp_path):
    logs = [tmp_path / f"{name}.mcap" for name in "ab"]
    world = OfficeConfig(rooms=1, visited=1)
    for seed, path in enumerate(logs, 1):
        simulate_laser(path, world, seed=seed)
    direct = Forked(["map", *map(str, logs), "--out", "direct"], tmp_path, tmp_path / "direct.log")
    assert direct.wait(120) == 0
    fleet = Fleet(tmp_path, tmp_path)
    try:
        fleet.map()
        for name, path in zip(("r1", "r2"), logs, strict=True):
            fleet.source = path
            fleet.robot(name, rate="inf")
        for name in ("map", "r1", "r2"):
            assert fleet.wait(name, 90) == 0, fleet.said(name)
            assert "Traceback" not in fleet.said(name), fleet.said(name)  # of its threads as well
    finally:
        fleet.end()
    same_result(tmp_path / "direct", tmp_path / "out-map", but=("report.html",))  # it tells how long a scan took
