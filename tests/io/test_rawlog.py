"""MRPT's rawlogs, of bytes as its classes write them: scans, odometry, ranges; what is not read, what is damaged."""

import gzip

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.laser_logs import is_laser_log, read_laser
from mapweave.io.rawlog import is_rawlog_of_ranges, read_rawlog_ranges

from . import made_rawlog as made

T0 = 1.7e9
RANGES = np.linspace(1.0, 9.0, 181)


def laid(tmp_path, *parts, name="drive.rawlog"):
    path = tmp_path / name
    path.write_bytes(b"".join(parts))
    return path


@pytest.mark.parametrize("version", range(4, 9))
def test_scans_of_every_version_are_where_they_are_said_to_be(tmp_path, version):
    valid = [1] * 181
    valid[7] = 0
    light = np.arange(181) if version >= 7 else None
    at = made.pose3([0.3, -0.1, 0.5], 0.2, version=1 + version % 3)
    seen = [made.scan(T0 + k, RANGES, version=version, valid=valid, light=light, at=at) for k in range(3)]
    log = read_laser(laid(tmp_path, *(made.frame(each) for each in seen)))
    assert log.scan_t.tolist() == [T0, T0 + 1, T0 + 2]
    scan = log.scans[1]
    np.testing.assert_allclose(scan.ranges[scan.hit], np.delete(RANGES, 7).astype("f4"))
    np.testing.assert_allclose(scan.angles()[[0, -1]], [-np.pi / 2, np.pi / 2], atol=1e-6)
    np.testing.assert_allclose(scan.T_robot_sensor, [0.3, -0.1, 0.2])
    assert (scan.intensities is not None) == (version >= 7)
    assert scan.odometry is None


@pytest.mark.parametrize(("leftwards", "upside_down"), [(False, False), (True, True)])
def test_beams_run_clockwise_where_that_is_said_or_the_scanner_hangs_upside_down(tmp_path, leftwards, upside_down):
    at = made.pose3([0.0, 0.0, 0.5], upside_down=upside_down)
    log = read_laser(laid(tmp_path, made.scan(T0, RANGES, leftwards=leftwards, at=at)))
    scan = log.scans[0]
    near = scan.angles()[np.argmin(np.where(scan.hit, scan.ranges, np.inf))]
    assert near == pytest.approx(np.pi / 2, abs=1e-6)


@pytest.mark.parametrize("version", [6, 7])
def test_increments_sum_to_the_odometry_of_the_scans(tmp_path, version):
    step = np.array([0.5, 0.0, 0.3])
    parts = [made.frame(made.scan(T0, RANGES))]
    for k in range(1, 4):
        done = made.actions(made.moved(step, T0 + k - 0.5, version=version))
        parts += [done, made.frame(made.scan(T0 + k, RANGES))]
    log = read_laser(laid(tmp_path, *parts))
    there = [np.zeros(3)]
    for _ in range(3):
        there.append(se2.compose(there[-1], step))
    np.testing.assert_allclose([scan.odometry for scan in log.scans], there, atol=1e-12)


def test_odometry_of_its_own_is_held_at_its_stamps_and_what_is_not_read_is_listed(tmp_path):
    image = made.made("CObservationImage", 4, bytes(range(256)) * 3)
    parts = []
    for k in range(5):
        parts += [made.odometry(T0 + k, [0.4 * k, 0.1, 0.0]), image, made.scan(T0 + k + 0.5, RANGES)]
    log = read_laser(laid(tmp_path, *parts))
    assert len(log.scans) == 5
    np.testing.assert_allclose(log.scans[2].odometry, [1.0, 0.1, 0.0], atol=1e-9)
    assert [(left.type, left.messages) for left in log.unused] == [("CObservationImage", 5)]


def test_a_packed_one_and_one_of_the_oldest_headers_open_whatever_they_are_called(tmp_path):
    parts = made.frame(made.scan(T0, RANGES))
    packed = laid(tmp_path, gzip.compress(parts), name="a.bin")
    assert is_laser_log(packed)
    assert len(read_laser(packed).scans) == 1
    old = made.made(
        "CObservationOdometry", 0, made.pose2([1.0, 2.0, 0.5], old=True) + made.text("x") + made.stamp(T0), old=True
    )
    log = read_laser(laid(tmp_path, old, made.scan(T0, RANGES), name="b.bin"))
    np.testing.assert_allclose(log.scans[0].odometry, [1.0, 2.0, 0.5])


