"""`mapweave localize`: a robot found and followed in a finished map, with and without intensity."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.localize import localize
from mapweave.api.map import map as map_logs
from mapweave.api.map_options import LaserOptions
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.core.errors import ConfigError, ReaderError, UsageError
from mapweave.core.records import Track
from mapweave.io.mcap import write_mcap
from mapweave.io.tum import read_tum, write_tum
from mapweave.sim.laser import DriftConfig, DriveConfig, Route, drive
from mapweave.sim.laser_worlds import CorridorConfig, corridor_world

DRIVE = DriveConfig(drift=DriftConfig(end_error=None))
RING = CorridorConfig(long_leg=24.0, short_leg=12.0, start=6.0, drive=DRIVE)


def along(start, length):
    """A drive along the first leg of the ring from x = `start`, metres, with noise of its own."""
    route = Route(np.array([start, 0.0, 0.0]), np.array([length]), np.array([0.0]))
    return drive(corridor_world(RING, 4), route, DRIVE, seed=50 + int(start))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """The map of a drive down the first leg, and a second drive with its true poses in the map's frame."""
    folder = tmp_path_factory.mktemp("localize")
    write_mcap(folder / "first.mcap", along(0.0, 14.0).log)
    map_logs(folder / "first.mcap", folder / "map", method="gated")
    second = along(5.0, 7.0)
    write_mcap(folder / "second.mcap", second.log)
    write_tum(folder / "second.truth.tum", second.truth)
    return folder


def test_a_robot_is_found_anywhere_in_the_map_and_followed(world):
    out = world / "out"
    truth = str(world / "second.truth.tum")
    words = ["localize", str(world / "second.mcap"), "--map", str(world / "map"), "--out", str(out), "--truth", truth]
    assert _run(words) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    told = metrics["localisation"]
    assert (told["start"], told["found"], told["trusted"], told["doubt"]) == ("global", True, True, None)
    assert told["evidence"]["light"] > 0.5
    assert told["evidence"]["explained"] > 0.9
    assert told["found_after_scans"] <= 15
    assert metrics["evaluation"]["right"] is True
    assert metrics["evaluation"]["position_rmse"] < 0.2
    assert metrics["timing"]["global_start"] > 0
    track = read_tum(out / "trajectories" / "robot1.tum")
    assert np.allclose(track.t, read_tum(world / "second.truth.tum").t, atol=1e-6)
    assert (out / "report.html").is_file()
    assert (out / "scans.csv").is_file()


def test_the_same_seed_gives_the_same_answer(world):
    a, b = (localize(world / "second.mcap", world / "map", seed=3).localisation.track.pose for _ in range(2))
    assert np.array_equal(a, b)


def test_a_given_start_is_used_at_once(world):
    found = localize(world / "second.mcap", world / "map", start=(5.0, 0.0, 0.0)).localisation
    assert (found.start, found.found_scans, found.trusted) == ("given", 1, True)
    assert np.abs(found.track.pose[-1] - [12.0, 0.0, 0.0]).max() < 0.2


def test_what_is_believed_is_a_setting_of_the_table_localize(world, tmp_path):
    strict = tmp_path / "strict.toml"
    strict.write_text("[localize.trust]\nleast_explained = 1.01\n")
    found = localize(world / "second.mcap", world / "map", start=(5.0, 0.0, 0.0), config=strict).localisation
    assert (found.start, found.trusted) == ("given", False)
    strict.write_text("[localize]\nleast_explained = 1.01\n")
    with pytest.raises(ConfigError, match=r"localize.least_explained: unknown key"):
        localize(world / "second.mcap", world / "map", config=strict)


def test_along_a_flush_corridor_intensity_finds_the_start_and_geometry_alone_does_not_know(world):
    truth = world / "second.truth.tum"
    bare = localize(world / "second.mcap", world / "map", truth=truth, laser=LaserOptions(feature="none"))
    assert bare.localisation.feature == "none"
    assert bare.score.right is not True
    assert localize(world / "second.mcap", world / "map", truth=truth).score.right is True


