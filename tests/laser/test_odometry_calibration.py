"""Wheels and mounting from a log itself: planted faults are found within their standard errors, and mapped away."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.laser.beam import BeamConfig
from mapweave.laser.odometry_calibration import (
    NOMINAL,
    PARAMETERS,
    OdometryCalibration,
    OdometryCalibrationConfig,
    OdometryFit,
    WheelNoise,
    calibrate_odometry,
    corrected,
    dead_reckoning,
    is_stated,
    sensor_poses,
    standard_errors,
    with_lag,
)
from mapweave.mapping import laser_mapping
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser_worlds import CorridorConfig, OfficeConfig, simulate_corridor, simulate_office

CFG, BEAM = OdometryCalibrationConfig(), BeamConfig()
GRAPH = LaserConfig(method="graph")
PLANTED = {
    "speed_scale": 1.03,
    "turn_scale": 1.05,
    "turn_per_m": 0.05,
    "lag": 0.3,
    "sensor_x": 0.2,
    "sensor_y": 0.1,
    "sensor_yaw": 0.15,
}


@pytest.fixture(scope="module")
def office():
    return simulate_office(OfficeConfig(rooms=2, visited=2), 5)


def at(p):
    """`NOMINAL` with these values."""
    out = NOMINAL.copy()
    for name, value in p.items():
        out[PARAMETERS.index(name)] = value
    return out


def planted(log, p):
    """The log that is right again when it is corrected by the parameters `p`, for one of them that is not nominal."""
    (k,) = np.flatnonzero(p != NOMINAL)
    name = PARAMETERS[k]
    if name.startswith("sensor"):
        off = -p[[5, 6, 7]]
        return replace(log, scans=tuple(replace(s, T_robot_sensor=s.T_robot_sensor + off) for s in log.scans))
    if name == "lag":
        t = log.scan_t + p[k]
        own = se2.interpolate(t, log.odometry.t, log.odometry.pose)
        return replace(log, scan_t=t, scans=tuple(replace(s, odometry=o) for s, o in zip(log.scans, own, strict=True)))
    inverse = at({name: 1.0 / p[k] if k < 2 else -p[k]})
    wrong = dead_reckoning(log.odometry.t, log.odometry.pose, inverse)
    own = se2.interpolate(log.scan_t, log.odometry.t, wrong)
    scans = tuple(replace(s, odometry=o) for s, o in zip(log.scans, own, strict=True))
    return replace(log, scans=scans, odometry=Track(log.odometry.t, wrong, frame="odom"))


def seen_by_scans(sim, rng):
    """Where the scanner stood, as good as matching tells it."""
    true = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
    return se2.compose(true, rng.normal(0.0, [0.003, 0.003, 0.0015], (len(true), 3)))


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_found_within_three_standard_errors(office, name):
    sensor = seen_by_scans(office, np.random.default_rng(0))
    before = calibrate_odometry(office.log, sensor, BEAM)
    k = PARAMETERS.index(name)
    p = at({name: PLANTED[name]})
    found = calibrate_odometry(planted(office.log, p), sensor, BEAM)
    true = before.value[k] * p[k] if k < 2 else before.value[k] + p[k]
    assert found.observed[k]
    assert abs(found.value[k] - true) < 3.0 * found.sd[k]
    assert abs(p[k] - NOMINAL[k]) > 5.0 * found.sd[k] or name == "speed_scale"


def test_standard_errors_hold_on_drives_whose_wheels_err_for_metres_on_end():
    """What was planted lies within 3 standard errors in 99 of 100, and they are not so wide that all would."""
    z = []
    for seed in range(200, 230):
        sim = simulate_office(OfficeConfig(rooms=2, visited=2), seed)
        found = calibrate_odometry(sim.log, seen_by_scans(sim, np.random.default_rng(seed)), BEAM)
        steps = [se2.between(t.pose[:-1], t.pose[1:])[:, 0].sum() for t in (sim.truth, sim.log.odometry)]
        true = at({"turn_per_m": -sim.heading_bias, "speed_scale": steps[0] / steps[1]})
        z.append(np.where(found.observed, (found.value - true) / found.sd, np.nan))
    z = np.array(z)
    known = z[np.isfinite(z)]
    assert len(known) >= 200
    assert np.mean(np.abs(known) <= 3.0) >= 0.99
    assert (np.nanmean(z[:, [0, 1, 2, 5, 6, 7]] ** 2, axis=0) > 0.1).all()


def test_a_robot_that_never_turns_tells_no_place_of_its_scanner():
    sim = simulate_corridor(CorridorConfig(distance=25.0), 3)
    found = calibrate_odometry(sim.log, seen_by_scans(sim, np.random.default_rng(1)), BEAM)
    for name in ("sensor_x", "sensor_y", "turn_scale", "turn_per_s"):
        k = PARAMETERS.index(name)
        assert not found.observed[k]
        assert found.value[k] == NOMINAL[k]
        assert np.isinf(found.sd[k])
    assert found.observed[PARAMETERS.index("sensor_yaw")]


def test_nothing_is_told_without_wheels_or_of_a_few_scans(office):
    sensor = seen_by_scans(office, np.random.default_rng(0))
    bare = replace(office.log, scans=tuple(replace(s, odometry=None) for s in office.log.scans), odometry=None)
    few = replace(office.log, scan_t=office.log.scan_t[:5], scans=office.log.scans[:5])
    assert calibrate_odometry(bare, sensor, BEAM) is None
    assert calibrate_odometry(few, sensor[:5], BEAM) is None


def test_wheels_of_another_drive_tell_nothing(office):
    other = simulate_office(OfficeConfig(rooms=2, visited=2), 6).log
    scans = tuple(replace(s, odometry=o.odometry) for s, o in zip(office.log.scans, other.scans, strict=False))
    log = replace(office.log, scan_t=office.log.scan_t[: len(scans)], scans=scans, odometry=None)
    sensor = seen_by_scans(office, np.random.default_rng(0))[: len(scans)]
    assert calibrate_odometry(log, sensor, BEAM) is None


def test_wheels_of_another_unit_are_found_with_the_factor(office):
    sensor = seen_by_scans(office, np.random.default_rng(0))
    found = calibrate_odometry(planted(office.log, at({"speed_scale": 1000.0})), sensor, BEAM)
    assert found.value[0] == pytest.approx(1000.0, rel=0.05)
    assert found.worth(stated=False)[0]


@pytest.mark.parametrize("name", PLANTED)
def test_a_corrected_log_tells_the_motion_of_the_right_one(office, name):
    p = at({name: PLANTED[name]})
    wrong = planted(office.log, p)
    known = OdometryCalibration(p, np.ones(8), p > -9, p != NOMINAL, WheelNoise(), 0.5, 0.0, 100)
    log = corrected(wrong, known)
    assert np.isin(wrong.stamps(), log.odometry.t).all()
    assert np.allclose(log.scan_t, office.log.scan_t)
    own = np.array([s.odometry for s in log.scans])
    right = np.array([s.odometry for s in office.log.scans])
    held = log.scan_t >= wrong.odometry.t[0]
    steps = [se2.between(a[held][:-1], a[held][1:]) for a in (own, right)]
    assert np.allclose(*steps, atol=2e-3)
    mounts = [np.array([s.T_robot_sensor for s in one.scans]) for one in (log, office.log)]
    assert np.allclose(*mounts)


def test_only_what_is_sure_and_matters_is_worth_applying():
    sd = np.full(8, 1e-3)
    off = at({"speed_scale": 1.01, "turn_scale": 1.3, "lag": 0.1, "sensor_x": 0.1, "sensor_yaw": 0.2})
    known = OdometryCalibration(off, sd, np.ones(8, bool), np.zeros(8, bool), WheelNoise(), 0.5, 5.0, 100)
    names = lambda c, stated: [PARAMETERS[k] for k in np.flatnonzero(c.worth(stated=stated))]
    assert names(known, False) == ["turn_scale", "sensor_yaw"]
    assert names(known, True) == ["turn_scale", "sensor_x", "sensor_yaw"]
    assert names(replace(known, unheld=50.0), False) == ["speed_scale", "turn_scale", "sensor_yaw"]
    assert names(replace(known, sd=np.full(8, 1.0)), True) == []
    assert names(replace(known, observed=np.zeros(8, bool)), True) == []


def test_a_value_that_is_usual_is_taken_where_it_is_as_likely():
    value = at({"lag": 0.2987, "sensor_x": -0.198, "sensor_y": 0.12, "sensor_yaw": -1.569})
    every = np.ones(8, bool)
    known = OdometryCalibration(value, np.full(8, 2e-3), every, every, WheelNoise(), 0.5, 5.0, 100)
    taken = known.usual(np.array([0.2, 0.0, 0.0]))
    assert np.allclose(taken.value[4:], [0.3, -0.2, 0.12, -np.pi / 2])
    assert np.array_equal(replace(known, sd=np.full(8, 1e-5)).usual(np.zeros(3)).value, value)
    assert np.array_equal(replace(known, applied=~every).usual(np.zeros(3)).value, value)


def test_what_wheels_are_worth_is_found_and_grows_with_the_way():
    rng = np.random.default_rng(4)
    sim = simulate_office(seed=11)
    true = se2.interpolate(sim.log.odometry.t, sim.truth.t, sim.truth.pose)
    step = se2.between(true[:-1], true[1:])
    way, turn = np.hypot(*step[:, :2].T), np.abs(step[:, 2])
    for place, heading, by_turn in ((0.01, 0.004, 0.02), (0.08, 0.03, 0.1)):
        noise = np.column_stack(
            [
                place * np.sqrt(way) * rng.standard_normal(len(way)),
                place * np.sqrt(way) * rng.standard_normal(len(way)),
                np.sqrt(heading**2 * way + by_turn**2 * turn) * rng.standard_normal(len(way)),
            ]
        )
        poses = [true[0]]
        for one in step + noise:
            poses.append(np.asarray(se2.compose(poses[-1], one)))
        poses = np.array(poses)
        own = se2.interpolate(sim.log.scan_t, sim.log.odometry.t, poses)
        scans = tuple(replace(s, odometry=o) for s, o in zip(sim.log.scans, own, strict=True))
        log = replace(sim.log, scans=scans, odometry=Track(sim.log.odometry.t, poses, frame="odom"))
        worth = calibrate_odometry(log, seen_by_scans(sim, rng), BEAM).noise
        assert worth.observed
        assert 0.7 * place < worth.place < 2.0 * place
        assert abs(worth.turn_per_m - heading) < 0.5 * heading + 3 * worth.turn_per_m_sd
        assert abs(worth.turn - by_turn) < 0.5 * by_turn + 3 * worth.turn_sd
        assert worth.good == (place < 0.05)
    assert not WheelNoise().good
    small, large = (np.diag(worth.covariance(np.array([d, 0.0, 0.5 * d]))) for d in (1.0, 4.0))
    assert np.allclose(large, 4.0 * small, rtol=1e-3)


def test_where_a_log_says_how_far_ahead_its_scanner_stands_is_told(office):
    assert not is_stated(office.log)
    assert not is_stated(planted(office.log, at({"sensor_yaw": 0.2})))
    assert is_stated(planted(office.log, at({"sensor_x": 0.2})))


def test_the_same_calibration_comes_from_its_numbers(office):
    found = calibrate_odometry(office.log, seen_by_scans(office, np.random.default_rng(0)), BEAM)
    again = OdometryCalibration.from_numbers(found.numbers())
    assert again.row() == found.row()
    assert np.array_equal(again.numbers(), found.numbers())


def off(made, sim):
    """Root mean square distance [m] of the trajectory from the truth after one rigid alignment."""
    t = sim.truth.t[(sim.truth.t >= made.track.t[0]) & (sim.truth.t <= made.track.t[-1])]
    p, q = (se2.interpolate(t, one.t, one.pose)[:, :2] for one in (made.track, sim.truth))
    return float(np.sqrt(((se2.act(se2.align(p, q), p) - q) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def right(office):
    return map_laser(office.log, GRAPH, 0)


def test_a_right_log_is_mapped_as_if_nothing_had_been_looked_for(office, right):
    apart = replace(GRAPH, odometry=OdometryCalibrationConfig(apply=False))
    made = map_laser(office.log, apart, 0)
    assert not right.odometry_calibration.applied.any()
    assert right.warnings == made.warnings
    assert right.track.pose.tobytes() == made.track.pose.tobytes()


@pytest.mark.parametrize(
    "name", ["sensor_x", *(pytest.param(n, marks=pytest.mark.slow) for n in ("lag", "sensor_yaw"))]
)
def test_a_fault_that_matters_is_mapped_away_and_told(office, right, name):
    log = planted(office.log, at({name: PLANTED[name]}))
    made = map_laser(log, GRAPH, 0)
    known = made.odometry_calibration
    assert [PARAMETERS[k] for k in np.flatnonzero(known.applied)] == [name]
    assert known.row()[name]["applied"]
    assert made.warnings[-1].startswith("mapped with what scans and wheels tell of each other: ")
    assert off(made, office) < 1.05 * off(right, office) + 0.005
    assert np.isin(log.stamps(), made.track.t).all()
    assert made.scan_hash == log.scan_hash()
    again = sensor_poses(made.scans.pose, corrected(log, known).scans)
    assert not calibrate_odometry(log, again, BEAM).worth(stated=True).sum() > 1


def test_a_lag_that_turns_tell_is_applied_unless_another_was_measured():
    alone = with_lag(None, -0.25)
    assert np.array_equal(alone.used(), at({"lag": -0.25}))
    assert alone.observed.sum() == 1
    every = np.ones(8, bool)
    known = OdometryCalibration(at({"lag": 0.27}), np.full(8, 0.02), every, ~every, WheelNoise(), 0.1, 0.0, 50)
    assert np.array_equal(with_lag(known, 0.25).used(), at({"lag": 0.27}))
    assert np.array_equal(with_lag(known, 0.5).used(), NOMINAL)
    assert np.array_equal(with_lag(replace(known, observed=~every), 0.5).used(), at({"lag": 0.5}))


@pytest.mark.slow
def test_a_lag_that_turns_alone_tell_is_mapped_away(office, right, monkeypatch):
    monkeypatch.setattr(laser_mapping, "calibrate_odometry", lambda *_: None)
    made = map_laser(planted(office.log, at({"lag": 0.3})), GRAPH, 0)
    assert made.odometry_calibration.used()[4] == pytest.approx(0.3, abs=0.051)
    assert "stamp-lag" not in {found.code for found in made.findings}
    assert off(made, office) < 1.05 * off(right, office) + 0.01


def test_wheels_of_another_unit_are_told_where_no_walls_tell_the_way():
    sim = simulate_corridor(seed=33)
    made = map_laser(planted(sim.log, at({"speed_scale": 1000.0})), replace(GRAPH, feature="none"), 0)
    assert {"wheels-unlike", "wheels-disagree"} & {found.code for found in made.findings}


def test_a_variance_that_rounding_made_negative_tells_nothing():
    fit = OdometryFit(np.zeros(8), np.diag([-1e-20, *[1e-4] * 7]), np.zeros((8, 8)), np.zeros((2, 8)), np.zeros((2, 8)))
    sd = standard_errors(fit, np.ones(8, dtype=bool), 0.1)
    assert np.isinf(sd[0])
    assert np.isfinite(sd[1:]).all()
