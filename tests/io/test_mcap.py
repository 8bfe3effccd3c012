"""A simulated log written as MCAP comes back to the bit, and other tools find what they need in it."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from mapweave.io.laser_logs import read_laser
from mapweave.io.mcap import write_mcap
from mapweave.sim.laser import DriftConfig, DriveConfig
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    drive = DriveConfig(sensor_pose=(0.11, -0.02, 0.3), people=3, drift=DriftConfig(end_error=None))
    sim = simulate_corridor(CorridorConfig(distance=40.0, drive=drive), seed=2)
    path = tmp_path_factory.mktemp("mcap") / "ring.mcap"
    write_mcap(path, sim.log, sim.truth, range_min=drive.scanner.near)
    return sim, path


def test_reading_it_back_gives_the_same_events_to_the_bit(driven):
    sim, path = driven
    wrote, read = list(sim.log.events()), list(read_laser(path).events())
    assert len(wrote) == len(read) == 2 * len(sim.log.scans)
    for a, b in zip(wrote, read, strict=True):
        assert (a.t, a.robot, type(a.record)) == (b.t, b.robot, type(b.record))
        for name in a.record.__slots__:
            u, v = getattr(a.record, name), getattr(b.record, name)
            assert np.array_equal(u, v) if isinstance(u, np.ndarray) else u == v, name


@pytest.mark.parametrize("sweep", [0.0667, -0.0667])
def test_the_time_that_a_scan_takes_is_stated(driven, tmp_path, sweep):
    write_mcap(tmp_path / "swept.mcap", replace(driven[0].log, sweep=sweep))
    assert read_laser(tmp_path / "swept.mcap").sweep == pytest.approx(0.0667, rel=1e-6)


def test_it_is_written_where_temporary_files_are_on_another_file_system(driven, tmp_path, monkeypatch):
    def within(move):
        def moved(source, target, **options):
            if Path(source).parent != Path(target).parent:
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), str(source))
            return move(source, target, **options)

        return moved

    sim, path = driven
    for name in ("rename", "replace"):
        monkeypatch.setattr(os, name, within(getattr(os, name)))
    write_mcap(tmp_path / path.name, sim.log, sim.truth, range_min=0.1)
    assert len(read_laser(tmp_path / path.name).scans) == len(sim.log.scans)


def test_the_truth_is_on_a_topic_no_reader_of_odometry_takes(driven):
    sim, path = driven
    with AnyReader([path]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        counts = {c.topic: c.msgcount for c in reader.connections}
        truth = [
            m for c, _, d in reader.messages() if c.topic == "/ground_truth" for m in [reader.deserialize(d, c.msgtype)]
        ]
    assert kinds["/ground_truth"] == "geometry_msgs/msg/PoseStamped"
    assert [t for t, kind in kinds.items() if kind == "nav_msgs/msg/Odometry"] == ["/odom"]
    assert counts["/scan"] == len(sim.log.scans)
    assert [m.pose.position.x for m in truth] == sim.truth.pose[:, 0].tolist()


def test_the_messages_are_what_ros_tools_expect(driven):
    sim, path = driven
    with AnyReader([path]) as reader:
        first = {}
        for c, ns, data in reader.messages():
            first.setdefault(c.topic, (ns, reader.deserialize(data, c.msgtype)))
        durability = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    scan = first["/scan"][1]
    assert scan.header.frame_id == "laser"
    assert scan.angle_max == pytest.approx(np.radians(120), abs=1e-5)
    assert np.isinf(scan.ranges[~sim.log.scans[0].hit]).all()
    assert len(scan.intensities) == len(scan.ranges) == 342
    assert first["/tf"][1].transforms[0].child_frame_id == "base_link"
    assert {t.child_frame_id for t in first["/tf_static"][1].transforms} == {"laser", "odom"}
    assert durability["/tf_static"][0].durability.name == "TRANSIENT_LOCAL"
    assert first["/scan"][0] == round(sim.log.scan_t[0] * 1e9)


def test_the_file_begins_and_ends_as_the_format_says_and_has_a_summary(driven):
    data = driven[1].read_bytes()
    magic = b"\x89MCAP0\r\n"
    assert data.startswith(magic)
    assert data.endswith(magic)
    summary = int.from_bytes(data[-28:-20], "little")
    assert 0 < summary < len(data)
    assert b"ros2" in data[:40]
