"""Mixed teams: what each robot carries, what is wrong in what it says, and files that readers know."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import UsageError
from mapweave.core.fixes import enu_of
from mapweave.core.walls import Walls
from mapweave.io.landmark_logs import read_tables
from mapweave.io.landmark_truth import read_survey
from mapweave.io.laser_logs import read_laser
from mapweave.sim.landmarks import Drive
from mapweave.sim.laser import DATUM
from mapweave.sim.mixed_team import MixedWorld, simulate_mixed

SMALL = MixedWorld(lasers=1, cameras=1, bearing_cameras=1, bearings=1, landmarks=6, minutes=0.7)


def errors(robot, made, drop=()):
    """Range and bearing errors of all sightings, with the calibration taken off; ids in `drop` left out."""
    truth = {r.name: r.truth for r in made.robots}
    own = se2.interpolate(robot.seen.t, robot.truth.t, robot.truth.pose)
    places = []
    for t, name in zip(robot.seen.t, robot.seen.ids, strict=True):
        if name in made.landmarks:
            places.append(made.landmarks[name])
        else:
            places.append(se2.interpolate(np.array([t]), truth[name].t, truth[name].pose)[0, :2])
    d = np.array(places) - own[:, :2]
    bearing = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - own[:, 2] + robot.drive.bearing_bias - robot.seen.bearing)
    return robot.drive.range_scale * np.hypot(*d.T) - robot.seen.range, bearing


def test_every_robot_tells_what_it_carries():
    laser, camera, directed, bearings = simulate_mixed(SMALL, 3).robots
    assert laser.laser is not None
    assert not len(laser.seen.t)
    assert laser.commands is None
    assert np.isfinite(camera.seen.range).all()
    assert camera.commands is not None
    assert {name[0] for name in camera.seen.ids} == {"L", "r"}
    assert np.isnan(directed.seen.range).all()
    assert {name[0] for name in directed.seen.ids} == {"L", "r"}
    assert bearings.commands is None
    assert all(name.startswith("robot") for name in bearings.seen.ids)
    assert np.isnan(bearings.seen.range).all()


def test_sightings_scatter_round_the_truth_as_told():
    made = simulate_mixed(MixedWorld(lasers=1, cameras=2, bearings=0, minutes=2.0, calibration="random"), 5)
    for robot in made.robots[1:]:
        r, b = errors(robot, made)
        assert np.sqrt(np.mean(b**2)) == pytest.approx(0.014, rel=0.35)
        assert 0.05 < np.sqrt(np.mean(r**2)) < 0.5
        assert abs(robot.drive.turn_scale - 1) < 0.31


def test_the_share_of_wrong_sightings_is_the_one_asked_for():
    made = simulate_mixed(MixedWorld(lasers=0, cameras=2, bearings=0, minutes=3.0, outliers=0.3), 2)
    for robot in made.robots:
        r, b = errors(robot, made)
        wrong = (np.abs(r) > 1.0) | (np.abs(b) > 0.1)
        assert 0.2 < wrong.mean() < 0.33  # some are wrong by little


def test_carrying_more_changes_nothing_else():
    plain, full = (simulate_mixed(world, 4) for world in (SMALL, replace(SMALL, everything=True)))
    for a, b in zip(plain.robots, full.robots, strict=True):
        np.testing.assert_array_equal(a.truth.pose, b.truth.pose)
        assert b.laser is not None
        assert b.commands is not None
    np.testing.assert_array_equal(plain.robots[1].seen.range, full.robots[1].seen.range)
    np.testing.assert_array_equal(plain.robots[0].laser.scans[5].ranges, full.robots[0].laser.scans[5].ranges)


def test_lasers_in_two_rooms_see_no_wall_of_the_other():
    made = simulate_mixed(MixedWorld(lasers=2, cameras=1, bearings=0, rooms=2, minutes=0.5), 1)
    middle = 0.5 * (made.walls.segments[:, [0, 2]].min() + made.walls.segments[:, [0, 2]].max())
    for k, side in ((0, -1), (1, 1)):
        log, truth = made.robots[k].laser, made.robots[k].truth
        for i in range(0, len(log.scans), 10):
            scan = log.scans[i]
            pose = se2.interpolate(log.scan_t[i : i + 1], truth.t, truth.pose)[0]
            angle = scan.angles()[scan.hit]
            hits = se2.act(pose, scan.ranges[scan.hit][:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
            assert (side * (hits[:, 0] - middle) > 0).all()
            assert np.median(Walls.of(made.walls.segments).clearance(hits)) < 0.1


def test_files_read_back_as_they_were_simulated(tmp_path):
    made = mapweave.simulate_team(
        tmp_path / "t", lasers=1, cameras=1, bearing_cameras=1, bearings=1, landmarks=6, minutes=0.7, seed=3
    )
    again = mapweave.simulate_team(
        tmp_path / "u", lasers=1, cameras=1, bearing_cameras=1, bearings=1, landmarks=6, minutes=0.7, seed=3
    )
    assert again.summary() == made.summary()
    for path in sorted((tmp_path / "t").rglob("*.*")):
        assert path.read_bytes() == (tmp_path / "u" / path.relative_to(tmp_path / "t")).read_bytes(), path.name
    logs = read_tables(tmp_path / "t" / "odometry.csv", tmp_path / "t" / "sightings.csv", ["robot1"])
    assert [log.robot for log in logs] == ["robot2", "robot3", "robot4"]
    for log, robot in zip(logs, made.robots[1:], strict=True):
        assert len(log.sightings) + len(log.bearings) == len(robot.seen.t)
        assert (log.odometry is None) == (robot.commands is None)
        assert np.isnan(log.bearings.range).all()
    scans = read_laser(tmp_path / "t" / "robot1.mcap", "1")
    np.testing.assert_array_equal(scans.scans[3].ranges, made.robots[0].laser.scans[3].ranges)
    assert read_survey(tmp_path / "t" / "truth").ids == tuple(made.landmarks)


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ({"lasers": 0, "cameras": 0, "bearings": 0}, "needs a robot"),
        ({"minutes": 0.0}, "--minutes"),
        ({"outliers": 1.5}, "--outliers"),
        ({"rooms": 0}, "--rooms"),
        ({"bearing_cameras": -1}, "--bearing-cameras"),
        ({"clock": float("nan")}, "--clock"),
        ({"lasers": 0, "fixes": 1.0}, "--fixes"),
    ],
)
def test_a_team_that_cannot_be_is_refused(option, word):
    with pytest.raises(UsageError, match=word):
        MixedWorld(**option).check()


def test_drives_tell_what_nobody_told_the_robot():
    made = simulate_mixed(MixedWorld(lasers=0, cameras=1, bearings=0, minutes=0.5, bias=0.0), 1)
    drive = made.robots[0].drive
    assert isinstance(drive, Drive)
    assert (drive.speed_scale, drive.turn_scale, drive.lag, drive.bearing_bias, drive.range_scale) == (1, 1, 0, 0, 1)


def test_receivers_change_nothing_that_robots_measure_and_tell_where_they_are_on_earth(tmp_path):
    kinds = {"lasers": 1, "cameras": 1, "bearings": 0, "landmarks": 5, "minutes": 0.5, "clock": 2.0, "seed": 4}
    plain, made = mapweave.simulate_team(**kinds), mapweave.simulate_team(tmp_path / "t", **kinds, fixes=0.1)
    laser, camera = made.robots
    assert camera.fixes is None
    np.testing.assert_array_equal(laser.laser.scans[3].ranges, plain.robots[0].laser.scans[3].ranges)
    np.testing.assert_array_equal(camera.seen.bearing, plain.robots[1].seen.bearing)
    T = se2.compose(laser.truth.pose[0], se2.inverse(plain.robots[0].truth.pose[0]))
    for name, at in plain.landmarks.items():
        np.testing.assert_allclose(se2.act(T, np.array(at)), made.landmarks[name], atol=1e-9)
    ends = plain.walls.segments.reshape(-1, 2)
    np.testing.assert_allclose(se2.act(T, ends), made.walls.segments.reshape(-1, 2), atol=1e-9)
    fixes = read_laser(tmp_path / "t" / "robot1.mcap", "1").fixes
    true = se2.interpolate(fixes.t - laser.clock, laser.truth.t, laser.truth.pose)[:, :2]
    off = np.hypot(*(enu_of(fixes.place, DATUM)[:, :2] - true).T)
    assert abs(laser.clock) > 0.1
    assert np.median(off) < 0.2


@pytest.mark.parametrize("sd", [0.0, -1.0, float("nan")])
def test_receivers_without_noise_are_refused(sd):
    with pytest.raises(UsageError, match="--fixes"):
        mapweave.simulate_team(ranges=True, fixes=sd)
