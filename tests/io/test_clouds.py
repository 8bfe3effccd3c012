"""Point clouds and scans of several echoes, as scans."""

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.io.clouds import floor_of, points_of
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.mcap import write_mcap

from .made_clouds import ABOVE_FLOOR, cloud_bag
from .ros_logs import Recording, usual, wall


@pytest.fixture(scope="module")
def drive():
    return mapweave.simulate_laser(seed=1, world=mapweave.OfficeConfig(rooms=2, visited=1))


@pytest.mark.parametrize(("name", "degrees"), [("a.bag", 0.0), ("a.mcap", 3.0), ("a.db3", -3.0)])
def test_a_slice_of_many_rings_is_what_a_plane_scanner_sees_level_or_tilted(tmp_path, drive, name, degrees):
    log = read_laser(cloud_bag(tmp_path / name, drive.log, lean=np.deg2rad(degrees)))
    assert len(log.scans) == len(drive.log.scans)
    for mine, theirs in zip(log.scans[::9], drive.log.scans[::9], strict=True):
        beam = np.rint((theirs.angles() - mine.angle_min) / mine.angle_increment).astype(int) % len(mine.ranges)
        near = theirs.hit & (theirs.ranges < 20)
        assert mine.hit[beam][near].mean() > 0.95
        assert np.quantile(np.abs(mine.ranges[beam] - theirs.ranges)[near & mine.hit[beam]], 0.9) < 0.01
        assert np.allclose(mine.T_robot_sensor, theirs.T_robot_sensor)
    tilted = [f.value for f in log.findings if f.code == "scanner-tilted"]
    assert tilted == ([pytest.approx(3.0, abs=0.1)] if degrees else [])
    assert any("from 0.20 to 1.10 m above the floor" in w for w in log.warnings)


def off_truth(track, truth):
    """Greatest distance [m] from the way that was driven, seen from the first pose."""
    true = se2.interpolate(track.t, truth.t, truth.pose)
    e = se2.between(se2.between(true[0], true), se2.between(track.pose[0], track.pose))
    return np.hypot(e[:, 0], e[:, 1]).max()


@pytest.mark.slow
def test_the_map_of_clouds_is_that_of_scans(tmp_path, drive):
    write_mcap(tmp_path / "scans.mcap", drive.log)
    laser = mapweave.LaserOptions(feature="none")
    a = mapweave.map(tmp_path / "scans.mcap", laser=laser).maps[0].track
    assert off_truth(a, drive.truth) < 0.1
    apart = []
    for seed in range(3):
        bag = cloud_bag(tmp_path / f"clouds{seed}.mcap", drive.log, seed=seed)
        of_clouds = mapweave.map(bag, tmp_path / f"out{seed}", laser=laser)
        b = of_clouds.maps[0].track
        apart.append(np.hypot(*se2.between(se2.interpolate(b.t, a.t, a.pose), b.pose)[:, :2].T).max())
        assert off_truth(b, drive.truth) < 0.22
        assert of_clouds.verdict == "good"
    assert np.mean(apart) < 0.15  # each is as far from the truth


def test_a_cloud_without_a_floor_is_cut_about_the_scanner_or_as_told(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    a = np.linspace(-3, 3, 300)
    heights = np.array([-0.7, -0.2, 0.3, 0.9])
    away = np.array([1.0, 2.0, 3.0, 0.5])
    ring = [
        np.column_stack([r * np.cos(a), r * np.sin(a), np.full(300, z)]) for r, z in zip(away, heights, strict=True)
    ]
    out.tf(1.0, "base_link", "lidar", z=1.0, topic="/tf_static")
    for k in range(3):
        out.odom(1.0 + k, 0.0)
        out.cloud(1.0 + k, np.concatenate(ring))
    path = out.write()
    for height, nearest in {None: 2.0, (1.2, 1.4): 3.0, (0.0, 3.0): 0.5}.items():
        scan = read_laser(path, "1", LaserSource(height=height)).scans[0]
        assert scan.ranges[scan.hit] == pytest.approx(nearest, abs=1e-5), height
        assert len(np.unique(np.rint(a / scan.angle_increment))) - 2 <= scan.hit.sum() <= 300


def test_a_camera_without_a_transform_looks_ahead_along_its_z(tmp_path):
    out = Recording(tmp_path / "a.db3")
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(-0.3, 0.3, 20))
    out.cloud(1.0, np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)]), frame="camera_depth_optical_frame")
    scan = read_laser(out.write()).scans[0]
    seen = scan.angles()[scan.hit]
    assert np.abs(np.arctan2(np.sin(seen), np.cos(seen))).max() == pytest.approx(np.arctan2(0.5, 2.0), abs=0.02)
    assert np.allclose((scan.ranges * np.cos(scan.angles()))[scan.hit], 2.0, atol=0.01)


