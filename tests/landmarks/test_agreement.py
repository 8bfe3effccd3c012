"""Wheels and sightings that speak of one motion are left alone; wrong signs, units and mountings are found and told."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Odometry
from mapweave.landmarks.agreement import Agreement, AgreementConfig, Scale, with_wheels_checked
from mapweave.landmarks.config import EkfSlamConfig

EKF = EkfSlamConfig()
CFG = AgreementConfig()


def a_log(seed: int) -> LandmarkLog:
    """Three minutes among twelve posts; the robot turns 0.92 of what it is told, 0.15 s late."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 180.0, 0.1)
    v = np.repeat(rng.uniform(0.05, 0.25, 90), 20)
    w = np.repeat(rng.uniform(-0.5, 0.5, 90), 20)
    posts = rng.uniform(-6, 6, (12, 2))
    heading = np.cumsum(0.92 * w * 0.1)
    place = np.cumsum((v * 0.1)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0)
    rows = []
    for k in range(0, len(t) - 1, 5):
        to = posts - place[k]
        distance, bearing = np.hypot(*to.T), np.angle(np.exp(1j * (np.arctan2(to[:, 1], to[:, 0]) - heading[k])))
        ahead = np.flatnonzero((np.abs(bearing) < 0.6) & (distance > 0.5)).tolist()
        noise = rng.normal(0, (0.05, 0.014), (len(ahead), 2)).tolist()
        rows += [(t[k] + 0.25, i, distance[i] + a, bearing[i] + b) for i, (a, b) in zip(ahead, noise, strict=True)]
    stamps, what, distance, bearing = (np.array(column) for column in zip(*rows, strict=True))
    seen = SightingTable(stamps, what, distance, bearing, tuple(f"P{k}" for k in range(12)))
    return LandmarkLog("robot1", Odometry(t, v, w), seen)


def with_wheels(log: LandmarkLog, speed: float = 1.0, turn: float = 1.0) -> LandmarkLog:
    assert log.odometry is not None
    return replace(log, odometry=Odometry(log.odometry.t, speed * log.odometry.v, turn * log.odometry.w))


def with_sightings(log: LandmarkLog, distance: float = 1.0, bearing: float = 1.0, turned: float = 0.0) -> LandmarkLog:
    s = log.sightings
    seen = SightingTable(s.t, s.what, distance * s.range, bearing * s.bearing + turned, s.ids)
    return replace(log, sightings=seen)


def test_a_scale_is_the_weighted_median_and_tells_how_much_it_explains():
    x = np.array([1.0, -2.0, 4.0, 1.0, 0.0])
    scale = Scale.of(x, np.array([3.0, -6.0, 12.0, -50.0, 7.0]), 6.0)
    assert scale.value == pytest.approx(3.0)
    assert scale.pairs == 4
    assert scale.fit == pytest.approx(1.0 - 53.0 / 71.0)
    assert scale.better == pytest.approx(1.0 - 53.0 / (2 + 4 + 8 + 51))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("speed", "turn"), [(1.0, 1.0), (0.9, 0.6), (1.2, 1.5)])
def test_wheels_of_another_calibration_are_left_to_the_estimator(seed, speed, turn):
    log = with_wheels(a_log(seed), 1 / speed, 1 / turn)
    assert with_wheels_checked(log, EKF) is log
    found = Agreement.of(log.sightings, log.odometry, EKF)
    assert found.speed.value == pytest.approx(speed, rel=0.1)
    assert found.turn.value == pytest.approx(0.92 * turn, rel=0.15)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("speed", "turn", "told"),
    [
        (1.0, -1.0, "run against its turns"),
        (1.0, 180 / np.pi, "its turns are taken as degrees a second"),
        (-1.0, 1.0, "its speeds are taken with the other sign"),
        (3.6, 1.0, "its speeds are taken as km/h"),
        (100.0, 1.0, "its speeds are taken as cm/s"),
        (-1000.0, -180 / np.pi, "its speeds are taken with the other sign and as mm/s"),
    ],
)
def test_wheels_of_another_sign_or_unit_are_mended_and_it_is_told(seed, speed, turn, told):
    right = a_log(seed)
    mended = with_wheels_checked(with_wheels(right, speed, turn), EKF)
    assert told in " ".join(mended.warnings)
    np.testing.assert_allclose(mended.odometry.v, right.odometry.v, rtol=1e-12)
    np.testing.assert_allclose(mended.odometry.w, right.odometry.w, rtol=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_wheels_are_left_out_where_the_sensor_looks_aside_or_no_unit_fits(side):
    log = a_log(4)
    looks = with_wheels_checked(with_sightings(log, turned=side * np.pi / 2), EKF)
    assert looks.odometry is None
    assert ("left" if side > 0 else "right") in looks.warnings[0]
    feet = with_wheels_checked(with_sightings(log, distance=1 / 0.3048), EKF)
    assert feet.odometry is None
    assert "not in metres" in feet.warnings[0]
    assert feet.log_hash == with_sightings(log, distance=1 / 0.3048).log_hash


def test_degrees_and_millimetres_are_one_clear_error():
    with pytest.raises(DataError, match=r"robot1: \d+% of its bearings are beyond a full turn.*degrees"):
        with_wheels_checked(with_sightings(a_log(5), bearing=180 / np.pi), EKF)
    with pytest.raises(DataError, match=r"robot1: its ranges change \d+ times what its speed says: expected metres"):
        with_wheels_checked(with_sightings(a_log(5), distance=1000.0), EKF)


def test_wheels_of_another_robot_are_left_out_and_said_to_be_so():
    log, other = a_log(7), a_log(8)
    made = with_wheels_checked(replace(log, odometry=other.odometry), EKF)
    assert made.odometry is None
    assert "do not follow its turns" in made.warnings[0]


def test_a_few_absurd_commands_do_not_condemn_the_wheels():
    log = a_log(9)
    v, w = log.odometry.v.copy(), log.odometry.w.copy()
    v[500:503], w[900] = 1e200, -1e6
    absurd = replace(log, odometry=Odometry(log.odometry.t, v, w))
    assert with_wheels_checked(absurd, EKF) is absurd


def test_what_hardly_shows_is_not_judged():
    log = with_wheels(a_log(6), -1.0, -1.0)
    few = replace(log, sightings=log.sightings.select(np.arange(20)))
    assert with_wheels_checked(few, EKF) is few
    bare = replace(log, odometry=None)
    assert with_wheels_checked(bare, EKF) is bare