def test_a_robot_somewhere_else_is_not_trusted(world, tmp_path):
    from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

    office = simulate_office(OfficeConfig(rooms=2, visited=1, drive=DRIVE), 1)
    write_mcap(tmp_path / "office.mcap", office.log)
    result = localize(tmp_path / "office.mcap", world / "map")
    assert not result.localisation.trusted
    told = result.metrics["localisation"]
    assert (told["trusted"], told["doubt"]) == (False, result.localisation.doubt)
    assert "not to be trusted" in result.lines()[1] or "not found" in result.lines()[0]


def test_a_place_that_does_not_explain_the_scans_is_given_up_and_sought_anew(world):
    from mapweave.io.laser_logs import read_laser
    from mapweave.io.laser_map import read_grid
    from mapweave.laser.localise import LocaliseConfig, localise
    from mapweave.mapping.config import LaserConfig

    grid, calibration, feature = read_grid(next((world / "map").glob("grid.npz")))
    log = read_laser(world / "second.mcap")
    runs = [
        localise(log, grid, calibration, feature, LaserConfig(), None, np.random.default_rng(0), quiet, how)
        for how in (LocaliseConfig(), LocaliseConfig(trusted=1.01))  # nothing explains more than all of a scan
    ]
    assert not any("given up" in told for told in runs[0].warnings)
    assert any("given up" in told for told in runs[1].warnings)
    assert not runs[1].trusted


def quiet(stage, done, total=None):
    pass


def test_a_log_without_intensity_or_odometry_is_followed_all_the_same_and_says_so(world, tmp_path):
    second = along(5.0, 7.0).log
    scans = tuple(replace(scan, intensities=None, odometry=None) for scan in second.scans)
    write_mcap(tmp_path / "bare.mcap", replace(second, scans=scans, odometry=None))
    found = localize(tmp_path / "bare.mcap", world / "map", start=(5.0, 0.0, 0.0)).localisation
    assert found.feature == "none"
    assert any("intensity of returns is not used" in w for w in found.warnings)
    assert any("no odometry" in w for w in found.warnings)
    assert np.isfinite(found.track.pose).all()
    assert np.abs(found.track.pose[:, 1]).max() < 0.3


def test_scores_against_the_truth_are_not_aligned(world):
    from mapweave.api.localize import score_start

    found = localize(world / "second.mcap", world / "map", start=(5.0, 0.0, 0.0)).localisation
    moved = Track(found.track.t, se2.compose(np.array([2.0, 0, 0]), found.track.pose))
    assert score_start(found, found.track).right is True
    assert score_start(found, moved).right is False
    assert score_start(found, moved).position_rmse == pytest.approx(2.0)


@pytest.mark.parametrize("lit", [True, False])
def test_scans_handed_over_one_by_one_are_placed_as_those_of_their_log(world, lit):
    import mapweave

    log = along(5.0, 7.0).log
    if not lit:
        log = replace(log, scans=tuple(replace(scan, intensities=None) for scan in log.scans))
    where = mapweave.Localizer(world / "map", start=(5.0, 0.0, 0.0), seed=3)
    assert where.doubt() == "the start was not found"
    assert np.isinf(where.pose.cov).all()
    poses = []
    for t, scan in zip(log.scan_t, log.scans, strict=True):
        told = {"odometry": scan.odometry, "range_max": scan.range_max, "sensor_pose": scan.T_robot_sensor}
        pose, cov = where.add_scan(t, scan.ranges, scan.angles(), intensities=scan.intensities, **told)
        poses.append(pose)
        assert np.linalg.eigvalsh(cov).min() > 0
    assert where.found
    assert where.doubt() == ""
    whole = localize(log, world / "map", start=(5.0, 0.0, 0.0), seed=3).localisation
    placed = np.flatnonzero(np.array(whole.scans.decision) == "matched")
    np.testing.assert_allclose(np.array(poses)[placed], whole.scans.pose[placed], atol=1e-9)
    with pytest.raises(mapweave.DataError, match="expected a stamp after the last"):
        where.add_scan(log.scan_t[0], scan.ranges, scan.angles(), odometry=scan.odometry, intensities=scan.intensities)


