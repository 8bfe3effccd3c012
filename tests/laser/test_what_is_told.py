"""Logs handed over with a mistake: the map says which, with the number found; a right log is mapped without a word."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.errors import DataError
from mapweave.core.findings import verdict
from mapweave.core.records import Track
from mapweave.io.assemble import RawLog, RawScan
from mapweave.laser.log_warnings import wheels_unlike
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import CorridorConfig, OfficeConfig, simulate_corridor, simulate_office

CFG = LaserConfig(method="graph", feature="none")


@pytest.fixture(scope="module")
def office():
    return simulate_office(OfficeConfig(rooms=2, visited=2), 5).log


def found(log, change=lambda scan: scan, rows=lambda rows: rows):
    """What is found, by code, when each scan and the rows of odometry are changed before the log is read."""
    raw = RawLog("1", "office", "")
    for t, scan in zip(log.scan_t.tolist(), log.scans, strict=True):
        ranges = np.where(scan.hit, scan.ranges, np.inf)
        mount, far = scan.T_robot_sensor, scan.range_max
        raw.scans.append(
            change(RawScan(t, ranges, None, scan.angle_min, scan.angle_increment, 0.0, far, mount, odometry=None))
        )
    raw.odometry = rows([tuple(row) for row in np.column_stack([log.odometry.t, log.odometry.pose]).tolist()])
    findings = map_laser(raw.finish(), CFG, 0).findings
    assert {f.robot for f in findings} <= {"1"}
    return {f.code: f for f in findings}


def test_nothing_is_found_in_a_right_log(office):
    assert found(office) == {}


@pytest.mark.parametrize("factor", [0.8, pytest.param(1.2, marks=pytest.mark.slow)])
def test_ranges_of_another_scale_are_told_with_the_factor(office, factor):
    said = found(office, lambda raw: replace(raw, ranges=factor * raw.ranges, range_max=factor * raw.range_max))
    assert said["wheels-scale"].value["value"] == pytest.approx(factor, abs=0.06)
    assert "wheels-disagree" not in said
    assert verdict(said.values()) == "doubtful"


@pytest.mark.parametrize("degrees", [8, pytest.param(20, marks=pytest.mark.slow)])
def test_a_scanner_mounted_turned_is_told_once_with_the_angle_and_mapped_as_it_stands(office, degrees):
    said = found(office, lambda raw: replace(raw, T_robot_sensor=np.array([0.0, 0.0, np.radians(degrees)])))
    assert set(said) == {"wheels-calibrated"}
    assert "the scanner turned left by" in said["wheels-calibrated"].text
    assert verdict(said.values()) == "good"


def test_angles_between_beams_that_are_wrong_are_told_by_walls_that_are_bent(office):
    wide = lambda raw: replace(raw, angle_min=1.1 * raw.angle_min, angle_increment=1.1 * raw.angle_increment)
    said = found(office, wide)
    assert said["beams-apart"].value["value"] == pytest.approx(1.1, abs=0.03)
    assert verdict(said.values()) == "bad"


def test_wheels_that_turn_too_far_are_told_by_walls_that_are_straight_and_the_map_is_good(office):
    def turned(rows):
        poses = np.array([row[1:] for row in rows])
        out = [poses[0]]
        for step in se2.between(poses[:-1], poses[1:]) * [1.0, 1.0, 1.2]:
            out.append(np.asarray(se2.compose(out[-1], step)))
        return [(row[0], *pose) for row, pose in zip(rows, np.array(out).tolist(), strict=True)]

    said = found(office, rows=turned)
    assert said["wheels-turns"].value["value"] == pytest.approx(1 / 1.2, abs=0.03)
    assert verdict(said.values()) == "good"


def test_scans_that_are_stamped_late_are_told_with_the_lag(office):
    said = found(office, lambda raw: replace(raw, t=raw.t + 0.5))
    late = said["wheels-calibrated"].text.split("late by ")[1]
    assert float(late.split()[0]) == pytest.approx(0.5, abs=0.01)


@pytest.mark.slow
def test_odometry_that_never_turns_or_is_another_drives_makes_a_map_bad(office):
    other = simulate_office(OfficeConfig(rooms=2, visited=2), 6).log.odometry.pose.tolist()
    for rows in (
        lambda rows: [(t, x, y, 0.0) for t, x, y, _ in rows],
        lambda rows: [(row[0], *pose) for row, pose in zip(rows, other, strict=False)],
    ):
        said = found(office, rows=rows)
        assert {"wheels-other", "beams-mirrored"} & set(said)
        assert verdict(said.values()) == "bad"


@pytest.mark.parametrize("factor", [pytest.param(1e-3, marks=pytest.mark.slow), 1e3])
def test_wheels_that_tell_a_thousandth_or_a_thousand_times_of_the_way_are_told(office, factor):
    said = found(office, rows=lambda rows: [(t, factor * x, factor * y, a) for t, x, y, a in rows])
    if factor > 1:
        assert said["wheels-fast"].value > 100.0
        assert "no-odometry" in said
        assert verdict(said.values()) != "good"
    else:
        assert "wheels-calibrated" in said


@pytest.mark.parametrize("again", [False, True])
def test_wheels_whose_pose_leaps_or_begins_anew_are_told_with_when_and_how_far(office, again):
    def leap(rows):
        half = len(rows) // 2
        if again:
            late = se2.between(
                np.array(rows[half][1:]) + np.array([0.0, 5.0, 0.0]), np.array([r[1:] for r in rows[half:]])
            )
        else:
            late = np.array([r[1:] for r in rows[half:]]) + np.array([5.0, 0.0, 0.0])
        return rows[:half] + [(r[0], *pose) for r, pose in zip(rows[half:], late.tolist(), strict=True)]

    leaped = found(office, rows=leap)["wheels-set"]
    half = office.odometry.t[len(office.odometry.t) // 2]
    assert leaped.span[0] - 0.1 <= half <= leaped.span[1] + 0.1
    assert leaped.value["times"] == 1
    assert leaped.value["value"] > 3.0


def test_a_robot_that_is_carried_to_another_room_is_told_with_the_time(office):
    first, last = 40, len(office.scans) - 40
    jump = office.scan_t[last]
    end, begin = np.array(office.scans[first].odometry), np.array(office.scans[last].odometry)

    def joined(rows):
        early = [row for row in rows if row[0] <= office.scan_t[first]]
        late = [
            (r[0], *np.asarray(se2.compose(end, se2.between(begin, np.array(r[1:]))))) for r in rows if r[0] >= jump
        ]
        return early + late

    kept = [k for k in range(len(office.scans)) if k <= first or k >= last]
    log = replace(office, scan_t=office.scan_t[kept], scans=tuple(office.scans[k] for k in kept))
    said = found(log, rows=joined)
    assert said["scene-change"].span == (pytest.approx(jump), pytest.approx(jump))
    assert verdict(said.values()) == "doubtful"


@pytest.mark.parametrize("limit", [False, True])
@pytest.mark.parametrize(("unit", "factor"), [("millimetres", 1000.0), ("centimetres", 100.0), ("inches", 39.37)])
def test_ranges_in_another_unit_are_refused_with_its_name(office, unit, factor, limit):
    def change(raw):
        return replace(raw, ranges=factor * raw.ranges, range_max=(factor if limit else 1.0) * raw.range_max)

    with pytest.raises(DataError, match=rf"office: the ranges are in {unit}: half of the ranges exceed .* expected"):
        found(office, change)


def test_a_log_of_few_scans_makes_a_map_whose_verdict_says_so(office):
    few = replace(office, scan_t=office.scan_t[:3], scans=office.scans[:3])
    said = found(few)
    assert said["few-scans"].value == 3
    assert verdict(said.values()) == "doubtful"


def test_a_robot_that_never_moves_is_mapped_and_it_is_told(office):
    n = len(office.scans)
    scans = tuple(replace(office.scans[0], odometry=np.zeros(3)) for _ in range(n))
    still = replace(office, scans=scans, odometry=Track(office.scan_t, np.zeros((n, 3)), frame="odom"))
    made = mapweave.map([still])
    assert [f.code for f in made.findings if f.code != "light-unused"] == ["robot-still"]
    assert made.verdict == made.metrics["verdict"] == "good"
    assert np.abs(made.maps[0].track.pose).max() < 0.02


def test_wide_turns_that_nothing_but_scans_tells_are_told_and_those_of_a_gyroscope_are_not(office):
    bare = replace(office, odometry=None, scans=tuple(replace(scan, odometry=None) for scan in office.scans))
    told = {f.code: f for f in map_laser(bare, CFG, 0).findings}
    assert told["turns-alone"].value["times"] >= 10
    assert 35.0 < told["turns-alone"].value["most"] < 180.0
    assert verdict(told.values()) == "doubtful"
    heading = np.interp(office.scan_t, office.odometry.t, np.unwrap(office.odometry.pose[:, 2]))
    gyro = tuple(replace(scan, heading=float(a)) for scan, a in zip(bare.scans, heading, strict=True))
    assert "turns-alone" not in {f.code for f in map_laser(replace(bare, scans=gyro), CFG, 0).findings}


@pytest.mark.parametrize(("driven", "seems"), [(25.0, "to stand"), (60.0, "short")])
def test_a_corridor_along_which_nothing_but_scans_tells_the_way_is_told_and_that_of_wheels_is_not(driven, seems):
    log = simulate_corridor(CorridorConfig(distance=driven), 5).log
    bare = replace(log, odometry=None, scans=tuple(replace(scan, odometry=None) for scan in log.scans))
    told = {f.code: f for f in map_laser(bare, CFG, 0).findings}
    assert (told["slides-alone"].value < 2.0) == (seems == "to stand")
    assert verdict(told.values()) == "doubtful"
    assert "slides-alone" not in {f.code for f in map_laser(log, CFG, 0).findings}


def test_a_short_way_along_one_wall_that_nothing_but_scans_tells_is_told():
    rng, angle = np.random.default_rng(0), -np.pi + np.radians(np.arange(360))
    raw = RawLog("1", "wall", "")
    for t in np.arange(0.0, 4.0, 0.1).tolist():  # weaving along the wall y = 0, which shows nothing of how fast
        y, heading = 0.5 - 0.1 * np.cos(0.8 * t), 0.3 * np.sin(0.8 * t)
        with np.errstate(divide="ignore"):
            r = -y / np.sin(angle + heading)
        r = np.where((r > 0) & (r < 12.0), r + 0.02 * rng.standard_normal(360), np.inf)
        raw.scans.append(RawScan(t, r, None, -np.pi, np.radians(1.0), 0.0, 12.0, np.zeros(3), odometry=None))
    told = {f.code: f for f in map_laser(raw.finish(), CFG, 0).findings}
    assert told["slides-alone"].value < 2.0
    assert verdict(told.values()) == "doubtful"


def test_a_short_way_that_the_wheels_tell_a_third_of_is_doubted():
    """As a camera's narrow view slides along one wall while the robot turns about."""
    t = 0.1 * np.arange(100)
    swings = np.column_stack([np.zeros(100), 0.8 * np.sin(t), np.zeros(100)])
    track = Track(t, swings)
    said = wheels_unlike(track, Track(t, 0.25 * swings), "1")
    assert [f.value for f in said] == [pytest.approx(4.0)]
    assert wheels_unlike(track, Track(t, 0.4 * swings), "1") == ()
    assert wheels_unlike(Track(t, 0.4 * swings), Track(t, 0.01 * swings), "1") == ()
