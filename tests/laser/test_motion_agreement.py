"""Scans that move as far as the wheels, or farther: the factor is found where walls tell it, and nowhere else."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.laser.beam import BeamConfig
from mapweave.laser.motion_agreement import (
    MOTION_LEAST,
    MOTION_TURN,
    MOTION_WAY,
    MotionAgreement,
    MotionRatio,
    _measured,
    motion_agreement,
    straight,
    ways,
)

from ..io.test_scan_agreement import drive, ranges

BEAM = BeamConfig()


def moved(scans, change=lambda step: step, noise=0.0, seed=0):
    """Poses that go on as the wheels do, each step changed and with noise [m]."""
    rng = np.random.default_rng(seed)
    wheels = np.array([scan.odometry for scan in scans])
    out = [np.zeros(3)]
    for step in se2.between(wheels[:-1], wheels[1:]):
        out.append(np.asarray(se2.compose(out[-1], change(step))))
    return np.array(out) + noise * rng.standard_normal((len(out), 3)) * [1.0, 1.0, 0.1]


def turned(step, by):
    return np.concatenate([se2.rotation(by) @ step[:2], step[2:]])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_scans_that_move_as_the_wheels_do_are_left_alone(seed):
    scans = drive(seed)
    found = motion_agreement(moved(scans, noise=0.01, seed=seed), scans, BEAM)
    assert found.scale.value == pytest.approx(1.0, abs=0.02)
    assert found.direction.value == pytest.approx(0.0, abs=0.02)
    assert found.findings("1") == ()


@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_scans_that_move_farther_or_less_far_are_told_with_the_factor_and_its_standard_error(scale):
    scans = drive(4)
    found = motion_agreement(moved(scans, lambda s: s * [scale, scale, 1.0], 0.01), scans, BEAM)
    assert abs(found.scale.value - scale) < max(4 * found.scale.sd, 0.01)
    assert 0 < found.scale.sd < 0.02
    (told,) = found.findings("1")
    assert (told.code, told.robot) == ("wheels-scale", "1")
    assert told.value == {"value": found.scale.value, "sd": found.scale.sd}


def test_scans_that_move_to_the_side_of_the_wheels_way_are_told():
    scans = drive(5)
    found = motion_agreement(moved(scans, lambda s: turned(s, -0.15), 0.01), scans, BEAM)
    assert found.direction.value == pytest.approx(-0.15, abs=0.02)
    (told,) = found.findings("1")
    angle, sd = np.degrees(-found.direction.value), np.degrees(found.direction.sd)
    assert told.code == "scanner-askew"
    assert told.value == {"degrees": pytest.approx(angle), "sd": pytest.approx(sd), "side": "right"}


def test_a_difference_that_may_be_chance_or_is_small_is_not_told():
    scans = drive(6)
    found = motion_agreement(moved(scans, lambda s: s * [1.2, 1.2, 1.0]), scans, BEAM)
    assert len(found.findings("1")) == 1
    assert replace(found, scale=replace(found.scale, sd=0.06)).findings("1") == ()
    assert replace(found, scale=replace(found.scale, value=1.04, sd=0.001)).findings("1") == ()


@pytest.mark.parametrize("scale", [0.9, 1.15])
def test_scans_that_turn_farther_or_less_far_than_the_wheels_are_told(scale):
    scans = drive(8)
    found = motion_agreement(moved(scans, lambda s: s * [1.0, 1.0, scale], 0.01), scans, BEAM)
    assert found.turn.value == pytest.approx(scale, abs=0.02)
    told = {f.code: f.value for f in found.findings("1")}
    assert told["wheels-turns"] == {"value": found.turn.value, "sd": found.turn.sd}  # the hall's walls are straight


@pytest.mark.parametrize(("walls", "code"), [(None, "turns-scale"), (0.5, "turns-scale"), (0.1, "beams-apart")])
def test_turns_that_differ_are_the_beams_fault_where_walls_are_bent_and_nobodys_where_none_tells(walls, code):
    found = replace(MotionAgreement(turn=MotionRatio(1.2, 0.01, 50)), walls=walls)
    assert [f.code for f in found.findings("1")] == [code]


@pytest.mark.parametrize("factor", [0.9, 1.15])
def test_walls_are_straight_by_right_angles_and_bent_by_wrong_ones(factor):
    scans = drive(9)
    wrong = [replace(s, angle_min=factor * s.angle_min, angle_increment=factor * s.angle_increment) for s in scans]
    assert straight(scans, factor) > 0.8
    assert straight(wrong, factor) < 0.2
    assert straight([replace(s, hit=~s.hit) for s in scans], factor) is None


@pytest.mark.parametrize(("span", "share"), [(2 * np.pi, 1.0), (1.5 * np.pi, None)])
def test_angles_that_close_all_round_are_right_where_no_walls_tell(span, share):
    scans = [replace(s, hit=~s.hit, angle_increment=span / len(s.ranges)) for s in drive(9)]
    assert straight(scans, 0.85) == share


@pytest.mark.parametrize("factor", [0.9, 1.15])
def test_bent_walls_deny_angles_that_close_all_round(factor):
    scans = [replace(s, angle_min=factor * s.angle_min, angle_increment=factor * s.angle_increment) for s in drive(9)]
    beams = int(2 * np.pi / scans[0].angle_increment)
    more = [
        replace(s, ranges=np.pad(s.ranges, (0, beams - len(s.ranges))), hit=np.pad(s.hit, (0, beams - len(s.hit))))
        for s in scans
    ]
    assert straight(more, factor) < 0.2


def test_a_bare_corridor_tells_nothing_of_the_way_along_it():
    scans = drive(7, (400.0, 2.0))
    along = [scan for scan in scans if abs(np.sin(scan.odometry[2])) < 0.1]
    assert len(along) > 20
    assert motion_agreement(1.2 * np.array([s.odometry for s in along]), along, BEAM).scale is None


@pytest.mark.parametrize(("course", "n"), [(0.5, 39), (0.0, 0)])
def test_a_way_that_bends_is_told_where_the_walls_at_both_its_ends_stand_across_its_chord(course, n):
    """To and fro in a corridor along x, turned by 0.3 rad on each way: a chord along the walls is not told."""
    ends = MOTION_WAY * np.array([[0.0, 0.0], [np.cos(course), np.sin(course)]])
    poses = np.tile(np.column_stack([ends, course + np.array([0.15, -0.15])]), (20, 1))
    rng = np.random.default_rng(3)
    seen = [ranges(pose, (400.0, 6.0), rng) for pose in poses]
    scans = [
        Scan(np.minimum(r, 30.0), r < 30.0, None, -np.pi / 2, np.pi / 179, 30.0, odometry=pose)
        for r, pose in zip(seen, poses, strict=True)
    ]
    found = motion_agreement(poses, scans, BEAM).scale
    assert (found.n if found else 0) == n


def test_without_odometry_there_is_nothing_to_say():
    scans = [replace(scan, odometry=None) for scan in drive(7)]
    assert motion_agreement(np.zeros((len(scans), 3)), scans, BEAM) == MotionAgreement()
    assert motion_agreement(np.zeros((0, 3)), [], BEAM).findings("1") == ()


def test_ways_follow_each_other_and_leave_turns_and_standing_out():
    x = np.concatenate([np.arange(0.0, 2.0, 0.1), np.full(30, 2.0), np.arange(2.0, 4.0, 0.1)])
    wheels = np.column_stack([x, 0 * x, np.where(x < 3.0, 0.0, 0.8 * (x - 3.0) / 0.5)])
    found = ways(wheels)
    assert len(found) > 4
    assert all(end <= begin for (_, end), (begin, _) in pairwise(found))
    for i, j in found:
        step = se2.between(wheels[i], wheels[j])
        assert abs(step[2]) <= MOTION_TURN
        assert np.hypot(step[0], step[1]) >= MOTION_WAY / 2
    assert ways(np.zeros((50, 3))) == []


def test_a_ratio_is_a_median_and_as_sure_as_medians_of_its_parts_agree():
    rng = np.random.default_rng(5)
    values = rng.normal([[0.9, 0.02]], [[0.05, 0.2]], size=(4000, 2))
    measured = _measured(values)
    for told, true, sd in zip(measured, (0.9, 0.02), (0.05, 0.2), strict=True):
        honest = np.sqrt(np.pi / 2) * sd / np.sqrt(4000)
        assert abs(told.value - true) < 4 * honest
        assert honest / 2.5 < told.sd < 2.5 * np.sqrt(np.pi / 2) * honest
    assert _measured(values[: MOTION_LEAST - 1]) is None
