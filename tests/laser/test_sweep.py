"""Scans that take their time while the robot drives: put right, and which way round is found."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import mapweave.laser.sweep as laser_sweep
from mapweave.core import se2
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.localise import localise
from mapweave.laser.scan_matching import FrontEndConfig
from mapweave.laser.sweep import sweep_of, swept, swept_by_wheels
from mapweave.mapping import laser_mapping
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser import DriftConfig, DriveConfig, Scanner
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

SWEEP = 0.15  # [s] of a revolution
ROUND = Scanner(beams=360, opening=np.radians(359.0), far=10.0)
HALF = replace(ROUND, opening=np.radians(240.0))


@cache
def drive(sweep, scanner=ROUND, seed=0):
    cfg = DriveConfig(
        scan_every=0.12, odometry_every=0.03, speed=0.8, sweep=sweep, scanner=scanner, drift=DriftConfig(end_error=None)
    )
    return simulate_office(OfficeConfig(rooms=2, visited=2, drive=cfg), seed)


def truth(sim):
    return se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)


def asked(log):
    return sweep_of(log, BeamConfig(), FrontEndConfig())


def without_wheels(log):
    return replace(log, odometry=None, scans=tuple(replace(scan, odometry=None) for scan in log.scans))


def off_walls(sim, scan, pose):
    """How far the median return lies from the nearest wall [m], seen from the true pose."""
    s = se2.act(pose, beams(scan, "none", None, BeamConfig()).s)
    a = sim.world.segments[:, :2]
    e = sim.world.segments[:, 2:] - a
    share = np.clip(((s[:, None] - a) * e).sum(axis=2) / (e * e).sum(axis=1), 0.0, 1.0)
    return np.median(np.hypot(*np.moveaxis(s[:, None] - a - share[..., None] * e, 2, 0)).min(axis=1))


@pytest.mark.parametrize("sweep", [SWEEP, -SWEEP])
def test_beams_lie_where_the_robot_saw_them_from(sweep):
    sim = drive(sweep)
    at = truth(sim)
    step = se2.between(at[:-2], at[2:]) * 0.5
    turning = [k for k in np.argsort(-np.abs(step[:, 2]))[:40].tolist() if abs(step[k, 2]) > 0.05]
    assert len(turning) > 20
    plain, right = [], []
    for k in turning:
        scan = sim.log.scans[k + 1]
        plain.append(off_walls(sim, scan, at[k + 1]))
        right.append(off_walls(sim, swept(scan, step[k], SWEEP, sweep), at[k + 1]))
    assert np.mean(right) < 0.02
    assert np.mean(plain) > 2 * np.mean(right)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("sweep", [SWEEP, -SWEEP])
def test_which_way_round_is_found_in_the_log(sweep, seed):
    log = drive(sweep, seed=seed).log
    assert log.sweep == SWEEP
    assert asked(log) == sweep
    assert asked(without_wheels(log)) == sweep


def test_the_time_of_a_part_of_a_circle_is_taken_as_it_is_stated():
    assert asked(drive(SWEEP, HALF).log) == SWEEP


def test_a_driver_that_states_another_time_means_a_revolution():
    log = replace(drive(-SWEEP).log, sweep=0.0107)
    assert asked(log) == pytest.approx(-SWEEP)
    seldom = replace(log, scan_t=3.0 * log.scan_t)
    assert asked(seldom) == 0.0


@pytest.mark.parametrize("sweep", [SWEEP, -SWEEP, 0.0])
def test_what_no_driver_states_is_found_of_a_scanner_that_sees_all_round(sweep):
    assert asked(replace(drive(sweep).log, sweep=0.0)) == pytest.approx(sweep)
    assert asked(replace(drive(sweep, HALF).log, sweep=0.0)) == 0.0


@pytest.mark.parametrize("stated", [SWEEP, 0.0107])
@pytest.mark.parametrize("seed", [1, 2])
def test_scans_of_one_moment_are_left_so_whatever_time_is_stated(seed, stated):
    assert asked(replace(drive(0.0, seed=seed).log, sweep=stated)) == 0.0


def test_a_short_first_scan_does_not_make_a_part_of_a_circle_of_all():
    log = drive(-SWEEP).log
    first = log.scans[0]
    short = replace(first, ranges=first.ranges[:90], hit=first.hit[:90], intensities=first.intensities[:90])
    assert asked(replace(log, scans=(short, *log.scans[1:]))) == -SWEEP


def test_a_scan_that_takes_longer_than_the_time_to_the_next_ones_is_not_believed():
    assert asked(replace(drive(SWEEP, HALF).log, sweep=2.1 * SWEEP)) == 0.0


def test_scans_of_one_stamp_tell_no_motion():
    log = drive(-SWEEP).log
    t = np.array(log.scan_t)
    t[1::40] = t[:-1:40][: len(t[1::40])]
    assert asked(replace(log, scan_t=t)) == -SWEEP


def test_nothing_is_found_where_nothing_is_told():
    log = drive(SWEEP).log
    few = replace(log, scans=log.scans[:20], scan_t=log.scan_t[:20])
    seldom = replace(log, scan_t=10.0 * log.scan_t)
    elsewhere = replace(log.scans[0], T_robot_sensor=np.array([0.1, 0.0, 0.0]))
    two = replace(log, scans=(elsewhere, *log.scans[1:]))
    assert [asked(one) for one in (few, seldom, two)] == [0.0] * 3
    assert swept(log.scans[3], np.array([0.1, 0.0, 0.1]), 2.0, SWEEP).motion is None
    still = replace(log, scans=two.scans)
    assert swept_by_wheels(still, BeamConfig(), FrontEndConfig()).scans is still.scans


@pytest.mark.parametrize("method", ["graph", "gated"])
def test_a_map_of_swept_scans_is_right(method, monkeypatch):
    sim = drive(-SWEEP)
    errors = []
    for told in ([pytest.approx(-SWEEP)], []):
        made = map_laser(sim.log, LaserConfig(method=method, feature="none"), 0)
        off = se2.between(se2.between(truth(sim)[0], truth(sim)), se2.between(made.scans.pose[0], made.scans.pose))
        errors.append(np.sqrt(np.mean(off**2, axis=0)))
        assert [f.value for f in made.findings if f.code == "scans-swept"] == told
        monkeypatch.setattr(laser_mapping, "sweep_of", lambda *_: 0.0)
    assert errors[0][2] < 0.02
    assert np.hypot(*errors[0][:2]) < 0.08
    assert errors[1][2] > 2 * errors[0][2]


def test_a_robot_under_a_scanner_that_turns_is_found_in_a_map(monkeypatch):
    sim, other = drive(-SWEEP), drive(0.0)
    made = map_laser(other.log, LaserConfig(feature="none"), 0)
    errors = []
    for _ in range(2):
        start, chance = np.zeros(3), np.random.default_rng(0)
        found = localise(sim.log, made.grid, None, "none", LaserConfig(), start, chance, lambda *_: None)
        assert [f.value for f in found.findings if f.code == "scans-swept"] == ([] if errors else [-SWEEP])
        poses = se2.interpolate(sim.log.scan_t, found.track.t, found.track.pose)
        off = se2.between(se2.between(truth(sim)[0], truth(sim)), poses)
        errors.append(np.sqrt(np.mean(off**2, axis=0)))
        monkeypatch.setattr(laser_sweep, "sweep_of", lambda *_: 0.0)
    assert (errors[0] < errors[1]).all()
    assert errors[0][2] < 0.5 * errors[1][2]