def test_points_that_are_no_numbers_and_either_order_of_bytes_are_read(tmp_path):
    a = np.linspace(-1.0, 1.0, 200)
    p = np.column_stack([4 * np.cos(a), 4 * np.sin(a), 0 * a, a + 2])
    p[::4, 1] = np.nan
    p[1::8, 2] = np.inf
    out = Recording(tmp_path / "a.mcap")
    out.cloud(1.0, p, names="xyzi", big=True)
    out.cloud(2.0, p[:, :2], names="xy", is_dense=False)
    out.cloud(3.0, np.zeros((0, 3)))
    log = read_laser(out.write())
    assert [scan.hit.sum() for scan in log.scans] == [125, 150, 0]
    assert np.allclose(log.scans[0].ranges[log.scans[0].hit], 4.0, atol=1e-4)


@pytest.mark.parametrize(
    "wrong", [{"width": 2**31}, {"point_step": 4}, {"point_step": 0}, {"data": np.zeros(7, np.uint8)}]
)
def test_a_cloud_that_does_not_hold_what_it_announces_is_dropped_and_counted(tmp_path, wrong):
    out = Recording(tmp_path / "a.mcap")
    p = np.column_stack([*wall(0)[None], *wall(1)[None], 0 * wall(0)])
    out.cloud(1.0, p, **wrong)
    with pytest.raises(ReaderError, match=r"/points: (expected|fields)"):
        read_laser(out.write())
    out = Recording(tmp_path / "b.mcap")
    for k in range(4):
        out.cloud(1.0 + k, p, **(wrong if k == 2 else {}))
    log = read_laser(out.write())
    assert (len(log.scans), log.dropped) == (3, {"cloud that does not hold what it announces": 1})


def test_clouds_without_x_and_y_are_one_error_that_says_what_there_is(tmp_path):
    out = Recording(tmp_path / "a.db3")
    out.cloud(1.0, np.ones((5, 2)), names=("range", "azimuth"))
    with pytest.raises(ReaderError, match=r"/points: expected fields x and y, found azimuth, range$"):
        read_laser(out.write())


def test_two_million_points_are_one_scan(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    rng = np.random.default_rng(0)
    a = rng.uniform(-np.pi, np.pi, 2_000_000)
    out.cloud(1.0, np.column_stack([5 * np.cos(a), 5 * np.sin(a), rng.uniform(-2, 2, len(a))]))
    scan = read_laser(out.write()).scans[0]
    assert len(scan.ranges) <= 3600
    assert np.allclose(scan.ranges[scan.hit], 5.0, atol=1e-4)
    assert scan.hit.mean() > 0.99


def test_beside_a_scan_clouds_are_left_aside_unless_chosen_and_said_so(tmp_path):
    out = usual(tmp_path / "a.mcap")
    for k in range(30):
        out.cloud(10.0 + 0.1 * k, [[1.0, 0.1 * k, 0.0]])
    path = out.write()
    log = read_laser(path)
    assert [(u.topic, u.messages) for u in log.unused] == [("/points", 30)]
    assert "--scan-topic /points" in log.unused[0].reason
    assert read_laser(path, "1", LaserSource(scan_topic="/points")).scans[0].hit.sum() == 1


def test_of_several_echoes_the_first_counts(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    for k in range(3):
        out.odom(1.0 + k, 0.0)
        out.echoes(1.0 + k, [[2.0, 4.0], [], [3.0]])
    scan = read_laser(out.write()).scans[0]
    assert scan.hit.tolist() == [True, False, True]
    assert np.allclose(scan.ranges[scan.hit], [2.0, 3.0])


def test_no_floor_is_seen_at_the_foot_of_walls():
    a = np.linspace(-np.pi, np.pi, 720)
    r = 2.0 / np.maximum(np.abs(np.cos(a)), np.abs(np.sin(a)))  # a square room, and rings that meet its walls alone
    rings = [np.column_stack([r * np.cos(a), r * np.sin(a), r * np.tan(np.deg2rad(e))]) for e in (-9, -6, -3, 0)]
    assert floor_of(np.concatenate(rings)) is None
    x, y = np.random.default_rng(0).uniform(-5, 5, (2, 3000))
    turn, height = floor_of(np.concatenate([*rings, np.column_stack([x, y, np.full(3000, -ABOVE_FLOOR)])]))
    assert height == pytest.approx(-ABOVE_FLOOR, abs=1e-3)
    assert np.allclose(turn, np.eye(3), atol=1e-3)


def test_a_row_of_an_image_may_be_longer_than_its_points(tmp_path):
    out = Recording(tmp_path / "a.mcap")
    whole = np.zeros((2, 5, 3), np.float32)
    whole[:, :3] = np.arange(18).reshape(2, 3, 3)
    out.cloud(1.0, whole.reshape(-1, 3), height=2, width=3, row_step=60)
    points, light = points_of(out.rows[0][3])
    assert light is None
    assert np.array_equal(points, np.arange(18.0).reshape(6, 3))