def test_a_localizer_says_what_map_or_start_cannot_be(world, tmp_path):
    import mapweave

    with pytest.raises(UsageError, match=r"--start: expected x,y,theta, found 1.0, nan, 0.0"):
        mapweave.Localizer(world / "map", start=(1.0, float("nan"), 0.0))
    (tmp_path / "bare.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes([254] * 16))
    (tmp_path / "bare.yaml").write_text("image: bare.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    with pytest.raises(mapweave.DataError, match="no cell of the map is occupied"):
        mapweave.Localizer(tmp_path / "bare.yaml")
    (tmp_path / "bare.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes(16))
    with pytest.raises(mapweave.DataError, match="no free place"):
        mapweave.Localizer(tmp_path / "bare.yaml")


def turned_yaml(folder, turn):
    """`folder/map.yaml` seen from a frame that is turned and moved, and the pose of the old frame in it."""
    text = (folder / "map.yaml").read_text()
    x, y, _ = json.loads(text.split("origin: ")[1].splitlines()[0])
    T = np.array([3.0, -2.0, turn])
    origin = se2.compose(T, np.array([x, y, 0.0]))
    lines = [f"origin: {origin.tolist()}" if line.startswith("origin") else line for line in text.splitlines()]
    (folder / "turned.yaml").write_text("\n".join(lines))
    return folder / "turned.yaml", T


def test_a_robot_is_followed_in_the_map_of_a_map_server_whatever_its_heading(world):
    truth = read_tum(world / "second.truth.tum")
    for turn in (0.0, 0.7):
        path, T = turned_yaml(world / "map", turn)
        start = se2.compose(T, np.array([5.0, 0.0, 0.0]))
        there = Track(truth.t, se2.compose(T, truth.pose))
        found = localize(world / "second.mcap", path, start=start.tolist(), truth=there)
        assert (found.localisation.feature, found.score.right) == ("none", True)
        back = se2.compose(se2.inverse(T), found.localisation.track.pose)
        across = back[:, 1] - se2.interpolate(found.localisation.track.t, truth.t, truth.pose)[:, 1]
        assert np.abs(across).max() < 0.15  # along itself a bare corridor holds nobody


@pytest.mark.slow
def test_a_robot_is_found_in_the_floor_that_another_program_mapped(data, tmp_path):
    import gzip

    name = "mac_1st_floor_final"
    (tmp_path / "map.yaml").write_text((data / "bags" / f"{name}.yaml").read_text())
    (tmp_path / f"{name}.pgm").write_bytes(gzip.decompress((data / "bags" / f"{name}.pgm.gz").read_bytes()))
    own = map_logs(data / "bags" / "turtlebot4.db3").maps[0].track
    found = localize(data / "bags" / "turtlebot4.db3", tmp_path / "map.yaml").localisation
    assert found.found_t is not None
    pose = se2.interpolate(found.track.t, own.t, own.pose)[:, :2]
    off = se2.act(se2.align(pose, found.track.pose[:, :2]), pose) - found.track.pose[:, :2]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.025


def test_a_start_may_begin_with_a_minus(world, capsys):
    words = ["localize", str(world / "second.mcap"), "--map", str(world / "map"), "--out", str(world / "minus")]
    assert _run([*words, "--start", "-0.5,0,0", "--sensor-pose", "-0.1,0,0"]) == 0
    assert "the start was given" in capsys.readouterr().out


def test_a_folder_without_a_map_and_a_feature_the_map_does_not_hold_are_told(world, tmp_path):
    with pytest.raises(ReaderError, match=r"expected a laser map with grid\.npz"):
        localize(world / "second.mcap", tmp_path)
    with pytest.raises(UsageError, match="--feature raw: the map holds normalised"):
        localize(world / "second.mcap", world / "map", laser=LaserOptions(feature="raw"))
    with pytest.raises(UsageError, match="--start"):
        localize(world / "second.mcap", world / "map", start=(1.0, 2.0))