def test_of_one_cut_short_what_is_whole_is_used_and_told(tmp_path):
    parts = b"".join(made.frame(made.scan(T0 + k, RANGES)) for k in range(3))
    log = read_laser(laid(tmp_path, parts[:-300]))
    assert len(log.scans) == 2
    assert [f.code for f in log.findings if f.code == "log-short"] == ["log-short"]


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        (
            [made.made("CObservationImage", 4, bytes(9))],
            r"ranges to beacons, found CObservationImage \(1\)",
        ),
        (
            [made.scan(T0, RANGES, version=8).replace(b"Scan\x08", b"Scan\x2a")],
            "RangeScan of version 8 at most, found 42",
        ),
        ([made.scan(T0, RANGES)[:900] + made.scan(T0 + 1, RANGES)[:200] + made.scan(T0 + 2, RANGES)], "byte"),
        ([made.scan(T0, RANGES, at=made.pose3([0, 0, 0], pitch=0.5))], r"found scanner not level \(1\)"),
        ([made.scan(T0, RANGES)[:100]], "expected 2D scans"),
    ],
)
def test_what_cannot_be_read_is_one_clear_error_that_names_the_file(tmp_path, parts, told):
    with pytest.raises(mapweave.MapweaveError, match=told) as error:
        read_laser(laid(tmp_path, *parts))
    assert "drive.rawlog" in str(error.value)
    assert "\n" not in str(error.value)


def beacons_drive(tmp_path):
    """A drive round a square among four beacons, ranges with noise from an antenna ahead of the middle."""
    rng = np.random.default_rng(3)
    beacons = {1: (-2.0, -2.0), 2: (9.0, -1.0), 3: (8.0, 9.0), 4: (-3.0, 7.0)}
    pose, parts, step = np.zeros(3), [], np.array([0.2, 0.0, 0.0])
    for k in range(160):
        turn = np.pi / 2 if k % 30 == 29 else 0.0
        motion = np.array([*step[:2], turn])
        pose = se2.compose(pose, motion)
        antenna = se2.act(pose, np.array([0.16, 0.0]))
        rows = [(b, np.hypot(*(antenna - at)) + 0.05 * rng.standard_normal()) for b, at in beacons.items()]
        t = T0 + 0.5 * k
        parts += [made.actions(made.moved(motion, t)), made.frame(made.ranges(t, rows))]
    return laid(tmp_path, *parts), beacons


def test_ranges_of_a_rawlog_without_scans_place_its_beacons(tmp_path):
    path, beacons = beacons_drive(tmp_path)
    assert is_rawlog_of_ranges(path)
    log = read_rawlog_ranges(path)
    np.testing.assert_allclose(log.antennas["robot1"], [0.16, 0.0])
    result = mapweave.map(path)
    placed = result.maps[0].landmarks
    T = se2.align(np.array([beacons[int(name[6:])] for name in placed.ids]), placed.mean)
    off = se2.act(T, np.array([beacons[int(name[6:])] for name in placed.ids])) - placed.mean
    assert np.abs(off).max() < 0.1


def test_ranges_from_several_places_of_the_robot_and_without_odometry_are_refused(tmp_path):
    far = laid(
        tmp_path,
        made.moved([1, 0, 0], T0),
        made.ranges(T0, [(1, 2.0)]),
        made.moved([1, 0, 0], T0 + 1),
        made.ranges(T0 + 1, [(1, 2.0)], (0.5, 0, 0)),
    )
    with pytest.raises(ReaderError, match="expected one antenna on the robot"):
        read_rawlog_ranges(far)
    with pytest.raises(ReaderError, match="expected odometry beside ranges, found 0 poses"):
        read_rawlog_ranges(laid(tmp_path, made.ranges(T0, [(1, 2.0)])))
